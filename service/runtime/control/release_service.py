"""Release service: orders of persons, and views of the release.

Every method may be called from any thread and raises nothing but errors of `service.errors`, with the codes of
docs/reference/errors.md, section Control. An order is an event that is built, handled and answered with a view: what
is judged and how stands in `service.pipeline.control.release`, how a step is kept in
`service.runtime.control.release_context`; nothing here decides anything.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from threading import Lock

from service.core.control.slew_schedule import Envelope
from service.errors import ConflictError, ForbiddenError, GoneError, InvalidInputError, NotFoundError
from service.pipeline.control.release import events
from service.pipeline.control.release.advance import settled_at
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.control_verdict import ControlView, control_view
from service.pipeline.control.release.events import OrderKind, Report, digest_of, state_of
from service.pipeline.control.release.interlock import Instant
from service.ports.archive import ListPart
from service.ports.storage import Catalogue
from service.records.catalogue import ControlMode, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.operations.release import Command, CommandRequest, ProductForm, UplinkProduct
from service.runtime.control.release_context import ReleaseContext
from service.runtime.control.release_loop import ReleaseLoop
from service.runtime.control.sign_checks import (
    begin_sign_check,
    continue_sign_check,
    error_of,
    judge_report,
    release_refusal,
    requested,
)

_REPORTS = {each.name.lower(): each for each in CommandTransition}
#: a report may be this much older than the release, and this much ahead of the clock: clocks of two centres differ
_REPORT_SLACK_US = 60 * US_PER_S


class ReleaseService(ReleaseLoop):
    """Interlock and commands of all spacecraft; parameters as `ReleaseLoop`.

    Orders raise StorageError ``lease.elsewhere`` while another service leads; views then show what it has stored.
    """

    def control(self, spacecraft_id: str) -> ControlView:
        """Return the view of the interlock; NotFoundError ``spacecraft.unknown``."""
        if self.turn(spacecraft_id) == 0:
            return self._stored_view(spacecraft_id)
        with self._present(spacecraft_id) as (context, at):
            return self._view(context, at)

    def order(self, spacecraft_id: str, kind: OrderKind, by: str) -> ControlView:
        """Arm, disengage, reset or stop."""
        with self._present(spacecraft_id) as (context, at):
            if kind is OrderKind.ARM:
                self._require_possible(context.spacecraft)
            self._handle(context, events.Order(at, by, kind))
            return self._view(context, at)

    def engage(
        self, spacecraft_id: str, by: str, *, is_approver: bool, until_us: int, envelope: Envelope | None = None
    ) -> ControlView:
        """Ask for standing authorisation, or join who asked for the same; without an envelope that of the settings."""
        wanted = envelope or self.settings.envelope
        with self._present(spacecraft_id) as (context, at):
            self._require_possible(context.spacecraft)
            self._handle(context, events.Engage(at, by, until_us, wanted, is_approver))
            return self._view(context, at)

    def prepare(self, spacecraft_id: str, by: str, request: CommandRequest, *, dry_run: bool = False) -> Command:
        """Return a prepared command; a dry run stores nothing and shows failing checks instead of refusing."""
        with self._present(spacecraft_id) as (context, at):
            self._require_possible(context.spacecraft)
            command = requested(context, request, at)
            counter = context.state.next_counter
            if dry_run:
                digest, now_us = digest_of(counter, command), at.now_us
                numbered = replace(command, counter=counter, digest=digest, prepared_by=by, prepared_us=now_us)
                return replace(numbered, expires_us=now_us, is_dry_run=True)
            self._handle(context, events.Prepare(at, by, command))
            return context.release.command(counter)

    def confirm(
        self, spacecraft_id: str, counter: int, by: str, digest: str, *, is_approver: bool, comment: str = ""
    ) -> Command:
        """Return a command released."""
        with self._present(spacecraft_id) as (context, at):
            self._require_possible(context.spacecraft)
            self._handle(context, events.Confirm(at, by, counter, digest, is_approver, comment))
            return context.release.command(counter)

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> Command:
        """Take a prepared command back."""
        with self._present(spacecraft_id) as (context, at):
            self._handle(context, events.Cancel(at, by, counter))
            return context.release.command(counter)

    def report(
        self,
        spacecraft_id: str,
        counter: int,
        turn: str,
        *,
        by: str,
        at_us: int | None = None,
        executed_from_us: int | None = None,
        executed_until_us: int | None = None,
    ) -> Command:
        """Report a released command ``sent``, ``executed`` or ``failed``; the same report again changes nothing."""
        with self._present(spacecraft_id) as (context, at):
            event = Report(at, counter, _REPORTS[turn], executed_from_us, executed_until_us, by, at_us)
            command = context.release.command(counter)
            if _is_repeated(command, event):
                return command
            if at_us is not None:
                _require_time(command, at_us, at, is_data=self.clock.is_data(spacecraft_id))
            self._handle(context, event)
            judge_report(context, event)
            continue_sign_check(context, at)
            return context.release.command(counter)

    def command(self, spacecraft_id: str, counter: int) -> Command:
        """Return one command as it is now; NotFoundError ``command.unknown``."""
        if self.turn(spacecraft_id) == 0:
            return self.storage.releases.command(spacecraft_id, counter)
        with self._present(spacecraft_id) as (context, at):
            context.release.handle(events.Tick(at))
            return context.release.command(counter)

    def commands(self, spacecraft_id: str, part: ListPart) -> list[Command]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""
        return self.storage.releases.commands(spacecraft_id, part)

    def uplink(self, spacecraft_id: str, counter: int) -> UplinkProduct:
        """Return the product of a released command; NotFoundError ``uplink.unknown``."""
        return self.storage.releases.product(spacecraft_id, ProductForm.TORQUES, counter)

    def attitude_uplink(self, spacecraft_id: str) -> UplinkProduct:
        """Return the newest angles for a spacecraft in mode onboard."""
        spacecraft = self.storage.catalogue.spacecraft(spacecraft_id)
        if spacecraft.control.mode is not ControlMode.ONBOARD:
            raise ConflictError("control.mode", f"{spacecraft_id} takes no angles: its mode is not onboard")
        product = self.storage.releases.newest_product(spacecraft_id, ProductForm.ATTITUDE)
        if product is None:
            raise NotFoundError("uplink.unknown", f"no angles of {spacecraft_id} have been fit for use yet")
        if (self.clock.now_us(spacecraft_id) or 0) >= product.valid_until_us:
            raise GoneError("uplink.expired", f"the newest angles fit for use, {product.counter}, are too old")
        return product

    def sign_check(self, spacecraft_id: str, axis: str, by: str) -> ControlView:
        """Start the sign check of an axis: its legs are prepared one after the other, each to be confirmed."""
        with self._present(spacecraft_id) as (context, at):
            self._require_possible(context.spacecraft)
            begin_sign_check(context, axis, by, at)
            return self._view(context, at)

    def _handle(self, context: ReleaseContext, event: events.Event) -> None:
        """Handle an order; refused, it is an error."""
        refusal = context.release.handle(event).refusal
        if refusal is None:
            return
        if refusal.code == "command.unknown" and isinstance(event, events.Confirm | events.Cancel | Report):
            # one that ended long ago is not in the state any more
            ended = context.release.command(event.counter).state
            raise ConflictError("command.state", f"command {event.counter} has ended, {ended}: nothing follows on that")
        raise error_of(refusal)

    def _view(self, context: ReleaseContext, at: Instant) -> ControlView:
        """Return the view of the interlock at an instant; nothing is stored."""
        state = settled_at(context.state, at, self.settings)
        return control_view(state, context.spacecraft, self.settings, at.now_us)

    def _stored_view(self, spacecraft_id: str) -> ControlView:
        """Return the view of what the service that leads has stored last."""
        releases = self.storage.releases
        state = state_of(releases.stored(spacecraft_id).document, partial(releases.command, spacecraft_id))
        spacecraft = self.storage.catalogue.spacecraft(spacecraft_id)
        return control_view(state, spacecraft, self.settings, self.clock.now_us(spacecraft_id) or 0)

    def _require_possible(self, spacecraft: Spacecraft) -> None:
        """Raise ConflictError unless commands of this spacecraft are released here at all."""
        if not self._may_send(spacecraft):
            detail = f"{spacecraft.id} is not simulated: under the clock of data it never gets a command"
            raise ConflictError("interlock.simulated", detail)
        refusal = release_refusal(spacecraft)
        if refusal is not None:
            raise error_of(refusal)


def _require_time(command: Command, at_us: int, at: Instant, *, is_data: bool) -> None:
    """Raise InvalidInputError for a report from before the release, or from the future."""
    is_early = command.released_us is not None and at_us < command.released_us - _REPORT_SLACK_US
    if is_early or (not is_data and at_us > at.now_us + _REPORT_SLACK_US):
        raise InvalidInputError("report.time", "the report is from before the release, or from the future")


def _is_repeated(command: Command, event: Report) -> bool:
    """Return whether a report repeats the newest one of its kind; then it means nothing."""
    if event.transition is CommandTransition.SENT:
        return command.sent_us is not None and event.reported_at_us in (None, command.sent_us)
    executed_us = (event.executed_from_us, event.executed_until_us)
    return command.state == event.transition.name and command.told_executed_us == executed_us


#: how long the first request for release automatic waits for the second, s
WAIT_S = 900.0


@dataclass
class AutomaticRelease:
    """Requests for release automatic of a real spacecraft, which two approvers make; a restart forgets those that wait.

    Parameters
    ----------
    catalogue : Catalogue
        Where the release is set.
    """

    catalogue: Catalogue
    #: who asked and when, by spacecraft
    _requests: dict[str, tuple[str, int]] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    def ask(self, spacecraft_id: str, by: str, now_us: int) -> str | None:
        """Ask for release automatic; return who asked before when that sets it, None while a second one is missing.

        ForbiddenError ``interlock.second_person`` when the same approver asks again.
        """
        with self._lock:
            first, asked_us = self._requests.get(spacecraft_id, (by, 0))
            is_waiting = asked_us <= now_us < asked_us + round(WAIT_S * US_PER_S)
            if not is_waiting:
                self._requests[spacecraft_id] = by, now_us
                return None
            if first == by:
                raise ForbiddenError("interlock.second_person", "release automatic needs two approvers")
            del self._requests[spacecraft_id]
            spacecraft = self.catalogue.spacecraft(spacecraft_id)
            control = replace(spacecraft.control, release=Release.AUTOMATIC)
            self.catalogue.replace_spacecraft(replace(spacecraft, control=control))
            return first
