"""Proposals of commands and sign checks, row by row, and the errors by which orders are refused."""

import logging
import math
from dataclasses import replace

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles
from service.core.control.sign_check import SignDecision, SignState
from service.core.control.slew_schedule import Effect
from service.errors import ConflictError, ForbiddenError, GoneError, InvalidInputError, NotFoundError, SooError
from service.pipeline.control.command.compute_command import command_for
from service.pipeline.control.command.control_design import PanelSwing, control_design, schedule_verdict, swing_after
from service.pipeline.control.release.advance import settled_at
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandTransition, State
from service.pipeline.control.release.command_transitions import command_of
from service.pipeline.control.release.events import (
    AnglesFit,
    Applied,
    Automatic,
    BeginSignCheck,
    PrepareLeg,
    Refusal,
    Report,
    ResponseJudged,
    RowSeen,
    SignJudged,
    StoredRow,
)
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import (
    ReleaseSettings,
    microseconds,
    missed_limit,
    own_affair,
)
from service.pipeline.control.release.release_checks import (
    effect_of_law,
    effect_of_pulses,
    envelope_left,
    proposal_of,
    proposed,
    release_checks,
    schedule_of,
)
from service.pipeline.control.release.sign_checks import RUNNING, is_leg_due, is_running, profile_of
from service.ports.archive import ListPart
from service.ports.storage import Releases
from service.records.calibration import Window
from service.records.catalogue import ControlMode, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, TorqueCommand, fit_angles_deg
from service.records.operations.release import (
    Command,
    CommandRequest,
    ProductForm,
    Purpose,
    SignCheck,
    SignRatios,
    UplinkProduct,
)
from service.runtime.control.release_context import SpacecraftRelease, read_telemetry
from service.runtime.control.sign_check_rows import AXES, SignCheckRows, joint_verdict, wheel_verdict

#: what was sent longer ago has left nothing in the flexible modes
_SWING_US = 3 * 3600 * US_PER_S
_COMMANDS_AT_ONCE = 500


def requested(release: SpacecraftRelease, request: CommandRequest, at: Instant) -> Command:
    """Return what a person requests as a proposal, with every check as it stands.

    ConflictError ``command.no_estimate``, ``command.estimate_stale``; InvalidInputError ``command.wish``.
    """
    row, settings, spacecraft = release.row, release.settings, release.spacecraft
    epoch_us = request.attitude_epoch_us
    if epoch_us is not None and not 0 <= row.epoch_us - epoch_us <= release.stale_us:
        raise ConflictError("command.estimate_stale", "attitude_epoch is not that of a recent estimate")
    start_us = request.start_us or soonest_start_us(at.now_us, settings, settings.confirm_s)
    duration_s = request.duration_s or spacecraft.control.forecast_horizon_s
    if not 0.0 < duration_s <= settings.latest_stop_s:
        raise InvalidInputError("command.wish", f"duration_s must lie between 0 and {settings.latest_stop_s:g} s")
    if not -US_PER_S <= start_us - at.now_us <= microseconds(settings.latest_stop_s):
        detail = f"start must lie ahead of the spacecraft's clock by at most {settings.latest_stop_s:g} s"
        raise InvalidInputError("command.wish", detail)
    computed = computed_command(release, at, start_us, duration_s, request.max_torque_n_m)
    try:
        command = proposal_of(computed, spacecraft, request.reason)
    except ValueError as error:
        raise InvalidInputError("command.wish", str(error)) from error
    settled = settled_at(release.state, at, settings)
    return replace(command, checks=release_checks(settled, command, at, settings))


def computed_command(
    release: SpacecraftRelease, at: Instant, start_us: int, duration_s: float, max_torque_n_m: float | None = None
) -> TorqueCommand:
    """Return the command of the law from an instant on, without what the interlock withholds."""
    row, facts, interlock = release.row, release.facts, release.state.interlock
    balance = None
    if interlock.state is State.BALANCE and interlock.row is not None:
        yaw, roll, pitch = interlock.row.balance_axes
        balance = yaw and not interlock.is_yaw_withheld, roll, pitch
    rate_age_s = release.torque.rate_stale_periods * release.period_s + release.torque.rate_stale_margin_s
    return command_for(
        allowed_row(row, interlock, release.settings),
        release.spacecraft,
        start_us,
        duration_s,
        max_torque_n_m,
        release.torque,
        None if release.stored is None else release.stored.outcome.disturbance,
        facts.momentum_n_m_s(row.epoch_us),
        swing=swing_left(release.storage.releases, release.spacecraft, start_us),
        body_rate_deg_s=facts.body_rate_deg_s(row.epoch_us, rate_age_s),
        balance=balance,
        envelope=envelope_left(release.state, at.now_us, release.settings),
    )


