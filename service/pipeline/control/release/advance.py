"""The one function that steps interlock, commands and sign check: state and event in, state, effects and refusal out.

Law of this file: an event is judged against the state as it is at the event's instant; where it is refused
nothing happens but what a tick at that instant does, so a trip found then is kept. No clock is read here. Effects
follow from the change of the state, so what a state does not show is not given out.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandTransition, next_state
from service.pipeline.control.release.command_transitions import (
    applied,
    automatic,
    cancel,
    command_effects,
    confirm,
    prepare,
    refused,
    report,
)
from service.pipeline.control.release.events import (
    AnglesFit,
    Applied,
    AuditEffect,
    Automatic,
    BeginSignCheck,
    Cancel,
    Confirm,
    Engage,
    Event,
    InputsChanged,
    JournalEffect,
    Order,
    OrderKind,
    Prepare,
    PrepareLeg,
    PublishEffect,
    ReleaseEffect,
    ReleaseState,
    Report,
    ResponseJudged,
    RowSeen,
    SignJudged,
    Step,
    UplinkEffect,
)
from service.pipeline.control.release.interlock import Instant, Interlock, Request, Terms, fire, settle, tripped
from service.pipeline.control.release.interlock_conditions import ALARMED, Condition, InterlockRow
from service.pipeline.control.release.interlock_states import REFUSALS, State, Trigger, rows_of
from service.pipeline.control.release.release_checks import unreported_of
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.pipeline.control.release.sign_checks import begin, followed, interrupted, judge, prepare_leg
from service.records.epoch import US_PER_S
from service.records.operations.release import Command, InterlockHold

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
        State, effects, and a refusal with a code where the event was illegal; then state and effects are those of a
        `Tick` at the same instant.
    """
    settled = settled_at(state, event.at, settings)
    step = _handled(settled, event, settings)
    # a refused step holds the settled state: time passes all the same, and what it brings to light is kept
    after = settled_at(step.state, event.at, settings)
    return Step(after, (*step.effects, *effects_of(state, after, event.at)), step.refusal)


def settled_at(state: ReleaseState, at: Instant, settings: ReleaseSettings) -> ReleaseState:
    """Return the state at an instant: the interlock settled, commands expired or rejected, old ones forgotten."""
    interlock = settle(state.interlock, at, unreported_of(state.commands), settings)
    is_tripped = interlock.state is State.TRIPPED
    commands = tuple(_aged(command, at, is_tripped=is_tripped) for command in state.commands)
    kept = tuple(command for command in commands if _is_kept(command, at))
    sent = tuple(each for each in state.sent if at.now_us - each.at_us < _HOUR_US)
    return followed(replace(state, interlock=interlock, commands=kept, sent=sent), settings)


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
    check = interrupted(state.sign_check)
    return replace(state, interlock=replace(forgotten, state=inhibited), sign_check=check)


def _handled(state: ReleaseState, event: Event, settings: ReleaseSettings) -> Step:
    """Return the step of an event on a settled state."""
    handler = _HANDLERS.get(type(event))
    return handler(state, event, settings) if handler else Step(state)


def _informed(state: ReleaseState, event: RowSeen | InputsChanged | ResponseJudged, settings: ReleaseSettings) -> Step:
    """Return the state whose interlock is updated by an event."""
    return Step(replace(state, interlock=_updated(state.interlock, event, settings)))


def _given(state: ReleaseState, event: AnglesFit, _settings: ReleaseSettings) -> Step:
    """Return the step that gives angles out; the state stays."""
    return Step(state, (UplinkEffect(event.product),))


def _updated(
    interlock: Interlock, event: RowSeen | InputsChanged | ResponseJudged, settings: ReleaseSettings
) -> Interlock:
    """Return the interlock updated by an event."""
    match event:
        case RowSeen():
            return _with_row(interlock, event, settings)
        case InputsChanged():
            is_other_spacecraft = event.inputs.spacecraft_version != interlock.inputs.spacecraft_version
            proven = () if is_other_spacecraft else interlock.proven_axes
            return replace(interlock, inputs=event.inputs, proven_axes=proven)
        case ResponseJudged():
            is_missed = not event.log_ratio <= settings.missed_log_ratio
            return tripped(interlock, Condition.RESPONSE_MISSED, event.at, settings) if is_missed else interlock


