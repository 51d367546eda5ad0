"""Commands: prepared, confirmed, released, reported.

Law of this file: every function gets a settled state, and returns a step whose refusal means that nothing changed. The
torque of a sign check is not told to the filter; its actions say so, the rest of its life is that of any command.
"""

from dataclasses import replace

from service.core.control.envelope import envelope_excesses
from service.core.control.slew_schedule import AxisPulse
from service.pipeline.control.release.command_states import OPEN, REPORTS, CommandState, CommandTransition, next_state
from service.pipeline.control.release.events import (
    Action,
    ActionKind,
    Applied,
    Automatic,
    Cancel,
    CommandRecord,
    Confirm,
    Prepare,
    Proposal,
    Refusal,
    ReleaseState,
    Report,
    SentImpulse,
    Step,
    digest_of,
)
from service.pipeline.control.release.interlock import Instant, tripped
from service.pipeline.control.release.interlock_conditions import Condition
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.release_checks import first_failure, release_checks, sent_within_an_hour
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.epoch import US_PER_S

#: who stands behind a command that nobody confirmed by hand
AUTHORISATION = "authorisation"


def prepare(state: ReleaseState, event: Prepare, settings: ReleaseSettings) -> Step:
    """Return the state with a prepared command."""
    waiting = [command.counter for command in state.commands if command.life in OPEN]
    if waiting:
        return refused(state, "command.open", f"command {waiting[0]} waits for its confirmation: confirm or cancel it")
    refusal = _failure_by_hand(state, event.proposal, event.at, settings)
    if refusal is not None:
        return Step(state, (), refusal)
    command = _new(state, event.proposal, event.by, event.at, settings)
    return Step(replace(state, commands=(*state.commands, command), next_counter=state.next_counter + 1))


def confirm(state: ReleaseState, event: Confirm, settings: ReleaseSettings) -> Step:
    """Return the state with a command confirmed and released in one."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    refusal = _confirm_refusal(command, event)
    if refusal is None:
        refusal = _failure_by_hand(state, command.proposal, event.at, settings)
    if refusal is not None:
        return Step(state, (), refusal)
    confirmed = replace(command, life=_moved(command, CommandTransition.CONFIRM), confirmed_by=event.by)
    released = replace(confirmed, life=_moved(confirmed, CommandTransition.RELEASE), released_us=event.at.now_us)
    actions = (
        Action(ActionKind.RELEASE, "confirmed", command.counter),
        Action(ActionKind.UNCERTAIN, "until reported", command.counter),
    )
    return Step(_with_released(state, released, event.at), actions)


def automatic(state: ReleaseState, event: Automatic, settings: ReleaseSettings) -> Step:
    """Return the state with a command of the law released under the standing authorisation.

    A request beyond the envelope of the settings trips: the law does not ask for such things. One beyond the authorised
    envelope only is refused; it may be prepared and confirmed. What was released waits for its report like any other.
    """
    interlock = state.interlock
    if interlock.state in (State.ARMED, State.RECOVERY) or interlock.authorisation is None:
        return refused(state, *_no_authorisation(interlock.state))
    if event.proposal.attitude_epoch_us <= state.released_epoch_us:
        return refused(state, "command.duplicate", "a command from this estimate, or a newer one, has been released")
    allowed = settings.envelope
    checks = release_checks(state, event.proposal, event.at, settings, envelope=allowed, waiting_s=0.0)
    failure = first_failure(checks)
    if failure is not None and failure.code == "envelope.exceeded":
        stopped = tripped(interlock, Condition.ENVELOPE, event.at, settings)
        return Step(replace(state, interlock=stopped), (Action(ActionKind.ALARM, f"envelope: {failure.detail}"),))
    allowed = interlock.authorisation.terms.envelope
    checks = release_checks(state, event.proposal, event.at, settings, envelope=allowed, waiting_s=0.0)
    failure = failure or first_failure(checks)
    if failure is not None:
        return Step(state, (), failure)
    command = _new(state, event.proposal, AUTHORISATION, event.at, settings)
    confirmed = replace(
        command, life=_moved(command, CommandTransition.CONFIRM), confirmed_by=AUTHORISATION, is_automatic=True
    )
    released = replace(confirmed, life=_moved(confirmed, CommandTransition.RELEASE), released_us=event.at.now_us)
    numbered = replace(state, commands=(*state.commands, command), next_counter=state.next_counter + 1)
    actions = (
        Action(ActionKind.RELEASE, "authorised", command.counter),
        Action(ActionKind.UNCERTAIN, "until reported", command.counter),
    )
    return Step(_with_released(numbered, released, event.at), actions)


def applied(state: ReleaseState, event: Applied, settings: ReleaseSettings) -> Step:
    """Return the state with a computed command that counts as applied without anybody's confirmation.

    It has been told already, so nothing can be refused: one beyond the envelope trips, and none is told any more.
    """
    sent = SentImpulse(event.at.now_us, event.effect.gross_impulse_n_m_s)
    counted = replace(state, sent=(*state.sent, sent))
    excesses = envelope_excesses(event.effect, sent_within_an_hour(state, event.at.now_us), settings.envelope)
    if not excesses:
        return Step(counted)
    stopped = tripped(state.interlock, Condition.ENVELOPE, event.at, settings)
    detail = f"envelope: {'; '.join(map(str, excesses))}"
    return Step(replace(counted, interlock=stopped), (Action(ActionKind.ALARM, detail),))


def _failure_by_hand(state: ReleaseState, proposal: Proposal, at: Instant, settings: ReleaseSettings) -> Refusal | None:
    """Return why a command that persons look at may not go."""
    allowed, waiting_s = settings.envelope, settings.prepared_s
    return first_failure(release_checks(state, proposal, at, settings, envelope=allowed, waiting_s=waiting_s))


def _no_authorisation(state: State) -> tuple[str, str]:
    """Return code and detail where the interlock is not engaged."""
    if state is State.TRIPPED:
        return "interlock.tripped", "control tripped: find the cause, reset, arm"
    return "interlock.not_engaged", "there is no standing authorisation: prepare and confirm the command"


def cancel(state: ReleaseState, event: Cancel) -> Step:
    """Return the state with a command taken back."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    life = next_state(command.life, CommandTransition.CANCEL)
    if life is None:
        return _illegal(state, command)
    return Step(with_command(state, replace(command, life=life)))


