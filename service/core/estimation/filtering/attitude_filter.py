"""One step of the robust attitude filter: predict, common first, carriers next, update, integrity.

The law of this file: the order of the stages is written here once. A state is a value that a step never changes; the
same rows give the same states bit for bit, and a row that is not newer than the state leaves it as it is. With fewer
than four carriers the filter coasts.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import protection_now_deg
from service.core.estimation.filtering.causes.carrier_faults import (
    SAME_LEVEL_DB,
    count_absence,
    count_skips,
    flag_failed,
    push_carrier_values,
)
from service.core.estimation.filtering.causes.fault_hypotheses import Cause, Chooser, choose_cause
from service.core.estimation.filtering.causes.rain_state import pass_hold, pass_minutes
from service.core.estimation.filtering.declared_effects import is_chain_worked, with_declared
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_records import FilterState, FilterStep, start
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.kernels.kernels import ARRAYS, Kernels
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    BoolArray,
    CarrierModel,
    FilterSettings,
    FloatArray,
    IntArray,
    KnownMotion,
)
from service.core.estimation.filtering.model.filter_state import ATTITUDE, CHAIN, RAIN, hidden_count
from service.core.estimation.filtering.model.hidden_motion import with_doubted_torque
from service.core.estimation.filtering.model.torque_prior import is_pushed
from service.core.estimation.filtering.row_stages import (
    common_first,
    is_shared,
    minute_update,
    moved,
    trusted,
    with_anchor,
)
from service.core.estimation.filtering.watches.command_watch import (
    believed_motion,
    doubting_settings,
    judge_commands,
    pass_commands,
    push_row,
)
from service.core.estimation.filtering.watches.drift_watch import push_drift, scaled_settings
from service.core.estimation.filtering.watches.integrity import IntegrityInputs, IntegrityLimits, assess
from service.core.estimation.filtering.watches.motion_watch import newly_explained, pass_motion

__all__ = ["MIN_CARRIERS", "FilterState", "FilterStep", "start", "step"]

MIN_CARRIERS = 4


class _Row(NamedTuple):
    """Row with the known motion and declarations of its step."""

    #: (N,) dB, NaN = absent or masked
    deviation_db: FloatArray
    #: (n,) carriers to be judged
    present: IntArray
    #: (N,) carriers that are there, or that nobody expects
    is_accounted: BoolArray
    minutes: float
    declared: Declared | None
    #: (N,) 1 where rain over the station is reported, 0 where none is, NaN where nobody says; None = of no station
    reported_wet: FloatArray | None = None


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
    declared: Declared | None = None,
    reported_wet: FloatArray | None = None,
    kernels: Kernels = ARRAYS,
) -> FilterStep:
    """Return the filter after one row.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The spacecraft.
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
    declared : Declared, optional
        What the ground declared about the time since the state's epoch.
    reported_wet : ndarray, shape (N,), optional
        1 where rain over the carrier's station is reported, 0 where none is, NaN where nobody says.
    kernels : Kernels
        Who does the arithmetic.

    Returns
    -------
    FilterStep
        New state, attitude, what was used, whether control may use it.
    """
    limits = limits or IntegrityLimits()
    nothing = np.full(model.carriers, np.nan)
    if epoch_us <= state.epoch_us:
        return _reported(model, state, nothing, np.empty(0, dtype=np.int64), None, limits)
    step_us = epoch_us - state.epoch_us
    minutes = min(step_us / 60e6, 1.0)
    ahead = _ahead(model, settings, state, step_us, known, declared, kernels)
    row = _row(ahead, deviation_db, minutes, declared)._replace(reported_wet=reported_wet)
    if len(row.present) < MIN_CARRIERS:
        return _reported(model, ahead, nothing, row.present[:0], None, limits)
    return _judged(model, settings, ahead, row, limits, chooser, kernels)


def _ahead(
    model: CarrierModel,
    settings: FilterSettings,
    state: FilterState,
    step_us: int,
    known: KnownMotion,
    declared: Declared | None,
    kernels: Kernels,
) -> FilterState:
    """Return the predicted state with the detectors as much later."""
    minutes = min(step_us / 60e6, 1.0)
    weather = Weather(
        state.rain.is_raining,
        state.motion.is_followed,
        state.noise.slow_scale,
        state.model_variance_db2,
        declared,
    )
    now = doubting_settings(scaled_settings(settings, state.drift), state.command)
    believed = believed_motion(state.command, known)
    predicted, variance = predict(model, now, state.gaussian, step_us, believed, weather, kernels, state.epoch_us)
    is_flagged, is_raining = state.carriers.is_flagged, state.rain.is_raining
    ahead = state._replace(
        epoch_us=state.epoch_us + step_us,
        gaussian=predicted,
        rain=pass_hold(state.rain, minutes),
        motion=pass_motion(state.motion, minutes),
        model_variance_db2=variance,
        command=pass_commands(
            model,
            now,
            state.command,
            step_us,
            known,
            is_flagged,
            is_raining=is_raining,
            from_us=state.epoch_us,
            hidden=hidden_count(model, len(predicted.mean)),
        ),
    )
    return ahead if declared is None else with_declared(model, ahead, declared)


def _row(ahead: FilterState, deviation_db: FloatArray, minutes: float, declared: Declared | None) -> _Row:
    """Return the row without the carriers that are not to be used."""
    is_there = np.isfinite(deviation_db)
    if declared is None:
        return _Row(deviation_db, np.flatnonzero(is_there & ~ahead.carriers.is_flagged), is_there, minutes, declared)
    used_db = np.where(declared.is_masked, np.nan, deviation_db)
    present = np.flatnonzero(is_there & ~declared.is_masked & ~ahead.carriers.is_flagged)
    return _Row(used_db, present, is_there | declared.is_masked, minutes, declared)


def _judged(
    model: CarrierModel,
    settings: FilterSettings,
    ahead: FilterState,
    row: _Row,
    limits: IntegrityLimits,
    chooser: Chooser,
    kernels: Kernels,
) -> FilterStep:
    """Test, update and watch a row of enough carriers."""
    white_db2 = (model.white_sigma_db * ahead.noise.white_scale) ** 2
    if row.declared is not None:
        white_db2 = white_db2 + row.declared.white_db**2
    first = second = innovate(model, ahead.gaussian, row.deviation_db, row.present, white_db2, kernels=kernels)
    freed, choice, values = common_first(model, ahead, first, chooser, is_chain_worked=is_chain_worked(row.declared))
    if is_shared(choice):
        second = innovate(model, freed.gaussian, row.deviation_db, row.present, white_db2, kernels=kernels)
    excess = np.abs(second.innovation_db) / second.sigma_db
    kept = trusted(second, excess)
    watch = count_skips(freed.carriers, row.present, excess, row.minutes)
    watch = count_absence(watch, row.is_accounted, row.minutes)
    if values is not None:
        watch = push_carrier_values(watch, values)
    updated, after = None, freed
    if len(kept.carriers) >= MIN_CARRIERS:
        updated = update(model, freed.gaussian, row.deviation_db, kept, kernels)
        motion = moved(freed, updated, choice, is_pushed=is_pushed(settings))
        axes = newly_explained(freed.motion, motion)
        if is_pushed(settings) and axes.any():
            updated = updated._replace(state=with_doubted_torque(model, updated.state, settings, axes))
        after = freed._replace(gaussian=updated.state, motion=motion)
        command = push_row(model, freed.command, kept, updated.state.covariance, is_shared=is_shared(choice))
        command, gaussian = judge_commands(command, updated.state)
        after = after._replace(gaussian=gaussian, command=command)
    gaussian, watch = flag_failed(model, after.gaussian, watch, ahead.gaussian)
    after = after._replace(gaussian=gaussian, carriers=watch)
    is_noise_declared = None if row.declared is None else row.declared.white_db > 0.0
    after = minute_update(model, after, row.deviation_db, values, updated, is_noise_declared)
    gaussian, rain = pass_minutes(after.gaussian, after.rain, row.minutes)
    if row.declared is not None and row.declared.chain_step_db > SAME_LEVEL_DB:
        # a fall that begins now is counted from where the chain stands now
        rain = rain._replace(base_chain_db=float(gaussian.mean[CHAIN]))
    if values is not None:
        after = after._replace(gaussian=gaussian)
        after = with_anchor(model, after, row.deviation_db, white_db2, row.reported_wet, kernels)
        gaussian = after.gaussian
    drift, gaussian = push_drift(after.drift, settings, gaussian, row.minutes)
    after = after._replace(gaussian=gaussian, rain=rain, drift=drift)
    innovation_db = np.full(model.carriers, np.nan)
    innovation_db[row.present] = first.innovation_db
    return _reported(model, after, innovation_db, kept.carriers, choice.cause if choice else None, limits)


def _reported(
    model: CarrierModel,
    state: FilterState,
    innovation_db: FloatArray,
    used: IntArray,
    cause: Cause | None,
    limits: IntegrityLimits,
) -> FilterStep:
    """Return the step's result with the judgement of its integrity."""
    gaussian = state.gaussian
    sigma_deg = gaussian.attitude_sigma_deg
    protection_deg = protection_now_deg(state.anchor, state.epoch_us, sigma_deg)
    evidence = IntegrityInputs(
        sigma_deg,
        protection_deg,
        len(used),
        state.rain.is_raining,
        state.rain.hold_minutes > 0.0,
        state.noise.nis_ratio,
        state.motion.is_unannounced,
        int(np.count_nonzero(state.carriers.is_relearned)),
        model.carriers,
        state.command.is_doubted,
    )
    return FilterStep(
        state,
        gaussian.mean[ATTITUDE],
        gaussian.covariance[ATTITUDE, ATTITUDE],
        protection_deg,
        innovation_db,
        used,
        cause,
        float(gaussian.mean[CHAIN]),
        float(gaussian.mean[RAIN]),
        assess(evidence, limits),
    )
