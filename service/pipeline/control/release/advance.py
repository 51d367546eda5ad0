"""The one function that steps interlock, commands and sign check: state and event in, state, effects and refusal out.

Law of this file: an event is judged against the state as it is at the event's instant; where it is refused
nothing happens but what a tick at that instant does, so a trip found then is kept. No clock is read here. Effects
follow from the change of the state, so what a state does not show is not given out.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from service.pipeline.control.release import command_transitions, events, sign_checks
from service.pipeline.control.release.command_states import (
    OPEN,
    REFUSALS,
    UNREPORTED,
    CommandTransition,
    State,
    Trigger,
    rows_of,
)
from service.pipeline.control.release.command_transitions import command_effects, moved, refused
from service.pipeline.control.release.events import (
    AuditEffect,
    Event,
    JournalEffect,
    OrderKind,
    PublishEffect,
    ReleaseEffect,
    ReleaseState,
    Step,
    UplinkEffect,
)
from service.pipeline.control.release.interlock import Instant, Interlock, Request, Terms, fire, settle, tripped
from service.pipeline.control.release.interlock_conditions import (
    ALARMED,
    Condition,
    ReleaseSettings,
    microseconds,
    missed_limit,
)
from service.records.epoch import US_PER_S
from service.records.operations.release import Command, InterlockHold

_HOUR_US = 3600 * US_PER_S


def advance(state: ReleaseState, event: Event, settings: ReleaseSettings) -> Step:
    """Return what an event leads to: state, effects, and a refusal with a code where it was illegal.

    State and effects of a refused event are those of a `Tick` at the same instant.
    """
    settled = settled_at(state, event.at, settings)
    handler = _HANDLERS.get(type(event))
    step = Step(settled) if handler is None else handler(settled, event, settings)
    # a refused step holds the settled state: time passes all the same, and what it brings to light is kept
    after = settled_at(step.state, event.at, settings)
    return Step(after, (*step.effects, *effects_of(state, after, event.at)), step.refusal)


def settled_at(state: ReleaseState, at: Instant, settings: ReleaseSettings) -> ReleaseState:
    """Return the state at an instant: the interlock settled, commands expired or rejected, old ones forgotten."""
    interlock = settle(state.interlock, at, state.commands, settings)
    is_tripped = interlock.state is State.TRIPPED
    commands = tuple(_aged(command, at, is_tripped=is_tripped) for command in state.commands)
    kept = tuple(command for command in commands if _is_kept(command, at))
    sent = tuple(each for each in state.sent if at.now_us - each.at_us < _HOUR_US)
    return sign_checks.followed(replace(state, interlock=interlock, commands=kept, sent=sent), settings)


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
    check = sign_checks.interrupted(state.sign_check)
    return replace(state, interlock=replace(forgotten, state=inhibited), sign_check=check)


def _row_seen(state: ReleaseState, event: events.RowSeen, settings: ReleaseSettings) -> Step:
    """Return the step of a row; one that is not newer changes nothing."""
    interlock, row, before = state.interlock, event.row, state.interlock.row
    if before is not None and row.epoch_us <= before.epoch_us:
        return Step(state)
    is_after_gap = before is not None and row.epoch_us - before.epoch_us > settings.stale_us(before.period_s)
    since_us = event.at.now_us if interlock.innovation_since_us is None else interlock.innovation_since_us
    updated = replace(
        interlock,
        row=replace(row, is_after_gap=True) if is_after_gap else row,
        innovation_since_us=None if row.is_innovation_in_band else since_us,
    )
    return Step(replace(state, interlock=updated))


def _inputs_changed(state: ReleaseState, event: events.InputsChanged, _settings: ReleaseSettings) -> Step:
    """Return the step of other inputs; signs are proven for one version of the spacecraft."""
    interlock = state.interlock
    is_other_spacecraft = event.inputs.spacecraft_version != interlock.inputs.spacecraft_version
    proven = () if is_other_spacecraft else interlock.proven_axes
    return Step(replace(state, interlock=replace(interlock, inputs=event.inputs, proven_axes=proven)))


def _response_judged(state: ReleaseState, event: events.ResponseJudged, settings: ReleaseSettings) -> Step:
    """Return the step of a judged response; a missed one trips."""
    if event.log_ratio <= missed_limit(state.interlock.row, settings):
        return Step(state)
    return Step(replace(state, interlock=tripped(state.interlock, Condition.RESPONSE_MISSED, event.at, settings)))


def _given(state: ReleaseState, event: events.AnglesFit, _settings: ReleaseSettings) -> Step:
    """Return the step that gives angles out; the state stays."""
    return Step(state, (UplinkEffect(event.product),))


def _ordered(state: ReleaseState, event: events.Order, settings: ReleaseSettings) -> Step:
    """Return the step of a person's order to the interlock."""
    if event.kind is OrderKind.STOP:
        return Step(replace(state, interlock=tripped(state.interlock, Condition.STOP, event.at, settings)))
    return _fired(state, Trigger[event.kind.name], event.at, settings)


