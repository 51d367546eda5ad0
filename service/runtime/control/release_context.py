"""Release of torques of one spacecraft: its state in memory, what it reads, what it publishes."""

import logging
import math
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from itertools import pairwise
from typing import Any

from service.errors import ConflictError, NotFoundError, SooError, StorageError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.advance import advance, restored
from service.pipeline.control.release.command_transitions import command_of
from service.pipeline.control.release.events import (
    AuditEffect,
    Event,
    InputsChanged,
    JournalEffect,
    PersonalEvent,
    PublishEffect,
    ReleaseEffect,
    ReleaseState,
    Report,
    Step,
    StoredRow,
    UplinkEffect,
    document_of,
    essence,
    state_of,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_conditions import (
    InterlockInputs,
    InterlockRow,
    ReleaseSettings,
    interlock_row,
)
from service.pipeline.control.release.sign_checks import is_running
from service.pipeline.inputs.knowledge import has_body_rate
from service.ports.archive import ListPart
from service.ports.storage import Audit, Storage
from service.records.calibration import CalibrationMethod, CalibrationState, Window
from service.records.catalogue import Method, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Operation, TelemetryRecord
from service.records.levels.attitude import AttitudeRow, Axes, ReleasedCommand, ReportedCommand
from service.records.operations.access import CURRENT_NOTE, DONE, AuditEvent, apart_from_request
from service.records.operations.release import Command, InterlockHold, ReleaseChange
from service.runtime.control.sign_check_rows import SignCheckRows
from service.runtime.live.journal_consumer import every_input
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed

#: operations are looked for so far back: a burn of then without a new ephemeris still counts
_OPERATIONS_BACK_US = 60 * 86_400 * US_PER_S
#: older telemetry says nothing of the present
_TELEMETRY_US = 600 * US_PER_S
#: records that must agree before a momentum trips
_MOMENTA = 2
_BEFORE_US = 3600 * US_PER_S
_AHEAD_US = 86_400 * US_PER_S
_AT_ONCE = 1000
_EVERY_NUMBER = 1 << 62
#: an operation of this kind changes the orbit
_BURN = "station_keeping"


@dataclass(frozen=True, slots=True)
class KnownFacts:
    """Facts of the archive about a spacecraft."""

    spacecraft: Spacecraft
    #: of the interlock, but for what depends on the instant
    inputs: InterlockInputs
    operations: tuple[Operation, ...]
    #: newest
    telemetry: TelemetryRecord | None
    #: momenta of the newest two records that state them, the newest first
    momenta_n_m_s: tuple[tuple[float, ...], ...] = ()
    #: newest with the rate of the body about every axis
    rated: TelemetryRecord | None = None

    def body_rate_deg_s(self, epoch_us: int, age_s: float) -> Axes | None:
        """Return the rate of the body from telemetry within an age of an epoch; None without."""
        if self.rated is None or abs(epoch_us - self.rated.epoch_us) > age_s * US_PER_S:
            return None
        return self.rated.body_rate_deg_s

    def momentum_n_m_s(self, now_us: int) -> tuple[float, ...] | None:
        """Return the momentum of each wheel, None without recent telemetry."""
        telemetry = self.telemetry_at(now_us)
        return None if telemetry is None else telemetry.wheel_momentum_n_m_s

    def telemetry_at(self, now_us: int) -> TelemetryRecord | None:
        """Return the newest telemetry unless it is too old."""
        if self.telemetry is None or now_us - self.telemetry.epoch_us > _TELEMETRY_US:
            return None
        return self.telemetry


def read_facts(storage: Storage, spacecraft_id: str, now_us: int) -> KnownFacts:
    """Return what the archive says; NotFoundError ``spacecraft.unknown``."""
    spacecraft = storage.catalogue.spacecraft(spacecraft_id)
    received_us, stop_us = _ephemeris(storage, spacecraft_id)
    window = Window(now_us - _OPERATIONS_BACK_US, now_us + _AHEAD_US)
    telemetry = read_telemetry(storage, spacecraft_id, now_us - _TELEMETRY_US)
    as_stored = partial(storage.archive.inputs, is_compared=False)
    operations = as_stored(spacecraft_id, "operation", ListPart(window, _AT_ONCE))
    inputs = InterlockInputs(
        is_aligned=bool(storage.results.alignments(spacecraft_id)),
        ephemeris_received_us=received_us,
        ephemeris_stop_us=stop_us,
        calibration_id=_calibration_id(storage, spacecraft),
        plan_id=_plan_id(storage, spacecraft_id),
        spacecraft_version=version_of(*_mechanics(spacecraft)),
        control_version=version_of(spacecraft.control),
        is_automatic=spacecraft.control.release is Release.AUTOMATIC,
        damaged_documents=storage.catalogue.damaged_documents(spacecraft_id),
    )
    known = tuple(each.content for each in operations if isinstance(each.content, Operation))
    rated = (each for each in reversed(telemetry) if has_body_rate(each))
    momenta_n_m_s = _newest_momenta(storage, spacecraft_id, telemetry)
    return KnownFacts(spacecraft, inputs, known, next(reversed(telemetry), None), momenta_n_m_s, next(rated, None))


def _newest_momenta(
    storage: Storage, spacecraft_id: str, telemetry: Sequence[TelemetryRecord]
) -> tuple[tuple[float, ...], ...]:
    """Return the momenta of the newest two records that state them, of recent telemetry and of an hour before it."""
    momenta = [one.wheel_momentum_n_m_s for one in reversed(telemetry) if one.wheel_momentum_n_m_s]
    if len(momenta) == 1:
        window = Window(telemetry[0].epoch_us - _BEFORE_US, telemetry[0].epoch_us)
        as_stored = partial(storage.archive.inputs, is_compared=False)
        for entry in as_stored(spacecraft_id, "telemetry", ListPart(window, _AT_ONCE, newest_first=True)):
            if isinstance(entry.content, TelemetryRecord) and entry.content.wheel_momentum_n_m_s:
                momenta.append(entry.content.wheel_momentum_n_m_s)
                break
    return tuple(momenta[:_MOMENTA])


def read_telemetry(storage: Storage, spacecraft_id: str, from_us: int) -> tuple[TelemetryRecord, ...]:
    """Return telemetry since an instant, in order of epoch."""
    entries = every_input(storage.archive, spacecraft_id, "telemetry", Window(from_us, _EVERY_NUMBER))
    return tuple(entry.content for entry in entries if isinstance(entry.content, TelemetryRecord))


def interlock_inputs(facts: KnownFacts, now_us: int, *, lease_holders: int, is_disagreeing: bool) -> InterlockInputs:
    """Return what the interlock must know at an instant."""
    telemetry = facts.telemetry_at(now_us)
    burns_us = [
        each.stop_us for each in facts.operations if each.kind == _BURN and each.stop_us and each.stop_us <= now_us
    ]
    return replace(
        facts.inputs,
        onboard_mode=None if telemetry is None else telemetry.onboard_mode,
        has_inhibiting_operation=any(_is_inhibiting(each, now_us) for each in facts.operations),
        burn_stop_us=max(burns_us, default=None),
        momentum_share=_momentum_share(facts.spacecraft, facts.momenta_n_m_s if telemetry else ()),
        lease_holders=lease_holders,
        is_disagreeing=is_disagreeing,
    )


def _mechanics(spacecraft: Spacecraft) -> tuple[object, ...]:
    """Return all that a torque's effect depends on: a sign is proven for these."""
    limits = spacecraft.inertia_kg_m2, spacecraft.torque_limit_n_m, spacecraft.wheels
    return *limits, spacecraft.modes, spacecraft.onboard


def version_of(*parts: object) -> int:
    """Return a number that changes with some parts of the catalogue, and with nothing else."""
    return int.from_bytes(sha256(repr(parts).encode()).digest()[:6], "big")


def _is_inhibiting(operation: Operation, now_us: int) -> bool:
    is_over = operation.stop_us is not None and operation.stop_us <= now_us
    return operation.inhibit_control and operation.start_us <= now_us and not is_over


def _momentum_share(spacecraft: Spacecraft, momenta_n_m_s: Sequence[Sequence[float]]) -> float | None:
    """Return how full the fullest wheel is by the better of two records: one alone, perhaps a wild one, trips nothing.

    Infinite for NaN, by which inputs would differ from themselves.
    """
    if len(momenta_n_m_s) < _MOMENTA:
        return None
    fullest_n_m_s = (max(math.inf if math.isnan(h) else abs(h) for h in record) for record in momenta_n_m_s)
    return min(fullest_n_m_s) / spacecraft.wheels.momentum_limit_n_m_s


def _ephemeris(storage: Storage, spacecraft_id: str) -> tuple[int | None, int | None]:
    """Return when the newest ephemeris came, by the rows, and when it ends."""
    try:
        stop_us = storage.catalogue.ephemeris(spacecraft_id).valid_stop_us
    except NotFoundError:
        return None, None
    entries = storage.archive.slow_inputs_before(spacecraft_id, _EVERY_NUMBER, ("ephemeris",))
    return (entries[-1].start_us if entries else None), stop_us


def _plan_id(storage: Storage, spacecraft_id: str) -> int | None:
    try:
        return storage.catalogue.plan(spacecraft_id).id
    except NotFoundError:
        return None


def _calibration_id(storage: Storage, spacecraft: Spacecraft) -> int | None:
    """Return the active calibration of the method that drives control."""
    active = {
        one.request.method: one.id for one in storage.results.calibrations(spacecraft.id, CalibrationState.ACTIVE)
    }
    geometry = active.get(CalibrationMethod.GEOMETRY)
    return geometry if spacecraft.control.method is Method.ROBUST else active.get(CalibrationMethod.PAPER, geometry)


_LOG = logging.getLogger("soo.release")

#: who did what no person ordered
_WHO = "interlock"


@dataclass
class ReleasePublisher:
    """Publishes the effects of a step that is stored."""

    #: gets what happened by itself; an order has the event of its request
    audit: Audit
    #: streams read the state again
    feed: LiveFeed
    #: called with the spacecraft whose journal has grown
    on_journal: Callable[[str], None]

    def publish(self, spacecraft_id: str, effects: Iterable[ReleaseEffect], at: Instant) -> None:
        """Apply the effects of a step; products and journal entries have been stored with it."""
        kinds = {type(effect) for effect in effects}
        if JournalEffect in kinds:
            self.on_journal(spacecraft_id)
        for effect in effects:
            if isinstance(effect, AuditEffect):
                self._append(effect.action, f"/spacecraft/{spacecraft_id}/{effect.target}", at)
            elif isinstance(effect, PublishEffect) and effect.warning:
                _LOG.warning("release warning of %s: %s", spacecraft_id, effect.warning)
        if PublishEffect in kinds and self.feed.has_subscribers(spacecraft_id):
            self.feed.publish(spacecraft_id, (FeedEvent("status", Cursor(0, 0), None),))

    def _append(self, action: str, target: str, at: Instant) -> None:
        """Append an event of the interlock itself; the archive may be away, and control does not wait for it."""
        if CURRENT_NOTE.get() is not None:
            return
        nobody: dict[str, Any] = dict.fromkeys(("key_id", "role", "address", "request_id"), "")
        event = AuditEvent(at_us=at.now_us, who=_WHO, action=action, target=target, outcome=DONE, **nobody)
        try:
            self.audit.append(event)
        except SooError as error:
            _LOG.error("audit entry %s of %s could not be written: %s", action, target, error)


#: rows from whose epochs the row period is taken
_PERIOD_ROWS = 15
_DEFAULT_PERIOD_S = 60.0
#: rows that came late or again say nothing of the present
_NOT_PRESENT = frozenset({"late", "catch_up"})
#: the estimator's reason for a turn that was not announced; a sign check announces none
_OWN_TURN = "unannounced_motion"
#: the estimator's reason for its statistic
_OUT_OF_BAND = "innovations"
#: another process that has stored counts as there for so long
_FOREIGN_US = 600 * US_PER_S
#: a state that matters is stored at least this often, so that a restart knows the time, s
_HEARTBEAT_S = 60.0
_ATTEMPTS = 3


@dataclass(eq=False)
class SpacecraftRelease:
    """Release of one spacecraft with all that its events are built from.

    StorageError ``release.unreadable`` where what is stored is no state.
    """

    #: of an existing one
    spacecraft_id: str
    #: where its state is stored
    storage: Storage
    #: gets the effects that are not stored here
    publisher: ReleasePublisher
    settings: ReleaseSettings
    #: of the control law
    torque: TorqueConfig
    #: this process
    holder: str
    #: of the service as the one that leads
    turn: int = 1
    known: KnownFacts | None = None
    read_s: float = 0.0
    #: newest instant of the spacecraft that was looked at
    newest_us: int = 0
    #: newest row of the method that drives control, with what came with it
    newest_row: AttitudeRow | None = None
    stored: StoredRow | None = None
    is_disagreeing: bool = False
    epochs_us: deque[int] = field(default_factory=lambda: deque(maxlen=_PERIOD_ROWS + 1))
    sign_rows: SignCheckRows | None = None
    #: when the law was asked last under a standing authorisation
    asked_us: int = 0

    def __post_init__(self) -> None:
        self.releases = self.storage.releases
        self._foreign_us: int | None = None
        #: newest epoch of which results are stored
        self.stored_us = 0
        self._stored_s = time.monotonic()
        #: an event and its storing are one
        self.lock = threading.RLock()
        self.state, self._version = self._loaded()

    def lease_holders(self, now_us: int) -> int:
        """Return how many processes have stored lately."""
        is_shared = self._foreign_us is not None and now_us - self._foreign_us < _FOREIGN_US
        return 2 if is_shared else 1

    def command(self, counter: int) -> Command:
        """Return a command as it is stored; NotFoundError ``command.unknown``."""
        return command_of(self.state, counter) or self.releases.command(self.spacecraft_id, counter)

    def handle(self, event: Event) -> Step:
        """Judge an event, store what follows, apply its effects, and return the step.

        StorageError ``release.busy`` where another process keeps storing, and those of the storage: nothing holds then.
        """
        with self.lock:
            for _ in range(_ATTEMPTS):
                step = self._judged(event)
                is_ordered = isinstance(event, PersonalEvent | Report) and step.refusal is None
                with nullcontext() if is_ordered else apart_from_request():
                    try:
                        self._store(step, event.at)
                    except ConflictError as error:
                        if error.code != "release.changed":
                            raise
                        self.state, self._version = self._loaded(event.at)
                        continue
                    self.publisher.publish(self.spacecraft_id, step.effects, event.at)
                    return step
            detail = f"another process changes the release of {self.spacecraft_id} too"
            raise StorageError("release.busy", detail)

    def _judged(self, event: Event) -> Step:
        """Return the step of an event; a lease that is held twice counts first."""
        before, now_us = self.state, event.at.now_us
        effects: tuple[ReleaseEffect, ...] = ()
        if self.lease_holders(now_us) > before.interlock.inputs.lease_holders:
            shared = InputsChanged(event.at, replace(before.interlock.inputs, lease_holders=2))
            first = advance(before, shared, self.settings)
            before, effects = first.state, first.effects
            if isinstance(event, InputsChanged):
                event = InputsChanged(event.at, replace(event.inputs, lease_holders=2))
        step = advance(before, event, self.settings)
        return replace(step, effects=(*effects, *step.effects)) if effects else step

    def _store(self, step: Step, at: Instant) -> None:
        """Store what a step must not lose, in one transaction; only then does the state hold."""
        known = {command.counter: command for command in self.state.commands}
        commands = tuple(each for each in step.state.commands if known.get(each.counter) != each)
        entries = tuple(self._numbered(each, at) for each in step.effects if isinstance(each, JournalEffect))
        products = tuple(each.product for each in step.effects if isinstance(each, UplinkEffect))
        is_same = essence(self.state) == essence(step.state)
        if not is_same or products or entries or self._is_due(step.state):
            change = ReleaseChange(document_of(step.state), self.holder, commands, products, entries)
            self._version = self.releases.save(self.spacecraft_id, self._version, change)
            self._stored_s = time.monotonic()
        self.state = step.state

    def _numbered(self, effect: JournalEffect, at: Instant) -> ReleasedCommand | ReportedCommand | InterlockHold:
        """Return a journal entry with the version that it is stored with."""
        entry = effect.entry
        if not isinstance(entry, InterlockHold):
            return entry
        # no row whose results are stored is later than the trip, also not one from a clock that is ahead
        return replace(entry, at_us=max(at.now_us, self.stored_us), version=self._version + 1)

    def _is_due(self, state: ReleaseState) -> bool:
        """Return whether a state that somebody relies on was stored long ago."""
        is_relied_on = state.interlock.is_armed or bool(state.interlock.trips) or bool(state.commands)
        return is_relied_on and time.monotonic() - self._stored_s > _HEARTBEAT_S

    def _loaded(self, at: Instant | None = None) -> tuple[ReleaseState, int]:
        """Return the stored state and its version, at an instant at which somebody else has changed it."""
        stored = self.releases.stored(self.spacecraft_id)
        if at is not None and stored.holder != self.holder:
            self._foreign_us = at.now_us
        try:
            state = state_of(stored.document, partial(self.releases.command, self.spacecraft_id))
        except (ValueError, NotFoundError) as error:
            raise StorageError("release.unreadable", f"{self.spacecraft_id}: {error}") from error
        return restored(state), stored.version

    @property
    def facts(self) -> KnownFacts:
        """Facts of the archive as they were read last."""
        if self.known is None:
            message = "the facts of the archive have not been read"
            raise ValueError(message)
        return self.known

    @property
    def spacecraft(self) -> Spacecraft:
        """Spacecraft as the catalogue states it."""
        return self.facts.spacecraft

    @property
    def row(self) -> AttitudeRow:
        """Newest row of the method that drives control; ConflictError ``command.no_estimate`` before the first."""
        if self.newest_row is None:
            raise ConflictError("command.no_estimate", "there is no row of the method that drives control yet")
        return self.newest_row

    @property
    def period_s(self) -> float:
        """Expected time to the next row."""
        if len(self.epochs_us) < 2:
            return _DEFAULT_PERIOD_S
        # numpy costs ten times as much on so few
        return statistics.median(later - earlier for earlier, later in pairwise(self.epochs_us)) / US_PER_S

    @property
    def stale_us(self) -> int:
        """Age at which an estimate is too old."""
        return self.settings.stale_us(self.period_s)

    def update(self, stored: StoredRow, method: Method) -> AttitudeRow | None:
        """Update with a row; return that of the method that drives control, None where it is not of the present."""
        row = next((each for each in stored.outcome.rows if each.method is method), None)
        if row is None or _NOT_PRESENT.intersection(row.inhibitions):
            return None
        if self.newest_row is not None and row.epoch_us <= self.newest_row.epoch_us:
            return None
        self.newest_row, self.stored = row, stored
        self.epochs_us.append(row.epoch_us)
        if not math.isnan(stored.outcome.disagreement_deg):
            self.is_disagreeing = stored.outcome.disagreement_deg > 0.0
        return row

    def row_facts(self, row: AttitudeRow) -> InterlockRow:
        """Return the facts of a row for the interlock."""
        command = None if self.stored is None else self.stored.outcome.command
        is_in_band = _OUT_OF_BAND not in row.inhibitions
        facts = interlock_row(row, command, self.period_s, is_innovation_in_band=is_in_band)
        if not is_running(self.state.sign_check):
            return facts
        return replace(facts, inhibitions=tuple(reason for reason in facts.inhibitions if reason != _OWN_TURN))
