"""Release service: orders of persons, views of the release, and the loop of rows and time.

Every method may be called from any thread and raises nothing but errors of `service.errors`, with the codes of
docs/reference/errors.md, section Control. An order is an event that is built, handled and answered with a view: what
is judged and how stands in `service.pipeline.control.release`, how a step is kept in
`service.runtime.control.release_context`; nothing here decides anything. Only the process
that leads a spacecraft judges its events; one that becomes its leader again reads the state from the archive.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from threading import Lock
from uuid import uuid4

from service.core.control.slew_schedule import Envelope
from service.errors import (
    ConflictError,
    ForbiddenError,
    GoneError,
    InvalidInputError,
    NotFoundError,
    SooError,
    StorageError,
)
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release import events
from service.pipeline.control.release.advance import settled_at
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.control_verdict import ControlView, control_view
from service.pipeline.control.release.events import (
    InputsChanged,
    OrderKind,
    Report,
    StoredRow,
    Tick,
    digest_of,
    state_of,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.ports.storage import Catalogue, Clock, Storage, Term
from service.records.catalogue import ControlMode, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.operations.release import Command, CommandRequest, ProductForm, UplinkProduct
from service.runtime.control.release_context import (
    KnownFacts,
    ReleasePublisher,
    SpacecraftRelease,
    interlock_inputs,
    read_facts,
)
from service.runtime.control.sign_checks import (
    begin_sign_check,
    continue_sign_check,
    error_of,
    handle_row,
    judge_report,
    release_refusal,
    requested,
)
from service.runtime.live.leadership import always, elsewhere, is_moving

_LOG = logging.getLogger("soo.release")
#: facts of the archive hold for so long, unless something came in, s
_FACTS_S = 60.0


def _steady_us() -> int:
    """Return a clock that nobody sets."""
    return round(time.monotonic() * US_PER_S)


@dataclass(eq=False)
class ReleaseLoop:
    """Releases of all spacecraft, and the events that rows and time bring about."""

    #: of state, commands and uplink products
    storage: Storage
    #: the only source of time
    clock: Clock
    #: conditions that inhibit or trip, limits and times
    settings: ReleaseSettings
    #: of the control law
    torque: TorqueConfig
    #: gets the effects of stored steps
    publisher: ReleasePublisher
    _: KW_ONLY
    #: whether the service runs under the data clock: then only simulated spacecraft get commands
    is_data_service: bool = False
    #: tells which spacecraft this process leads
    turn: Term = always
    #: a clock that nobody sets
    steady_us: Callable[[], int] = _steady_us

    def __post_init__(self) -> None:
        self._holder = uuid4().hex
        self._releases: dict[str, SpacecraftRelease] = {}
        self._making = threading.Lock()
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

    def on_rows(self, spacecraft_id: str, seen: Sequence[StoredRow], *, has_inputs: bool = False) -> None:
        """Handle rows after they were stored, and that other inputs came in; called from the supervisor's thread.

        Nothing is raised: estimation goes on whatever happens to control.
        """
        try:
            release = self._release(spacecraft_id)
            with release.lock:
                if has_inputs:
                    release.read_s = -math.inf
                epochs_us = (row.epoch_us for stored in seen for row in stored.outcome.rows)
                release.stored_us = max(release.stored_us, *epochs_us, 0)
                for stored in seen:
                    self._on_row(release, stored)
        except Exception as fault:  # noqa: BLE001 rows go on; what was not stored does not hold, old estimates inhibit
            if is_moving(fault):
                return
            _LOG.exception("release of %s could not handle new rows; old estimates inhibit control", spacecraft_id)

    @contextmanager
    def steady(self, spacecraft_id: str) -> Iterator[bool]:
        """Let nobody trip control while rows are stored and handled; yield whether torques are withheld."""
        try:
            release = self._release(spacecraft_id)
            with release.lock:
                if release.known is None:
                    # documents are compared before the first row of this process is stored
                    self._update_inputs(release, self._instant(release))
        except SooError as fault:
            # the rows of a spacecraft that moves to another process are refused
            if not is_moving(fault):
                _LOG.exception("release of %s cannot be read from the archive; check it by `soo doctor`", spacecraft_id)
            yield False
            return
        with release.lock:
            yield release.state.interlock.is_withholding

    def tick(self) -> None:
        """Let time pass for every spacecraft that is led here and whose clock does not wait for rows."""
        for spacecraft in self.storage.catalogue.all_spacecraft():
            if self.turn(spacecraft.id) == 0 or self.clock.is_data(spacecraft.id):
                continue
            try:
                with self._present(spacecraft.id) as (release, at):
                    release.handle(Tick(at))
                    continue_sign_check(release, at)
            except SooError as error:
                # time goes on for the others; a state that grows old inhibits
                _LOG.error("release loop failed for %s: %s", spacecraft.id, error)

    def _run(self) -> None:
        """Let time pass until stopped."""
        while not self._stopping.wait(self.settings.tick_s):
            try:
                self.tick()
            except Exception:  # noqa: BLE001 time goes on; a state that grows old inhibits
                _LOG.exception("release loop failed; it runs again at the next tick")

    def _release(self, spacecraft_id: str) -> SpacecraftRelease:
        """Return the release of a spacecraft, loaded when this process has become the one that leads it.

        NotFoundError ``spacecraft.unknown``; StorageError ``lease.elsewhere`` while another service leads.
        """
        turn = self.turn(spacecraft_id)
        if turn == 0:
            raise elsewhere(self.storage.leases, spacecraft_id)
        with self._making:
            release = self._releases.get(spacecraft_id)
            if release is None or release.turn != turn:
                parts = self.storage, self.publisher, self.settings, self.torque, f"{self._holder}/{turn}", turn
                release = SpacecraftRelease(spacecraft_id, *parts)
                release.newest_us = self._newest_us(release)
                self._releases[spacecraft_id] = release
            return release

    @contextmanager
    def _present(self, spacecraft_id: str) -> Iterator[tuple[SpacecraftRelease, Instant]]:
        """Hold a spacecraft's release at the present, with the inputs of the interlock as they are now."""
        release = self._release(spacecraft_id)
        with release.lock:
            at = self._instant(release)
            self._update_inputs(release, at)
            yield release, at

    def _instant(self, release: SpacecraftRelease, epoch_us: int | None = None) -> Instant:
        """Return the present; under the data clock the newest epoch that was looked at, which never goes back.

        Rows that are stored and not yet computed do not move that clock: they would make the estimate look old to
        any caller before they are.
        """
        # asked several times a row: without a look at the catalogue, where the spacecraft is known
        spacecraft = None if release.known is None else release.known.spacecraft
        if not (self.clock.reading(spacecraft, 0).is_data if spacecraft else self.clock.is_data(release.spacecraft_id)):
            # read together: a process that is stopped between two readings would see a jump of the clock
            readings = ((self.steady_us(), self.clock.system_us(), self.steady_us()) for _ in range(3))
            before_us, now_us, _ = min(readings, key=lambda reading: reading[2] - reading[0])
            return Instant(now_us, before_us)
        release.newest_us = max(release.newest_us, epoch_us or 0)
        return Instant(release.newest_us, release.newest_us)

    def _newest_us(self, release: SpacecraftRelease) -> int:
        """Return the newest instant that the interlock, or the estimator before a restart, has looked at."""
        stored = release.state.interlock.clock
        consumed_us = self.storage.archive.head(release.spacecraft_id).consumed_epoch_us
        is_data = self.clock.is_data(release.spacecraft_id)
        return max(0 if stored is None else stored.now_us, consumed_us or 0 if is_data else 0)

    def _refresh_facts(self, release: SpacecraftRelease, at: Instant) -> None:
        """Read the facts of the archive if they are old."""
        if release.known is None or time.monotonic() - release.read_s > _FACTS_S:
            release.known = self._facts(release, at)
            release.read_s = time.monotonic()

    def _update_inputs(self, release: SpacecraftRelease, at: Instant) -> None:
        """Handle a change of the interlock's inputs."""
        self._refresh_facts(release, at)
        holders, is_disagreeing = release.lease_holders(at.now_us), release.is_disagreeing
        inputs = interlock_inputs(release.facts, at.now_us, lease_holders=holders, is_disagreeing=is_disagreeing)
        if inputs != release.state.interlock.inputs:
            release.handle(InputsChanged(at, inputs))

    def _facts(self, release: SpacecraftRelease, at: Instant) -> KnownFacts:
        """Return the facts of the archive; while a damaged document cannot be read, those known before."""
        try:
            return read_facts(self.storage, release.spacecraft_id, at.now_us)
        except StorageError as fault:
            if fault.code != "storage.corrupt" or release.known is None:
                raise
            damaged = self.storage.catalogue.damaged_documents(release.spacecraft_id)
            return replace(release.known, inputs=replace(release.known.inputs, damaged_documents=damaged))

    def _on_row(self, release: SpacecraftRelease, stored: StoredRow) -> None:
        epochs_us = [row.epoch_us for row in stored.outcome.rows]
        at = self._instant(release, max(epochs_us, default=None))
        self._refresh_facts(release, at)
        row = release.update(stored, release.spacecraft.control.method)
        self._update_inputs(release, at)
        if row is not None:
            handle_row(release, stored, row, at, may_send=self._may_send(release.spacecraft))

    def _may_send(self, spacecraft: Spacecraft) -> bool:
        """Return whether a spacecraft gets commands at all under the clock of this service."""
        return not self.is_data_service or spacecraft.simulated


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
        with self._present(spacecraft_id) as (release, at):
            return self._view(release, at)

    def order(self, spacecraft_id: str, kind: OrderKind, by: str) -> ControlView:
        """Arm, disengage, reset or stop."""
        with self._present(spacecraft_id) as (release, at):
            if kind is OrderKind.ARM:
                self._require_possible(release.spacecraft)
            self._handle(release, events.Order(at, by, kind))
            return self._view(release, at)

    def engage(
        self, spacecraft_id: str, by: str, *, is_approver: bool, until_us: int, envelope: Envelope | None = None
    ) -> ControlView:
        """Ask for standing authorisation, or join who asked for the same; without an envelope that of the settings."""
        wanted = envelope or self.settings.envelope
        with self._present(spacecraft_id) as (release, at):
            self._require_possible(release.spacecraft)
            self._handle(release, events.Engage(at, by, until_us, wanted, is_approver))
            return self._view(release, at)

    def prepare(self, spacecraft_id: str, by: str, request: CommandRequest, *, dry_run: bool = False) -> Command:
        """Return a prepared command; a dry run stores nothing and shows failing checks instead of refusing."""
        with self._present(spacecraft_id) as (release, at):
            self._require_possible(release.spacecraft)
            command = requested(release, request, at)
            counter = release.state.next_counter
            if dry_run:
                digest, now_us = digest_of(counter, command), at.now_us
                numbered = replace(command, counter=counter, digest=digest, prepared_by=by, prepared_us=now_us)
                return replace(numbered, expires_us=now_us, is_dry_run=True)
            self._handle(release, events.Prepare(at, by, command))
            return release.command(counter)

    def confirm(
        self, spacecraft_id: str, counter: int, by: str, digest: str, *, is_approver: bool, comment: str = ""
    ) -> Command:
        """Return a command released."""
        with self._present(spacecraft_id) as (release, at):
            self._require_possible(release.spacecraft)
            self._handle(release, events.Confirm(at, by, counter, digest, is_approver, comment))
            return release.command(counter)

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> Command:
        """Take a prepared command back."""
        with self._present(spacecraft_id) as (release, at):
            self._handle(release, events.Cancel(at, by, counter))
            return release.command(counter)

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
        with self._present(spacecraft_id) as (release, at):
            event = Report(at, counter, _REPORTS[turn], executed_from_us, executed_until_us, by, at_us)
            command = release.command(counter)
            if _is_repeated(command, event):
                return command
            if at_us is not None:
                _require_time(command, at_us, at, is_data=self.clock.is_data(spacecraft_id))
            self._handle(release, event)
            judge_report(release, event)
            continue_sign_check(release, at)
            return release.command(counter)

    def command(self, spacecraft_id: str, counter: int) -> Command:
        """Return one command as it is now; NotFoundError ``command.unknown``."""
        if self.turn(spacecraft_id) == 0:
            return self.storage.releases.command(spacecraft_id, counter)
        with self._present(spacecraft_id) as (release, at):
            release.handle(events.Tick(at))
            return release.command(counter)

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
        with self._present(spacecraft_id) as (release, at):
            self._require_possible(release.spacecraft)
            begin_sign_check(release, axis, by, at)
            return self._view(release, at)

    def _handle(self, release: SpacecraftRelease, event: events.Event) -> None:
        """Handle an order; refused, it is an error."""
        refusal = release.handle(event).refusal
        if refusal is None:
            return
        if refusal.code == "command.unknown" and isinstance(event, events.Confirm | events.Cancel | Report):
            # one that ended long ago is not in the state any more
            ended = release.command(event.counter).state
            raise ConflictError("command.state", f"command {event.counter} has ended, {ended}: nothing follows on that")
        raise error_of(refusal)

    def _view(self, release: SpacecraftRelease, at: Instant) -> ControlView:
        """Return the view of the interlock at an instant; nothing is stored."""
        state = settled_at(release.state, at, self.settings)
        return control_view(state, release.spacecraft, self.settings, at.now_us)

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
