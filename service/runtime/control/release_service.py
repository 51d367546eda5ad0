"""Release service: what persons order, and what they are told.

Every method may be called from any thread and raises nothing but errors of `service.errors`, with the codes of
docs/reference/errors.md, section Control. What is judged and how stands in `service.pipeline.control.release`; how a
step is kept in `service.runtime.control.persisted_release`; nothing here decides anything.
"""

from dataclasses import replace

from service.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from service.pipeline.control.release.command_states import CommandState, CommandTransition
from service.pipeline.control.release.events import (
    Cancel,
    CommandRecord,
    Confirm,
    Engage,
    Event,
    Order,
    OrderKind,
    Prepare,
    Report,
    ResponseJudged,
    Tick,
    digest_of,
)
from service.pipeline.control.release.interlock import Instant
from service.records.calibration import Window
from service.records.catalogue import ControlMode, Spacecraft
from service.records.epoch import US_PER_S
from service.records.operations.release import (
    CommandRequest,
    CommandView,
    ControlView,
    EnvelopeLimits,
    ProductForm,
    UplinkProduct,
)
from service.runtime.control.persisted_release import Annex
from service.runtime.control.refusal_errors import error_of, require_release
from service.runtime.control.release_inputs import KnownFacts
from service.runtime.control.release_loop import ReleaseLoop
from service.runtime.control.spacecraft_release import SpacecraftRelease
from service.runtime.control.views import envelope_of, is_told_already

_REPORTS = {"sent": CommandTransition.SENT, "executed": CommandTransition.EXECUTED, "failed": CommandTransition.FAILED}
#: a report may be this much older than the release, and this much ahead of the clock: clocks of two centres differ
_REPORT_SLACK_US = 60 * US_PER_S


