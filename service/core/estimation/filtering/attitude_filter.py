"""One step of the robust attitude filter: predict, common first, carriers next, update, integrity.

The law of this file: the order of the stages is written here once. A state is a value that a step never changes; the
same rows give the same states bit for bit, and a row that is not newer than the state leaves it as it is. With fewer
than four carriers the filter coasts.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import ask_anchor, is_contradicted, protection_now_deg
from service.core.estimation.filtering.causes.carrier_return import release_quiet
from service.core.estimation.filtering.causes.fault_hypotheses import Cause, Chooser, choose_cause
from service.core.estimation.filtering.declared_effects import with_declared
from service.core.estimation.filtering.filter_predict import Weather, predict, waiting_loss_deg
from service.core.estimation.filtering.filter_records import FilterState, FilterStep, start
from service.core.estimation.filtering.filter_update import site_db
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    CarrierModel,
    FilterSettings,
    FloatArray,
    KnownMotion,
)
from service.core.estimation.filtering.model.filter_state import ATTITUDE, CHAIN, RAIN, hidden_count
from service.core.estimation.filtering.model.step_inputs import StepInputs, step_inputs
from service.core.estimation.filtering.new_start import start_again
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, RowKernels
from service.core.estimation.filtering.rows.row_stages import (
    MIN_CARRIERS,
    OrdinaryRow,
    state_ahead,
)
from service.core.estimation.filtering.rows.staged_row import JudgedRow, staged_row
from service.core.estimation.filtering.watches.command_watch import (
    CommandWatch,
    believed_motion,
    doubting_settings,
    pass_commands,
)
from service.core.estimation.filtering.watches.drift_watch import scaled_settings
from service.core.estimation.filtering.watches.integrity import IntegrityInputs, IntegrityLimits, assess

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
    if epoch_us <= state.epoch_us:
        return _unused(model, settings, state, limits, deviation_db)
    passed = _passed(model, settings, state, epoch_us - state.epoch_us, known)
    row = _row(state, deviation_db, passed.step.minutes, declared, reported_wet)
    is_enough = len(row.present) >= MIN_CARRIERS
    if is_enough and declared is None:
        found = kernels.ordinary_row(
            model, state, passed.step, passed.command, settings.drift_deg_h, row.deviation_db, row.present
        )
        if found.is_ordinary:
            return _judged(model, settings, found, row, None, limits, kernels)
    ahead = _ahead(model, passed, state, declared, kernels)
    if not is_enough:
        return _unused(model, settings, ahead, limits, deviation_db)
    white_db2 = (model.white_sigma_db * ahead.noise.white_scale) ** 2
    if declared is not None:
        white_db2 = white_db2 + declared.white_db**2
    found, cause = staged_row(model, settings, ahead, row, white_db2, chooser)
    judged = _judged(model, settings, found, row, cause, limits, kernels)
    return judged if declared is None else judged._replace(residual_db=_left_db(model, judged.state, deviation_db))


class _Passed(NamedTuple):
    """Step of time before it is applied to the state: its inputs, and the watch on commands after it."""

    settings: FilterSettings
    known: KnownMotion
    step: StepInputs
    command: CommandWatch


def _passed(
    model: CarrierModel, settings: FilterSettings, state: FilterState, step_us: int, known: KnownMotion
) -> _Passed:
    """Return what a step of time brings, with the drift that was learned and the share of commands that is believed."""
    is_raining, from_us, hidden = state.rain.is_raining, state.epoch_us, hidden_count(model, len(state.gaussian.mean))
    now = doubting_settings(scaled_settings(settings, state.drift), state.command)
    believed = believed_motion(state.command, known)
    command = pass_commands(
        model,
        now,
        state.command,
        step_us,
        known,
        state.carriers.is_flagged,
        is_raining=is_raining,
        from_us=from_us,
        hidden=hidden,
    )
    followed = state.motion.is_followed
    step = step_inputs(model, now, hidden, step_us, believed, followed, is_raining=is_raining, from_us=from_us)
    return _Passed(now, believed, step, command)


def _ahead(
    model: CarrierModel, passed: _Passed, state: FilterState, declared: Declared | None, kernels: RowKernels
) -> FilterState:
    """Return the predicted state with the detectors as much later."""
    rain, followed = state.rain.is_raining, state.motion.is_followed
    weather = Weather(rain, followed, state.noise.slow_scale, state.model_variance_db2, declared)
    now, step_us, known = passed.settings, passed.step.step_us, passed.known
    predicted, variance = predict(
        model, now, state.gaussian, step_us, known, weather, kernels.move_state, state.epoch_us
    )
    ahead = state_ahead(state, passed.step, predicted, variance, passed.command)
    return ahead if declared is None else with_declared(model, ahead, declared)


def _row(
    state: FilterState,
    deviation_db: FloatArray,
    minutes: float,
    declared: Declared | None,
    reported_wet: FloatArray | None,
) -> JudgedRow:
    """Return the row without the carriers that are not to be used."""
    is_there = np.isfinite(deviation_db)
    if declared is None:
        present = (is_there & ~state.carriers.is_flagged).nonzero()[0]
        return JudgedRow(deviation_db, present, is_there, minutes, declared, reported_wet)
    used_db = np.where(declared.is_masked, np.nan, deviation_db)
    present = np.flatnonzero(is_there & ~declared.is_masked & ~state.carriers.is_flagged)
    return JudgedRow(used_db, present, is_there | declared.is_masked, minutes, declared, reported_wet)


def _judged(
    model: CarrierModel,
    settings: FilterSettings,
    found: OrdinaryRow,
    row: JudgedRow,
    cause: Cause | None,
    limits: IntegrityLimits,
    kernels: RowKernels,
) -> FilterStep:
    """Return the step after a row that was taken: carriers that come back, the references' answer, integrity."""
    after = found.state
    if found.is_returning:
        gaussian, carriers = release_quiet(model, after.gaussian, after.carriers)
        after = after._replace(gaussian=gaussian, carriers=carriers)
    if found.is_due:
        after = _anchored(model, after, row.reported_wet, kernels)
    residual_db = found.residual_db
    if after.gaussian is not found.state.gaussian:
        residual_db = _left_db(model, after, row.deviation_db)
    return _reported(model, settings, after, found, cause, limits, residual_db)


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


