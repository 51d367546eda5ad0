"""What must hold at the moment of a release: each check by name, with the code by which it refuses."""

from typing import NamedTuple

from service.core.control.envelope import Envelope, envelope_excesses
from service.core.control.slew_schedule import Triple
from service.pipeline.control.release.command_states import UNREPORTED
from service.pipeline.control.release.events import CommandRecord, Proposal, Refusal, ReleaseState
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import Condition, Consequence, Unreported
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.epoch import US_PER_S

_HOUR_US = 3600 * US_PER_S
#: states in which a command may go
_MAY_RELEASE = frozenset({State.ARMED, State.ENGAGED, State.RECOVERY})


class Check(NamedTuple):
    """One check of a proposal."""

    name: str
    is_ok: bool
    #: by which it refuses
    code: str
    detail: str


def release_checks(
    state: ReleaseState,
    proposal: Proposal,
    at: Instant,
    settings: ReleaseSettings,
    *,
    envelope: Envelope,
    waiting_s: float,
) -> tuple[Check, ...]:
    """Return every check of a proposal against a settled state, those that fail and those that hold.

    Parameters
    ----------
    state : ReleaseState
        At the instant.
    envelope : Envelope
        Of the settings, or the authorised one.
    waiting_s : float, s
        How long a person may look at a proposal before it is too old; 0 for the law.
    """
    interlock = state.interlock
    sent = sent_within_an_hour(state, at.now_us)
    excesses = envelope_excesses(proposal.effect, sent, envelope)
    row = interlock.row
    newest_us, period_s = (0, 0.0) if row is None else (row.epoch_us, row.period_s)
    stale_us = microseconds(settings.stale_periods * period_s + settings.stale_margin_s + waiting_s)
    yaw = proposal.effect.gross_impulse_n_m_s[0]
    waiting = [command.counter for command in state.commands if command.life in UNREPORTED]
    return (
        _interlock_check(state),
        Check("envelope", not excesses, "envelope.exceeded", "; ".join(map(str, excesses))),
        Check(
            "yaw",
            yaw == 0.0 or not _is_yaw_withheld(interlock, proposal),
            "interlock.yaw_withheld",
            "the yaw torque is withheld: leave it out",
        ),
        Check(
            "reports",
            not waiting,
            "command.unreported",
            f"what became of command {', '.join(map(str, waiting))} is not reported: report it first",
        ),
        Check(
            "estimate",
            0 < proposal.attitude_epoch_us <= newest_us and newest_us - proposal.attitude_epoch_us <= stale_us,
            "command.estimate_stale",
            "computed from an estimate that is not the newest any more: prepare anew",
        ),
        *_tail_checks(state, proposal),
        *_schedule_checks(proposal, at, settings),
    )


def _tail_checks(state: ReleaseState, proposal: Proposal) -> tuple[Check, ...]:
    """Return the check that a sign check cuts no command short: the filter would not be told."""
    if not proposal.is_sign_check:
        return ()
    flying = [
        command.counter
        for command in state.commands
        if not command.proposal.is_sign_check and _executed_until_us(command) > proposal.start_us
    ]
    detail = f"command {', '.join(map(str, flying))} is still flown when it would begin: wait for its end"
    return (Check("earlier commands", not flying, "sign_check.flying", detail),)


def _executed_until_us(command: CommandRecord) -> int:
    """Return when what was reported executed of a command ends, 0 where nothing was."""
    ends_s = [pulse.stop_s for pulse in command.executed]
    return command.proposal.start_us + round(max(ends_s) * US_PER_S) if ends_s else 0


def _schedule_checks(proposal: Proposal, at: Instant, settings: ReleaseSettings) -> tuple[Check, ...]:
    """Return the checks of the schedule itself."""
    latest_us = at.now_us + microseconds(settings.latest_stop_s)
    return (
        Check(
            "flexible response",
            proposal.schedule_verdict in ("accept", "warn"),
            "schedule.rejected",
            f"the flexible-response check says {proposal.schedule_verdict}",
        ),
        Check(
            "start",
            proposal.start_us >= at.now_us + microseconds(settings.uplink_lead_s),
            "command.start_passed",
            f"the uplink needs {settings.uplink_lead_s:g} s: the schedule begins before it can be there",
        ),
        Check(
            "end",
            proposal.stop_us <= latest_us,
            "command.too_long",
            f"the schedule must be over within {settings.latest_stop_s:g} s: what has gone out no trip can stop",
        ),
        Check("pulses", bool(proposal.pulses), "command.empty", "a command without a pulse does nothing"),
    )


def first_failure(checks: tuple[Check, ...]) -> Refusal | None:
    """Return the refusal of the first check that fails."""
    return next((Refusal(check.code, check.detail) for check in checks if not check.is_ok), None)


def sent_within_an_hour(state: ReleaseState, now_us: int) -> Triple:
    """Return the sum of the impulses sent within the hour before an instant, yaw, roll, pitch, N m s."""
    recent = [sent.impulse_n_m_s for sent in state.sent if now_us - sent.at_us < _HOUR_US]
    yaw, roll, pitch = (float(sum(values)) for values in zip(*recent, strict=True)) if recent else (0.0, 0.0, 0.0)
    return yaw, roll, pitch


def unreported_of(commands: tuple[CommandRecord, ...]) -> Unreported:
    """Return what nobody has reported among the commands that went out."""
    waiting = [command for command in commands if command.life in UNREPORTED]
    stops_us = [max(command.proposal.stop_us, command.released_us or 0) for command in waiting]
    return Unreported(len(waiting), min(stops_us, default=None))


def _is_yaw_withheld(interlock: Interlock, proposal: Proposal) -> bool:
    """Whether a yaw torque may not go; that the sign is not proven does not hold back the check that proves it."""
    standing = {each for each in interlock.standing if each.consequence is Consequence.YAW}
    return bool(standing - {Condition.YAW_SIGN} if proposal.is_sign_check else standing)


def _interlock_check(state: ReleaseState) -> Check:
    """Return the check that the interlock lets commands go at all."""
    interlock = state.interlock
    reasons = ", ".join(interlock.reasons)
    if interlock.state is State.TRIPPED:
        return Check(
            "interlock", False, "interlock.tripped", f"control tripped ({reasons}): find the cause, reset, arm"
        )
    if interlock.state is State.INHIBITED and not interlock.inhibiting and not interlock.is_armed:
        return Check("interlock", False, "interlock.not_armed", "control is not armed")
    is_ok = interlock.state in _MAY_RELEASE and not interlock.inhibiting
    return Check("interlock", is_ok, "interlock.inhibited", f"control is inhibited: {reasons}")