class ReleaseService(ReleaseLoop):
    """Interlock and commands of all spacecraft; parameters as `ReleaseLoop`.

    Orders raise StorageError ``lease.elsewhere`` while another service leads; what is told then is what it has stored.
    """

    def control(self, spacecraft_id: str) -> ControlView:
        """Return what the interlock says; NotFoundError ``spacecraft.unknown``."""
        if self._turn() == 0:
            return self._stored_view(spacecraft_id)
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            return self._view(release, facts, at)

    def order(self, spacecraft_id: str, kind: OrderKind, by: str) -> ControlView:
        """Arm, disengage, reset or stop.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.trip_stands``,
        ``interlock.not_armed``, ``interlock.state``, ``interlock.simulated``, ``control.mode``, ``release.automatic``.
        """
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            if kind is OrderKind.ARM:
                self._require_possible(facts.spacecraft)
            self._done(release, facts, Order(at, by, kind))
            return self._view(release, facts, at)

    def engage(
        self, spacecraft_id: str, by: str, *, is_approver: bool, until_us: int, envelope: EnvelopeLimits | None = None
    ) -> ControlView:
        """Ask for standing authorisation, or join who asked for the same; without an envelope that of the settings.

        Beside those of `order`: ConflictError ``interlock.sign_unproven``; ForbiddenError
        ``interlock.second_person``; InvalidInputError ``interlock.authorisation``, ``envelope.wider``.
        """
        release = self._release(spacecraft_id)
        wanted = self._settings.envelope if envelope is None else envelope_of(envelope)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._require_possible(facts.spacecraft)
            self._done(release, facts, Engage(at, by, until_us, wanted, is_approver))
            return self._view(release, facts, at)

    def prepare(self, spacecraft_id: str, by: str, request: CommandRequest, *, dry_run: bool = False) -> CommandView:
        """Return a prepared command; a dry run stores nothing and tells failing checks instead of refusing.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.not_armed``,
        ``interlock.simulated``, ``interlock.yaw_withheld``, ``control.mode``, ``release.automatic``,
        ``envelope.exceeded``, ``schedule.rejected``, ``command.open``, ``command.unreported``, ``command.empty``,
        ``command.estimate_stale``, ``command.no_estimate``, ``command.start_passed``, ``command.too_long``;
        InvalidInputError ``command.wish``.
        """
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._require_possible(facts.spacecraft)
            proposal, dress = self._proposals.requested(release, facts.spacecraft, request, at)
            counter = release.case.state.next_counter
            if dry_run:
                digest = digest_of(counter, proposal)
                record = CommandRecord(counter, CommandState.PREPARED, proposal, digest, by, at.now_us, at.now_us)
                return replace(dress.view(record), is_dry_run=True)
            self._done(release, facts, Prepare(at, by, proposal), Annex(dress))
            return release.case.view(counter)

    def confirm(
        self, spacecraft_id: str, counter: int, by: str, digest: str, *, is_approver: bool, comment: str = ""
    ) -> CommandView:
        """Return a command released.

        NotFoundError ``command.unknown``; GoneError ``command.expired``; ForbiddenError ``command.second_person``;
        ConflictError ``command.digest``, ``command.state`` and those of `prepare`.
        """
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._require_possible(facts.spacecraft)
            event = Confirm(at, by, counter, digest, is_approver)
            self._done(release, facts, event, Annex(notes={counter: {"comment": comment}} if comment else {}))
            return release.case.view(counter)

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> CommandView:
        """Take a prepared command back; NotFoundError ``command.unknown``, ConflictError ``command.state``."""
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._done(release, facts, Cancel(at, by, counter))
            return release.case.view(counter)

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
    ) -> CommandView:
        """Take what the centre tells of a released command: ``sent``, ``executed`` or ``failed``.

        The same report again changes nothing. NotFoundError ``command.unknown``; ConflictError ``command.state``;
        InvalidInputError ``report.interval``, ``report.time``.
        """
        release = self._release(spacecraft_id)
        executed = (executed_from_us, executed_until_us)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            if is_told_already(release.case.view(counter), turn, at_us, executed):
                return release.case.view(counter)
            if at_us is not None:
                self._require_time(release, counter, at_us, at, is_data=self._clock.is_data(spacecraft_id))
            told_us = at.now_us if at_us is None else at_us
            notes = {"sent_us": told_us} if turn == "sent" else {"reported_by": by, "told_executed_us": executed}
            event = Report(at, counter, _REPORTS[turn], *executed)
            self._done(release, facts, event, Annex(notes={counter: notes}))
            self._hold_against_powers(release, facts.spacecraft, event)
            self._rows.go_on(release, facts, at)
            return release.case.view(counter)

    def command(self, spacecraft_id: str, counter: int) -> CommandView:
        """Return one command as it is now; NotFoundError ``command.unknown``."""
        if self._turn() == 0:
            return self._storage.releases.command(spacecraft_id, counter)
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._step(release, facts.spacecraft, Tick(at))
            return release.case.view(counter)

    def commands(
        self, spacecraft_id: str, window: Window, limit: int, after: tuple[int, int] | None = None
    ) -> list[CommandView]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""
        return self._storage.releases.commands(spacecraft_id, window, limit, after)

    def uplink(self, spacecraft_id: str, counter: int) -> UplinkProduct:
        """Return the product of a released command; NotFoundError ``uplink.unknown``."""
        return self._storage.releases.product(spacecraft_id, ProductForm.TORQUES, counter)

    def attitude_uplink(self, spacecraft_id: str) -> UplinkProduct:
        """Return the newest angles for a spacecraft in mode onboard.

        ConflictError ``control.mode``; NotFoundError ``uplink.unknown`` before the first, GoneError ``uplink.expired``.
        """
        spacecraft = self._storage.catalogue.spacecraft(spacecraft_id)
        if spacecraft.control.mode is not ControlMode.ONBOARD:
            raise ConflictError("control.mode", f"{spacecraft_id} takes no angles: its mode is not onboard")
        product = self._storage.releases.newest_product(spacecraft_id, ProductForm.ATTITUDE)
        if product is None:
            raise NotFoundError("uplink.unknown", f"no angles of {spacecraft_id} have been fit for use yet")
        if (self._clock.now_us(spacecraft_id) or 0) >= product.valid_until_us:
            raise GoneError("uplink.expired", f"the newest angles fit for use, {product.counter}, are too old")
        return product

    def sign_check(self, spacecraft_id: str, axis: str, by: str) -> ControlView:
        """Start the sign check of an axis: its legs are prepared one after the other, each to be confirmed.

        ConflictError ``sign_check.running``, ``sign_check.no_rows``, ``sign_check.flying`` and those of `prepare`;
        InvalidInputError ``sign_check.axis``.
        """
        release = self._release(spacecraft_id)
        with release.case.lock:
            at, facts = self._present(release, spacecraft_id)
            self._require_possible(facts.spacecraft)
            self._rows.sign_checks.begin(release, facts, axis, by, at)
            self._tell(release, spacecraft_id)
            return self._view(release, facts, at)

    def _done(self, release: SpacecraftRelease, facts: KnownFacts, event: Event, annex: Annex | None = None) -> None:
        """Do what a person wants; refused, it is an error."""
        step = self._step(release, facts.spacecraft, event, annex)
        self._tell(release, facts.spacecraft.id)
        refusal = step.refusal
        if refusal is None:
            return
        if refusal.code == "command.unknown" and isinstance(event, Confirm | Cancel | Report):
            # one that ended long ago is not on the service any more
            life = release.case.view(event.counter).state
            raise ConflictError("command.state", f"command {event.counter} is {life}: this is not possible any more")
        raise error_of(refusal)

    def _require_possible(self, spacecraft: Spacecraft) -> None:
        """Raise ConflictError unless commands of this spacecraft are released here at all."""
        if not self._may_send(spacecraft):
            detail = f"{spacecraft.id} is not simulated: under the clock of data it never gets a command"
            raise ConflictError("interlock.simulated", detail)
        require_release(spacecraft)

    def _require_time(
        self, release: SpacecraftRelease, counter: int, at_us: int, at: Instant, *, is_data: bool
    ) -> None:
        """Raise InvalidInputError for a report from before the release, or from the future."""
        released_us = release.case.view(counter).released_us
        is_early = released_us is not None and at_us < released_us - _REPORT_SLACK_US
        if is_early or (not is_data and at_us > at.now_us + _REPORT_SLACK_US):
            raise InvalidInputError("report.time", "the report is from before the release, or from the future")

    def _hold_against_powers(self, release: SpacecraftRelease, spacecraft: Spacecraft, event: Report) -> None:
        """Judge a command that is reported executed whole by what the powers said of it before."""
        record = next(each for each in release.case.state.commands if each.counter == event.counter)
        evidence = None if release.seen is None else release.seen.evidence
        is_whole = event.turn is CommandTransition.EXECUTED and record.executed == record.proposal.pulses
        if evidence is None or evidence.unreported_log_ratio is None or record.proposal.is_sign_check or not is_whole:
            return
        self._step(release, spacecraft, ResponseJudged(event.at, evidence.unreported_log_ratio))