def _with_row(interlock: Interlock, event: RowSeen, settings: ReleaseSettings) -> Interlock:
    """Return the interlock with a row; one that is not newer changes nothing."""
    row, before = event.row, interlock.row
    if before is not None and row.epoch_us <= before.epoch_us:
        return interlock
    is_after_gap = before is not None and row.epoch_us - before.epoch_us > _stale_us(before, settings)
    since_us = _since(interlock.durations.innovation_since_us, event.at.now_us, is_so=not row.is_innovation_in_band)
    durations = replace(interlock.durations, innovation_since_us=since_us)
    return replace(interlock, row=replace(row, is_after_gap=is_after_gap), durations=durations)


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


def _aged(command: Command, at: Instant, *, is_tripped: bool) -> Command:
    """Return a command at an instant: an open one ends by a trip or by its time."""
    if command.state not in OPEN or (not is_tripped and at.now_us < command.expires_us):
        return command
    ended = next_state(command.state, CommandTransition.REJECT if is_tripped else CommandTransition.EXPIRE)
    return command if ended is None else replace(command, state=ended)


def _is_kept(command: Command, at: Instant) -> bool:
    """Return whether a command stays in the state: it has not ended, or ended less than an hour ago."""
    if command.state in OPEN or command.state in UNREPORTED:
        return True
    newest_us = max(command.prepared_us, command.released_us or 0, command.reported_us or 0)
    if command.executed:
        # a later command may leave out its end
        newest_us = max(newest_us, command.stop_us)
    return at.now_us - newest_us < _HOUR_US


def _stale_us(row: InterlockRow, settings: ReleaseSettings) -> int:
    return microseconds(settings.stale_periods * row.period_s + settings.stale_margin_s)


def _since(before_us: int | None, now_us: int, *, is_so: bool) -> int | None:
    """Return since when something has been so."""
    if not is_so:
        return None
    return now_us if before_us is None else before_us


def effects_of(before: ReleaseState, after: ReleaseState, at: Instant) -> Iterator[ReleaseEffect]:
    """Yield the effects of a change of the state: of its commands, of its interlock, and of what listeners see."""
    known = {command.counter: command for command in before.commands}
    for command in after.commands:
        yield from command_effects(known.get(command.counter), command)
    old, new = before.interlock, after.interlock
    if new.is_withholding is not old.is_withholding:
        yield JournalEffect(InterlockHold(at.now_us, new.state.name, new.reasons, new.is_withholding, 0))
    if new.state is not old.state:
        yield AuditEffect(f"interlock_{new.state.name.lower()}", "control")
    alarms = [condition for condition in new.standing if condition in ALARMED and condition not in old.standing]
    alarms += [condition for condition in new.trips if condition not in old.trips]
    yield from (PublishEffect(condition.word) for condition in alarms)
    if _shown(before) != _shown(after):
        yield PublishEffect()


def _shown(state: ReleaseState) -> tuple[object, ...]:
    """Return the part of a state whose change listeners are notified of."""
    interlock, check = state.interlock, state.sign_check
    states = tuple((command.counter, command.state) for command in state.commands)
    shown = None if check is None else replace(check, log_ratio=None)
    return interlock.state, interlock.reasons, interlock.authorisation, states, shown


#: a tick does nothing but let time pass
_HANDLERS: dict[type, Callable[[ReleaseState, Any, ReleaseSettings], Step]] = {
    RowSeen: _informed,
    InputsChanged: _informed,
    ResponseJudged: _informed,
    Prepare: prepare,
    Confirm: confirm,
    Cancel: cancel,
    Report: report,
    Automatic: automatic,
    Applied: applied,
    AnglesFit: _given,
    BeginSignCheck: begin,
    PrepareLeg: prepare_leg,
    SignJudged: judge,
    Order: _ordered,
    Engage: _ordered,
}
