"""One row of the attitude filter: predict, common first, carriers next, update, integrity.

The order of the stages is written here once. A row writes into the state that it is given, which is the caller's own
copy; the same rows give the same states bit for bit. With fewer than four carriers the filter coasts. What the ground
declared is no fault: a masked carrier is neither used nor missed, a declared step of levels empties the sums it would
have filled, a declared change of the chain holds control as a found one does. Steps too small to be told from noise, of
which an operation that lasts makes one a row, widen the state and no more. The functions are compiled as they stand.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.anchor import (
    ask_anchor,
    is_contradicted,
    is_question_due,
    push_anchor,
    start_again,
)
from service.core.estimation.filtering.carrier_watch import (
    MINUTE_US,
    QUIET_ROWS,
    QUIET_STD_DB,
    SAME_LEVEL_DB,
    count_row,
    failed,
    is_returning,
    pushed_minute,
    release_quiet,
    set_aside,
    trusted,
    watch_flagged,
)
from service.core.estimation.filtering.command_watch import (
    SHARE_ERROR,
    forget_evidence,
    judge_commands,
    likelier_share,
    missed_log_ratio,
    pass_commands,
    push_row,
)
from service.core.estimation.filtering.common_cause import (
    ATTITUDE_JUMP,
    COMMON,
    HOLD_MINUTES,
    INDEPENDENT,
    NOTHING,
    SUDDEN_CHANGE,
    choose_cause,
    common_innovation,
    pass_rain,
    push_common,
    suspicion,
    widen_cause,
)
from service.core.estimation.filtering.filter_model import ATTITUDE, CHAIN, FIRST_COMMON, RAIN, rates_deg_h
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.integrity import assess
from service.core.estimation.filtering.motion import step_motion, write_wave
from service.core.estimation.filtering.motion_watch import (
    alarmed_axes,
    doubt_torque,
    drift_scale,
    explain_by_torque,
    follow_jump,
    forget_shifts,
    is_torque_seen,
    newly_explained,
    pass_motion,
    push_drift,
    push_noise,
    push_shift,
    raise_alarms,
)
from service.core.estimation.filtering.plant import TORQUES, FilterModel
from service.core.estimation.filtering.prediction import (
    Innovation,
    decay_factors,
    hidden_states,
    innovate,
    predict_state,
    site_level_db,
    update_state,
    widen_declared,
)
from service.core.estimation.filtering.row_block import (
    ABSENT,
    FROZEN,
    GROUP_MOVED,
    INTERFERENCE,
    LOST,
    MANUAL,
    NOT_EXCLUDED,
    OLD,
    STEPPED,
    TAKEN,
    UPLINK_FADE,
    BlockResult,
    RowBlock,
    RowTrace,
)
from service.core.estimation.filtering.sensor_records import model_of_step, motion_advice, take_records

MIN_CARRIERS = 4
#: smallest declared step of an attitude that the watch on motion must not take for its own, deg
_STEP_DEG = 0.05
#: fewest rows of a flagged carrier from which its kind of fault is told, and carriers of a transponder that moved
_INFORMATIVE_ROWS, _MIN_GROUP = QUIET_ROWS // 2, 3
#: variance whose products are no numbers any more; that of an angle grows far over months without a row
_LOST_VARIANCE = 1e100


class PredictedRow(NamedTuple):
    """Carriers of a row after its prediction."""

    #: (N,) dB, NaN = absent or masked
    deviation_db: FloatArray
    #: (n,) carriers to be judged, none where too few are there
    carriers: IntArray
    #: (N,) dB^2, white noise
    white_db2: FloatArray
    #: (N,) references and their variance before the row, which failed carriers keep
    reference_db: FloatArray
    reference_db2: FloatArray
    #: minutes for which the row stands, at most 1
    minutes: float


class Screened(NamedTuple):
    """Row after the tests of all carriers together."""

    innovation: Innovation
    #: (N,) test values of a minute that the row closes; NaN while it lasts
    values: FloatArray
    is_minute: bool
    cause: int
    #: (3,) alarms of motion before the update
    alarms: FloatArray


class Used(NamedTuple):
    """Row after the update with the carriers that are trusted."""

    innovation: Innovation
    #: carriers in the update, 0 = there was none, and their normalised innovation squared
    degrees: int
    nis: float
    has_findings: bool
    #: False = the covariance of the innovations is not positive definite
    is_done: bool


def take_rows(
    model: FilterModel,
    state: FilterState,
    one: FilterState,
    other: FilterState,
    block: RowBlock,
    result: BlockResult,
    trace: RowTrace,
) -> int:
    """Take rows in turns into two sets of arrays, and write what is left of each; the state given is not changed.

    Return where the newest state is: as given (0), in one (1), in the other (2). A row that is not newer than the state
    moves nothing, and neither does one whose numbers are lost.
    """
    newest = 0
    for number in range(len(block.rows)):
        before = state if newest == 0 else (one if newest == 1 else other)
        after = other if newest == 1 else one
        copy_state(before, after)
        begin_result(block, number, result)
        is_newer = block.rows["epoch_us"][number] > before.watch["epoch_us"][0]
        if is_newer:
            take_records(model, after, block, number, trace)
        step_model = model_of_step(model, after)
        # each stage is called from here alone: the compiler goes over what a function calls once for each caller
        row = begin_row(step_model, after, block, number, trace)
        status, used_count, is_moved = TAKEN, 0, True
        if not is_newer:
            status = OLD
        elif is_lost(after):
            status = LOST
        elif len(row.carriers) >= MIN_CARRIERS:
            screened = screen_row(step_model, after, block, number, row, result)
            used = use_row(step_model, after, block, number, row, screened, result, trace)
            used_count = len(used.innovation.carriers)
            # no matrix of lost numbers has an inverse
            if not used.is_done or is_lost(after):
                status = LOST
            else:
                if used.has_findings:
                    act_on_findings(step_model, after, block, row, screened, used)
                is_due, is_moved = close_row(step_model, after, block, number, row, screened, used, result)
                if is_due:
                    mixture = ask_anchor(step_model, after, block.carriers["reported_wet"][number])
                    if is_contradicted(mixture):
                        start_again(step_model, after, mixture)
                        is_moved = True
        if is_moved:
            residual_db = block.carriers["deviation_db"][number] - site_level_db(step_model, after.mean)
            result.carriers["residual_db"][number] = residual_db
        assess(step_model, after, used_count, result.rows[number])
        exclude_carriers(step_model, after, block, number, result)
        result.rows["motion_advice"][number] = motion_advice(model, after)
        status = write_state(step_model, after, status, block.unreported.shape[1], result.rows[number])
        if status == TAKEN:
            newest = 2 if newest == 1 else 1
    return newest


def copy_state(state: FilterState, into: FilterState) -> None:
    """Write a state into other arrays."""
    into.mean[:], into.covariance[:], into.carriers[:] = state.mean, state.covariance, state.carriers
    into.watch[0] = state.watch[0]
    into.aside_db[:], into.anchor[:], into.sensitivity[:] = state.aside_db, state.anchor, state.sensitivity
    into.sensors[:], into.rates[0] = state.sensors, state.rates[0]


def begin_result(block: RowBlock, number: int, result: BlockResult) -> None:
    """Write what is left of a row in which nothing is used."""
    found, carriers = result.rows[number], result.carriers[number]
    found["cause"], found["has_event"] = NOTHING, block.rows["is_declared"][number]
    carriers["innovation_db"][:] = np.nan
    carriers["is_used"][:] = False


def write_state(model: FilterModel, state: FilterState, status: int, shares: int, found: NDArray[np.void]) -> int:
    """Write what a record of `RESULT` says of the state after a row; return what became of the row."""
    mean, watch, one = state.mean, state.watch[0], model.plant[0]
    if is_lost(state):
        status = LOST
    found["status"] = status
    rates = rates_deg_h(mean, one["coupling_per_h"])
    for axis in range(3):
        found["attitude_deg"][axis], found["rates_deg_s"][axis] = mean[axis], rates[axis] / 3600.0
    found["rain_db"], found["is_raining"], found["missed_log_ratio"] = (
        mean[RAIN],
        watch["is_raining"],
        missed_log_ratio(watch),
    )
    first, hidden = FIRST_COMMON + len(model.common), hidden_states(model, len(mean))
    found["common_db"] = mean[CHAIN] + mean[FIRST_COMMON:first].sum()
    found["is_torque_shown"] = (watch["followed_minutes"] > 0.0).any()
    if hidden - shares - one["sensor_states"] >= TORQUES:
        at = first + shares
        write_wave(found["torque_deg_h2"], mean, state.covariance, at, watch["epoch_us"], one["wave_period_us"])
        if is_torque_seen(mean, state.covariance, at):
            found["is_torque_shown"] = True
    return status


def exclude_carriers(model: FilterModel, state: FilterState, block: RowBlock, number: int, result: BlockResult) -> None:
    """Write why a carrier that a row did not use is out, the likeliest hypothesis of each, and what those used left."""
    given, found, carriers, row = block.carriers[number], result.carriers[number], state.carriers, result.rows[number]
    used, residuals, total = 0, 0, 0.0
    for k in range(len(carriers)):
        is_asked = not math.isnan(carriers["probability"][k])
        found["hypothesis"][k] = carriers["hypothesis"][k] + 1 if is_asked else 0
        if found["is_used"][k]:
            reason = NOT_EXCLUDED
            used += 1
            if math.isfinite(found["residual_db"][k]):
                residuals += 1
                total += found["residual_db"][k] ** 2
        elif given["is_masked"][k]:
            reason = MANUAL
        elif given["is_frozen"][k]:
            reason = FROZEN
        elif math.isnan(given["deviation_db"][k]):
            reason = ABSENT
        else:
            reason = _fault(model, state, k, found["residual_db"][k])
        found["exclusion"][k] = reason
    row["carriers_used"], row["residual_rms_db"] = used, math.sqrt(total / residuals) if residuals else math.nan


def _fault(model: FilterModel, state: FilterState, k: int, residual_db: float) -> int:
    """Return what is wrong with a carrier that is there and not in use."""
    if state.carriers["is_flagged"][k]:
        members, flagged = 0, 0
        for other in range(len(state.carriers)):
            if model.carriers["transponder"][other] == model.carriers["transponder"][k]:
                members += 1
                flagged += 1 if state.carriers["is_flagged"][other] else 0
        if members >= _MIN_GROUP and flagged == members:
            return GROUP_MOVED
        seen_db = state.aside_db[:, k]
        seen_db = seen_db[np.isfinite(seen_db)]
        if len(seen_db) >= _INFORMATIVE_ROWS:
            if seen_db.std() < QUIET_STD_DB:
                return STEPPED
            residual_db = seen_db.mean()
    return UPLINK_FADE if residual_db < 0.0 else INTERFERENCE


def is_lost(state: FilterState) -> bool:
    """Return whether numbers of a state are none, or so uncertain that products of them are."""
    for place in range(len(state.mean)):
        # negated, so that NaN is lost
        if not (math.isfinite(state.mean[place]) and abs(state.covariance[place, place]) <= _LOST_VARIANCE):
            return True
    return False


def begin_row(model: FilterModel, state: FilterState, block: RowBlock, number: int, trace: RowTrace) -> PredictedRow:
    """Move the state over the step before a row, in place, and the watches with it; return who is there."""
    watch, row, carriers = state.watch[0], block.rows[number], block.carriers[number]
    step_us, every = row["epoch_us"] - watch["epoch_us"], len(model.carriers)
    minutes = min(step_us / 60e6, 1.0)
    if step_us > 0:
        _predict(model, state, block, number, step_us, trace)
        watch["epoch_us"] = row["epoch_us"]
        watch["hold_minutes"] = max(0.0, watch["hold_minutes"] - minutes)
        pass_motion(watch, minutes)
        if row["is_declared"]:
            _declare(state, block, number)
    is_there = np.isfinite(carriers["deviation_db"]) & ~carriers["is_masked"]
    deviation_db = np.where(is_there, carriers["deviation_db"], np.nan)
    present = np.flatnonzero(is_there & ~state.carriers["is_flagged"])
    white_db2 = (model.carriers["white_sigma_db"] * state.carriers["white_scale"]) ** 2 + carriers["white_db"] ** 2
    reference_db, reference_db2 = state.mean[-every:].copy(), np.empty(every)
    for k in range(every):
        reference_db2[k] = state.covariance[k - every, k - every]
    return PredictedRow(deviation_db, present, white_db2, reference_db, reference_db2, minutes)


def _predict(
    model: FilterModel, state: FilterState, block: RowBlock, number: int, step_us: int, trace: RowTrace
) -> None:
    """Move mean, covariance and the derivative by commands over the step before a row, in place."""
    watch, row, shares = state.watch[0], block.rows[number], block.unreported.shape[1]
    hidden = hidden_states(model, len(state.mean))
    share, is_doubted = watch["share"], watch["doubted_minutes"] > 0.0
    correction_deg, rate_change_deg_h = row["correction_deg"], row["rate_change_deg_h"]
    motion = step_motion(
        model,
        hidden,
        block.unreported[number],
        watch["epoch_us"],
        step_us,
        share * correction_deg,
        row["late_correction_deg"],
        share * rate_change_deg_h,
        drift_scale(watch["log_drift_scale"]),
        SHARE_ERROR if is_doubted else math.nan,
        watch["followed_minutes"] > 0.0,
        watch["is_raining"],
    )
    factor, hidden_variance = decay_factors(model, state, step_us / 1e6, shares)
    if len(trace.factor):
        trace.factor[:] = factor
        trace.transition[: len(motion.transition)] = motion.transition
    pass_commands(model, state, motion.transition, factor, correction_deg, rate_change_deg_h, step_us)
    predict_state(model, state, motion, factor, hidden_variance, shares, step_us)
    if row["is_declared"]:
        widen_declared(model, state, row, block.carriers[number], step_us / 3.6e9)


def _declare(state: FilterState, block: RowBlock, number: int) -> None:
    """Let the detectors know, in place, what was declared about the step."""
    watch, carriers, row, declared = state.watch[0], state.carriers, block.rows[number], block.carriers[number]
    for k in range(len(carriers)):
        step_db, group_db = declared["reference_step_db"][k], declared["group_step_db"][k]
        if max(step_db, group_db) > SAME_LEVEL_DB:
            carriers["skip_minutes"][k] = carriers["up"][k] = carriers["down"][k] = 0.0
        if declared["is_masked"][k]:
            carriers["absent_minutes"][k] = 0.0
        carriers["saved_variance_db2"][k] += step_db**2 + group_db**2
        carriers["is_relearned"][k] = carriers["is_relearned"][k] or step_db > SAME_LEVEL_DB
    if row["chain_step_db"] > SAME_LEVEL_DB:
        watch["hold_minutes"] = HOLD_MINUTES
        watch["common_up"] = watch["common_down"] = 0.0
    if row["attitude_step_deg"].max() > _STEP_DEG:
        forget_shifts(watch)


def screen_row(
    model: FilterModel, state: FilterState, block: RowBlock, number: int, present: PredictedRow, result: BlockResult
) -> Screened:
    """Test all carriers together, and let the unknown of their common cause be free, in place."""
    watch, carriers, row = state.watch[0], state.carriers, block.rows[number]
    innovation = _innovation(model, state, present)
    result.carriers["innovation_db"][number][present.carriers] = innovation.innovation_db
    excess = np.abs(innovation.innovation_db) / _sigma_db(innovation)
    median_db, common_value = common_innovation(model, innovation)
    common_up, common_down, base_db = watch["common_up"], watch["common_down"], watch["base_chain_db"]
    values, is_minute = _push_minute(state, innovation, common_value)
    cause, transponder = NOTHING, -1
    suspected = suspicion(state, excess, common_value)
    if suspected == SUDDEN_CHANGE:
        cause, transponder = choose_cause(model, innovation)
    elif suspected != NOTHING:
        cause = COMMON
    if cause == INDEPENDENT:
        # what single carriers did says nothing about the common level
        watch["common_up"], watch["common_down"], watch["base_chain_db"] = common_up, common_down, base_db
    elif cause != NOTHING:
        is_chain_worked = row["chain_walk_db"] > 0.0 or row["chain_step_db"] > SAME_LEVEL_DB
        widen_cause(model, state, cause, transponder, median_db, is_chain_worked)
        if cause == ATTITUDE_JUMP:
            follow_jump(watch)
        carriers["minute_total"][:] = 0.0
        carriers["minute_rows"][:] = 0.0
        watch["common_total"] = watch["common_rows"] = 0.0
        watch["minute_start_us"] = watch["epoch_us"]
        values[:] = np.nan
        is_minute = False
        innovation = _innovation(model, state, present)
    result.rows["cause"][number] = cause
    return Screened(innovation, values, is_minute, cause, watch["alarms"].copy())


def _innovation(model: FilterModel, state: FilterState, present: PredictedRow) -> Innovation:
    """Return the innovations of the carriers to be judged, their patterns linearised at the predicted attitude."""
    at_deg, white_db2 = state.mean[ATTITUDE].copy(), present.white_db2[present.carriers]
    return innovate(model, state.mean, state.covariance, present.deviation_db, present.carriers, white_db2, at_deg)


def _push_minute(state: FilterState, innovation: Innovation, common_value: float) -> tuple[FloatArray, bool]:
    """Count a row's test values, in place; return those of the minute that it closes (N,), NaN, and whether it does."""
    watch, carriers = state.watch[0], state.carriers
    is_over = watch["epoch_us"] - watch["minute_start_us"] >= MINUTE_US
    row_value, values = np.full(len(carriers), np.nan), np.full(len(carriers), np.nan)
    row_value[innovation.carriers] = innovation.innovation_db / _sigma_db(innovation)
    for k in range(len(carriers)):
        total, rows, value = pushed_minute(carriers["minute_total"][k], carriers["minute_rows"][k], row_value[k])
        carriers["minute_total"][k], carriers["minute_rows"][k] = (0.0, 0.0) if is_over else (total, rows)
        if is_over:
            values[k] = value
    total, rows, value = pushed_minute(watch["common_total"], watch["common_rows"], common_value)
    watch["common_total"], watch["common_rows"] = (0.0, 0.0) if is_over else (total, rows)
    if is_over:
        watch["minute_start_us"] = watch["epoch_us"]
        push_common(state, value)
    return values, is_over