def _unused(
    model: CarrierModel,
    settings: FilterSettings,
    state: FilterState,
    limits: IntegrityLimits,
    deviation_db: FloatArray,
) -> FilterStep:
    """Return the step's result after a row of which nothing was used."""
    nothing = OrdinaryRow(
        True,
        state,
        np.full(model.carriers, np.nan),
        np.empty(0, dtype=np.int64),
        _left_db(model, state, deviation_db),
        False,
        False,
        None,
    )
    return _reported(model, settings, state, nothing, None, limits, nothing.residual_db)


def _reported(
    model: CarrierModel,
    settings: FilterSettings,
    state: FilterState,
    found: OrdinaryRow,
    cause: Cause | None,
    limits: IntegrityLimits,
    residual_db: FloatArray,
) -> FilterStep:
    """Return the step's result with the judgement of its integrity."""
    gaussian = state.gaussian
    sigma_deg = gaussian.attitude_sigma_deg
    protection_deg, nominal_deg = protection_now_deg(state.anchor, state.epoch_us, sigma_deg)
    loss_deg = waiting_loss_deg(model, settings, gaussian, state.epoch_us)
    evidence = IntegrityInputs(
        state.epoch_us,
        sigma_deg,
        protection_deg,
        nominal_deg,
        loss_deg,
        len(found.used),
        state.rain.is_raining,
        state.rain.hold_minutes > 0.0,
        state.noise.nis_ratio,
        state.motion.is_unannounced,
        int(np.count_nonzero(state.carriers.is_relearned)),
        model.carriers,
        state.command.is_doubted,
        state.motion.jump_minutes > 0.0,
    )
    integrity, beyond_until_us = assess(evidence, limits, state.beyond_until_us)
    return FilterStep(
        state if beyond_until_us is state.beyond_until_us else state._replace(beyond_until_us=beyond_until_us),
        gaussian.mean[ATTITUDE],
        gaussian.covariance[ATTITUDE, ATTITUDE],
        protection_deg,
        nominal_deg,
        loss_deg,
        found.innovation_db,
        found.used,
        cause,
        float(gaussian.mean[CHAIN]),
        float(gaussian.mean[RAIN]),
        integrity,
        residual_db,
        found.is_ordinary,
        found.effective,
    )
