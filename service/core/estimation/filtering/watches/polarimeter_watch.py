"""Angles of a polarimeter judged block by block, and watched over six hours.

A block is some minutes of records. Beyond two sigma it counts less, beyond four it is left out; three in a row that are
left out in quiet co-polar power are a moved feed: the offset is free again. A fade of the co-polar port widens, a deep
one leaves the block out; three hours without a block of use are told. Where blocks keep disagreeing the polarimeter is
refused until the next alignment, and yaw is known as if it had measured nothing for long. At an alignment yaw is known:
a first block beyond two sigma says that a feed does not stand where the calibration saw it, and its offset is free. The
law of this file: blocks in, a verdict and the next watch out.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import ATTITUDE, Gaussian, PolarimeterModel
from service.core.estimation.filtering.model.polarimeter import (
    WANDER,
    compared_angle,
    updated_by_angle,
    with_moved_feed,
)
from service.core.estimation.filtering.model.sensor_effect import NO_EFFECT, SensorEffect
from service.core.estimation.filtering.watches.momentum_watch import SILENT_US

#: sigmas from which a block counts less and is left out
_TRUSTED, _GATE = 2.0, 4.0
#: blocks left out in a row that are a moved feed
_MOVED_BLOCKS = 3
#: blocks are watched with this memory, h
_MEMORY_H = 6.0
#: mean square of the innovations, and moved feeds within the memory, from which a polarimeter is refused
_REFUSED_MEAN, _REFUSED_MOVES = 2.5, 2.5
#: fewest blocks of which a mean is judged
_LEAST_BLOCKS = 12.0
#: what a polarimeter that was refused may have done to the angles, deg, order yaw, roll, pitch
_MISLED_DEG = (0.2, 0.02, 0.02)
#: fade of the co-polar port that is none, one too deep, dB, and sigma of the turn by it, deg/dB: rain lasts for blocks
_QUIET_DB, _DEEP_DB, _RAIN_DEG_DB = 0.3, 5.0, 0.2
#: time in which the power in clear sky is learned upwards and forgotten, h
_RISE_H, _FALL_H = 0.5, 24.0
#: a moved feed is reported for this long, us
_REPORTED_US = 3_600_000_000
NEVER_US = -(1 << 62)


class AngleBlock(NamedTuple):
    """Some minutes of a polarimeter."""

    epoch_us: int
    angle_deg: float
    variance_deg2: float
    #: NaN = not stated
    co_power_dbm: float


class PolarimeterWatch(NamedTuple):
    """State of the judgement; sums forget."""

    #: newest block out of a deep fade, at first the begin of the watch
    heard_us: int
    newest_us: int = NEVER_US
    #: blocks left out in a row
    skipped: int = 0
    #: weights, sum of squares of normalised innovations and moved feeds of the last hours
    blocks: float = 0.0
    squares: float = 0.0
    moves: float = 0.0
    moved_us: int = NEVER_US
    is_refused: bool = False
    #: co-polar power in clear sky
    clear_dbm: float = math.nan


def polarimeter_advice(watches: tuple[PolarimeterWatch, ...], epoch_us: int) -> dict[str, bool]:
    """Return which advice about polarimeters is given at an epoch."""
    return {
        "polarimeter_refused": any(watch.is_refused for watch in watches),
        "polarimeter_moved": any(epoch_us - watch.moved_us < _REPORTED_US for watch in watches),
        "polarimeter_silent": any(epoch_us - one.heard_us > SILENT_US and not one.is_refused for one in watches),
    }


def push_block(
    watch: PolarimeterWatch,
    gaussian: Gaussian,
    first: int,
    block: AngleBlock,
    epoch_us: int,
    polarimeter: PolarimeterModel,
) -> tuple[PolarimeterWatch, Gaussian, SensorEffect]:
    """Return watch and state after a block, and its effect.

    The state is that of an epoch not earlier, its offset stands at `first`.
    """
    if watch.is_refused or block.epoch_us <= watch.newest_us:
        return watch, gaussian, NO_EFFECT
    is_first = watch.newest_us == NEVER_US
    hours = 0.0 if is_first else (block.epoch_us - watch.newest_us) / 3.6e9
    keep, clear_dbm = math.exp(-hours / _MEMORY_H), _clear_dbm(watch.clear_dbm, block.co_power_dbm, hours)
    watch = watch._replace(
        newest_us=block.epoch_us,
        blocks=keep * watch.blocks,
        squares=keep * watch.squares,
        moves=keep * watch.moves,
        clear_dbm=clear_dbm,
    )
    gaussian = with_moved_feed(gaussian, first, polarimeter.offset_walk_deg_sqrt_h * math.sqrt(hours))
    fade_db = 0.0 if math.isnan(block.co_power_dbm) else max(0.0, abs(clear_dbm - block.co_power_dbm) - _QUIET_DB)
    if fade_db > _DEEP_DB:
        return watch, gaussian, NO_EFFECT
    watch = watch._replace(heard_us=block.epoch_us)
    variance_deg2 = block.variance_deg2 + (_RAIN_DEG_DB * fade_db) ** 2
    after_h = (block.epoch_us - epoch_us) / 3.6e9
    found = compared_angle(gaussian, first, block.angle_deg, variance_deg2, epoch_us, after_h, polarimeter)
    if is_first and polarimeter.learned is not None and found.excess > _TRUSTED:
        watch = watch._replace(moved_us=block.epoch_us) if found.excess > _GATE else watch
        gaussian = _with_other_feed(gaussian, first, polarimeter)
        found = compared_angle(gaussian, first, block.angle_deg, variance_deg2, epoch_us, after_h, polarimeter)
    excess = found.excess
    if excess <= _GATE:
        found = found.widened(variance_deg2 * (max(excess / _TRUSTED, 1.0) ** 2 - 1.0))
        judged = _judged(watch._replace(skipped=0), updated_by_angle(gaussian, found), excess**2)
        return *judged, NO_EFFECT._replace(update=found.update)
    watch = watch._replace(skipped=watch.skipped + 1)
    if watch.skipped < _MOVED_BLOCKS or fade_db > 0.0:
        return *_judged(watch, gaussian, excess**2), NO_EFFECT
    moved = watch._replace(skipped=0, moves=watch.moves + 1.0, moved_us=block.epoch_us, blocks=0.0, squares=0.0)
    return *_judged(moved, _with_other_feed(gaussian, first, polarimeter), 0.0), NO_EFFECT


def _with_other_feed(gaussian: Gaussian, first: int, polarimeter: PolarimeterModel) -> Gaussian:
    """Return the state whose offset is free; what a calibration learned of the wave may hold no more."""
    if polarimeter.learned is not None:
        wave = np.arange(first + 1, first + WANDER)
        covariance = gaussian.covariance.copy()
        covariance[wave, wave] += polarimeter.daily_deg**2
        gaussian = Gaussian(gaussian.mean, covariance)
    return with_moved_feed(gaussian, first)


def _clear_dbm(clear_dbm: float, power_dbm: float, hours: float) -> float:
    """Return the power in clear sky: soon where more comes, slowly where less; none is learned of a saturated one."""
    if math.isnan(clear_dbm) or math.isnan(power_dbm) or abs(power_dbm - clear_dbm) > _DEEP_DB:
        return power_dbm if math.isnan(clear_dbm) else clear_dbm
    time_h = _RISE_H if power_dbm > clear_dbm else _FALL_H
    return clear_dbm + (power_dbm - clear_dbm) * -math.expm1(-hours / time_h)


def _judged(watch: PolarimeterWatch, gaussian: Gaussian, square: float) -> tuple[PolarimeterWatch, Gaussian]:
    """Return watch and state after a block of some square; the polarimeter is refused where they stay too large."""
    watch = watch._replace(blocks=watch.blocks + 1.0, squares=watch.squares + min(square, _GATE**2))
    is_bad = watch.blocks >= _LEAST_BLOCKS and watch.squares > _REFUSED_MEAN * watch.blocks
    if not (is_bad or watch.moves > _REFUSED_MOVES):
        return watch, gaussian
    covariance: FloatArray = gaussian.covariance.copy()
    covariance[ATTITUDE, ATTITUDE] += np.diag(np.square(_MISLED_DEG))
    return watch._replace(is_refused=True), Gaussian(gaussian.mean, covariance)
