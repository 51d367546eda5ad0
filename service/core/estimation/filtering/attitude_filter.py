"""One step of the robust attitude filter: predict, common first, carriers next, update, integrity.

The law of this file: the order of the stages is written here once. A state is a value that a step never changes; the
same rows give the same states bit for bit, and a row that is not newer than the state leaves it as it is. With fewer
than four carriers the filter coasts.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.carrier_faults import (
    SKIPPED,
    CarrierWatch,
    count_absence,
    count_skips,
    flag_failed,
    healthy,
    push_carrier_values,
    release_quiet,
    trusted_white_db2,
    watch_flagged,
)
from service.core.estimation.filtering.common_cause import common_innovation, find_cause, widen
from service.core.estimation.filtering.fault_hypotheses import Cause, Choice, Chooser, choose_cause
from service.core.estimation.filtering.filter_model import (
    CarrierModel,
    FilterSettings,
    FloatArray,
    IntArray,
    KnownMotion,
)
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_state import ATTITUDE, CHAIN, RAIN, Gaussian
from service.core.estimation.filtering.filter_update import Innovation, Updated, innovate, site_db, update
from service.core.estimation.filtering.integrity import Evidence, Integrity, IntegrityLimits, assess
from service.core.estimation.filtering.minute_sums import MinuteSums, empty_minute, push_minute
from service.core.estimation.filtering.motion_watch import (
    MotionWatch,
    follow_all,
    forget_shifts,
    pass_motion,
    push_shift,
    still_watch,
)
from service.core.estimation.filtering.noise_watch import NoiseWatch, calm_watch, push_values
from service.core.estimation.filtering.rain_state import RainWatch, dry_watch, pass_hold, pass_minutes, push_common

MIN_CARRIERS = 4


class FilterState(NamedTuple):
    """Everything that the next step needs."""

    epoch_us: int
    gaussian: Gaussian
    carriers: CarrierWatch
    rain: RainWatch
    noise: NoiseWatch
    #: test values of the carriers, the common one last
    minute: MinuteSums
    motion: MotionWatch
    model_variance_db2: FloatArray


class FilterStep(NamedTuple):
    """State after a row and what is told about it."""

    state: FilterState
    #: (3,) deg and (3, 3) deg^2
    attitude_deg: FloatArray
    covariance_deg2: FloatArray
    #: (N,) dB, NaN = absent or flagged
    innovation_db: FloatArray
    #: (n,) carriers used
    used: IntArray
    cause: Cause | None
    common_db: float
    rain_db: float
    integrity: Integrity


def start(model: CarrierModel, epoch_us: int, gaussian: Gaussian) -> FilterState:
    """Return the state of a filter that was just aligned.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    epoch_us : int, microseconds UTC
        Epoch of the alignment.
    gaussian : Gaussian
        From `initial_gaussian`.
    """
    count = model.carriers
    return FilterState(
        epoch_us,
        gaussian,
        healthy(count),
        dry_watch(),
        calm_watch(count),
        empty_minute(count + 1, epoch_us),
        still_watch(epoch_us),
        np.zeros(count),
    )


def step(
    model: CarrierModel,
    settings: FilterSettings,
    state: FilterState,
    epoch_us: int,
    deviation_db: FloatArray,
    known: KnownMotion,
    *,
    limits: IntegrityLimits | None = None,
    chooser: Chooser = choose_cause,
) -> FilterStep:
    """Return the filter after one row.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The craft.
    state : FilterState
        State before; it is not changed.
    epoch_us : int, microseconds UTC
        Epoch of the row; a row that is not newer than the state changes nothing.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference minus harmonic, NaN = absent.
    known : KnownMotion
        What was commanded since the state's epoch.
    limits : IntegrityLimits, optional
        When control may use the attitude.
    chooser : callable
        ``chooser(model, innovation) -> Choice`` decides what moved several carriers at once.

    Returns
    -------
    FilterStep
        New state, attitude, what was used, whether control may use it.
    """
    limits = limits or IntegrityLimits()
    nothing = np.full(model.carriers, np.nan)
    if epoch_us <= state.epoch_us:
        return _told(model, state, nothing, np.empty(0, dtype=np.int64), None, limits)
    step_us = epoch_us - state.epoch_us
    minutes = min(step_us / 60e6, 1.0)
    weather = Weather(
        state.rain.is_raining,
        state.motion.is_unannounced,
        state.noise.slow_scale,
        state.model_variance_db2,
    )
    predicted, variance = predict(model, settings, state.gaussian, step_us, known, weather)
    ahead = state._replace(
        epoch_us=epoch_us,
        gaussian=predicted,
        rain=pass_hold(state.rain, minutes),
        motion=pass_motion(state.motion, minutes),
        model_variance_db2=variance,
    )
    present = np.flatnonzero(np.isfinite(deviation_db) & ~state.carriers.is_flagged)
    if len(present) < MIN_CARRIERS:
        return _told(model, ahead, nothing, present[:0], None, limits)
    return _judged(model, ahead, deviation_db, present, minutes, limits, chooser)


def _judged(
    model: CarrierModel,
    ahead: FilterState,
    deviation_db: FloatArray,
    present: IntArray,
    minutes: float,
    limits: IntegrityLimits,
    chooser: Chooser,
) -> FilterStep:
    """Test, update and watch a row of enough carriers."""
    white_db2 = (model.white_sigma_db * ahead.noise.white_scale) ** 2
    first = innovate(model, ahead.gaussian, deviation_db, present, white_db2)
    freed, choice, values = _common_first(model, ahead, first, chooser)
    is_common = choice is not None and choice.cause is not Cause.INDEPENDENT
    second = innovate(model, freed.gaussian, deviation_db, present, white_db2) if is_common else first
    excess = np.abs(second.innovation_db) / second.sigma_db
    trusted = _trusted(second, excess)
    watch = count_skips(freed.carriers, present, excess, minutes)
    watch = count_absence(watch, np.isfinite(deviation_db), minutes)
    if values is not None:
        watch = push_carrier_values(watch, values)
    updated, after = None, freed
    if len(trusted.carriers) >= MIN_CARRIERS:
        updated = update(model, freed.gaussian, deviation_db, trusted)
        after = freed._replace(gaussian=updated.state, motion=_moved(freed, updated, is_common=is_common))
    gaussian, watch = flag_failed(model, after.gaussian, watch, ahead.gaussian)
    after = after._replace(gaussian=gaussian, carriers=watch)
    after = _watched(model, after, deviation_db, values, updated)
    gaussian, rain = pass_minutes(after.gaussian, after.rain, minutes)
    after = after._replace(gaussian=gaussian, rain=rain)
    innovation_db = np.full(model.carriers, np.nan)
    innovation_db[present] = first.innovation_db
    return _told(model, after, innovation_db, trusted.carriers, choice.cause if choice else None, limits)


def _common_first(
    model: CarrierModel, state: FilterState, innovation: Innovation, chooser: Chooser
) -> tuple[FilterState, Choice | None, FloatArray | None]:
    """Return the state after the tests of all carriers together, their cause, and the values of a closed minute.

    The values (N,) are for the tests of single carriers; None while a minute lasts, and in a row whose innovations
    belong to a common cause.
    """
    common = common_innovation(model, innovation)
    row = np.full(model.carriers + 1, np.nan)
    row[innovation.carriers] = innovation.innovation_db / innovation.sigma_db
    row[-1] = common.value
    sums, values = push_minute(state.minute, state.epoch_us, row)
    rain = state.rain
    if values is not None:
        rain = push_common(rain, float(values[-1]), float(state.gaussian.mean[CHAIN]))
    choice = find_cause(model, rain, innovation, common, chooser)
    if choice is None or choice.cause is Cause.INDEPENDENT:
        # what single carriers did says nothing about the common level
        heard = state._replace(minute=sums, rain=rain if choice is None else state.rain)
        return heard, choice, None if values is None else values[:-1]
    widened = widen(model, state.gaussian, state.carriers, rain, choice, common)
    motion = follow_all(state.motion) if choice.cause is Cause.ATTITUDE else state.motion
    minute = empty_minute(model.carriers + 1, state.epoch_us)
    freed = state._replace(
        gaussian=widened.gaussian, carriers=widened.carriers, rain=widened.rain, motion=motion, minute=minute
    )
    return freed, choice, None


def _moved(state: FilterState, updated: Updated, *, is_common: bool) -> MotionWatch:
    """Return the watch on motion after an update."""
    motion, epoch_us = state.motion, state.epoch_us
    return forget_shifts(motion, epoch_us) if is_common else push_shift(motion, epoch_us, updated.attitude_shift)


def _trusted(innovation: Innovation, excess: FloatArray) -> Innovation:
    """Return the innovations of the carriers that are not skipped, with Huber's weights."""
    kept = np.flatnonzero(excess <= SKIPPED)
    return Innovation(
        innovation.carriers[kept],
        innovation.innovation_db[kept],
        innovation.predicted_db2[kept][:, kept],
        trusted_white_db2(innovation.white_db2[kept], excess[kept]),
        innovation.core_jacobian[kept],
        innovation.cross[kept],
    )