def _engaged(state: ReleaseState, event: events.Engage, settings: ReleaseSettings) -> Step:
    """Return the step of a request for standing authorisation."""
    asked = Request(event.by, event.at.now_us, Terms(event.until_us, event.envelope))
    is_legal = rows_of(state.interlock.state, Trigger.ENGAGE)
    problem = _engage_problem(state.interlock, event, settings) if is_legal else None
    return refused(state, *problem) if problem else _fired(state, Trigger.ENGAGE, event.at, settings, asked)


def _fired(
    state: ReleaseState, trigger: Trigger, at: Instant, settings: ReleaseSettings, asked: Request | None = None
) -> Step:
    """Return the step of an order's trigger, refused where it means nothing or no guard lets it through."""
    interlock = state.interlock
    reasons = ", ".join(interlock.reasons)
    if not rows_of(interlock.state, trigger):
        if interlock.state is State.TRIPPED:
            return refused(state, "interlock.tripped", f"control tripped ({reasons})")
        return refused(state, "interlock.state", f"{trigger.value}: not in state {interlock.state.name}")
    fired = fire(interlock, trigger, at, settings, asked)
    if fired is None:
        return refused(state, REFUSALS[trigger], f"{trigger.value}: {reasons or 'not as asked'}")
    return Step(replace(state, interlock=fired))


def _engage_problem(interlock: Interlock, event: events.Engage, settings: ReleaseSettings) -> tuple[str, str] | None:
    """Return code and detail of what is wrong with the terms of an authorisation."""
    if not {"roll", "pitch"} <= set(interlock.proven_axes):
        return "interlock.sign_unproven", "the signs of roll and pitch are not proven"
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
    if command.state in OPEN and is_tripped:
        return moved(command, CommandTransition.REJECT)
    if command.state in OPEN and at.now_us >= command.expires_us:
        return moved(command, CommandTransition.EXPIRE)
    return command


def _is_kept(command: Command, at: Instant) -> bool:
    """Return whether a command stays in the state: it has not ended, or ended less than an hour ago."""
    if command.state in OPEN or command.state in UNREPORTED:
        return True
    newest_us = max(command.prepared_us, command.released_us or 0, command.reported_us or 0)
    if command.executed:
        # a later command may leave out its end
        newest_us = max(newest_us, command.stop_us)
    return at.now_us - newest_us < _HOUR_US


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
    # of a settled interlock `since` has its reasons
    return interlock.state, interlock.since, interlock.authorisation, states, shown


#: a tick does nothing but let time pass
_HANDLERS: dict[type[Event], Callable[[ReleaseState, Any, ReleaseSettings], Step]] = {
    events.RowSeen: _row_seen,
    events.InputsChanged: _inputs_changed,
    events.ResponseJudged: _response_judged,
    events.Prepare: command_transitions.prepare,
    events.Confirm: command_transitions.confirm,
    events.Cancel: command_transitions.cancel,
    events.Report: command_transitions.report,
    events.Automatic: command_transitions.automatic,
    events.Applied: command_transitions.applied,
    events.AnglesFit: _given,
    events.BeginSignCheck: sign_checks.begin,
    events.PrepareLeg: sign_checks.prepare_leg,
    events.SignJudged: sign_checks.judge,
    events.Order: _ordered,
    events.Engage: _engaged,
}