def _sigma_db(innovation: Innovation) -> FloatArray:
    """Return one standard deviation (n,) of each innovation, dB."""
    return np.sqrt(np.diag(innovation.predicted_db2) + innovation.white_db2)


def use_row(
    model: FilterModel,
    state: FilterState,
    block: RowBlock,
    number: int,
    present: PredictedRow,
    screened: Screened,
    result: BlockResult,
    trace: RowTrace,
) -> Used:
    """Take a row into the state, in place; carriers beyond four sigma are skipped, fewer than four move nothing."""
    watch, innovation, carriers = state.watch[0], screened.innovation, block.carriers[number]
    is_shared = screened.cause > INDEPENDENT
    excess = np.abs(innovation.innovation_db) / _sigma_db(innovation)
    kept = trusted(innovation, excess)
    # carriers that are there, or that nobody expects
    is_accounted = np.isfinite(carriers["deviation_db"]) | carriers["is_masked"]
    count_row(state.carriers, innovation, excess, is_accounted, present.minutes, screened.values)
    result.carriers["is_used"][number][kept.carriers] = True
    has_findings = bool(failed(state.carriers).any())
    if len(kept.carriers) < MIN_CARRIERS:
        return Used(kept, 0, 0.0, has_findings, True)
    shift = np.zeros(3)
    is_done, nis = update_state(model, state, present.deviation_db, kept, shift, result.rows[number], trace)
    if is_shared:
        forget_shifts(watch)
    else:
        push_shift(watch, shift)
    is_moving = bool(alarmed_axes(watch).any())
    if not is_moving:
        push_row(model, state, kept, is_shared)
    has_findings = has_findings or is_moving or not math.isnan(likelier_share(watch))
    if has_findings:
        result.rows["has_event"][number] = True
    return Used(kept, len(kept.carriers), nis, has_findings, is_done)