def allowed_row(row: AttitudeRow, interlock: Interlock, settings: ReleaseSettings) -> AttitudeRow:
    """Return a row with the reasons and axes that hold for the release.

    The interlock judges range and level itself, by limits that let an approver bring a spacecraft back from beyond the
    range of automatic control: about the axes whose angle, or that range, exceeds the protection level.
    """
    own = frozenset() if interlock.row is None else own_affair(interlock.row, settings)
    reasons = tuple(reason for reason in row.inhibitions if reason not in own)
    yaw, roll, pitch = row.control_allowed_axes
    if row.inhibitions and not reasons:
        level, size, range_deg = row.protection_deg, row.attitude_deg, settings.recovery_deg
        yaw = level.yaw < abs(size.yaw)
        # a method without levels doubts no angle by them
        roll = not level.roll > max(abs(size.roll), range_deg)
        pitch = not level.pitch > max(abs(size.pitch), range_deg)
    return replace(
        row,
        inhibitions=reasons,
        control_allowed=not reasons,
        control_allowed_axes=(yaw and not interlock.is_yaw_withheld, roll, pitch),
    )


def swing_left(releases: Releases, spacecraft: Spacecraft, now_us: int) -> PanelSwing | None:
    """Return what released schedules have left in the flexible modes; unreported ones count as carried out."""
    if not spacecraft.modes:
        return None
    swing = None
    window = Window(now_us - _SWING_US, now_us + 1)
    for command in releases.commands(spacecraft.id, ListPart(window, _COMMANDS_AT_ONCE)):
        if command.released_us is not None:
            schedule = command.schedule if command.reported_us is None else command.executed
            swing = swing_after(swing, schedule, spacecraft)
    return swing


def soonest_start_us(now_us: int, settings: ReleaseSettings, waiting_s: float = 0.0) -> int:
    """Return when a schedule may begin at the soonest; persons get so long to confirm it."""
    return now_us + microseconds(settings.uplink_lead_s + waiting_s)


#: every other code is a conflict
_KINDS: dict[str, type[SooError]] = {
    "command.unknown": NotFoundError,
    "command.second_person": ForbiddenError,
    "interlock.second_person": ForbiddenError,
    "command.expired": GoneError,
    "interlock.authorisation": InvalidInputError,
    "envelope.wider": InvalidInputError,
    "report.interval": InvalidInputError,
}


def error_of(refusal: Refusal) -> SooError:
    """Return the error of a refusal.

    Examples
    --------
    >>> error_of(Refusal("command.expired", "prepare it again"))
    GoneError('command.expired: prepare it again')
    """
    return _KINDS.get(refusal.code, ConflictError)(refusal.code, refusal.detail)


def release_refusal(spacecraft: Spacecraft) -> Refusal | None:
    """Return why no command of a spacecraft is released one by one, None where they are."""
    control, onboard = spacecraft.control, spacecraft.onboard
    if control.mode is not ControlMode.GROUND:
        return Refusal("control.mode", f"{spacecraft.id} takes no torques: its mode is {control.mode.value}")
    if not (onboard.fast_loop and onboard.forecast_mode):
        return Refusal("control.mode", f"{spacecraft.id} states no fast loop or no Forecast mode on board")
    if control.release is Release.AUTOMATIC:
        detail = "computed commands of this spacecraft count as applied; nothing is prepared or authorised"
        return Refusal("release.automatic", detail)
    return None


#: a check of yaw, with hours of rows, is judged once in so many
_YAW_ROWS = 30


