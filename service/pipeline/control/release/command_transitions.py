"""Commands: prepared, confirmed, released, reported.

Law of this file: every function gets a settled state, and returns a step whose refusal means that nothing changed. The
effects of a release and of a report follow from the change of the record alone.
"""

from collections.abc import Iterator
from dataclasses import replace

from service.core.control.slew_schedule import Triple, envelope_excesses
from service.pipeline.control.release import events
from service.pipeline.control.release.command_states import OPEN, REPORTS, CommandTransition, State, next_state
from service.pipeline.control.release.events import Refusal, ReleaseState, Step, digest_of
from service.pipeline.control.release.interlock import Instant, tripped
from service.pipeline.control.release.interlock_conditions import Condition, ReleaseSettings, microseconds
from service.pipeline.control.release.release_checks import first_failure, release_checks, sent_within_an_hour
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Pulse, ReleasedCommand, ReportedCommand
from service.records.operations.release import Command, CommandState, ProductForm, UplinkProduct

#: who stands behind a command that nobody confirmed by hand
AUTHORISATION = "authorisation"


def prepare(state: ReleaseState, event: events.Prepare, settings: ReleaseSettings) -> Step:
    """Return the state with a prepared command."""
    waiting = [command.counter for command in state.commands if command.state in OPEN]
    if waiting:
        return refused(state, "command.open", f"command {waiting[0]} waits for its confirmation")
    refusal = first_failure(release_checks(state, event.command, event.at, settings))
    if refusal is not None:
        return Step(state, (), refusal)
    return Step(_with_new(state, event.command, event.by, event.at, settings))


def confirm(state: ReleaseState, event: events.Confirm, settings: ReleaseSettings) -> Step:
    """Return the state with a command confirmed and released in one."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    refusal = _confirm_refusal(command, event) or first_failure(release_checks(state, command, event.at, settings))
    if refusal is not None:
        return Step(state, (), refusal)
    return Step(_with_released(state, replace(command, comment=event.comment or command.comment), event.by, event.at))


def automatic(state: ReleaseState, event: events.Automatic, settings: ReleaseSettings) -> Step:
    """Return the state with a command of the law released under the standing authorisation.

    A request beyond the envelope of the settings trips: the law does not ask for such things. One beyond the authorised
    envelope only is refused; it may be prepared and confirmed. A released command waits for its report like any other.
    """
    interlock, wanted = state.interlock, event.command
    if interlock.state in (State.ARMED, State.RECOVERY) or interlock.authorisation is None:
        if interlock.state is State.TRIPPED:
            return refused(state, "interlock.tripped", "control tripped")
        detail = "there is no standing authorisation"
        return refused(state, "interlock.not_engaged", detail)
    if wanted.attitude_epoch_us <= state.released_epoch_us:
        return refused(state, "command.duplicate", "a command from this estimate, or a newer one, has been released")
    failure = first_failure(release_checks(state, wanted, event.at, settings, waiting_s=0.0))
    if failure is not None and failure.code == "envelope.exceeded":
        stopped = tripped(interlock, Condition.ENVELOPE, event.at, settings)
        return Step(replace(state, interlock=stopped), (events.PublishEffect(f"envelope: {failure.detail}"),))
    allowed = interlock.authorisation.terms.envelope
    checks = release_checks(state, wanted, event.at, settings, envelope=allowed, waiting_s=0.0)
    failure = failure or first_failure(checks)
    if failure is not None:
        return Step(state, (), failure)
    numbered = _with_new(state, replace(wanted, is_automatic=True), AUTHORISATION, event.at, settings)
    return Step(_with_released(numbered, numbered.commands[-1], AUTHORISATION, event.at))


def applied(state: ReleaseState, event: events.Applied, settings: ReleaseSettings) -> Step:
    """Return the state with a computed command that counts as applied without anybody's confirmation.

    It has been published already, so nothing can be refused: one beyond the envelope trips, and the next are withheld.
    """
    counted = _with_sent(state, event.effect.gross_impulse_n_m_s, event.at)
    excesses = envelope_excesses(event.effect, sent_within_an_hour(state, event.at.now_us), settings.envelope)
    if not excesses:
        return Step(counted)
    stopped = tripped(state.interlock, Condition.ENVELOPE, event.at, settings)
    detail = f"envelope: {'; '.join(map(str, excesses))}"
    return Step(replace(counted, interlock=stopped), (events.PublishEffect(detail),))


def cancel(state: ReleaseState, event: events.Cancel, _settings: ReleaseSettings) -> Step:
    """Return the state with a command taken back."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    if command.state not in OPEN:
        return _illegal(state, command, CommandTransition.CANCEL)
    return Step(with_command(state, moved(command, CommandTransition.CANCEL)))


