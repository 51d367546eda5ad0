"""Alarm desk: one thread that looks at what the chains have computed and at the clock, and does what operators order.

The supervisor hands over rows and goes on; nothing here makes a chain wait. A change is stored, then published, then
told outside, so that what somebody was told of is never forgotten. While the archive does not answer changes wait in
order; an operator's order is refused instead.

The alarms of one spacecraft, or of the service, with what keeps them beyond a restart.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from service.errors import ConflictError, FieldError, InvalidInputError, StorageError
from service.pipeline.alarms.alarm_engine import AlarmEngine, Key, Readings
from service.pipeline.alarms.readings import RowReader
from service.pipeline.alarms.states import AlarmCondition
from service.pipeline.estimation.method import RowEvidence
from service.ports.storage import ARCHIVE, Alarms, Clock, Storage, Term
from service.records.epoch import US_PER_S
from service.records.operations.alarms import Alarm, AlarmChange, AlarmLimits, EngineMemory, Handling
from service.runtime.alarms.clock_checks import ClockChecks, StoredFacts
from service.runtime.alarms.notifications import NoticeChannel
from service.runtime.live.leadership import always, elsewhere
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed, Seen
from service.runtime.live.supervisor import StepFailures

#: what is kept of the rows may be so old, us, and their period so far off
_FAR_US = 600 * US_PER_S
_OTHER_PACE = 0.2


class PersistedAlarms:
    """A book, its reader of rows, and the changes that wait to be stored.

    Parameters
    ----------
    alarms : Alarms
        Where they are kept; what is open is read from there.
    spacecraft_id : str or None
        None: the service as a whole.
    conditions : mapping
        Table of conditions.
    """

    def __init__(self, alarms: Alarms, spacecraft_id: str | None, conditions: Mapping[str, AlarmCondition]) -> None:
        self._alarms = alarms
        self._spacecraft_id = spacecraft_id
        self._unsaved: list[AlarmChange] = []
        self._kept = alarms.memory(spacecraft_id)
        limits = AlarmLimits() if spacecraft_id is None else alarms.limits(spacecraft_id)
        self.engine = AlarmEngine(spacecraft_id, conditions, limits, alarms.open_alarms(spacecraft_id), self._kept)
        self.reader = RowReader(self.engine, self._kept)
        self.reader.use_nominal(limits.nominal_dbm)

    def use_limits(self, limits: AlarmLimits, at_us: int) -> tuple[AlarmChange, ...]:
        """Hold values against other limits from now on; return what that changes, stored."""
        self.engine.use_limits(limits)
        self.reader.use_nominal(limits.nominal_dbm)
        return self.store(self.engine.enter(self.engine.context, at_us))

    def store(self, changes: Sequence[AlarmChange]) -> tuple[AlarmChange, ...]:
        """Store changes, and those that could not be stored before; return them with their numbers.

        Raises
        ------
        StorageError
            Nothing was stored; the next call tries again.
        """
        self._unsaved += changes
        if not self._unsaved:
            return ()
        saved = self._alarms.save(self._unsaved)
        self._unsaved.clear()
        for change in saved:
            self.engine.adopt(change.alarm)
        return saved

    def keep_memory(self) -> None:
        """Store what is about to happen, where it has changed."""
        memory = EngineMemory(self.engine.watches(), self.reader.newest_row_us, self.reader.row_period_s)
        # rows alone are no reason to write, nor is the jitter of their period
        if memory.watches != self._kept.watches or _is_other(memory, self._kept):
            self._alarms.save_memory(self._spacecraft_id, memory)
            self._kept = memory


def _is_other(memory: EngineMemory, kept: EngineMemory) -> bool:
    """Return whether rows have gone on by much, or come at another pace, since the memory was stored."""
    if memory.newest_row_us is None or memory.newest_row_us == kept.newest_row_us:
        return False
    if kept.newest_row_us is None or memory.newest_row_us - kept.newest_row_us > _FAR_US:
        return True
    before_s, now_s = kept.row_period_s or 0.0, memory.row_period_s or 0.0
    return abs(now_s - before_s) > _OTHER_PACE * before_s


_LOG = logging.getLogger("soo.alarms")

#: rows and references that wait to be looked at; more than that are not alarmed on
_CAPACITY = 5000
#: longest shelving
SHELVE_LIMIT_US = 24 * 3600 * US_PER_S
#: ages of what the estimate rests on are looked at once in so many checks
_CHECKS_A_POLL = 15


class AlarmService:
    """Alarms of all spacecraft.

    Parameters
    ----------
    storage : Storage
        Where alarms are kept and what is looked at lies.
    clock : Clock
        The only source of time.
    feed : LiveFeed
        Where changes are published after they are stored.
    conditions : mapping
        Table of conditions.
    channels : sequence of NoticeChannel
        Who is told outside.
    check_period_s : float
        Time between looks at the clock.
    stale_periods : float
        Row periods that are waited for after a start before rows are missed.
    turn : Term
        Tells which spacecraft this service leads: of others it alarms nobody.
    failures : StepFailures, optional
        Of the estimator.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        feed: LiveFeed,
        conditions: Mapping[str, AlarmCondition],
        channels: Sequence[NoticeChannel] = (),
        *,
        check_period_s: float = 2.0,
        stale_periods: float = 3.0,
        turn: Term = always,
        failures: StepFailures | None = None,
    ) -> None:
        self._turn = turn
        #: terms from which on the alarms at hand are what the archive holds
        self._served_turns: dict[str | None, int] = {}
        self._storage = storage
        self._clock = clock
        self._feed = feed
        self.channels = channels
        self.conditions = conditions
        self._check_period_s = check_period_s
        self._checks = ClockChecks(storage, clock, stale_periods, failures or StepFailures())
        self._polls = 0
        self._persisted_by_id: dict[str | None, PersistedAlarms] = {}
        self._lock = threading.RLock()
        # of rows that come faster than they can be looked at the newest
        self._queue: deque[tuple[str, Seen]] = deque(maxlen=_CAPACITY)
        self._arrived = threading.Event()
        self._is_stopping = False
        self._is_failing = False
        self._thread = threading.Thread(target=self._run, name="soo-alarms", daemon=True)

    def start(self) -> None:
        """Start the thread of the alarm checks."""
        for channel in self.channels:
            channel.start()
        self._thread.start()

    def stop(self) -> None:
        """Process the rows that wait and end the thread."""
        self._is_stopping = True
        self._arrived.set()
        if self._thread.is_alive():
            self._thread.join()
        for channel in self.channels:
            channel.stop()

    def on_rows(self, spacecraft_id: str, seen: Sequence[Seen]) -> None:
        """Take over rows and references; called from the supervisor's thread."""
        self._queue.extend((spacecraft_id, one) for one in seen)
        self._arrived.set()

    def acknowledge(self, alarm_id: int, by: str, comment: str) -> Alarm:
        """Note that somebody has seen an alarm; ConflictError ``alarm.closed``."""
        return self._order(alarm_id, by, comment, AlarmEngine.acknowledge)

    def clear(self, alarm_id: int, by: str, comment: str) -> Alarm:
        """Close an alarm; ConflictError ``alarm.closed``."""
        return self._order(alarm_id, by, comment, AlarmEngine.clear)

    def shelve(self, alarm_id: int, by: str, comment: str, until_us: int) -> Alarm:
        """Keep an alarm quiet until an instant; InvalidInputError ``alarm.shelve_until``."""

        def shelve(engine: AlarmEngine, key: Key, handling: Handling) -> AlarmChange:
            if not handling.at_us < until_us <= handling.at_us + SHELVE_LIMIT_US:
                detail = "until must lie ahead of the spacecraft's clock by at most 24 h"
                field = FieldError("/until", "alarm.shelve_until", detail)
                raise InvalidInputError("alarm.shelve_until", detail, (field,))
            return engine.shelve(key, handling, until_us)

        return self._order(alarm_id, by, comment, shelve)

    def unshelve(self, alarm_id: int, by: str, comment: str) -> Alarm:
        """End a shelving before its time; ConflictError ``alarm.not_shelved``."""

        def unshelve(engine: AlarmEngine, key: Key, handling: Handling) -> AlarmChange:
            if engine.open_alarms[key].state != "shelved":
                raise ConflictError("alarm.not_shelved", f"alarm {alarm_id} is not shelved")
            return engine.unshelve(key, handling)

        return self._order(alarm_id, by, comment, unshelve)

    def put_limits(self, spacecraft_id: str, limits: AlarmLimits) -> AlarmLimits:
        """Store limits as the next version and hold values against them."""
        with self._lock:
            stored = self._storage.alarms.put_limits(spacecraft_id, limits)
            if not self._is_on_duty(spacecraft_id):
                return stored
            with self._guarded(spacecraft_id):
                self._report(self._persisted(spacecraft_id).use_limits(stored, self._now_us(spacecraft_id)))
        return stored

    def sets_in_force(self, spacecraft_id: str) -> tuple[str, ...]:
        """Return the limit sets in force, as the newest row found them."""
        with self._lock:
            self._is_on_duty(spacecraft_id)
            return self._persisted(spacecraft_id).engine.context.sets

    def present_value(self, alarm: Alarm) -> tuple[float, int | None]:
        """Return the newest value behind an open alarm and its epoch, NaN and None where none is known."""
        persisted = self._persisted_by_id.get(alarm.spacecraft_id)
        return (float("nan"), None) if persisted is None else persisted.engine.present_value(alarm.key)

    def _order(
        self, alarm_id: int, by: str, comment: str, carry_out: Callable[[AlarmEngine, Key, Handling], AlarmChange]
    ) -> Alarm:
        """Carry out an operator's order; stored when this returns."""
        with self._lock:
            stored = self._storage.alarms.alarm(alarm_id)
            if not self._is_on_duty(stored.spacecraft_id):
                raise elsewhere(self._storage.leases, stored.spacecraft_id or ARCHIVE)
            persisted = self._persisted(stored.spacecraft_id)
            # what could not be stored before goes first; where it still cannot, nothing has been touched
            self._report(persisted.store(()))
            present = persisted.engine.open_alarms.get(stored.key)
            if present is None or present.id != alarm_id:
                raise ConflictError("alarm.closed", f"alarm {alarm_id} is closed")
            change = carry_out(persisted.engine, stored.key, Handling(by, self._now_us(stored.spacecraft_id), comment))
            try:
                saved = persisted.store((change,))
            except StorageError:
                # the archive knows best what holds
                self._persisted_by_id.pop(stored.spacecraft_id, None)
                raise
            self._report(saved)
            return saved[-1].alarm

    def _run(self) -> None:
        """Check alarms until stopped, and once more then."""
        next_check_s = time.monotonic()
        while not self._is_stopping:
            self._arrived.wait(max(0.0, next_check_s - time.monotonic()))
            self._arrived.clear()
            self._check_rows()
            if time.monotonic() >= next_check_s:
                self._check_clock()
                next_check_s = time.monotonic() + self._check_period_s
        self._check_rows()
        self._check_clock()

    def _check_rows(self) -> None:
        with self._lock:
            while self._queue:
                spacecraft_id, seen = self._queue.popleft()
                if not self._is_on_duty(spacecraft_id):
                    continue
                with self._guarded(spacecraft_id):
                    persisted = self._persisted(spacecraft_id)
                    if isinstance(seen, RowEvidence):
                        changes = persisted.reader.read_row(seen)
                    else:
                        changes = persisted.reader.read_reference(seen)
                    if changes:
                        self._report(persisted.store(changes))

    def _check_clock(self) -> None:
        """Check the conditions that depend on the clock, and store the memory of the alarm engine."""
        is_thorough = self._polls % _CHECKS_A_POLL == 0
        self._polls += 1
        with self._lock:
            with self._guarded(None):
                stored = StoredFacts.read(self._storage)
                for spacecraft in self._storage.catalogue.all_spacecraft():
                    if self._is_on_duty(spacecraft.id) and (head := stored.heads.get(spacecraft.id)) is not None:
                        with self._guarded(spacecraft.id):
                            now_us = self._clock.reading(spacecraft, head.newest_epoch_us).now_us
                            self._check_spacecraft(spacecraft.id, now_us, stored, is_thorough=is_thorough)
            if not self._is_on_duty(None):
                return
            with self._guarded(None):
                readings = self._checks.of_service(self._clock.system_us()) if is_thorough else iter(())
                self._check(self._persisted(None), readings, self._clock.system_us())

    def _check_spacecraft(
        self, spacecraft_id: str, now_us: int | None, stored: StoredFacts, *, is_thorough: bool
    ) -> None:
        """Check one spacecraft by its clock, the estimator alone where it has no row and therefore no present yet."""
        persisted = self._persisted(spacecraft_id)
        readings = [self._checks.of_estimator(spacecraft_id), self._checks.of_telemetry(spacecraft_id, stored)]
        families = []
        if now_us is not None:
            families.append(self._checks.of_inputs(spacecraft_id, persisted.reader, now_us, stored))
            version = stored.release_versions.get(spacecraft_id, 0)
            families.append(self._checks.of_release(spacecraft_id, now_us, version))
            if is_thorough:
                families.append(self._checks.of_foundations(spacecraft_id, now_us))
        for family in families:
            # a family that fails keeps no other from being checked; an archive that is away ends the check
            with self._unless_away(spacecraft_id):
                readings += family
        self._check(persisted, readings, self._clock.system_us() if now_us is None else now_us)

    def _check(self, persisted: PersistedAlarms, readings: Iterable[Readings], now_us: int) -> None:
        """Hold readings of the clock against the limits, let time pass, and keep what is about to happen."""
        changes: list[AlarmChange] = []
        for each in readings:
            changes += persisted.engine.observe(each, now_us)
        changes += persisted.engine.pass_time(now_us)
        self._report(persisted.store(changes))
        persisted.keep_memory()

    def _report(self, changes: Sequence[AlarmChange]) -> None:
        """Publish stored changes and tell them outside."""
        if changes:
            self._is_failing = False
        for change in changes:
            event = FeedEvent("alarm", Cursor(0, 0, change.sequence), change)
            about = change.alarm.spacecraft_id
            for spacecraft_id in (
                [name for name in self._persisted_by_id if name is not None] if about is None else [about]
            ):
                self._feed.publish(spacecraft_id, (event,))
            for channel in self.channels:
                channel.offer(change)

    def _is_on_duty(self, spacecraft_id: str | None) -> bool:
        """Return whether this service leads a spacecraft; what another may have changed meanwhile is read again."""
        turn = self._turn(spacecraft_id or ARCHIVE)
        if turn == 0 or turn != self._served_turns.get(spacecraft_id):
            self._persisted_by_id.pop(spacecraft_id, None)
            self._served_turns[spacecraft_id] = turn
        return turn > 0

    def _persisted(self, spacecraft_id: str | None) -> PersistedAlarms:
        """Return the alarms of a spacecraft, from the archive where they are not at hand."""
        persisted = self._persisted_by_id.get(spacecraft_id)
        if persisted is None:
            persisted = self._persisted_by_id[spacecraft_id] = PersistedAlarms(
                self._storage.alarms, spacecraft_id, self.conditions
            )
        return persisted

    def _now_us(self, spacecraft_id: str | None) -> int:
        """Return the present of a spacecraft, that of the system where it has none."""
        now_us = None if spacecraft_id is None else self._clock.now_us(spacecraft_id)
        return self._clock.system_us() if now_us is None else now_us

    @contextmanager
    def _unless_away(self, spacecraft_id: str) -> Iterator[None]:
        """Go on after any error but that of an archive that does not answer."""
        try:
            yield
        except Exception as error:
            if isinstance(error, StorageError) and error.code != "storage.corrupt":
                raise
            _LOG.error("some alarms of %s are not checked: %s: %s", spacecraft_id, type(error).__name__, error)

    @contextmanager
    def _guarded(self, spacecraft_id: str | None) -> Iterator[None]:
        """Go on after a fault: changes wait while the archive is away; after any other fault it is read again."""
        try:
            yield
        except StorageError as error:
            if not self._is_failing:
                _LOG.error("alarms of %s cannot be stored, will retry: %s", spacecraft_id or "the service", error)
            self._is_failing = True
        except Exception:  # noqa: BLE001 the alarm service outlives every error; the archive holds its state
            _LOG.exception(
                "alarm check of %s failed; its alarms are reloaded from the archive", spacecraft_id or "the service"
            )
            self._persisted_by_id.pop(spacecraft_id, None)
