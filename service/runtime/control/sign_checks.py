"""Sign checks: the inputs of their events, which are legs to be prepared and verdicts on the rows."""

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles
from service.core.control.sign_check import SignDecision, SignState
from service.errors import ConflictError, InvalidInputError
from service.pipeline.control.command.control_design import control_design
from service.pipeline.control.command.schedule_check import schedule_verdict
from service.pipeline.control.release.events import BeginSignCheck, PrepareLeg, Refusal, SignJudged
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.proposals import effect_of_pulses, proposed, schedule_of
from service.pipeline.control.release.sign_checks import RUNNING, is_leg_due, is_running, profile_of
from service.records.operations.release import Command, Purpose, SignCheck, SignRatios
from service.runtime.control.proposals import soonest_start_us, swing_left
from service.runtime.control.refusal_errors import error_of
from service.runtime.control.release_context import ReleaseContext
from service.runtime.control.release_inputs import read_telemetry
from service.runtime.control.sign_check_rows import AXES, SignCheckRows, joint_verdict, wheel_verdict

#: a check of yaw, with hours of rows, is judged once in so many
_YAW_ROWS = 30


def begin_sign_check(context: ReleaseContext, axis: str, by: str, at: Instant) -> None:
    """Start a check with its first leg, or raise why it cannot be."""
    if axis not in AXES:
        raise InvalidInputError("sign_check.axis", "axis must be yaw, roll or pitch")
    if context.stored is None or context.stored.evidence is None:
        detail = "there are no rows of the robust method yet, whose model a sign check needs"
        raise ConflictError("sign_check.no_rows", detail)
    spacecraft = context.spacecraft
    rows = SignCheckRows(
        attitude_deg=context.row.attitude_deg,
        inertia_kg_m2=inertia_about_angles(np.array(spacecraft.inertia_kg_m2)),
        has_coupling=spacecraft.onboard.roll_yaw_coupling is True,
    )
    check = SignCheck(axis, RUNNING, at.now_us, by, 0, 0, 0)
    leg = _leg(context, rows, check, at)
    refusal = leg if isinstance(leg, Refusal) else context.release.handle(BeginSignCheck(at, by, axis, leg)).refusal
    if refusal is not None:
        raise error_of(refusal)
    context.sign_rows = rows


def continue_sign_check(context: ReleaseContext, at: Instant) -> None:
    """Judge the rows of a running check, and prepare its next leg when it is due."""
    check, rows = context.state.sign_check, context.sign_rows
    if check is None or not is_running(check) or rows is None:
        return
    decision = _decision(check, rows)
    wheels = _wheels(context, check, rows) if check.axis == "yaw" else None
    powers = SignState.OPEN if decision is None else decision.verdict
    verdict = joint_verdict(check, powers, wheels, at.now_us, context.settings)
    ratio = None if decision is None else SignRatios(*decision.log_ratio)
    judged = SignJudged(at, check.axis, verdict, ratio, None if wheels is None else wheels.value)
    check = context.release.handle(judged).state.sign_check
    if check is not None and is_leg_due(check, _start_us(context, at)):
        leg = _leg(context, rows, check, at)
        context.release.handle(PrepareLeg(at, leg))


def _decision(check: SignCheck, rows: SignCheckRows) -> SignDecision | None:
    """Return the decision of the powers; hours of rows are not weighed with every one of them."""
    if check.axis == "yaw" and len(rows.epochs_us) % _YAW_ROWS:
        return None
    return rows.decision(check)


def _wheels(context: ReleaseContext, check: SignCheck, rows: SignCheckRows) -> SignState:
    """Return the verdict of wheel telemetry on a check of yaw."""
    if not check.flown or len(rows.epochs_us) % _YAW_ROWS:
        return SignState.OPEN
    telemetry = read_telemetry(context.storage, context.spacecraft.id, check.started_us)
    axes = control_design(context.spacecraft, context.torque).wheels.axes
    return wheel_verdict(check, telemetry, axes, context.settings)


def _start_us(context: ReleaseContext, at: Instant) -> int:
    """Return when a leg may begin that is prepared now."""
    return soonest_start_us(at.now_us, context.settings, context.settings.sign_confirm_s)


def _leg(context: ReleaseContext, rows: SignCheckRows, check: SignCheck, at: Instant) -> Command | Refusal:
    """Return the next leg as a command, or why there can be none."""
    spacecraft, start_us = context.spacecraft, _start_us(context, at)
    try:
        pulses = rows.leg(check, control_design(spacecraft, context.torque).drive)
    except ValueError as error:
        return Refusal("command.empty", str(error))
    swing = swing_left(context.storage.releases, spacecraft, start_us)
    return proposed(
        spacecraft,
        context.row.epoch_us,
        start_us,
        pulses,
        effect_of_pulses(pulses, spacecraft, 0.0),
        schedule_verdict(schedule_of(pulses, start_us), spacecraft, context.torque, swing),
        reason=f"sign check of {check.axis}, leg {check.legs_done + 1} of {len(profile_of(check.axis).legs)}",
        purpose=Purpose.SIGN_CHECK,
    )