def act_on_findings(
    model: FilterModel, state: FilterState, block: RowBlock, present: PredictedRow, screened: Screened, used: Used
) -> None:
    """Act on what a row found, in place: motion of its own, commands that are not obeyed, failed carriers."""
    watch, one, shares = state.watch[0], model.plant[0], block.unreported.shape[1]
    # a torque that was called small, about a spacecraft that is turned by torques, explains motion as one that was not
    unknown_deg_h2 = one["unknown_torque_deg_h2"]
    is_small = bool((one["torque_size_deg_h2"] < unknown_deg_h2).any())
    is_explained = one["is_pushed"] and (not is_small or watch["is_by_torque"])
    # one that nobody knows may have changed, as at the edge of a shadow
    unproven = (unknown_deg_h2 > 0.0) & (is_explained and not watch["alarms"].any())
    moving = alarmed_axes(watch)
    if used.degrees and moving.any():
        raise_alarms(watch, moving, is_explained)
        axes = newly_explained(screened.alarms, watch)
        if is_explained and axes.any():
            # what is wrong about one axis is so about all
            axes |= unproven
            unproven[:] = False
            doubt_torque(model, state, axes, shares)
            forget_evidence(watch)
        push_row(model, state, used.innovation, False)
    if used.degrees:
        if unproven.any() and not math.isnan(likelier_share(watch)):
            # a torque explains as much as a command that is not obeyed, and is the likelier
            explain_by_torque(watch, unproven)
            doubt_torque(model, state, unproven, shares)
            forget_evidence(watch)
        judge_commands(state)
    is_failed = failed(state.carriers)
    for k in range(len(is_failed)):
        if is_failed[k]:
            set_aside(model, state, k, present.reference_db[k], present.reference_db2[k])