def report(state: ReleaseState, event: events.Report, _settings: ReleaseSettings) -> Step:
    """Return the state with what became of a command."""
    command = command_of(state, event.counter)
    if command is None:
        return unknown(state, event.counter)
    if event.transition not in REPORTS or next_state(command.state, event.transition) is None:
        return _illegal(state, command, event.transition)
    reported = moved(command, event.transition)
    if event.transition is CommandTransition.SENT:
        sent_us = event.at.now_us if event.reported_at_us is None else event.reported_at_us
        return Step(with_command(state, replace(reported, sent_us=sent_us)))
    start_us, stop_us = event.executed_from_us, event.executed_until_us
    if start_us is not None and stop_us is not None and stop_us < start_us:
        return refused(state, "report.interval", "the executed part ends before it begins")
    ended = replace(
        reported,
        reported_us=event.at.now_us,
        reported_by=event.by,
        told_executed_us=(start_us, stop_us),
        executed=_reported_part(command, event),
    )
    return Step(_with_replaced(with_command(state, ended)))


def command_effects(before: Command | None, after: Command) -> Iterator[events.ReleaseEffect]:
    """Yield the effects of a command's release and report; the filter does not get the torque of a sign check."""
    if after.released_us is not None and (before is None or before.released_us is None):
        if not after.is_sign_check:
            yield events.JournalEffect(ReleasedCommand(after.counter, after.released_us, after.schedule))
        yield events.UplinkEffect(_torque_product(after, after.released_us))
        if after.is_automatic:
            yield events.AuditEffect("release_torque", f"torques/{after.counter}")
    is_reported = after.reported_us is not None and (before is None or before.reported_us is None)
    if is_reported and not after.is_sign_check:
        yield events.JournalEffect(ReportedCommand(after.counter, after.reported_us or 0, after.executed))


def pulses_between(pulses: tuple[Pulse, ...], from_us: int, until_us: int) -> tuple[Pulse, ...]:
    """Return the pulses of a schedule, or parts of them, that lie between two instants."""
    kept = []
    for pulse in pulses:
        start_us, stop_us = max(pulse.start_us, from_us), min(pulse.stop_us, until_us)
        if (start_us, stop_us) == (pulse.start_us, pulse.stop_us):
            kept.append(pulse)
        elif stop_us > start_us:
            kept.append(replace(pulse, start_us=start_us, duration_s=(stop_us - start_us) / US_PER_S))
    return tuple(kept)


def moved(command: Command, transition: CommandTransition) -> Command:
    """Return a command after a transition that its table must have."""
    state = next_state(command.state, transition)
    if state is None:
        raise ValueError(f"the table of commands knows no {transition.name} from {command.state}")
    return replace(command, state=state)


def command_of(state: ReleaseState, counter: int | None) -> Command | None:
    """Return a command by its counter."""
    return next((command for command in state.commands if command.counter == counter), None)


def with_command(state: ReleaseState, changed: Command) -> ReleaseState:
    """Return the state with a command in the place of the one of its counter."""
    commands = tuple(changed if each.counter == changed.counter else each for each in state.commands)
    return replace(state, commands=commands)


def refused(state: ReleaseState, code: str, detail: str) -> Step:
    """Return the step of an illegal event."""
    return Step(state, (), Refusal(code, detail))


def unknown(state: ReleaseState, counter: int) -> Step:
    """Return the step of an event about a command that is not known."""
    return refused(state, "command.unknown", f"no command {counter} is open or ended within the last hour")


