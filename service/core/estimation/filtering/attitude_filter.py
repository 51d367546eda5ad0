"""One step of the robust attitude filter: predict, common first, carriers next, update, integrity.

The law of this file: the order of the stages is written here once. A state is a value that a step never changes; the
same rows give the same states bit for bit, and a row that is not newer than the state leaves it as it is. With fewer
than four carriers the filter coasts.

A row in which something is found or declared, stage by stage, in Python.

The stages are those of `row_stages`; what the row gives cause for is done between them: the unknown of a common cause
is set free, failed carriers are set aside, commands are judged. The law of this file: common first, carriers next.

New start of the filter where the references of the alignment contradict its attitude.

The attitude is moved by the error that the anchor found and set free; carriers that are likely dry have the reference
of the alignment again, those that are not are set aside. Drift, rates, receiving chain and rain go on as they are. The
rows that follow settle the attitude, so that no reading counts twice.

Effects of declared operations on the detectors of a step; the prediction handles the state vector.

The law of this file: what the ground declared is no fault. A masked carrier is neither used nor missed, a declared
step of levels empties the sums it would have filled, a declared change of the chain holds control as a found one does.
Steps too small to be told from noise, of which an operation that lasts makes one a row, widen the state and no more.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.anchor.anchor_watch import (
    ERROR_SIGMA_DEG,
    ask_anchor,
    is_contradicted,
    moved_anchor,
    protection_now_deg,
)
from service.core.estimation.filtering.anchor.carrier_mixture import DRY, LEARNED, Mixture
from service.core.estimation.filtering.causes.carrier_faults import (
    SAME_LEVEL_DB,
    CarrierWatch,
    flag_failed,
    give_back,
    release_quiet,
    set_aside,
)
from service.core.estimation.filtering.causes.common_cause import (
    HOLD_MINUTES,
    NOTHING,
    SUDDEN_CHANGE,
    Cause,
    Chooser,
    LikeliestCause,
    RainWatch,
    choose_cause,
    widen,
)
from service.core.estimation.filtering.causes.common_change import quiet_cusum, reset_cusum
from service.core.estimation.filtering.filter_predict import Weather, predict, waiting_loss_deg
from service.core.estimation.filtering.filter_records import FilterState, FilterStep, start
from service.core.estimation.filtering.filter_update import innovate, site_db
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    CHAIN,
    RAIN,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    hidden_count,
)
from service.core.estimation.filtering.model.hidden_motion import with_doubted_torque
from service.core.estimation.filtering.model.step_inputs import StepInputs, step_inputs
from service.core.estimation.filtering.model.torque_prior import is_pushed, torque_size_deg_h2
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, RowKernels
from service.core.estimation.filtering.rows.row_stages import (
    MIN_CARRIERS,
    ClosedRow,
    OrdinaryRow,
    ScreenedRow,
    UsedRow,
    close_row,
    screen_row,
    state_ahead,
    use_row,
)
from service.core.estimation.filtering.watches.command_watch import (
    CommandWatch,
    believed_motion,
    doubting_settings,
    is_share_likelier,
    judge_commands,
    pass_commands,
    push_row,
    without_evidence,
)
from service.core.estimation.filtering.watches.drift_watch import scaled_settings
from service.core.estimation.filtering.watches.integrity import IntegrityInputs, IntegrityLimits, assess
from service.core.estimation.filtering.watches.minute_sums import empty_minute
from service.core.estimation.filtering.watches.motion_watch import (
    follow_all,
    forget_shifts,
    newly_explained,
    with_alarms,
    with_explained,
)

#: smallest declared step of an attitude that the watch on motion must not take for its own, deg
_STEP_DEG = 0.05


def with_declared(model: CarrierModel, state: FilterState, declared: Declared) -> FilterState:
    """Return the state whose detectors know what was declared about the step.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : FilterState
        Predicted state.
    declared : Declared
        Effect of the declared operations on the step.
    """
    reported = state._replace(carriers=_levels_declared(model, state.carriers, declared))
    if declared.chain_step_db > SAME_LEVEL_DB:
        rain = state.rain._replace(hold_minutes=HOLD_MINUTES, cusum=quiet_cusum(1))
        reported = reported._replace(rain=rain)
    if np.any(declared.attitude_step_deg > _STEP_DEG):
        reported = reported._replace(motion=forget_shifts(state.motion, state.epoch_us))
    return reported


def is_chain_worked(declared: Declared | None) -> bool:
    """Return whether the receiving chain is being worked on, so that a common fall is not taken for rain."""
    return declared is not None and (declared.chain_walk_db > 0.0 or declared.chain_step_db > SAME_LEVEL_DB)


def stepped_carriers(model: CarrierModel, declared: Declared) -> BoolArray:
    """Return the carriers (N,) whose levels were declared to step, alone or with their transponder."""
    group_db = declared.group_step_db[model.transponder]
    return np.asarray((declared.reference_step_db > SAME_LEVEL_DB) | (group_db > SAME_LEVEL_DB))


def _levels_declared(model: CarrierModel, watch: CarrierWatch, declared: Declared) -> CarrierWatch:
    """Return the watch on carriers of which some were declared to step or not to be used."""
    is_stepped = stepped_carriers(model, declared)
    step_db2 = declared.reference_step_db**2 + declared.group_step_db[model.transponder] ** 2
    return watch._replace(
        skip_minutes=np.where(is_stepped, 0.0, watch.skip_minutes),
        cusum=reset_cusum(watch.cusum, is_stepped),
        absent_minutes=np.where(declared.is_masked, 0.0, watch.absent_minutes),
        saved_variance_db2=watch.saved_variance_db2 + step_db2,
        is_relearned=watch.is_relearned | (declared.reference_step_db > SAME_LEVEL_DB),
    )


#: a hypothesis that is likelier than all others together
_LIKELY = 0.5
#: what a reference may have moved since the alignment, dB
_MOVED_DB = 0.05


def start_again(model: CarrierModel, state: FilterState, mixture: Mixture) -> FilterState:
    """Return the state at the attitude that the references of the alignment ask for, with these references."""
    watch, mean, covariance = state.carriers, state.gaussian.mean.copy(), state.gaussian.covariance.copy()
    # as the anchor was asked: the error that it found, and what the filter did not know before
    sigma_deg = np.hypot(ERROR_SIGMA_DEG, state.gaussian.attitude_sigma_deg)
    anchor = moved_anchor(model, state.anchor, mean[ATTITUDE], sigma_deg, mixture)
    mean[ATTITUDE] += mixture.error_deg
    covariance[ATTITUDE, :] = covariance[:, ATTITUDE] = 0.0
    covariance[ATTITUDE, ATTITUDE] = np.diag(sigma_deg**2)
    is_dry = (mixture.branch_probability[:, DRY] > _LIKELY) & np.isfinite(watch.aligned_reference_db)
    is_out = ~is_dry & ~watch.is_flagged & (mixture.branch_probability[:, LEARNED] < _LIKELY)
    gaussian, watch = give_back(model, Gaussian(mean, covariance), watch, is_dry, _MOVED_DB**2)
    gaussian, watch = set_aside(model, gaussian, watch, is_out, watch.aligned_reference_db, watch.aligned_variance_db2)
    return state._replace(
        gaussian=gaussian,
        anchor=anchor,
        carriers=watch._replace(cusum=quiet_cusum(model.carriers)),
        motion=forget_shifts(state.motion, state.epoch_us),
    )


class JudgedRow(NamedTuple):
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


def staged_row(
    model: CarrierModel,
    settings: FilterSettings,
    ahead: FilterState,
    row: JudgedRow,
    white_db2: FloatArray,
    chooser: Chooser,
) -> tuple[OrdinaryRow, Cause | None]:
    """Return a row taken stage by stage, with what the ground or the row itself gives cause for between them."""
    deviation_db = row.deviation_db
    screened = screen_row(model, ahead, deviation_db, row.present, white_db2)
    freed, cause = _screened(model, ahead, screened, row, chooser)
    is_shared = cause is not None and cause is not Cause.INDEPENDENT
    innovation, values, is_minute = screened.innovation, screened.values, screened.is_minute
    if is_shared:
        innovation = innovate(model, freed.gaussian, deviation_db, row.present, white_db2)
        values, is_minute = np.full(model.carriers, np.nan), False
    used = use_row(model, freed, deviation_db, innovation, row.is_accounted, row.minutes, values, is_shared)
    if used.is_moving or used.is_doubted or used.is_failed:
        used = _with_findings(model, settings, ahead, freed, used)
    closed = close_row(
        model,
        freed,
        used,
        freed.rain,
        settings.drift_deg_h,
        deviation_db,
        white_db2,
        _undeclared(values, row.declared),
        is_minute,
        row.minutes,
    )
    after = freed._replace(
        gaussian=closed.gaussian,
        carriers=closed.carriers,
        noise=closed.noise,
        rain=_declared_base(closed, row.declared),
        anchor=closed.anchor,
        drift=closed.drift,
        motion=used.motion,
        command=used.command,
    )
    innovation_db = np.full(model.carriers, np.nan)
    innovation_db[row.present] = screened.innovation.innovation_db
    carriers, is_due, is_returning = used.kept.carriers, closed.is_due, closed.is_returning
    found = OrdinaryRow(False, after, innovation_db, carriers, closed.residual_db, is_due, is_returning, used.effective)
    return found, cause


def _screened(
    model: CarrierModel, ahead: FilterState, screened: ScreenedRow, row: JudgedRow, chooser: Chooser
) -> tuple[FilterState, Cause | None]:
    """Return the state after the tests of all carriers together, the unknown of their cause set free, and the cause."""
    if screened.suspicion == NOTHING:
        return ahead._replace(minute=screened.minute, rain=screened.rain), None
    choice = LikeliestCause(Cause.COMMON)
    if screened.suspicion == SUDDEN_CHANGE:
        choice = chooser(model, screened.innovation)
    if choice.cause is Cause.INDEPENDENT:
        # what single carriers did says nothing about the common level
        return ahead._replace(minute=screened.minute), choice.cause
    widened = widen(
        model,
        ahead.gaussian,
        ahead.carriers,
        screened.rain,
        choice,
        screened.common,
        is_chain_worked=is_chain_worked(row.declared),
    )
    freed = ahead._replace(
        gaussian=widened.gaussian,
        carriers=widened.carriers,
        rain=widened.rain,
        motion=follow_all(ahead.motion) if choice.cause is Cause.ATTITUDE else ahead.motion,
        minute=empty_minute(model.carriers + 1, ahead.epoch_us),
    )
    return freed, choice.cause


def _with_findings(
    model: CarrierModel, settings: FilterSettings, ahead: FilterState, freed: FilterState, used: UsedRow
) -> UsedRow:
    """Return the used row after what it found: motion of its own, commands that are not obeyed, failed carriers."""
    gaussian, motion, command = used.gaussian, used.motion, used.command
    # a torque that was called small, about a spacecraft that is turned by torques, explains motion as one that was not
    unknown_deg_h2 = np.array(settings.unknown_torque_deg_h2)
    is_small = torque_size_deg_h2(settings) < unknown_deg_h2
    is_explained = is_pushed(settings) and (not is_small.any() or command.is_by_torque)
    # one that nobody knows may have changed, as at the edge of a shadow
    unproven = (unknown_deg_h2 > 0.0) & is_explained & (not motion.alarms.any())
    if used.is_moving:
        motion = with_alarms(motion, is_pushed=is_explained)
        axes = newly_explained(freed.motion, motion)
        if is_explained and axes.any():
            # what is wrong about one axis is so about all
            axes, unproven = axes | unproven, np.zeros(3, dtype=np.bool_)
            gaussian, command = with_doubted_torque(model, gaussian, settings, axes), without_evidence(command)
        command = push_row(model, command, used.kept, gaussian.covariance, is_shared=False)
    if used.degrees:
        if unproven.any() and is_share_likelier(command):
            # a torque explains as much as a command that is not obeyed, and is the likelier
            motion = with_explained(motion, unproven)
            gaussian, command = with_doubted_torque(model, gaussian, settings, unproven), without_evidence(command)
        command, gaussian = judge_commands(command, gaussian)
    gaussian, carriers = flag_failed(model, gaussian, used.carriers, ahead.gaussian)
    return used._replace(gaussian=gaussian, motion=motion, command=command, carriers=carriers)


def _declared_base(closed: ClosedRow, declared: Declared | None) -> RainWatch:
    """Return the watch on rain: a fall that begins at a declared step is counted from where the chain stands now."""
    if declared is None or declared.chain_step_db <= SAME_LEVEL_DB:
        return closed.rain
    return closed.rain._replace(base_chain_db=float(closed.gaussian.mean[CHAIN]))


def _undeclared(values: FloatArray, declared: Declared | None) -> FloatArray:
    """Return the test values (N,) from which noise is learned: none of carriers whose noise is declared."""
    return values if declared is None else np.where(declared.white_db > 0.0, np.nan, values)


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
