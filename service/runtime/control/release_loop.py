"""The floor of the release service: each spacecraft's case, the present, rows and time as they come in.

Persons' orders stand in `service.runtime.control.release_service`. Only the service that leads its archive
judges events; a service that becomes leader again reads its state from the archive.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from uuid import uuid4

from service.errors import SooError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.advance import settled_at
from service.pipeline.control.release.events import Event, InputsChanged, Step, Tick
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.row_facts import SeenRow
from service.pipeline.control.release.settings import ReleaseSettings
from service.pipeline.control.release.state_document import memory_of
from service.ports import Clock, Storage
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.operations.audit import apart_from_request
from service.records.operations.release import ControlView
from service.runtime.control.persisted_release import Annex, PersistedRelease, is_order
from service.runtime.control.proposals import Proposals
from service.runtime.control.release_inputs import KnownFacts, interlock_inputs, read_facts
from service.runtime.control.release_notifications import ReleasePublisher
from service.runtime.control.row_handler import RowHandler
from service.runtime.control.spacecraft_release import SpacecraftRelease
from service.runtime.control.views import control_view
from service.runtime.live.leadership import Turn, always, elsewhere

_LOG = logging.getLogger("soo.release")


def _steady_us() -> int:
    """Return a clock that nobody sets."""
    return round(time.monotonic() * US_PER_S)


class ReleaseLoop:
    """Cases of all spacecraft, and what rows and time bring about.

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
    publisher : ReleasePublisher
        Who is told of what has been stored.
    is_data_service : bool
        Whether the service runs under the data clock: then only simulated craft get commands.
    turn : Turn, optional
        Tells whether this service leads.
    steady : callable, optional
        A clock that nobody sets, microseconds.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        settings: ReleaseSettings,
        torque: TorqueConfig,
        publisher: ReleasePublisher,
        *,
        is_data_service: bool = False,
        turn: Turn = always,
        steady: Callable[[], int] = _steady_us,
    ) -> None:
        self._storage = storage
        self._clock = clock
        self._settings = settings
        self._publisher = publisher
        self._is_data_service = is_data_service
        self._turn = turn
        self._steady = steady
        self._holder = uuid4().hex
        self._releases: dict[str, SpacecraftRelease] = {}
        self._making = threading.Lock()
        self._proposals = Proposals(storage.releases, settings, torque)
        self._rows = RowHandler(storage, settings, torque, self._step, self._proposals)
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

    def see(self, spacecraft_id: str, seen: Sequence[SeenRow], *, has_inputs: bool = False) -> None:
        """Take over rows after they were stored, and that other inputs came in; called from the supervisor's thread.

        Nothing is raised: estimation goes on whatever happens to control.
        """
        try:
            release = self._release(spacecraft_id)
            with release.case.lock:
                if has_inputs:
                    release.read_s = -math.inf
                epochs_us = (row.epoch_us for one in seen for row in one.outcome.rows)
                release.case.stored_us = max(release.case.stored_us, *epochs_us, 0)
                for one in seen:
                    self._see_one(release, spacecraft_id, one)
                self._tell(release, spacecraft_id)
        except Exception:  # noqa: BLE001 rows go on; what was not stored does not hold, and old estimates inhibit
            _LOG.exception("the release of %s could not take rows over", spacecraft_id)

    @contextmanager
    def steady(self, spacecraft_id: str) -> Iterator[bool]:
        """Let nobody trip control while rows are stored and taken over; tell whether torques are withheld."""
        try:
            case = self._release(spacecraft_id).case
        except SooError:
            _LOG.exception("the release of %s cannot be read", spacecraft_id)
            yield False
            return
        with case.lock:
            yield case.state.interlock.is_withholding

    def tick(self) -> None:
        """Let time pass for every spacecraft whose clock does not wait for rows; nothing while another one leads."""
        if self._turn() == 0:
            return
        for spacecraft in self._storage.catalogue.all_spacecraft():
            if self._clock.is_data(spacecraft.id):
                continue
            release = self._release(spacecraft.id)
            with release.case.lock:
                at, facts = self._present(release, spacecraft.id)
                self._step(release, facts.spacecraft, Tick(at))
                self._rows.go_on(release, facts, at)
                self._tell(release, spacecraft.id)

    def _run(self) -> None:
        """Let time pass until stopped."""
        while not self._stopping.wait(self._settings.tick_s):
            try:
                self.tick()
            except Exception:  # noqa: BLE001 time goes on; a state that grows old inhibits
                _LOG.exception("time could not pass for the release")

    def _release(self, spacecraft_id: str) -> SpacecraftRelease:
        """Return what is kept of a spacecraft.

        NotFoundError ``spacecraft.unknown``; StorageError ``lease.elsewhere`` while another service leads.
        """
        turn = self._turn()
        if turn == 0:
            raise elsewhere()
        with self._making:
            release = self._releases.get(spacecraft_id)
            if release is None or release.turn != turn:
                case = PersistedRelease(self._storage.releases, spacecraft_id, f"{self._holder}/{turn}")
                release = SpacecraftRelease(case, turn, newest_us=self._newest_us(spacecraft_id, case))
                self._releases[spacecraft_id] = release
            return release

    def _instant(self, release: SpacecraftRelease, spacecraft_id: str, epoch_us: int | None = None) -> Instant:
        """Return the present; under the data clock the newest epoch that was looked at, which never goes back.

        Rows that are stored and not yet computed do not move that clock: they would make the estimate look old to
        whoever asks before they are.
        """
        if not self._clock.is_data(spacecraft_id):
            return Instant(self._clock.system_us(), self._steady())
        release.newest_us = max(release.newest_us, epoch_us or 0)
        return Instant(release.newest_us, release.newest_us)

    def _newest_us(self, spacecraft_id: str, case: PersistedRelease) -> int:
        """Return the newest instant that the interlock, or the estimator before a restart, has looked at."""
        stored = case.state.interlock.clock
        consumed_us = self._storage.archive.head(spacecraft_id).consumed_epoch_us
        is_data = self._clock.is_data(spacecraft_id)
        return max(0 if stored is None else stored.now_us, consumed_us or 0 if is_data else 0)

    def _present(self, release: SpacecraftRelease, spacecraft_id: str) -> tuple[Instant, KnownFacts]:
        """Return the present with what holds at it, told to the interlock."""
        at = self._instant(release, spacecraft_id)
        return at, self._informed(release, spacecraft_id, at)

    def _informed(self, release: SpacecraftRelease, spacecraft_id: str, at: Instant) -> KnownFacts:
        """Return what holds beside the rows, and tell the interlock where it has changed."""
        if release.facts is None or release.are_facts_old:
            release.facts = read_facts(self._storage, spacecraft_id, at.now_us)
            release.read_s = time.monotonic()
        facts, case = release.facts, release.case
        holders = case.lease_holders(at.now_us)
        inputs = interlock_inputs(facts, at.now_us, lease_holders=holders, is_disagreeing=release.is_disagreeing)
        if inputs != case.state.interlock.inputs:
            self._step(release, facts.spacecraft, InputsChanged(at, inputs))
        return facts

    def _see_one(self, release: SpacecraftRelease, spacecraft_id: str, one: SeenRow) -> None:
        """Take over one row."""
        epochs_us = [row.epoch_us for row in one.outcome.rows]
        at = self._instant(release, spacecraft_id, max(epochs_us, default=None))
        facts = self._informed(release, spacecraft_id, at)
        row = release.take(one, facts.spacecraft.control.method)
        if row is not None:
            self._informed(release, spacecraft_id, at)
            self._rows.see(release, facts, one, row, at, may_send=self._may_send(facts.spacecraft))

    def _step(
        self, release: SpacecraftRelease, spacecraft: Spacecraft, event: Event, annex: Annex | None = None
    ) -> Step:
        """Judge and store an event, and tell who has to know."""
        step, entries = release.case.step(event, self._settings, annex)
        with nullcontext() if is_order(event, step) else apart_from_request():
            self._publisher.told(spacecraft, step, event.at, has_entries=bool(entries))
        return step

    def _tell(self, release: SpacecraftRelease, spacecraft_id: str) -> None:
        """Tell streams that something has changed, if it has."""
        interlock = release.case.state.interlock
        lives = tuple((command.counter, command.life) for command in release.case.state.commands)
        told = (interlock.state, interlock.reasons, interlock.authorisation, lives, release.case.sign_check)
        if told != release.told:
            release.told = told
            self._publisher.changed(spacecraft_id)

    def _view(self, release: SpacecraftRelease, facts: KnownFacts, at: Instant) -> ControlView:
        """Return what the interlock says at an instant; nothing is stored."""
        state = settled_at(release.case.state, at, self._settings)
        return control_view(state, facts.spacecraft, self._settings, at.now_us, release.case.sign_check)

    def _stored_view(self, spacecraft_id: str) -> ControlView:
        """Return what the service that leads has stored last."""
        memory = memory_of(self._storage.releases.stored(spacecraft_id).document)
        spacecraft = self._storage.catalogue.spacecraft(spacecraft_id)
        now_us = self._clock.now_us(spacecraft_id) or 0
        return control_view(memory.state, spacecraft, self._settings, now_us, memory.sign_check)

    def _may_send(self, spacecraft: Spacecraft) -> bool:
        """Whether a spacecraft gets commands at all under the clock of this service."""
        return not self._is_data_service or spacecraft.simulated
