"""Release loop: rows and time as they come in, for every spacecraft.

Orders of persons stand in `service.runtime.control.release_service`. Only the process that leads a spacecraft
judges its events; one that becomes its leader again reads the state from the archive.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, replace
from uuid import uuid4

from service.errors import SooError, StorageError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.events import InputsChanged, StoredRow, Tick
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.ports.storage import Clock, Storage, Term
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.runtime.control.release_context import (
    KnownFacts,
    ReleasePublisher,
    SpacecraftRelease,
    interlock_inputs,
    read_facts,
)
from service.runtime.control.sign_checks import continue_sign_check, handle_row
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

    def _update_inputs(self, release: SpacecraftRelease, at: Instant) -> None:
        """Read the facts of the archive if they are old, and handle a change of the interlock's inputs."""
        if release.known is None or time.monotonic() - release.read_s > _FACTS_S:
            release.known = self._facts(release, at)
            release.read_s = time.monotonic()
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
        """Handle one row."""
        epochs_us = [row.epoch_us for row in stored.outcome.rows]
        at = self._instant(release, max(epochs_us, default=None))
        self._update_inputs(release, at)
        row = release.update(stored, release.spacecraft.control.method)
        if row is not None:
            self._update_inputs(release, at)
            handle_row(release, stored, row, at, may_send=self._may_send(release.spacecraft))

    def _may_send(self, spacecraft: Spacecraft) -> bool:
        """Return whether a spacecraft gets commands at all under the clock of this service."""
        return not self.is_data_service or spacecraft.simulated
