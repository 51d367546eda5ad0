"""One step of the robust attitude filter: predict, common first, carriers next, update, integrity.

The law of this file: the order of the stages is written here once. A state is a value that a step never changes; the
same rows give the same states bit for bit, and a row that is not newer than the state leaves it as it is. With fewer
than four carriers the filter coasts.
"""

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import ask_anchor, is_contradicted, protection_now_deg
from service.core.estimation.filtering.causes.carrier_return import release_quiet
from service.core.estimation.filtering.causes.fault_hypotheses import Cause, Chooser, choose_cause
from service.core.estimation.filtering.causes.rain_state import pass_hold
from service.core.estimation.filtering.declared_effects import with_declared
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_records import FilterState, FilterStep, start
from service.core.estimation.filtering.filter_update import site_db
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    CarrierModel,
    FilterSettings,
    FloatArray,
    IntArray,
    KnownMotion,
)
from service.core.estimation.filtering.model.filter_state import ATTITUDE, CHAIN, RAIN, hidden_count
from service.core.estimation.filtering.new_start import start_again
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, RowKernels
from service.core.estimation.filtering.rows.row_stages import (
    MIN_CARRIERS,
)
from service.core.estimation.filtering.rows.staged_row import JudgedRow, staged_row
from service.core.estimation.filtering.watches.command_watch import (
    believed_motion,
    doubting_settings,
    pass_commands,
)
from service.core.estimation.filtering.watches.drift_watch import scaled_settings
from service.core.estimation.filtering.watches.integrity import IntegrityInputs, IntegrityLimits, assess
from service.core.estimation.filtering.watches.motion_watch import (
    pass_motion,
)

__all__ = ["MIN_CARRIERS", "FilterState", "FilterStep", "start", "step"]


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
    kernels: RowKernels = ARRAYS,
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
    kernels : RowKernels
        Stages of a row, compiled or not.

    Returns
    -------
    FilterStep
        New state, attitude, what was used, whether control may use it.
    """
    limits = limits or IntegrityLimits()
    nothing = np.full(model.carriers, np.nan)
    if epoch_us <= state.epoch_us:
        return _reported(
            model, state, nothing, np.empty(0, dtype=np.int64), None, limits, _left_db(model, state, deviation_db)
        )
    step_us = epoch_us - state.epoch_us
    minutes = min(step_us / 60e6, 1.0)
    ahead = _ahead(model, settings, state, step_us, known, declared, kernels)
    row = _row(ahead, deviation_db, minutes, declared, reported_wet)
    if len(row.present) < MIN_CARRIERS:
        return _reported(model, ahead, nothing, row.present[:0], None, limits, _left_db(model, ahead, deviation_db))
    found = _judged(model, settings, ahead, row, limits, chooser, kernels)
    return found if declared is None else found._replace(residual_db=_left_db(model, found.state, deviation_db))


def _ahead(
    model: CarrierModel,
    settings: FilterSettings,
    state: FilterState,
    step_us: int,
    known: KnownMotion,
    declared: Declared | None,
    kernels: RowKernels,
) -> FilterState:
    """Return the predicted state with the detectors as much later."""
    minutes = min(step_us / 60e6, 1.0)
    is_raining = state.rain.is_raining
    noise, held_db2 = state.noise.slow_scale, state.model_variance_db2
    weather = Weather(is_raining, state.motion.is_followed, noise, held_db2, declared)
    now = doubting_settings(scaled_settings(settings, state.drift), state.command)
    believed = believed_motion(state.command, known)
    predicted, variance = predict(
        model, now, state.gaussian, step_us, believed, weather, kernels.move_state, state.epoch_us
    )
    command = pass_commands(
        model,
        now,
        state.command,
        step_us,
        known,
        state.carriers.is_flagged,
        is_raining=is_raining,
        from_us=state.epoch_us,
        hidden=hidden_count(model, len(predicted.mean)),
    )
    ahead = state._replace(
        epoch_us=state.epoch_us + step_us,
        gaussian=predicted,
        rain=pass_hold(state.rain, minutes),
        motion=pass_motion(state.motion, minutes),
        model_variance_db2=variance,
        command=command,
    )
    return ahead if declared is None else with_declared(model, ahead, declared)


def _row(
    ahead: FilterState,
    deviation_db: FloatArray,
    minutes: float,
    declared: Declared | None,
    reported_wet: FloatArray | None,
) -> JudgedRow:
    """Return the row without the carriers that are not to be used."""
    is_there = np.isfinite(deviation_db)
    if declared is None:
        present = np.flatnonzero(is_there & ~ahead.carriers.is_flagged)
        return JudgedRow(deviation_db, present, is_there, minutes, declared, reported_wet)
    used_db = np.where(declared.is_masked, np.nan, deviation_db)
    present = np.flatnonzero(is_there & ~declared.is_masked & ~ahead.carriers.is_flagged)
    return JudgedRow(used_db, present, is_there | declared.is_masked, minutes, declared, reported_wet)


def _judged(
    model: CarrierModel,
    settings: FilterSettings,
    ahead: FilterState,
    row: JudgedRow,
    limits: IntegrityLimits,
    chooser: Chooser,
    kernels: RowKernels,
) -> FilterStep:
    """Test, update and watch a row of enough carriers."""
    white_db2 = (model.white_sigma_db * ahead.noise.white_scale) ** 2
    if row.declared is not None:
        white_db2 = white_db2 + row.declared.white_db**2
    found = None
    if row.declared is None:
        found = kernels.ordinary_row(
            model,
            ahead,
            settings.drift_deg_h,
            row.deviation_db,
            row.present,
            row.is_accounted,
            white_db2,
            row.minutes,
        )
    is_ordinary, cause = found is not None and found.is_ordinary, None
    if found is None or not is_ordinary:
        found, cause = staged_row(model, settings, ahead, row, white_db2, chooser)
    after = found.state
    if found.is_returning:
        gaussian, carriers = release_quiet(model, after.gaussian, after.carriers)
        after = after._replace(gaussian=gaussian, carriers=carriers)
    if found.is_due:
        after = _anchored(model, after, row.reported_wet, kernels)
    residual_db = found.residual_db
    if after.gaussian is not found.state.gaussian:
        residual_db = _left_db(model, after, row.deviation_db)
    reported = _reported(model, after, found.innovation_db, found.used, cause, limits, residual_db)
    return reported._replace(is_ordinary=is_ordinary, effective=found.effective)


def _left_db(model: CarrierModel, state: FilterState, deviation_db: FloatArray) -> FloatArray:
    """Return what attitude, chain, rain and common parts of a state leave of deviations (N,), dB."""
    return deviation_db - site_db(model, state.gaussian.mean)


def _anchored(
    model: CarrierModel, state: FilterState, reported_wet: FloatArray | None, kernels: RowKernels
) -> FilterState:
    """Return the state with the answer of the references of the alignment, started again where they demand it."""
    anchor, mixture = ask_anchor(
        model,
        state.anchor,
        state.carriers,
        state.gaussian,
        state.epoch_us,
        is_raining=state.rain.is_raining,
        reported_wet=reported_wet,
        kernels=kernels.anchor,
    )
    state = state._replace(anchor=anchor)
    return start_again(model, state, mixture) if is_contradicted(mixture) else state


def _reported(
    model: CarrierModel,
    state: FilterState,
    innovation_db: FloatArray,
    used: IntArray,
    cause: Cause | None,
    limits: IntegrityLimits,
    residual_db: FloatArray,
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
        residual_db,
    )
