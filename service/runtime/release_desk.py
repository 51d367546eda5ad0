"""Release desk: persons order, rows inform, the interlock decides; what it decides is stored, then told.

Every method may be called from any thread and raises nothing but errors of `service.errors`, with the codes of
docs/reference/errors.md, section Control. What is judged and how stands in `service.pipeline.release_interlock`; how a
step is kept in `service.runtime.release_case`; nothing here decides anything.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from uuid import uuid4

from service.errors import ConflictError, GoneError, InvalidInputError, NotFoundError
from service.pipeline.config import TorqueConfig
from service.pipeline.release_interlock.command_states import Life, Turn
from service.pipeline.release_interlock.interlock import Instant
from service.pipeline.release_interlock.release import settled_at
from service.pipeline.release_interlock.release_events import (
    Cancel,
    CommandRecord,
    Confirm,
    Engage,
    Event,
    Order,
    OrderKind,
    Prepare,
    Report,
    Step,
    Tick,
    Told,
    digest_of,
)
from service.pipeline.release_interlock.release_settings import ReleaseSettings
from service.pipeline.release_interlock.row_facts import SeenRow
from service.ports import Clock, Storage
from service.records.audit import apart_from_request
from service.records.calibration import Window
from service.records.catalogue import ControlMode, Spacecraft
from service.records.epoch import US_PER_S
from service.records.release import (
    CommandView,
    CommandWish,
    ControlView,
    EnvelopeLimits,
    ProductForm,
    UplinkProduct,
)
from service.runtime.release_case import Annex, ReleaseCase, is_deed
from service.runtime.release_entry import ReleaseEntry
from service.runtime.release_proposing import Proposals
from service.runtime.release_refusals import error_of, require_release
from service.runtime.release_rows import RowWork
from service.runtime.release_surroundings import KnownFacts, read_facts, surroundings_of
from service.runtime.release_tidings import Tidings
from service.runtime.release_views import control_view, envelope_of, is_told_already

_LOG = logging.getLogger("soo.release")

_TURNS = {"sent": Turn.SENT, "executed": Turn.EXECUTED, "failed": Turn.FAILED}
#: a report may be this much older than the release, and this much ahead of the clock: clocks of two centres differ
_REPORT_SLACK_US = 60 * US_PER_S


def _steady_us() -> int:
    """Return a clock that nobody sets."""
    return round(time.monotonic() * US_PER_S)


class ReleaseDesk:
    """Interlock and commands of all spacecraft.

    Parameters
    ----------
    storage : Storage
        Where state, commands and uplink products are kept.
    clock : Clock
        The only source of time.
    settings : ReleaseSettings
        What inhibits, what trips, and how long things last.
    torque : TorqueConfig
        Of the control law.
    tidings : Tidings
        Who is told of what has been stored.
    is_data_service : bool
        Whether the service runs under the data clock: then only simulated craft get commands.
    steady : callable
        A clock that nobody sets, microseconds.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        settings: ReleaseSettings,
        torque: TorqueConfig,
        tidings: Tidings,
        *,
        is_data_service: bool = False,
        steady: Callable[[], int] = _steady_us,
    ) -> None:
        self._storage = storage
        self._clock = clock
        self._settings = settings
        self._tidings = tidings
        self._is_data_service = is_data_service
        self._steady = steady
        self._holder = uuid4().hex
        self._entries: dict[str, ReleaseEntry] = {}
        self._making = threading.Lock()
        self._proposals = Proposals(storage.releases, settings, torque)
        self._rows = RowWork(storage, settings, torque, self._step, self._proposals)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="soo-release", daemon=True)

    def start(self) -> None:
        """Let time pass from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def control(self, spacecraft_id: str) -> ControlView:
        """Return what the interlock says; NotFoundError ``spacecraft.unknown``."""
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            return self._view(entry, facts, at)

    def order(self, spacecraft_id: str, kind: OrderKind, by: str) -> ControlView:
        """Arm, disengage, reset or stop.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.trip_stands``,
        ``interlock.not_armed``, ``interlock.state``, ``interlock.simulated``, ``control.mode``, ``release.automatic``.
        """
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            if kind is OrderKind.ARM:
                self._require_possible(facts.spacecraft)
            self._done(entry, facts, Order(at, by, kind))
            return self._view(entry, facts, at)

    def engage(
        self, spacecraft_id: str, by: str, *, is_approver: bool, until_us: int, envelope: EnvelopeLimits | None = None
    ) -> ControlView:
        """Ask for standing authorisation, or join who asked for the same; without an envelope that of the settings.

        Beside those of `order`: ConflictError ``interlock.sign_unproven``; ForbiddenError
        ``interlock.second_person``; InvalidInputError ``interlock.authorisation``, ``envelope.wider``.
        """
        entry = self._entry(spacecraft_id)
        wanted = self._settings.envelope if envelope is None else envelope_of(envelope)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            self._require_possible(facts.spacecraft)
            self._done(entry, facts, Engage(at, by, until_us, wanted, is_approver))
            return self._view(entry, facts, at)

    def prepare(self, spacecraft_id: str, by: str, wish: CommandWish, *, dry_run: bool = False) -> CommandView:
        """Return a prepared command; a dry run stores nothing and tells failing checks instead of refusing.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.not_armed``,
        ``interlock.simulated``, ``interlock.yaw_withheld``, ``control.mode``, ``release.automatic``,
        ``envelope.exceeded``, ``schedule.rejected``, ``command.open``, ``command.unreported``, ``command.empty``,
        ``command.estimate_stale``, ``command.no_estimate``, ``command.start_passed``, ``command.too_long``;
        InvalidInputError ``command.wish``.
        """
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            self._require_possible(facts.spacecraft)
            proposal, dress = self._proposals.wished(entry, facts.spacecraft, wish, at)
            counter = entry.case.state.next_counter
            if dry_run:
                digest = digest_of(counter, proposal)
                record = CommandRecord(counter, Life.PREPARED, proposal, digest, by, at.now_us, at.now_us)
                return replace(dress.view(record), is_dry_run=True)
            self._done(entry, facts, Prepare(at, by, proposal), Annex(dress))
            return entry.case.view(counter)

    def confirm(
        self, spacecraft_id: str, counter: int, by: str, digest: str, *, is_approver: bool, comment: str = ""
    ) -> CommandView:
        """Return a command released.

        NotFoundError ``command.unknown``; GoneError ``command.expired``; ForbiddenError ``command.second_person``;
        ConflictError ``command.digest``, ``command.state`` and those of `prepare`.
        """
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            self._require_possible(facts.spacecraft)
            event = Confirm(at, by, counter, digest, is_approver)
            self._done(entry, facts, event, Annex(notes={counter: {"comment": comment}} if comment else {}))
            return entry.case.view(counter)

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> CommandView:
        """Take a prepared command back; NotFoundError ``command.unknown``, ConflictError ``command.state``."""
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            self._done(entry, facts, Cancel(at, by, counter))
            return entry.case.view(counter)

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
        entry = self._entry(spacecraft_id)
        executed = (executed_from_us, executed_until_us)
        with entry.case.lock:
            if is_told_already(entry.case.view(counter), turn, at_us, executed):
                return entry.case.view(counter)
            at, facts = self._present(entry, spacecraft_id)
            if at_us is not None:
                self._require_time(entry, counter, at_us, at, is_data=self._clock.is_data(spacecraft_id))
            told_us = at.now_us if at_us is None else at_us
            notes = {"sent_us": told_us} if turn == "sent" else {"reported_by": by, "told_executed_us": executed}
            event = Report(at, counter, _TURNS[turn], *executed)
            self._done(entry, facts, event, Annex(notes={counter: notes}))
            self._rows.go_on(entry, facts, at)
            return entry.case.view(counter)

    def command(self, spacecraft_id: str, counter: int) -> CommandView:
        """Return one command as it is now; NotFoundError ``command.unknown``."""
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, _ = self._present(entry, spacecraft_id)
            self._pass_time(entry, spacecraft_id, at)
            return entry.case.view(counter)

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
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
        if facts.spacecraft.control.mode is not ControlMode.ONBOARD:
            raise ConflictError("control.mode", f"{spacecraft_id} takes no angles: its mode is not onboard")
        product = self._storage.releases.newest_product(spacecraft_id, ProductForm.ATTITUDE)
        if product is None:
            raise NotFoundError("uplink.unknown", f"no angles of {spacecraft_id} have been fit for use yet")
        if at.now_us >= product.valid_until_us:
            raise GoneError("uplink.expired", f"the newest angles fit for use, {product.counter}, are too old")
        return product

    def sign_check(self, spacecraft_id: str, axis: str, by: str) -> ControlView:
        """Start the sign check of an axis: its legs are prepared one after the other, each to be confirmed.

        ConflictError ``sign_check.running``, ``sign_check.no_rows`` and those of `prepare`; InvalidInputError
        ``sign_check.axis``.
        """
        entry = self._entry(spacecraft_id)
        with entry.case.lock:
            at, facts = self._present(entry, spacecraft_id)
            self._require_possible(facts.spacecraft)
            self._rows.sign_checks.begin(entry, facts, axis, by, at)
            self._tell(entry, spacecraft_id)
            return self._view(entry, facts, at)

    def see(self, spacecraft_id: str, seen: Sequence[SeenRow], *, has_inputs: bool = False) -> None:
        """Take over rows after they were stored, and that other inputs came in; called from the supervisor's thread.

        Nothing is raised: estimation goes on whatever happens to control.
        """
        try:
            entry = self._entry(spacecraft_id)
            with entry.case.lock:
                if has_inputs:
                    entry.read_s = -math.inf
                for one in seen:
                    self._see_one(entry, spacecraft_id, one)
                self._tell(entry, spacecraft_id)
        except Exception:  # noqa: BLE001 rows go on; what was not stored does not hold, and old estimates inhibit
            _LOG.exception("the release of %s could not take rows over", spacecraft_id)

    def tick(self) -> None:
        """Let time pass for every spacecraft whose clock does not wait for rows."""
        for spacecraft in self._storage.catalogue.all_spacecraft():
            if self._clock.is_data(spacecraft.id):
                continue
            entry = self._entry(spacecraft.id)
            with entry.case.lock:
                at, facts = self._present(entry, spacecraft.id)
                self._pass_time(entry, spacecraft.id, at)
                self._rows.go_on(entry, facts, at)
                self._tell(entry, spacecraft.id)

    def _run(self) -> None:
        """Let time pass until stopped."""
        while not self._stopping.wait(self._settings.tick_s):
            try:
                self.tick()
            except Exception:  # noqa: BLE001 time goes on; a state that grows old inhibits
                _LOG.exception("time could not pass for the release")

    def _entry(self, spacecraft_id: str) -> ReleaseEntry:
        """Return what is kept of a spacecraft; NotFoundError ``spacecraft.unknown``."""
        with self._making:
            entry = self._entries.get(spacecraft_id)
            if entry is None:
                case = ReleaseCase(self._storage.releases, spacecraft_id, self._holder)
                entry = self._entries[spacecraft_id] = ReleaseEntry(case)
                entry.newest_us = 0 if case.state.interlock.clock is None else case.state.interlock.clock.now_us
            return entry

    def _instant(self, entry: ReleaseEntry, spacecraft_id: str, epoch_us: int | None = None) -> Instant:
        """Return the present; under the data clock the newest epoch that was looked at, which never goes back."""
        if not self._clock.is_data(spacecraft_id):
            return Instant(self._clock.system_us(), self._steady())
        now_us = epoch_us if epoch_us is not None else self._clock.now_us(spacecraft_id)
        entry.newest_us = max(entry.newest_us, now_us or 0)
        return Instant(entry.newest_us, entry.newest_us)

    def _present(self, entry: ReleaseEntry, spacecraft_id: str) -> tuple[Instant, KnownFacts]:
        """Return the present with what holds at it, told to the interlock."""
        at = self._instant(entry, spacecraft_id)
        return at, self._informed(entry, spacecraft_id, at)

    def _informed(self, entry: ReleaseEntry, spacecraft_id: str, at: Instant) -> KnownFacts:
        """Return what holds beside the rows, and tell the interlock where it has changed."""
        if entry.facts is None or entry.are_facts_old:
            entry.facts = read_facts(self._storage, spacecraft_id, at.now_us)
            entry.read_s = time.monotonic()
        facts, case = entry.facts, entry.case
        around = surroundings_of(
            facts,
            at.now_us,
            lease_holders=case.lease_holders(at.now_us),
            disagreement_deg=entry.disagreement_deg,
        )
        if around != case.state.interlock.around:
            self._step(entry, facts.spacecraft, Told(at, around))
        return facts

    def _see_one(self, entry: ReleaseEntry, spacecraft_id: str, one: SeenRow) -> None:
        """Take over one row."""
        epochs_us = [row.epoch_us for row in one.outcome.rows]
        at = self._instant(entry, spacecraft_id, max(epochs_us, default=None))
        facts = self._informed(entry, spacecraft_id, at)
        row = entry.take(one, facts.spacecraft.control.method)
        if row is not None:
            self._informed(entry, spacecraft_id, at)
            self._rows.see(entry, facts, one, row, at, may_send=self._may_send(facts.spacecraft))

    def _pass_time(self, entry: ReleaseEntry, spacecraft_id: str, at: Instant) -> None:
        """Let the interlock see an instant."""
        facts = entry.facts or self._informed(entry, spacecraft_id, at)
        self._step(entry, facts.spacecraft, Tick(at))

    def _step(self, entry: ReleaseEntry, spacecraft: Spacecraft, event: Event, annex: Annex | None = None) -> Step:
        """Judge and store an event, and tell who has to know."""
        step, entries = entry.case.step(event, self._settings, annex)
        with nullcontext() if is_deed(event, step) else apart_from_request():
            self._tidings.told(spacecraft, step, event.at, has_entries=bool(entries))
        return step

    def _done(self, entry: ReleaseEntry, facts: KnownFacts, event: Event, annex: Annex | None = None) -> None:
        """Do what a person wants; refused, it is an error."""
        step = self._step(entry, facts.spacecraft, event, annex)
        self._tell(entry, facts.spacecraft.id)
        refusal = step.refusal
        if refusal is None:
            return
        if refusal.code == "command.unknown" and isinstance(event, Confirm | Cancel | Report):
            # one that ended long ago is not on the desk any more
            life = entry.case.view(event.counter).state
            raise ConflictError("command.state", f"command {event.counter} is {life}: this is not possible any more")
        raise error_of(refusal)

    def _tell(self, entry: ReleaseEntry, spacecraft_id: str) -> None:
        """Tell streams that something has changed, if it has."""
        interlock = entry.case.state.interlock
        lives = tuple((command.counter, command.life) for command in entry.case.state.commands)
        told = (interlock.state, interlock.reasons, interlock.authorisation, lives, entry.case.sign_check)
        if told != entry.told:
            entry.told = told
            self._tidings.changed(spacecraft_id)

    def _view(self, entry: ReleaseEntry, facts: KnownFacts, at: Instant) -> ControlView:
        """Return what the interlock says at an instant; nothing is stored."""
        state = settled_at(entry.case.state, at, self._settings)
        return control_view(state, facts.spacecraft, self._settings, at.now_us, entry.case.sign_check)

    def _may_send(self, spacecraft: Spacecraft) -> bool:
        return not self._is_data_service or spacecraft.simulated

    def _require_possible(self, spacecraft: Spacecraft) -> None:
        """Raise ConflictError unless commands of this spacecraft are released here at all."""
        if not self._may_send(spacecraft):
            detail = f"{spacecraft.id} is not simulated: under the clock of data it never gets a command"
            raise ConflictError("interlock.simulated", detail)
        require_release(spacecraft)

    def _require_time(self, entry: ReleaseEntry, counter: int, at_us: int, at: Instant, *, is_data: bool) -> None:
        """Raise InvalidInputError for a report from before the release, or from the future."""
        released_us = entry.case.view(counter).released_us
        is_early = released_us is not None and at_us < released_us - _REPORT_SLACK_US
        if is_early or (not is_data and at_us > at.now_us + _REPORT_SLACK_US):
            raise InvalidInputError("report.time", "the report is from before the release, or from the future")