def _illegal(state: ReleaseState, command: Command, transition: CommandTransition) -> Step:
    detail = f"command {command.counter} is {command.state}: {transition.name} does not follow on that"
    return refused(state, "command.state", detail)


def _confirm_refusal(command: Command, event: events.Confirm) -> Refusal | None:
    """Return why a confirmation cannot hold for this command."""
    if command.state is CommandState.EXPIRED:
        return Refusal("command.expired", f"command {command.counter} was not confirmed in time")
    if next_state(command.state, CommandTransition.CONFIRM) is None:
        return Refusal("command.state", f"command {command.counter} is {command.state}: it cannot be confirmed")
    if event.digest != command.digest:
        return Refusal("command.digest", "the digest is not that of the prepared command")
    if event.by == command.prepared_by or not event.is_approver:
        return Refusal("command.second_person", "the second person must be another one, and an approver")
    return None


def _with_new(state: ReleaseState, command: Command, by: str, at: Instant, settings: ReleaseSettings) -> ReleaseState:
    """Return the state with a prepared command; it expires when the uplink cannot bring it in time any more."""
    latest_us = command.start_us - microseconds(settings.uplink_lead_s) + 1
    prepared = replace(
        command,
        counter=state.next_counter,
        state=CommandState.PREPARED,
        digest=digest_of(state.next_counter, command),
        prepared_by=by,
        prepared_us=at.now_us,
        expires_us=min(at.now_us + microseconds(settings.prepared_s), latest_us),
    )
    return replace(state, commands=(*state.commands, prepared), next_counter=state.next_counter + 1)


def _with_released(state: ReleaseState, command: Command, by: str, at: Instant) -> ReleaseState:
    """Return the state with a command confirmed and released; its whole impulse counts, whatever becomes of it."""
    released = moved(moved(command, CommandTransition.CONFIRM), CommandTransition.RELEASE)
    released = replace(released, confirmed_by=by, released_us=at.now_us)
    newest_us = max(state.released_epoch_us, command.attitude_epoch_us)
    sent = _with_sent(with_command(state, released), command.gross_impulse_n_m_s, at)
    return replace(sent, released_epoch_us=newest_us)


def _with_sent(state: ReleaseState, impulse_n_m_s: Triple, at: Instant) -> ReleaseState:
    yaw, roll, pitch = impulse_n_m_s
    return replace(state, sent=(*state.sent, events.SentImpulse(at.now_us, (yaw, roll, pitch))))


def _with_replaced(state: ReleaseState) -> ReleaseState:
    """Return the state in which nothing was executed of a command after the first pulse of a later one.

    A report may say that all was executed while the end still lies ahead; the spacecraft leaves it out when it begins a
    command with a greater counter.
    """
    begun_us = {command.counter: command.executed[0].start_us for command in state.commands if command.executed}
    commands = []
    for command in state.commands:
        later_us = [start_us for counter, start_us in begun_us.items() if counter > command.counter]
        if later_us:
            command = replace(command, executed=pulses_between(command.executed, 0, min(later_us)))
        commands.append(command)
    return replace(state, commands=tuple(commands))


def _reported_part(command: Command, event: events.Report) -> tuple[Pulse, ...]:
    from_us, until_us = event.executed_from_us, event.executed_until_us
    if from_us is None and until_us is None:
        return command.schedule if event.transition is CommandTransition.EXECUTED else ()
    start_us = command.start_us if from_us is None else from_us
    return pulses_between(command.schedule, start_us, command.stop_us + US_PER_S if until_us is None else until_us)


def _torque_product(command: Command, released_us: int) -> UplinkProduct:
    return UplinkProduct(
        form=ProductForm.TORQUES,
        counter=command.counter,
        created_us=released_us,
        valid_from_us=released_us,
        # a centre that gets it later than the first pulse must not send it
        valid_until_us=command.start_us,
        attitude_epoch_us=command.attitude_epoch_us,
        is_simulated=command.is_simulated,
        digest=command.digest,
        schedule=command.schedule,
    )
