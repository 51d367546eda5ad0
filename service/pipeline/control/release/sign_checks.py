"""Sign check as a part of the state: begun with its first leg, followed leg by leg, ended by a verdict or a reason.

Legs are commands like any other, each confirmed by persons and reported by the centre. A leg counts as flown when it
is reported executed; one that was lost on its way is prepared again.
"""

from dataclasses import replace

from service.core.control.sign_check import Profile, SignState, pitch_profile, roll_profile, yaw_profile
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandTransition, State
from service.pipeline.control.release.command_transitions import command_of, moved, prepare, refused, with_command
from service.pipeline.control.release.events import (
    BeginSignCheck,
    Prepare,
    PrepareLeg,
    Refusal,
    ReleaseState,
    SignJudged,
    Step,
)
from service.pipeline.control.release.interlock import Interlock, tripped
from service.pipeline.control.release.interlock_conditions import Condition, ReleaseSettings, microseconds
from service.records.operations.release import Command, CommandState, SignCheck

RUNNING, INTERRUPTED = "running", "interrupted"


def profile_of(axis: str) -> Profile:
    """Return the turns that are planned for the check of an axis."""
    return {"yaw": yaw_profile, "roll": roll_profile, "pitch": pitch_profile}[axis]()


def is_running(check: SignCheck | None) -> bool:
    """Return whether a sign check is under way."""
    return check is not None and check.state == RUNNING


def is_leg_due(check: SignCheck, start_us: int) -> bool:
    """Return whether the next leg may begin at an instant: yaw stays on each side for its time."""
    legs = profile_of(check.axis).legs
    if check.state != RUNNING or check.leg is not None or check.legs_done >= len(legs):
        return False
    if not check.flown:
        return True
    return start_us >= check.flown[0][0].start_us + microseconds(legs[check.legs_done].start_s)


def begin(state: ReleaseState, event: BeginSignCheck, settings: ReleaseSettings) -> Step:
    """Return the state with a sign check whose first leg is prepared."""
    if state.sign_check is not None and is_running(state.sign_check):
        return refused(state, "sign_check.running", f"the sign check of {state.sign_check.axis} is under way")
    step = prepare(state, Prepare(event.at, event.by, event.command), settings)
    if step.refusal is not None:
        return step
    legs = len(profile_of(event.axis).legs)
    check = SignCheck(event.axis, RUNNING, event.at.now_us, event.by, 0, legs, 0)
    return Step(_with_leg(step.state, replace(check, until_us=_until_us(check, settings))))


def prepare_leg(state: ReleaseState, event: PrepareLeg, settings: ReleaseSettings) -> Step:
    """Return the state with the next leg prepared, or with the reason why it cannot be."""
    check, leg, step = state.sign_check, event.leg, Step(state)
    if check is None or check.state != RUNNING or check.leg is not None:
        return step
    if isinstance(leg, Command):
        step = prepare(state, Prepare(event.at, check.started_by, leg), settings)
    refusal = leg if isinstance(leg, Refusal) else step.refusal
    if refusal is None:
        return Step(_with_leg(step.state, replace(check, detail="")))
    return Step(replace(state, sign_check=replace(check, detail=f"{refusal.code}: {refusal.detail}")))


def judge(state: ReleaseState, event: SignJudged, settings: ReleaseSettings) -> Step:
    """Return the state with a verdict: any but an open one ends the check, an open one when its time is over."""
    judged = replace(state, interlock=_with_sign(state.interlock, event, settings))
    check = state.sign_check
    if check is None or check.state != RUNNING or check.axis != event.axis:
        return Step(judged)
    ratio = check.log_ratio if event.log_ratio is None else event.log_ratio
    reported = replace(check, log_ratio=ratio, wheels=event.wheels)
    is_open = event.verdict is SignState.OPEN
    if is_open and event.at.now_us < check.until_us:
        return Step(replace(judged, sign_check=reported))
    detail = "its time is over" if is_open else ""
    return Step(_ended(judged, replace(reported, state=event.verdict.value, detail=detail)))


def followed(state: ReleaseState, settings: ReleaseSettings) -> ReleaseState:
    """Return the state in which a running check has taken over the end of its leg, or is interrupted by a trip."""
    check = state.sign_check
    if check is None or check.state != RUNNING:
        return state
    if state.interlock.state is State.TRIPPED:
        return _ended(state, replace(check, state=INTERRUPTED, detail="control tripped"))
    command = command_of(state, check.leg)
    if command is None or command.state in OPEN or command.state in UNREPORTED:
        return state
    waiting = replace(check, leg=None)
    if command.executed and command.state is not CommandState.EXECUTED:
        detail = f"leg {command.counter} was carried out in part"
        return _ended(state, replace(waiting, state=INTERRUPTED, detail=detail))
    if command.executed:
        waiting = replace(waiting, legs_done=check.legs_done + 1, flown=(*check.flown, command.executed))
        waiting = replace(waiting, until_us=_until_us(waiting, settings))
    return replace(state, sign_check=waiting)


def interrupted(check: SignCheck | None) -> SignCheck | None:
    """Return a sign check as a restart leaves it: its rows are lost."""
    if check is None or check.state != RUNNING:
        return check
    return replace(check, state=INTERRUPTED, detail="the service was restarted")


def _with_leg(state: ReleaseState, check: SignCheck) -> ReleaseState:
    """Return the state whose sign check waits for the newest command."""
    command = state.commands[-1]
    return replace(state, sign_check=replace(check, leg=command.counter, leg_start_us=command.start_us))


def _with_sign(interlock: Interlock, event: SignJudged, settings: ReleaseSettings) -> Interlock:
    """Return the interlock with the result of a sign check; an axis that answers wrongly or not at all trips."""
    others = tuple(axis for axis in interlock.proven_axes if axis != event.axis)
    if event.verdict is SignState.PLUS:
        return replace(interlock, proven_axes=(*others, event.axis))
    if event.verdict in (SignState.MINUS, SignState.NOTHING):
        return tripped(replace(interlock, proven_axes=others), Condition.RESPONSE_MISSED, event.at, settings)
    return interlock


def _ended(state: ReleaseState, check: SignCheck) -> ReleaseState:
    """Return the state with an ended check, whose leg is taken back if it was not released."""
    command, ended = command_of(state, check.leg), replace(state, sign_check=check)
    if command is None or command.state not in OPEN:
        return ended
    return with_command(ended, moved(command, CommandTransition.CANCEL))


def _until_us(check: SignCheck, settings: ReleaseSettings) -> int:
    """Return when a check ends undecided: its time runs from the first turn on, and persons get theirs before."""
    limit_s = settings.yaw_sign_check_s if check.axis == "yaw" else settings.sign_check_s
    if check.flown:
        return check.flown[0][0].start_us + microseconds(limit_s)
    return check.started_us + microseconds(limit_s + settings.prepared_s)
