"""The one function that steps interlock and commands: state and event in, state, actions and refusal out.

Law of this file: an event is judged against the state as it is at the event's instant; where it is refused
nothing happens but what a tick at that instant does, so a trip found then is kept. No clock is read here.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.core.control.sign_check import SignState
from service.core.control.slew_schedule import Triple, triple_of
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandTransition, next_state
from service.pipeline.control.release.command_transitions import (
    applied,
    automatic,
    cancel,
    confirm,
    prepare,
    refused,
    report,
)
from service.pipeline.control.release.events import (
    Action,
    ActionKind,
    Applied,
    Automatic,
    Cancel,
    CommandRecord,
    Confirm,
    Engage,
    Event,
    InputsChanged,
    Order,
    OrderKind,
    Prepare,
    ReleaseState,
    Report,
    ResponseJudged,
    RowSeen,
    SignJudged,
    Step,
    Tick,
)
from service.pipeline.control.release.interlock import (
    Instant,
    Interlock,
    Request,
    Terms,
    fire,
    settle,
    tripped,
)
from service.pipeline.control.release.interlock_conditions import ALARMED, Condition, RowFacts
from service.pipeline.control.release.interlock_states import REFUSALS, State, Trigger, rows_of
from service.pipeline.control.release.release_checks import unreported_of
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.epoch import US_PER_S

_HOUR_US = 3600 * US_PER_S
_TRIGGERS = {
    OrderKind.ARM: Trigger.ARM,
    OrderKind.DISENGAGE: Trigger.DISENGAGE,
    OrderKind.RESET: Trigger.RESET,
    OrderKind.STOP: Trigger.TRIP,
}


def advance(state: ReleaseState, event: Event, settings: ReleaseSettings) -> Step:
    """Return what an event leads to.

    Parameters
    ----------
    state : ReleaseState
        Before.
    event : Event
        With the instant at which it is handled.
    settings : ReleaseSettings
        Limits and times.

    Returns
    -------
    Step
        State, what the world must do, and a refusal with a code where the event was illegal; then state and actions
        are those of a `Tick` at the same instant.
    """
    settled = settled_at(state, event.at, settings)
    step = _handled(settled, event, settings)
    # a refused step holds the settled state: time passes all the same, and what it brings to light is kept
    after = settled_at(step.state, event.at, settings)
    return Step(after, (*step.actions, *_changes(state, after)), step.refusal)


def settled_at(state: ReleaseState, at: Instant, settings: ReleaseSettings) -> ReleaseState:
    """Return the state at an instant: the interlock settled, commands expired or rejected, old ones forgotten."""
    interlock = settle(state.interlock, at, unreported_of(state.commands), settings)
    is_tripped = interlock.state is State.TRIPPED
    commands = tuple(_aged(command, at, is_tripped=is_tripped) for command in state.commands)
    kept = tuple(command for command in commands if _is_kept(command, at))
    sent = tuple(each for each in state.sent if at.now_us - each.at_us < _HOUR_US)
    return replace(state, interlock=interlock, commands=kept, sent=sent)


def restored(state: ReleaseState) -> ReleaseState:
    """Return a stored state as a new process takes it up: inhibited until 10 good minutes are over, trips kept.

    A command that was released before stays released: it is never given out again, only reported.
    """
    interlock = state.interlock
    clock = None if interlock.clock is None else replace(interlock.clock, steady_us=None)
    inhibited = interlock.state if interlock.state is State.TRIPPED else State.INHIBITED
    # what stood when it was stored may have gone since; a trip has not
    trips = {condition.word for condition in interlock.trips}
    since = tuple(each for each in interlock.since if each[0] in trips)
    forgotten = replace(interlock, row=None, good_since_us=None, clock=clock, request=None, since=since)
    return replace(state, interlock=replace(forgotten, state=inhibited))


class Uncertainty(NamedTuple):
    """What may have been done and is not told, one sigma."""

    angle_deg: Triple
    rate_deg_s: Triple


def uncertainty_of(state: ReleaseState) -> Uncertainty:
    """Return what unreported commands may have done: their whole effect, at its greatest."""
    angle, rate = np.zeros(3), np.zeros(3)
    for command in state.commands:
        if command.life in UNREPORTED and not command.proposal.is_sign_check:
            effect = command.proposal.effect
            angle += np.maximum(np.abs(effect.angle_change_deg), np.abs(effect.peak_angle_deg))
            rate += np.maximum(np.abs(effect.rate_change_deg_s), np.abs(effect.peak_rate_deg_s))
    return Uncertainty(triple_of(angle), triple_of(rate))


def _handled(state: ReleaseState, event: Event, settings: ReleaseSettings) -> Step:
    """Return the step of an event on a settled state."""
    match event:
        case Prepare():
            return prepare(state, event, settings)
        case Confirm():
            return confirm(state, event, settings)
        case Automatic():
            return automatic(state, event, settings)
        case Applied():
            return applied(state, event, settings)
        case Cancel():
            return cancel(state, event)
        case Report():
            return report(state, event)
        case Order() | Engage():
            return _ordered(state, event, settings)
        case _:
            return Step(replace(state, interlock=_informed(state.interlock, event, settings)))


def _informed(
    interlock: Interlock, event: Tick | RowSeen | InputsChanged | ResponseJudged | SignJudged, settings: ReleaseSettings
) -> Interlock:
    """Return the interlock with what an event tells."""
    match event:
        case RowSeen():
            return _with_row(interlock, event, settings)
        case InputsChanged():
            is_other_craft = event.inputs.spacecraft_version != interlock.inputs.spacecraft_version
            proven = () if is_other_craft else interlock.proven_axes
            return replace(interlock, inputs=event.inputs, proven_axes=proven)
        case ResponseJudged():
            is_missed = not event.log_ratio <= settings.missed_log_ratio
            return tripped(interlock, Condition.RESPONSE_MISSED, event.at, settings) if is_missed else interlock
        case SignJudged():
            return _with_sign(interlock, event, settings)
        case Tick():
            return interlock


def _with_row(interlock: Interlock, event: RowSeen, settings: ReleaseSettings) -> Interlock:
    """Return the interlock with a row; one that is older than the newest is no news."""
    row, before = event.row, interlock.row
    if before is not None and row.epoch_us <= before.epoch_us:
        return interlock
    is_after_gap = before is not None and row.epoch_us - before.epoch_us > _stale_us(before, settings)
    since_us = _since(interlock.durations.innovation_since_us, event.at.now_us, is_so=not row.is_innovation_in_band)
    durations = replace(interlock.durations, innovation_since_us=since_us)
    return replace(interlock, row=replace(row, is_after_gap=is_after_gap), durations=durations)


def _with_sign(interlock: Interlock, event: SignJudged, settings: ReleaseSettings) -> Interlock:
    """Return the interlock with the result of a sign check; an axis that answers wrongly or not at all trips."""
    others = tuple(axis for axis in interlock.proven_axes if axis != event.axis)
    if event.verdict is SignState.PLUS:
        return replace(interlock, proven_axes=(*others, event.axis))
    if event.verdict in (SignState.MINUS, SignState.NOTHING):
        return tripped(replace(interlock, proven_axes=others), Condition.RESPONSE_MISSED, event.at, settings)
    return interlock


def _ordered(state: ReleaseState, event: Order | Engage, settings: ReleaseSettings) -> Step:
    """Return the step of a person's order."""
    interlock = state.interlock
    if isinstance(event, Order) and event.kind is OrderKind.STOP:
        return Step(replace(state, interlock=tripped(interlock, Condition.STOP, event.at, settings)))
    trigger = Trigger.ENGAGE if isinstance(event, Engage) else _TRIGGERS[event.kind]
    if not rows_of(interlock.state, trigger):
        return refused(state, *_illegal_order(interlock, trigger))
    asked = None
    if isinstance(event, Engage):
        problem = _engage_problem(interlock, event, settings)
        if problem is not None:
            return refused(state, *problem)
        asked = Request(event.by, event.at.now_us, Terms(event.until_us, event.envelope))
    moved = fire(interlock, trigger, event.at, settings, asked)
    if moved is None:
        return refused(state, REFUSALS[trigger], f"{trigger.value}: {', '.join(interlock.reasons) or 'not as asked'}")
    return Step(replace(state, interlock=moved))


