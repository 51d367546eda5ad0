"""The release as it is stored and told: commands, uplink products and the interlock as records without machinery."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from service.core.control.envelope import Envelope
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandState
from service.pipeline.control.release.control_reasons import reason_of
from service.pipeline.control.release.events import CommandRecord, ReleaseState
from service.pipeline.control.release.proposals import schedule_of
from service.pipeline.control.release.release_checks import Check, sent_within_an_hour
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.catalogue import Spacecraft
from service.records.levels.attitude import AttitudeRow, Axes
from service.records.levels.command import ReleasedCommand, ReportedCommand, TorqueCommand
from service.records.operations.release import (
    CheckView,
    CommandView,
    ControlView,
    EnvelopeLimits,
    ProductForm,
    Purpose,
    SignCheckView,
    UplinkProduct,
)


@dataclass(frozen=True, slots=True)
class Dress:
    """What a command carries beside what the interlock knows of it."""

    spacecraft: Spacecraft
    checks: tuple[CheckView, ...] = ()
    computed: TorqueCommand | None = None

    def view(self, record: CommandRecord) -> CommandView:
        """Return a new command as it is stored."""
        proposal, effect = record.proposal, record.proposal.effect
        view = CommandView(
            counter=record.counter,
            state=record.life.name,
            digest=record.digest,
            purpose=Purpose.SIGN_CHECK if proposal.is_sign_check else Purpose.CONTROL,
            is_automatic=record.is_automatic,
            is_simulated=self.spacecraft.simulated,
            reason=proposal.reason,
            prepared_by=record.prepared_by,
            prepared_us=record.prepared_us,
            expires_us=record.expires_us,
            attitude_epoch_us=proposal.attitude_epoch_us,
            start_us=proposal.start_us,
            stop_us=proposal.stop_us,
            schedule=schedule_of(proposal.pulses, proposal.start_us),
            impulse_n_m_s=Axes(*effect.impulse_n_m_s),
            gross_impulse_n_m_s=Axes(*effect.gross_impulse_n_m_s),
            angle_change_deg=Axes(*effect.angle_change_deg),
            rate_change_deg_s=Axes(*effect.rate_change_deg_s),
            peak_angle_deg=Axes(*effect.peak_angle_deg),
            peak_rate_deg_s=Axes(*effect.peak_rate_deg_s),
            wheel_momentum_n_m_s=effect.wheel_momentum_n_m_s,
            checks=self.checks,
            computed=self.computed,
        )
        return changed_view(view, record)


def changed_view(view: CommandView, record: CommandRecord) -> CommandView:
    """Return a stored command as it stands now."""
    return replace(
        view,
        state=record.life.name,
        confirmed_by=record.confirmed_by,
        released_us=record.released_us,
        reported_us=record.reported_us,
        executed=schedule_of(record.executed, record.proposal.start_us),
    )


def check_views(checks: tuple[Check, ...]) -> tuple[CheckView, ...]:
    """Return checks as they are told: a detail only where one fails."""
    return tuple(CheckView(check.name, check.is_ok, "" if check.is_ok else check.detail) for check in checks)


def torque_product(record: CommandRecord, *, is_simulated: bool) -> UplinkProduct:
    """Return what goes up for a released command."""
    proposal, released_us = record.proposal, record.released_us or 0
    return UplinkProduct(
        form=ProductForm.TORQUES,
        counter=record.counter,
        created_us=released_us,
        valid_from_us=released_us,
        # who gets it later than the first pulse must not send it
        valid_until_us=proposal.start_us,
        attitude_epoch_us=proposal.attitude_epoch_us,
        is_simulated=is_simulated,
        digest=record.digest,
        schedule=schedule_of(proposal.pulses, proposal.start_us),
    )


def attitude_product(
    row: AttitudeRow, counter: int, now_us: int, valid_until_us: int, *, is_simulated: bool
) -> UplinkProduct:
    """Return what goes up to a craft that computes its torques itself."""
    return UplinkProduct(
        form=ProductForm.ATTITUDE,
        counter=counter,
        created_us=now_us,
        valid_from_us=row.epoch_us,
        valid_until_us=valid_until_us,
        attitude_epoch_us=row.epoch_us,
        is_simulated=is_simulated,
        attitude_deg=row.attitude_deg,
        sigma_deg=row.sigma_deg,
    )


def released_entry(record: CommandRecord) -> ReleasedCommand:
    """Return the journal's entry of a release."""
    schedule = schedule_of(record.proposal.pulses, record.proposal.start_us)
    return ReleasedCommand(record.counter, record.released_us or 0, schedule)


def reported_entry(record: CommandRecord) -> ReportedCommand:
    """Return the journal's entry of a report."""
    executed = schedule_of(record.executed, record.proposal.start_us)
    return ReportedCommand(record.counter, record.reported_us or 0, executed)


def control_view(
    state: ReleaseState,
    spacecraft: Spacecraft,
    settings: ReleaseSettings,
    now_us: int,
    sign_check: SignCheckView | None,
) -> ControlView:
    """Return what the interlock says."""
    interlock = state.interlock
    authorisation, request, since = interlock.authorisation, interlock.request, dict(interlock.since)
    is_asked = request is not None and now_us - request.at_us <= microseconds(settings.request_s)
    envelope = settings.envelope if authorisation is None else authorisation.terms.envelope
    return ControlView(
        state=interlock.state.name,
        since_us=interlock.since_us,
        reasons=tuple(reason_of(word, since.get(word) or None, settings) for word in interlock.reasons),
        trips=tuple(condition.word for condition in interlock.trips),
        is_armed=interlock.is_armed,
        is_withheld=interlock.is_withholding,
        release=spacecraft.control.release.value,
        mode=spacecraft.control.mode.value,
        envelope=limits_of(envelope),
        authorised_by=() if authorisation is None else authorisation.persons,
        authorised_until_us=None if authorisation is None else authorisation.terms.until_us,
        requested_by=request.by if request is not None and is_asked else None,
        requested_until_us=request.terms.until_us if request is not None and is_asked else None,
        proven_axes=interlock.proven_axes,
        open_commands=_counters(state, lambda life: life in OPEN),
        unreported_commands=_counters(state, lambda life: life in UNREPORTED),
        sent_impulse_n_m_s=Axes(*sent_within_an_hour(state, now_us)),
        sign_check=sign_check,
    )


def limits_of(envelope: Envelope) -> EnvelopeLimits:
    """Return an envelope as it is told."""
    return EnvelopeLimits(**envelope._asdict())


def envelope_of(limits: EnvelopeLimits) -> Envelope:
    """Return an envelope as the interlock takes it."""
    return Envelope(
        limits.angle_change_deg, limits.rate_change_deg_s, limits.impulse_n_m_s, limits.impulse_an_hour_n_m_s
    )


def _counters(state: ReleaseState, is_wanted: Callable[[CommandState], bool]) -> tuple[int, ...]:
    return tuple(command.counter for command in state.commands if is_wanted(command.life))


def is_told_already(
    view: CommandView, turn: str, at_us: int | None, executed_us: tuple[int | None, int | None]
) -> bool:
    """Whether a report says what the newest one of its kind has said; then it was sent again, and means nothing."""
    if turn == "sent":
        return view.sent_us is not None and at_us in (None, view.sent_us)
    return view.state == turn.upper() and view.told_executed_us == executed_us