def begin_sign_check(release: SpacecraftRelease, axis: str, by: str, at: Instant) -> None:
    """Start a check with its first leg, or raise why it cannot be."""
    if axis not in AXES:
        raise InvalidInputError("sign_check.axis", "axis must be yaw, roll or pitch")
    if release.stored is None or release.stored.evidence is None:
        detail = "there are no rows of the robust method yet, whose model a sign check needs"
        raise ConflictError("sign_check.no_rows", detail)
    spacecraft = release.spacecraft
    rows = SignCheckRows(
        attitude_deg=release.row.attitude_deg,
        inertia_kg_m2=inertia_about_angles(np.array(spacecraft.inertia_kg_m2)),
        has_coupling=spacecraft.onboard.roll_yaw_coupling is True,
    )
    check = SignCheck(axis, RUNNING, at.now_us, by, 0, 0, 0)
    leg = _leg(release, rows, check, at)
    refusal = leg if isinstance(leg, Refusal) else release.handle(BeginSignCheck(at, by, axis, leg)).refusal
    if refusal is not None:
        raise error_of(refusal)
    release.sign_rows = rows


def continue_sign_check(release: SpacecraftRelease, at: Instant) -> None:
    """Judge the rows of a running check, and prepare its next leg when it is due."""
    check, rows = release.state.sign_check, release.sign_rows
    if check is None or not is_running(check) or rows is None:
        return
    decision = _decision(check, rows)
    wheels = _wheels(release, check, rows) if check.axis == "yaw" else None
    powers = SignState.OPEN if decision is None else decision.verdict
    verdict = joint_verdict(check, powers, wheels, at.now_us, release.settings)
    ratio = None if decision is None else SignRatios(*decision.log_ratio)
    judged = SignJudged(at, check.axis, verdict, ratio, None if wheels is None else wheels.value)
    check = release.handle(judged).state.sign_check
    if check is not None and is_leg_due(check, _start_us(release, at)):
        leg = _leg(release, rows, check, at)
        release.handle(PrepareLeg(at, leg))


def _decision(check: SignCheck, rows: SignCheckRows) -> SignDecision | None:
    """Return the decision of the powers; hours of rows are not weighed with every one of them."""
    if check.axis == "yaw" and len(rows.epochs_us) % _YAW_ROWS:
        return None
    return rows.decision(check)


def _wheels(release: SpacecraftRelease, check: SignCheck, rows: SignCheckRows) -> SignState:
    """Return the verdict of wheel telemetry on a check of yaw."""
    if not check.flown or len(rows.epochs_us) % _YAW_ROWS:
        return SignState.OPEN
    telemetry = read_telemetry(release.storage, release.spacecraft.id, check.started_us)
    axes = control_design(release.spacecraft, release.torque).wheels.axes
    return wheel_verdict(check, telemetry, axes, release.settings)


def _start_us(release: SpacecraftRelease, at: Instant) -> int:
    """Return when a leg may begin that is prepared now."""
    return soonest_start_us(at.now_us, release.settings, release.settings.sign_confirm_s)


def _leg(release: SpacecraftRelease, rows: SignCheckRows, check: SignCheck, at: Instant) -> Command | Refusal:
    """Return the next leg as a command, or why there can be none."""
    spacecraft, start_us = release.spacecraft, _start_us(release, at)
    try:
        pulses = rows.leg(check, control_design(spacecraft, release.torque).drive)
    except ValueError as error:
        return Refusal("command.empty", str(error))
    swing = swing_left(release.storage.releases, spacecraft, start_us)
    return proposed(
        spacecraft,
        release.row.epoch_us,
        start_us,
        pulses,
        effect_of_pulses(pulses, spacecraft, 0.0),
        schedule_verdict(schedule_of(pulses, start_us), spacecraft, release.torque, swing),
        reason=f"sign check of {check.axis}, leg {check.legs_done + 1} of {len(profile_of(check.axis).legs)}",
        purpose=Purpose.SIGN_CHECK,
    )


_LOG = logging.getLogger("soo.release")

_UNKNOWN = (math.nan, math.nan, math.nan)
#: of a schedule that cannot be followed: beyond every envelope
_BOUNDLESS = Effect(_UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, ())
_REASON = "standing authorisation"


