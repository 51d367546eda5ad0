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
    envelope: Envelope | None = None,
    waiting_s: float | None = None,
) -> tuple[CommandCheck, ...]:
    """Return every check of a command against a settled state, those that fail and those that hold.

    The envelope is that of the settings unless another one is authorised; persons may look at the command for
    `waiting_s`, by default as long as a prepared one waits, before its estimate is too old.
    """
    interlock, epoch_us, yaw = state.interlock, command.attitude_epoch_us, command.gross_impulse_n_m_s.yaw
    sent_n_m_s = sent_within_an_hour(state, at.now_us)
    effect = Effect(*(getattr(command, name) for name in Effect._fields))
    excesses = envelope_excesses(effect, sent_n_m_s, envelope or settings.envelope)
    newest_us, period_s = (0, 0.0) if interlock.row is None else (interlock.row.epoch_us, interlock.row.period_s)
    stale_us = settings.stale_us(period_s, settings.prepared_s if waiting_s is None else waiting_s)
    waiting = [each.counter for each in state.commands if each.state in UNREPORTED]
    unreported = f"what became of command {', '.join(map(str, waiting))} is not reported"
    stale = "computed from an estimate that is not the newest any more"
    withheld = "the yaw torque is withheld"
    return (
        _interlock_check(interlock),
        _check("envelope", not excesses, "envelope.exceeded", "; ".join(map(str, excesses))),
        _check("yaw", yaw == 0.0 or not _is_yaw_withheld(interlock, command), "interlock.yaw_withheld", withheld),
        _check("reports", not waiting, "command.unreported", unreported),
        _check("estimate", 0 < epoch_us <= newest_us <= epoch_us + stale_us, "command.estimate_stale", stale),
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
    detail = f"command {', '.join(map(str, flying))} is still flown when it would begin"
    return (_check("earlier commands", not flying, "sign_check.flying", detail),)


def _schedule_checks(command: Command, at: Instant, settings: ReleaseSettings) -> tuple[CommandCheck, ...]:
    """Return the checks of the schedule itself."""
    soonest_us = at.now_us + microseconds(settings.uplink_lead_s)
    latest_us = at.now_us + microseconds(settings.latest_stop_s)
    stop_us = max(command.start_us, command.stop_us, *(pulse.stop_us for pulse in command.schedule))
    lead, limit, verdict = settings.uplink_lead_s, settings.latest_stop_s, command.schedule_verdict
    rejected = f"the flexible-response check says {verdict}"
    passed = f"the uplink needs {lead:g} s: the schedule begins before it can be there"
    too_long = f"the schedule must be over within {limit:g} s: what has gone out no trip can stop"
    return (
        _check("flexible response", verdict in ("accept", "warn"), "schedule.rejected", rejected),
        _check("start", command.start_us >= soonest_us, "command.start_passed", passed),
        _check("end", stop_us <= latest_us, "command.too_long", too_long),
        _check("pulses", bool(command.schedule), "command.empty", "a command without a pulse does nothing"),
    )


def first_failure(checks: tuple[CommandCheck, ...]) -> Refusal | None:
    """Return the refusal of the first check that fails."""
    return next((Refusal(check.code, check.detail) for check in checks if not check.is_ok), None)


def sent_within_an_hour(state: ReleaseState, now_us: int) -> Triple:
    """Return the sum of the impulses sent within the hour before an instant, yaw, roll, pitch, N m s."""
    recent = [sent.impulse_n_m_s for sent in state.sent if now_us - sent.at_us < _HOUR_US]
    yaw, roll, pitch = (float(sum(values)) for values in zip(*recent, strict=True)) if recent else (0.0, 0.0, 0.0)
    return yaw, roll, pitch


def _is_yaw_withheld(interlock: Interlock, command: Command) -> bool:
    """Return whether a yaw torque is withheld; an unproven sign does not withhold the check that proves it."""
    standing = {each for each in interlock.standing if each.consequence is Consequence.YAW}
    return bool(standing - {Condition.YAW_SIGN} if command.is_sign_check else standing)


def _check(name: str, is_ok: bool, code: str, detail: str) -> CommandCheck:  # noqa: FBT001 - one row of a table
    """Return a check; code and detail stand only where it fails."""
    return CommandCheck(name, is_ok) if is_ok else CommandCheck(name, is_ok, detail, code)


def _interlock_check(interlock: Interlock) -> CommandCheck:
    """Return the check that the interlock lets commands go at all."""
    reasons, is_ok, code = ", ".join(interlock.reasons), False, "interlock.inhibited"
    detail = f"control is inhibited: {reasons}"
    if interlock.state is State.TRIPPED:
        code, detail = "interlock.tripped", f"control tripped ({reasons})"
    elif interlock.state is State.INHIBITED and not interlock.inhibiting and not interlock.is_armed:
        code, detail = "interlock.not_armed", "control is not armed"
    else:
        is_ok = interlock.state in _MAY_RELEASE and not interlock.inhibiting
    return _check("interlock", is_ok, code, detail)