def _illegal_order(interlock: Interlock, trigger: Trigger) -> tuple[str, str]:
    """Return code and detail of an order that means nothing in this state."""
    if interlock.state is State.TRIPPED:
        return "interlock.tripped", f"control tripped ({', '.join(interlock.reasons)}): reset first"
    return "interlock.state", f"{trigger.value}: not in state {interlock.state.name}"


def _engage_problem(interlock: Interlock, event: Engage, settings: ReleaseSettings) -> tuple[str, str] | None:
    """Return code and detail of what is wrong with the terms of an authorisation."""
    if not {"roll", "pitch"} <= set(interlock.proven_axes):
        return "interlock.sign_unproven", "the signs of roll and pitch must be proven by a sign check first"
    left_us = event.until_us - event.at.now_us
    if not 0 < left_us <= microseconds(settings.longest_authorisation_s):
        hours = settings.longest_authorisation_s / 3600.0
        return "interlock.authorisation", f"an authorisation ends in the future, at most {hours:g} h ahead"
    if not event.envelope.is_within(settings.envelope):
        return "envelope.wider", "the envelope is wider than that of the settings, or a limit is not positive"
    is_joining = interlock.request is not None and interlock.request.by != event.by
    if is_joining and not event.is_approver:
        return "interlock.second_person", "the second person must be an approver"
    return None


def _aged(command: CommandRecord, at: Instant, *, is_tripped: bool) -> CommandRecord:
    """Return a command at an instant: an open one ends by a trip or by its time."""
    if command.life not in OPEN:
        return command
    if not is_tripped and at.now_us < command.expires_us:
        return command
    ended = next_state(command.life, CommandTransition.REJECT if is_tripped else CommandTransition.EXPIRE)
    return command if ended is None else replace(command, life=ended)


def _is_kept(command: CommandRecord, at: Instant) -> bool:
    """Whether a command may still be asked for: it is alive, or ended less than an hour ago."""
    if command.life in OPEN or command.life in UNREPORTED:
        return True
    newest_us = max(command.prepared_us, command.released_us or 0, command.reported_us or 0)
    if command.executed:
        # a later command may leave out its end
        newest_us = max(newest_us, command.proposal.stop_us)
    return at.now_us - newest_us < _HOUR_US


def _stale_us(row: RowFacts, settings: ReleaseSettings) -> int:
    return microseconds(settings.stale_periods * row.period_s + settings.stale_margin_s)


def _since(before_us: int | None, now_us: int, *, is_so: bool) -> int | None:
    """Return since when something has been so."""
    if not is_so:
        return None
    return now_us if before_us is None else before_us


def _changes(before: ReleaseState, after: ReleaseState) -> tuple[Action, ...]:
    """Return what a change of the interlock tells the world."""
    old, new = before.interlock, after.interlock
    actions = []
    if new.state is not old.state:
        actions.append(Action(ActionKind.STATE, new.state.name))
    alarms = [condition for condition in new.standing if condition in ALARMED and condition not in old.standing]
    alarms += [condition for condition in new.trips if condition not in old.trips]
    actions += [Action(ActionKind.ALARM, condition.word) for condition in alarms]
    return tuple(actions)