def handle_row(release: SpacecraftRelease, stored: StoredRow, row: AttitudeRow, at: Instant, *, may_send: bool) -> None:
    """Handle what follows from a row of the method that drives control."""
    spacecraft = release.spacecraft
    release.handle(RowSeen(at, release.row_facts(row)))
    if stored.outcome.applied is not None:
        release.handle(Applied(at, _effect(stored.outcome.applied.command, spacecraft)))
    evidence = stored.evidence
    limit = missed_limit(release.state.interlock.row, release.settings)
    if evidence is not None and not evidence.missed_log_ratio <= limit:
        release.handle(ResponseJudged(at, evidence.missed_log_ratio))
    if evidence is not None and release.sign_rows is not None:
        release.sign_rows.append(row.epoch_us, evidence.model, evidence.deviation_db)
    continue_sign_check(release, at)
    if may_send:
        _send(release, at)
        _give_angles(release, row, at)


def judge_report(release: SpacecraftRelease, event: Report) -> None:
    """Judge a command that is reported executed whole by its response in the powers before."""
    command = command_of(release.state, event.counter)
    evidence = None if release.stored is None else release.stored.evidence
    if command is None or evidence is None or evidence.unreported_log_ratio is None or command.is_sign_check:
        return
    is_whole = event.transition is CommandTransition.EXECUTED and command.executed == command.schedule
    # one command proves less than all of an hour
    if is_whole and not evidence.unreported_log_ratio <= release.settings.missed_log_ratio:
        release.handle(ResponseJudged(event.at, evidence.unreported_log_ratio))


def _send(release: SpacecraftRelease, at: Instant) -> None:
    """Offer the law's command to a standing authorisation, once a command period, while nothing else is out.

    In `BALANCE` it is that which balances the known torque.
    """
    spacecraft, state = release.spacecraft, release.state
    is_checking = is_running(state.sign_check)
    is_standing = state.interlock.state is State.ENGAGED or (
        state.interlock.state is State.BALANCE and state.interlock.authorisation is not None
    )
    if not is_standing or release_refusal(spacecraft) or is_checking:
        return
    period_s = spacecraft.control.command_period_s
    newest_us = max([release.asked_us, *(each.released_us or 0 for each in state.commands)])
    is_busy = any(each.state in OPEN or each.state in UNREPORTED for each in state.commands)
    if is_busy or at.now_us - newest_us < microseconds(period_s):
        return
    release.asked_us = at.now_us
    computed = computed_command(release, at, soonest_start_us(at.now_us, release.settings), period_s)
    if not computed.schedule:
        return
    step = release.handle(Automatic(at, proposal_of(computed, spacecraft, _REASON)))
    if step.refusal is not None:
        _LOG.warning("automatic command of %s refused: %s (%s)", spacecraft.id, step.refusal.detail, step.refusal.code)


def _give_angles(release: SpacecraftRelease, row: AttitudeRow, at: Instant) -> None:
    """Store angles for a spacecraft that computes its torques itself, while nothing stands against them."""
    spacecraft, interlock = release.spacecraft, release.state.interlock
    is_fit = row.control_allowed and not interlock.inhibiting and interlock.state is not State.TRIPPED
    if spacecraft.control.mode is not ControlMode.ONBOARD or not is_fit:
        return
    newest = release.storage.releases.newest_product(spacecraft.id, ProductForm.ATTITUDE)
    counter = 1 if newest is None else newest.counter + 1
    product = UplinkProduct(
        form=ProductForm.ATTITUDE,
        counter=counter,
        created_us=at.now_us,
        valid_from_us=row.epoch_us,
        valid_until_us=row.epoch_us + release.stale_us,
        attitude_epoch_us=row.epoch_us,
        is_simulated=spacecraft.simulated,
        attitude_deg=fit_angles_deg(row),
        sigma_deg=row.steered_sigma_deg,
    )
    release.handle(AnglesFit(at, product))


def _effect(command: TorqueCommand, spacecraft: Spacecraft) -> Effect:
    """Return the effect of a computed command; one that cannot be predicted is beyond every envelope."""
    try:
        return effect_of_law(command, spacecraft)
    except ValueError:
        return _BOUNDLESS
