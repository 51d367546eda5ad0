"""Checks at the moment of a release, each by name, with the code by which it refuses."""

from service.core.control.envelope import Envelope, envelope_excesses
from service.core.control.slew_schedule import Effect, Triple
from service.pipeline.control.release.command_states import UNREPORTED
from service.pipeline.control.release.events import Refusal, ReleaseState
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import Condition, Consequence
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.epoch import US_PER_S
from service.records.operations.release import Command, CommandCheck

_HOUR_US = 3600 * US_PER_S
#: states in which a command may go
_MAY_RELEASE = frozenset({State.ARMED, State.ENGAGED, State.RECOVERY})


def release_checks(
    state: ReleaseState,
    command: Command,
    at: Instant,
    settings: ReleaseSettings,
    *,
    envelope: Envelope,
    waiting_s: float,
) -> tuple[CommandCheck, ...]:
    """Return every check of a command against a settled state, those that fail and those that hold.

    Parameters
    ----------
    state : ReleaseState
        At the instant.
    envelope : Envelope
        Of the settings, or the authorised one.
    waiting_s : float, s
        How long a person may look at a command before it is too old; 0 for the law.
    """
    interlock = state.interlock
    sent = sent_within_an_hour(state, at.now_us)
    excesses = envelope_excesses(effect_of(command), sent, envelope)
    row = interlock.row
    newest_us, period_s = (0, 0.0) if row is None else (row.epoch_us, row.period_s)
    stale_us = settings.stale_us(period_s, waiting_s)
    yaw = command.gross_impulse_n_m_s.yaw
    waiting = [each.counter for each in state.commands if each.state in UNREPORTED]
    return (
        _interlock_check(state),
        _check("envelope", not excesses, "envelope.exceeded", "; ".join(map(str, excesses))),
        _check(
            "yaw",
            yaw == 0.0 or not _is_yaw_withheld(interlock, command),
            "interlock.yaw_withheld",
            "the yaw torque is withheld: leave it out",
        ),
        _check(
            "reports",
            not waiting,
            "command.unreported",
            f"what became of command {', '.join(map(str, waiting))} is not reported: report it first",
        ),
        _check(
            "estimate",
            0 < command.attitude_epoch_us <= newest_us and newest_us - command.attitude_epoch_us <= stale_us,
            "command.estimate_stale",
            "computed from an estimate that is not the newest any more: prepare it again",
        ),
        *_tail_checks(state, command),
        *_schedule_checks(command, at, settings),
    )


def _tail_checks(state: ReleaseState, command: Command) -> tuple[CommandCheck, ...]:
    """Return the check that a sign check cuts no command short: the filter does not get its torque."""
    if not command.is_sign_check:
        return ()
    flying = [
        each.counter
        for each in state.commands
        if not each.is_sign_check and max((pulse.stop_us for pulse in each.executed), default=0) > command.start_us
    ]
    detail = f"command {', '.join(map(str, flying))} is still flown when it would begin: wait for its end"
    return (_check("earlier commands", not flying, "sign_check.flying", detail),)


def _schedule_checks(command: Command, at: Instant, settings: ReleaseSettings) -> tuple[CommandCheck, ...]:
    """Return the checks of the schedule itself."""
    latest_us = at.now_us + microseconds(settings.latest_stop_s)
    return (
        _check(
            "flexible response",
            command.schedule_verdict in ("accept", "warn"),
            "schedule.rejected",
            f"the flexible-response check says {command.schedule_verdict}",
        ),
        _check(
            "start",
            command.start_us >= at.now_us + microseconds(settings.uplink_lead_s),
            "command.start_passed",
            f"the uplink needs {settings.uplink_lead_s:g} s: the schedule begins before it can be there",
        ),
        _check(
            "end",
            max(command.start_us, command.stop_us, *(pulse.stop_us for pulse in command.schedule)) <= latest_us,
            "command.too_long",
            f"the schedule must be over within {settings.latest_stop_s:g} s: what has gone out no trip can stop",
        ),
        _check("pulses", bool(command.schedule), "command.empty", "a command without a pulse does nothing"),
    )


def first_failure(checks: tuple[CommandCheck, ...]) -> Refusal | None:
    """Return the refusal of the first check that fails."""
    return next((Refusal(check.code, check.detail) for check in checks if not check.is_ok), None)


def effect_of(command: Command) -> Effect:
    """Return the predicted effect of a command as the envelope measures it."""
    return Effect(*(getattr(command, name) for name in Effect._fields))


def sent_within_an_hour(state: ReleaseState, now_us: int) -> Triple:
    """Return the sum of the impulses sent within the hour before an instant, yaw, roll, pitch, N m s."""
    recent = [sent.impulse_n_m_s for sent in state.sent if now_us - sent.at_us < _HOUR_US]
    yaw, roll, pitch = (float(sum(values)) for values in zip(*recent, strict=True)) if recent else (0.0, 0.0, 0.0)
    return yaw, roll, pitch


def _is_yaw_withheld(interlock: Interlock, command: Command) -> bool:
    """Whether a yaw torque may not go; that the sign is not proven does not hold back the check that proves it."""
    standing = {each for each in interlock.standing if each.consequence is Consequence.YAW}
    return bool(standing - {Condition.YAW_SIGN} if command.is_sign_check else standing)


def _check(name: str, is_ok: bool, code: str, detail: str) -> CommandCheck:  # noqa: FBT001 - one row of a table
    """Return a check; code and detail stand only where it fails."""
    return CommandCheck(name, is_ok) if is_ok else CommandCheck(name, is_ok, detail, code)


def _interlock_check(state: ReleaseState) -> CommandCheck:
    """Return the check that the interlock lets commands go at all."""
    interlock = state.interlock
    reasons = ", ".join(interlock.reasons)
    if interlock.state is State.TRIPPED:
        return _check(
            "interlock", False, "interlock.tripped", f"control tripped ({reasons}): find the cause, reset, arm"
        )
    if interlock.state is State.INHIBITED and not interlock.inhibiting and not interlock.is_armed:
        return _check("interlock", False, "interlock.not_armed", "control is not armed")
    is_ok = interlock.state in _MAY_RELEASE and not interlock.inhibiting
    return _check("interlock", is_ok, "interlock.inhibited", f"control is inhibited: {reasons}")