def report(state: ReleaseState, event: Report) -> Step:
    """Return the state with what became of a command."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    life = next_state(command.life, event.turn) if event.turn in REPORTS else None
    if life is None:
        return _illegal(state, command)
    if event.turn is CommandTransition.SENT:
        return Step(with_command(state, replace(command, life=life)))
    start_us, stop_us = event.executed_from_us, event.executed_until_us
    if start_us is not None and stop_us is not None and stop_us < start_us:
        return refused(state, "report.interval", "the executed part ends before it begins")
    executed = _reported_part(command.proposal, event)
    ended = replace(command, life=life, reported_us=event.at.now_us, executed=executed)
    actions = [Action(ActionKind.CERTAIN, life.name, command.counter)]
    if executed:
        actions.append(Action(ActionKind.KNOWN_INPUT, "as reported", command.counter))
    return Step(_with_replaced(with_command(state, ended)), tuple(actions))


def _with_replaced(state: ReleaseState) -> ReleaseState:
    """Return the state in which nothing was executed of a command after the first pulse of a later one.

    A report may say that all was executed while the end still lies ahead; the craft leaves it out when it begins a
    command with a greater counter.
    """
    begun_us = {
        command.counter: command.proposal.start_us + round(command.executed[0].start_s * US_PER_S)
        for command in state.commands
        if command.executed
    }
    commands = []
    for command in state.commands:
        later_us = [start_us for counter, start_us in begun_us.items() if counter > command.counter]
        if later_us and command.executed:
            left = pulses_between(command.executed, command.proposal.start_us, 0, min(later_us))
            command = command if left == command.executed else replace(command, executed=left)
        commands.append(command)
    return replace(state, commands=tuple(commands))


def executed_part(proposal: Proposal, from_us: int, until_us: int) -> tuple[AxisPulse, ...]:
    """Return the pulses of a schedule, or parts of them, that lie between two instants."""
    return pulses_between(proposal.pulses, proposal.start_us, from_us, until_us)


def pulses_between(pulses: tuple[AxisPulse, ...], epoch_us: int, from_us: int, until_us: int) -> tuple[AxisPulse, ...]:
    """Return the pulses of a schedule that began at an epoch, or parts of them, that lie between two instants."""
    from_s = (from_us - epoch_us) / US_PER_S
    until_s = (until_us - epoch_us) / US_PER_S
    kept = []
    for pulse in pulses:
        start_s, stop_s = max(pulse.start_s, from_s), min(pulse.stop_s, until_s)
        if stop_s > start_s:
            is_whole = start_s == pulse.start_s and stop_s == pulse.stop_s
            kept.append(pulse if is_whole else pulse._replace(start_s=start_s, duration_s=stop_s - start_s))
    return tuple(kept)


def command_of(state: ReleaseState, counter: int) -> CommandRecord | None:
    """Return a command by its counter."""
    return next((command for command in state.commands if command.counter == counter), None)


def with_command(state: ReleaseState, changed: CommandRecord) -> ReleaseState:
    """Return the state with a command in the place of the one of its counter."""
    commands = tuple(changed if each.counter == changed.counter else each for each in state.commands)
    return replace(state, commands=commands)


def refused(state: ReleaseState, code: str, detail: str) -> Step:
    """Return the step of an illegal event."""
    return Step(state, (), Refusal(code, detail))


def unknown(state: ReleaseState, counter: int) -> Step:
    """Return the step of an event about a command that is not known."""
    return refused(state, "command.unknown", f"no command {counter} is open or ended within the last hour")


def _illegal(state: ReleaseState, command: CommandRecord) -> Step:
    return refused(
        state, "command.state", f"command {command.counter} is {command.life.name}: this is not possible any more"
    )


def _new(state: ReleaseState, proposal: Proposal, by: str, at: Instant, settings: ReleaseSettings) -> CommandRecord:
    """Return a prepared command with the next counter; it expires when the uplink cannot bring it in time any more."""
    latest_us = proposal.start_us - microseconds(settings.uplink_lead_s) + 1
    expires_us = min(at.now_us + microseconds(settings.prepared_s), latest_us)
    digest = digest_of(state.next_counter, proposal)
    return CommandRecord(state.next_counter, CommandState.PREPARED, proposal, digest, by, at.now_us, expires_us)


def _confirm_refusal(command: CommandRecord, event: Confirm) -> Refusal | None:
    """Return why a confirmation cannot hold for this command."""
    if command.life is CommandState.EXPIRED:
        return Refusal("command.expired", f"command {command.counter} was not confirmed in time: prepare anew")
    if next_state(command.life, CommandTransition.CONFIRM) is None:
        return Refusal("command.state", f"command {command.counter} is {command.life.name}: it cannot be confirmed")
    if event.digest != command.digest:
        return Refusal("command.digest", "the digest is not that of the prepared command: read it again")
    if event.by == command.prepared_by or not event.is_approver:
        return Refusal("command.second_person", "another person, an approver, must confirm")
    return None


def _moved(command: CommandRecord, turn: CommandTransition) -> CommandState:
    """Return where a turn leads that the table must allow here."""
    life = next_state(command.life, turn)
    if life is None:
        raise ValueError(f"the table of lives knows no {turn.name} from {command.life.name}")
    return life


def _with_released(state: ReleaseState, command: CommandRecord, at: Instant) -> ReleaseState:
    """Return the state with a released command; its whole impulse counts from now on, whatever becomes of it."""
    sent = SentImpulse(at.now_us, command.proposal.effect.gross_impulse_n_m_s)
    newest_us = max(state.released_epoch_us, command.proposal.attitude_epoch_us)
    return replace(with_command(state, command), sent=(*state.sent, sent), released_epoch_us=newest_us)


def _reported_part(proposal: Proposal, event: Report) -> tuple[AxisPulse, ...]:
    """Return what a report says was executed."""
    if event.turn is CommandTransition.EXECUTED and event.executed_from_us is None and event.executed_until_us is None:
        return proposal.pulses
    if event.executed_from_us is None and event.executed_until_us is None:
        return ()
    from_us = proposal.start_us if event.executed_from_us is None else event.executed_from_us
    until_us = proposal.stop_us + US_PER_S if event.executed_until_us is None else event.executed_until_us
    return executed_part(proposal, from_us, until_us)
