"""Telemetry of the wheels judged record by record, and watched over six hours.

A record beyond four sigma is left out, one beyond two counts less. Two beyond five in a row are a jump, which thrusters
make: the momentum is freed. Where records keep disagreeing the telemetry is refused until the next alignment, and yaw
is known as if it had told nothing for long. The law of this file: records in, a verdict and the next watch out.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import ATTITUDE, FilterSettings, Gaussian, MomentumModel
from service.core.estimation.filtering.model.sensor_effect import NO_EFFECT, SensorEffect
from service.core.estimation.filtering.model.wheel_momentum import compared, updated_by, with_free_momentum

#: sigmas from which a record counts less, is left out, and is a jump when it comes twice
TRUSTED, GATE, JUMP = 2.0, 4.0, 5.0
#: records are watched with this memory, h
_MEMORY_H = 6.0
#: mean square of the innovations, a degree of freedom, and jumps within the memory from which telemetry is refused
_REFUSED_MEAN, _REFUSED_JUMPS = 2.5, 2.5
#: fewest records of which a mean is judged, and records that the limit counts beside them, so that it is wider for few:
#: chance takes the mean of five beyond 2.5 once in a thousand alignments, beyond 2.75 once in three thousand
_LEAST_RECORDS, _FEW_RECORDS = 5.0, 0.5
#: what telemetry that was refused may have done to the angles, deg, order yaw, roll, pitch
_MISLED_DEG = (0.2, 0.02, 0.02)
#: a jump is reported for this long, us
_REPORTED_US = 3_600_000_000
#: without anything of use for this long yaw is known as without the sensor, us; records of each hour may miss one
SILENT_US = 3 * 3_600_000_000
#: epoch of the newest record before the first
NEVER_US = -(1 << 62)


class MomentumWatch(NamedTuple):
    """State of the judgement; sums forget."""

    #: epoch of the newest record judged, and the record (3,)
    newest_us: int
    newest: FloatArray
    #: records left out in a row
    skipped: int
    #: weights, sum of mean squares of innovations and jumps of the last hours
    records: float
    squares: float
    jumps: float
    jumped_us: int
    is_refused: bool


def fresh_watch() -> MomentumWatch:
    """Return the watch before the first record."""
    return MomentumWatch(NEVER_US, np.zeros(3), 0, 0.0, 0.0, 0.0, NEVER_US, False)


def with_impossible(watch: MomentumWatch) -> MomentumWatch:
    """Return the watch after a record that no wheel can hold: telemetry that begins so is refused."""
    return watch._replace(is_refused=True) if watch.newest_us == NEVER_US else watch


def has_jumped(watch: MomentumWatch, epoch_us: int) -> bool:
    """Return whether a jump that nobody declared is reported at an epoch."""
    return epoch_us - watch.jumped_us < _REPORTED_US


def momentum_advice(watch: MomentumWatch, since_us: int, epoch_us: int, *, is_used: bool) -> dict[str, bool]:
    """Return which advice about the telemetry of the wheels is given at an epoch of a filter that began at another."""
    is_silent = epoch_us - max(watch.newest_us, since_us) > SILENT_US
    return {
        "momentum_refused": watch.is_refused,
        "momentum_jump": has_jumped(watch, epoch_us),
        "momentum_silent": is_used and is_silent and not watch.is_refused,
    }


def push_record(
    watch: MomentumWatch,
    gaussian: Gaussian,
    first: int,
    record_us: int,
    reported: FloatArray,
    epoch_us: int,
    settings: FilterSettings,
    wheels: MomentumModel,
    *,
    is_unloading: bool,
) -> tuple[MomentumWatch, Gaussian, SensorEffect]:
    """Return watch and state after a record (3,) of an epoch, and its effect; the state is of a not earlier epoch.

    Records that are not newer than the newest, or repeat it to the last digit, tell nothing.
    """
    if watch.is_refused or record_us <= watch.newest_us or np.array_equal(reported, watch.newest):
        return watch, gaussian, NO_EFFECT
    is_first = watch.newest_us == NEVER_US
    keep = 0.0 if is_first else math.exp(-(record_us - watch.newest_us) / (_MEMORY_H * 3.6e9))
    watch = watch._replace(
        newest_us=record_us,
        newest=reported,
        records=keep * watch.records,
        squares=keep * watch.squares,
        jumps=keep * watch.jumps,
    )
    effect = SensorEffect(np.arange(first, first + 3)) if is_first else NO_EFFECT
    if is_first or is_unloading:
        gaussian = with_free_momentum(gaussian, first, reported if is_first else None)
    found = compared(gaussian, first, reported, (record_us - epoch_us) / 3.6e9, settings, wheels)
    excess = float(np.abs(found.innovation / np.sqrt(found.covariance.diagonal())).max())
    mean_square = float(found.innovation @ np.linalg.solve(found.covariance, found.innovation)) / 3.0
    if excess > GATE:
        if excess <= JUMP or not watch.skipped:
            return *_judged(watch._replace(skipped=watch.skipped + 1), gaussian, mean_square), effect
        watch = watch._replace(jumps=watch.jumps + 1.0, jumped_us=record_us)
        gaussian = with_free_momentum(gaussian, first)
        found, excess = compared(gaussian, first, reported, (record_us - epoch_us) / 3.6e9, settings, wheels), 0.0
        mean_square = float(found.innovation @ np.linalg.solve(found.covariance, found.innovation)) / 3.0
    if excess > TRUSTED:
        found = found.widened(wheels.sigma_n_m_s**2 * ((excess / TRUSTED) ** 2 - 1.0))
    judged = _judged(watch._replace(skipped=0), updated_by(gaussian, found), mean_square)
    return *judged, effect._replace(update=found)


def _judged(watch: MomentumWatch, gaussian: Gaussian, mean_square: float) -> tuple[MomentumWatch, Gaussian]:
    """Return watch and state after a record of some mean square; the telemetry is refused where they stay too large."""
    watch = watch._replace(records=watch.records + 1.0, squares=watch.squares + min(mean_square, GATE**2))
    is_bad = watch.records >= _LEAST_RECORDS and watch.squares > _REFUSED_MEAN * (watch.records + _FEW_RECORDS)
    if not (is_bad or watch.jumps > _REFUSED_JUMPS):
        return watch, gaussian
    covariance = gaussian.covariance.copy()
    covariance[ATTITUDE, ATTITUDE] += np.diag(np.square(_MISLED_DEG))
    return watch._replace(is_refused=True), Gaussian(gaussian.mean, covariance)