def _watched(
    model: CarrierModel,
    state: FilterState,
    deviation_db: FloatArray,
    values: FloatArray | None,
    updated: Updated | None,
) -> FilterState:
    """Return the state after what is done once a minute: noise and flagged carriers."""
    if values is None:
        return state
    noise = state.noise
    if updated is not None:
        noise = push_values(noise, values, updated.nis, updated.degrees)
    if not state.carriers.is_flagged.any():
        return state._replace(noise=noise)
    residual_db = deviation_db - site_db(model, state.gaussian.mean)
    gaussian, watch = release_quiet(model, state.gaussian, watch_flagged(state.carriers, residual_db, 1.0))
    return state._replace(gaussian=gaussian, carriers=watch, noise=noise)


def _told(
    model: CarrierModel,
    state: FilterState,
    innovation_db: FloatArray,
    used: IntArray,
    cause: Cause | None,
    limits: IntegrityLimits,
) -> FilterStep:
    """Return what is told about a state."""
    gaussian = state.gaussian
    evidence = Evidence(
        gaussian.attitude_sigma_deg,
        len(used),
        state.rain.is_raining,
        state.rain.hold_minutes > 0.0,
        state.noise.nis_ratio,
        state.motion.is_unannounced,
        int(np.count_nonzero(state.carriers.is_relearned)),
        model.carriers,
    )
    return FilterStep(
        state,
        gaussian.mean[ATTITUDE],
        gaussian.covariance[ATTITUDE, ATTITUDE],
        innovation_db,
        used,
        cause,
        float(gaussian.mean[CHAIN]),
        float(gaussian.mean[RAIN]),
        assess(evidence, limits),
    )
