"""Views of the release: the interlock, checks and angles as records that the interface answers with."""

from collections.abc import Callable

from service.core.control.envelope import Envelope
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandTransition
from service.pipeline.control.release.control_verdict import reason_of
from service.pipeline.control.release.events import ReleaseState, Report
from service.pipeline.control.release.release_checks import sent_within_an_hour
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.records.catalogue import Spacecraft
from service.records.levels.attitude import AttitudeRow, Axes
from service.records.operations.release import (
    Command,
    CommandState,
    ControlView,
    EnvelopeLimits,
    ProductForm,
    UplinkProduct,
)


def attitude_product(
    row: AttitudeRow, counter: int, now_us: int, valid_until_us: int, *, is_simulated: bool
) -> UplinkProduct:
    """Return what goes up to a spacecraft that computes its torques itself."""
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


def control_view(
    state: ReleaseState,
    spacecraft: Spacecraft,
    settings: ReleaseSettings,
    now_us: int,
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
        open_commands=_counters(state, lambda word: word in OPEN),
        unreported_commands=_counters(state, lambda word: word in UNREPORTED),
        sent_impulse_n_m_s=Axes(*sent_within_an_hour(state, now_us)),
        sign_check=state.sign_check,
    )


def limits_of(envelope: Envelope) -> EnvelopeLimits:
    """Return the limits of an envelope."""
    return EnvelopeLimits(**envelope._asdict())


def envelope_of(limits: EnvelopeLimits) -> Envelope:
    """Return the envelope of some limits."""
    return Envelope(
        limits.angle_change_deg, limits.rate_change_deg_s, limits.impulse_n_m_s, limits.impulse_an_hour_n_m_s
    )


def _counters(state: ReleaseState, is_wanted: Callable[[CommandState], bool]) -> tuple[int, ...]:
    return tuple(command.counter for command in state.commands if is_wanted(command.state))


def is_repeated(command: Command, event: Report) -> bool:
    """Return whether a report repeats the newest one of its kind; then it means nothing."""
    if event.transition is CommandTransition.SENT:
        return command.sent_us is not None and event.reported_at_us in (None, command.sent_us)
    executed_us = (event.executed_from_us, event.executed_until_us)
    return command.state == event.transition.name and command.told_executed_us == executed_us