def close_row(
    model: FilterModel,
    state: FilterState,
    block: RowBlock,
    number: int,
    present: PredictedRow,
    screened: Screened,
    used: Used,
    result: BlockResult,
) -> tuple[bool, bool]:
    """Learn from a row, in place: noise, flagged carriers, rain, anchor and drift; write what the deviations leave.

    Return whether the references of the alignment are to be asked, and whether what is left is to be written again.
    """
    watch, declared, is_declared = state.watch[0], block.carriers[number], block.rows["is_declared"][number]
    if screened.is_minute and used.degrees:
        # while it rains their variance holds the free walk of the rain, a quarter of a decibel a row, so that all look
        # small; none is learned of carriers whose noise is declared
        values = screened.values.copy()
        for k in range(len(values)):
            if watch["is_raining"] or declared["white_db"][k] > 0.0:
                values[k] = np.nan
        push_noise(state, values, used.nis, used.degrees)
    if screened.is_minute and state.carriers["is_flagged"].any():
        watch_flagged(state, present.deviation_db - site_level_db(model, state.mean), 1.0)
    pass_rain(state, present.minutes)
    residual_db = present.deviation_db - site_level_db(model, state.mean)
    result.carriers["residual_db"][number] = residual_db
    if screened.is_minute:
        push_anchor(state, residual_db, present.white_db2)
    drift_deg_h = model.plant[0]["drift_deg_h"]
    log_scale = watch["log_drift_scale"]
    watch["log_drift_scale"] = push_drift(state.mean, state.covariance, log_scale, drift_deg_h, present.minutes)
    if block.rows["chain_step_db"][number] > SAME_LEVEL_DB:
        # a fall that begins at a declared step is counted from where the chain stands now
        watch["base_chain_db"] = state.mean[CHAIN]
    is_due, is_moved = screened.is_minute and is_question_due(state), is_declared
    if screened.is_minute and is_returning(state.carriers):
        is_moved = release_quiet(model, state) or is_moved
    if screened.cause != NOTHING:
        result.rows["has_event"][number] = True
    return is_due, is_moved
