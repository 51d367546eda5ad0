"""Live feed: rows and events to those who follow, also from the process that computes them."""

import asyncio
import threading
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple, Protocol

import numpy as np

from service.pipeline.control.release.events import StoredRow
from service.pipeline.estimation.method import RowEvidence
from service.ports.storage import Storage
from service.records.inputs import AttitudeReference, JournalEntry
from service.records.levels.attitude import AttitudeRow, CarrierResults, TorqueCommand
from service.records.levels.measurement import BatchReceipt, CarrierDetails, HeadState, Measurement, MeasurementBatch
from service.records.operations.alarms import AlarmChange

#: what an event may tell; None: something is to be looked up
Content = Measurement | AttitudeRow | TorqueCommand | AlarmChange | None


class Cursor(NamedTuple):
    """Place in a live stream: the newest journal number, result sequence and alarm sequence that were sent."""

    number: int
    sequence: int
    alarm: int = 0


@dataclass(frozen=True, slots=True)
class FeedEvent:
    """One event of one spacecraft."""

    #: measurement, attitude, torque, alarm or status
    kind: str
    #: of an alarm's event only ``alarm`` counts
    cursor: Cursor
    content: Content
    #: of an attitude row what its method makes of the carriers
    carriers: CarrierResults | None = field(default=None, compare=False)

    @property
    def at_us(self) -> int | None:
        """Instant that the event is about."""
        return getattr(self.content, "epoch_us", None)


@dataclass(slots=True)
class DroppedRows:
    """Rows dropped from the full queue of a slow subscriber."""

    #: by kind of event
    counts: Counter[str] = field(default_factory=Counter)
    #: least and greatest epoch among them, microseconds UTC
    first_us: int | None = None
    last_us: int | None = None

    def __bool__(self) -> bool:
        return bool(self.counts)

    def add(self, event: FeedEvent) -> None:
        """Count one event."""
        self.counts[event.kind] += 1
        at_us = event.at_us
        if at_us is not None:
            self.first_us = at_us if self.first_us is None else min(self.first_us, at_us)
            self.last_us = at_us if self.last_us is None else max(self.last_us, at_us)


class Subscription:
    """One subscriber's bounded queue; made by LiveFeed.subscribe inside a running event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        self.loop = loop
        self._events: deque[FeedEvent] = deque()
        self._capacity = capacity
        self._arrived = asyncio.Event()
        self._dropped = DroppedRows()

    def consume(self, events: Sequence[FeedEvent]) -> None:
        """Queue events in the subscriber's own loop; drop the oldest when full."""
        self._events.extend(events)
        while len(self._events) > self._capacity:
            self._dropped.add(self._events.popleft())
        self._arrived.set()

    def wake(self) -> None:
        """Let the reader look around, in the subscriber's own loop."""
        self._arrived.set()

    async def next_events(self, timeout_s: float) -> tuple[tuple[FeedEvent, ...], DroppedRows]:
        """Return the queued events and what was lost before them; nothing after the timeout."""
        if not self._events:
            self._arrived.clear()
            try:
                async with asyncio.timeout(timeout_s):
                    await self._arrived.wait()
            except TimeoutError:
                return (), DroppedRows()
        events, dropped = tuple(self._events), self._dropped
        self._events.clear()
        self._dropped = DroppedRows()
        return events, dropped


#: subscribers woken in one turn of the loop: requests that come meanwhile wait for these, not for all
_READERS_A_TURN = 8


class LiveFeed:
    """Fan-out of events, by spacecraft.

    Parameters
    ----------
    capacity : int
        Events that one slow subscriber may hold; all subscribers share the events themselves.
    """

    def __init__(self, capacity: int = 2_000) -> None:
        self._capacity = capacity
        self._lock = threading.Lock()
        self._subscribers: dict[str, set[Subscription]] = {}
        #: subscribers that get events in the next turns of their loop; each is used inside its loop alone
        self._deliveries: dict[
            asyncio.AbstractEventLoop, deque[tuple[Sequence[Subscription], Sequence[FeedEvent]]]
        ] = {}

    def subscribe(self, spacecraft_id: str) -> Subscription:
        """Return a new subscription; call inside the event loop that will read it."""
        subscription = Subscription(asyncio.get_running_loop(), self._capacity)
        with self._lock:
            self._subscribers.setdefault(spacecraft_id, set()).add(subscription)
        return subscription

    def unsubscribe(self, spacecraft_id: str, subscription: Subscription) -> None:
        """Forget a subscription."""
        with self._lock:
            self._subscribers.get(spacecraft_id, set()).discard(subscription)

    def has_subscribers(self, spacecraft_id: str) -> bool:
        """Return whether anybody listens.

        Who subscribes after this was False finds in the archive what had been stored before it was asked.
        """
        with self._lock:
            return bool(self._subscribers.get(spacecraft_id))

    def publish(self, spacecraft_id: str, events: tuple[FeedEvent, ...]) -> None:
        """Hand events to every subscriber of a spacecraft; called from any thread, after they were stored."""
        with self._lock:
            subscribers = tuple(self._subscribers.get(spacecraft_id, ()))
        by_loop: dict[asyncio.AbstractEventLoop, list[Subscription]] = {}
        for subscription in subscribers:
            by_loop.setdefault(subscription.loop, []).append(subscription)
        for loop, readers in by_loop.items():
            # one call a loop, not one a reader: each wakes the loop
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._deliver, loop, readers, events)

    def _deliver(
        self, loop: asyncio.AbstractEventLoop, readers: Sequence[Subscription], events: Sequence[FeedEvent]
    ) -> None:
        """Give events to subscribers inside their loop, behind those that are still being given."""
        is_idle = loop not in self._deliveries
        queue = self._deliveries.setdefault(loop, deque())
        queue.extend((readers[k : k + _READERS_A_TURN], events) for k in range(0, len(readers), _READERS_A_TURN))
        if is_idle:
            self._hand_over(loop)

    def _hand_over(self, loop: asyncio.AbstractEventLoop) -> None:
        """Give events to the next few subscribers, and let the loop turn before those after them."""
        queue = self._deliveries[loop]
        readers, events = queue.popleft()
        for reader in readers:
            reader.consume(events)
        if queue:
            loop.call_soon(self._hand_over, loop)
        else:
            del self._deliveries[loop]


#: entries and changes read in one go
_AT_ONCE = 256


class Relay:
    """Follower of the stored rows of each spacecraft.

    Parameters
    ----------
    storage : Storage
        The archive.
    feed : LiveFeed
        Where it is told.
    """

    def __init__(self, storage: Storage, feed: LiveFeed) -> None:
        self._storage = storage
        self._feed = feed
        self._positions: dict[str, Cursor] = {}

    def forget(self, spacecraft_id: str) -> None:
        """Begin with the present when it is needed again."""
        self._positions.pop(spacecraft_id, None)

    def behind(self, heads: Mapping[str, HeadState]) -> set[str]:
        """Return the spacecraft with subscribers of which something may have been stored since their last poll."""
        alarm = self._storage.alarms.newest_sequence()
        present = {name: Cursor(head.newest_number, head.result_sequence, alarm) for name, head in heads.items()}
        # who subscribes from here on finds in the archive what was stored up to this present
        quiet = {name for name in present if not self._feed.has_subscribers(name)}
        self._positions |= {name: present[name] for name in quiet}
        return {name for name in present.keys() - quiet if self._positions.get(name) != present[name]}

    def poll(self, spacecraft_id: str) -> None:
        """Publish the entries since the last poll."""
        present = self._present(spacecraft_id)
        position = self._positions.setdefault(spacecraft_id, present)
        # who subscribes from here on finds in the archive what was stored up to this present
        if not self._feed.has_subscribers(spacecraft_id):
            self._positions[spacecraft_id] = present
            return
        while events := self._events(spacecraft_id, position):
            position = self._positions[spacecraft_id] = events[-1].cursor
            self._feed.publish(spacecraft_id, tuple(events))

    def _present(self, spacecraft_id: str) -> Cursor:
        head = self._storage.archive.head(spacecraft_id)
        return Cursor(head.newest_number, head.result_sequence, self._storage.alarms.newest_sequence())

    def _events(self, spacecraft_id: str, position: Cursor) -> list[FeedEvent]:
        """Return the next events; the last one stands where all that was read ends."""
        entries = self._storage.archive.journal(spacecraft_id, position.number, _AT_ONCE)
        rows = [entry.content for entry in entries if isinstance(entry.content, Measurement)]
        events = [FeedEvent("measurement", position._replace(number=row.number), row) for row in rows]
        changes = self._storage.alarms.changes_after(spacecraft_id, position.alarm, _AT_ONCE)
        events += [FeedEvent("alarm", position._replace(alarm=change.sequence), change) for change in changes]
        sequence = self._storage.archive.head(spacecraft_id).result_sequence
        end = Cursor(
            entries[-1].number if entries else position.number,
            sequence,
            changes[-1].sequence if changes else position.alarm,
        )
        return [] if end == position else [*events, FeedEvent("status", end, None)]


#: rows of a batch that the writer tells of; more are a backlog, for which the writer has no time
_ROWS_AT_ONCE = 16


#: journal numbers of one spacecraft, 200 bytes a row at 32 carriers; fewer would not outlast a stop of a second
_MOST_ROWS = 16_384


class _Stored(NamedTuple):
    """A batch that was stored as a whole."""

    first: int
    last: int
    batch: MeasurementBatch
    receipt: BatchReceipt
    #: built already for a listener
    rows: tuple[Measurement, ...] | None


class CommittedRows:
    """Rows as they are committed, for listeners and for the chain that follows; safe from any thread.

    Parameters
    ----------
    feed : LiveFeed
        Listeners.
    """

    def __init__(self, feed: LiveFeed) -> None:
        self._feed = feed
        self._lock = Lock()
        #: journal number up to which all is told, or was in the archive before anybody could listen
        self._reported: dict[str, int] = {}
        #: newest batches of each spacecraft
        self._batches: defaultdict[str, deque[_Stored]] = defaultdict(deque)

    def begin(self, spacecraft_id: str, number: int) -> None:
        """Start publishing the rows of a journal after a number."""
        with self._lock:
            self._reported[spacecraft_id] = max(number, self._reported.get(spacecraft_id, 0))

    def stored(self, batch: MeasurementBatch, receipt: BatchReceipt) -> None:
        """Keep a batch that was committed just now, and publish it if it comes next; called in the order of commits.

        Only one that was stored as it came: so it is known what became of each row.
        """
        first, name = receipt.first_number, batch.spacecraft_id
        if first is None or receipt.accepted != len(batch.index) or receipt.flagged or receipt.accepted > _MOST_ROWS:
            return
        last, rows = first + receipt.accepted - 1, None
        with self._lock:
            if receipt.accepted <= _ROWS_AT_ONCE and self._reported.get(name) == first - 1:
                self._reported[name] = last
                # who subscribes from here on finds the rows in the archive
                if self._feed.has_subscribers(name):
                    rows = tuple(stored_rows(batch, receipt))
                    self._publish(name, rows)
            batches = self._batches[name]
            batches.append(_Stored(first, last, batch, receipt, rows))
            while last - batches[0].first >= _MOST_ROWS:
                batches.popleft()

    def followed(self, spacecraft_id: str, entries: Sequence[JournalEntry]) -> None:
        """Publish those rows among the next entries of a journal that were not published yet."""
        with self._lock:
            reported = self._reported.get(spacecraft_id, 0)
            self._reported[spacecraft_id] = max(reported, entries[-1].number)
            if self._feed.has_subscribers(spacecraft_id):
                rows = (entry.content for entry in entries if entry.number > reported)
                self._publish(spacecraft_id, tuple(row for row in rows if isinstance(row, Measurement)))

    def after(self, spacecraft_id: str, number: int, limit: int) -> list[JournalEntry]:
        """Return some entries that follow a journal number without gap, none where they are not here.

        What is given is no longer kept. A batch more than ``limit`` entries may come, never a part of one.
        """
        taken: list[_Stored] = []
        reached = number
        with self._lock:
            batches = self._batches[spacecraft_id]
            while batches and batches[0].last <= number:
                batches.popleft()
            while batches and reached < number + limit and batches[0].first <= reached + 1:
                taken.append(batches.popleft())
                reached = taken[-1].last
        rows = (row for each in taken for row in each.rows or stored_rows(each.batch, each.receipt))
        return [JournalEntry(row.number, row) for row in rows if row.number > number]

    def _publish(self, spacecraft_id: str, rows: Sequence[Measurement]) -> None:
        # a row moves the first part of a listener's place alone
        events = tuple(FeedEvent("measurement", Cursor(row.number, 0), row) for row in rows)
        if events:
            self._feed.publish(spacecraft_id, events)


def stored_rows(batch: MeasurementBatch, receipt: BatchReceipt) -> Iterator[Measurement]:
    """Yield the rows of a batch that was stored as a whole, as the archive gives them."""
    power_dbm = batch.power_dbm.astype(np.float32).astype(np.float64)
    power_dbm.setflags(write=False)
    is_late = [receipt.late > 0] * len(batch.index) if receipt.is_late is None else receipt.is_late.tolist()
    for position in range(len(batch.index)):
        given = batch.flags[position]
        flags = None if given is None else np.array(given, dtype=np.int64)
        if flags is not None:
            flags.setflags(write=False)
        yield Measurement(
            epoch_us=int(batch.epochs_us[position]),
            received_at_us=batch.received_at_us,
            number=(receipt.first_number or 0) + position,
            source=batch.source,
            plan_id=batch.plan_id,
            power_dbm=power_dbm[position],
            flags=flags,
            is_late=is_late[position],
            feeds_estimator=receipt.feeds_estimator,
            seq=None if batch.first_seq is None else batch.first_seq + int(batch.index[position]),
            details=_details(batch.details, position),
            key_id=None if batch.sender is None else batch.sender.key_id,
            station=None if batch.sender is None else batch.sender.station,
        )


def _details(details: CarrierDetails | None, position: int) -> CarrierDetails | None:
    """Return the details of a row beside its powers, None where it has none."""
    if details is None:
        return None
    statistics = details.row(position).astype(np.float64)
    statistics.setflags(write=False)
    return None if np.isnan(statistics).all() else CarrierDetails(*statistics)


#: what alarms look at
Seen = RowEvidence | AttitudeReference


class Watcher(Protocol):
    """Watcher of stored results; it must not make the chain wait."""

    def on_rows(self, spacecraft_id: str, seen: Sequence[Seen]) -> None:
        """Take over rows that are neither late nor caught up with, and references, in the order of the journal."""


class ReleaseWatcher(Protocol):
    """Watcher of stored rows on which control depends."""

    def on_rows(self, spacecraft_id: str, seen: Sequence[StoredRow], *, has_inputs: bool = False) -> None:
        """Take over what was computed, and whether inputs other than rows came in; nothing is raised."""

    def steady(self, spacecraft_id: str) -> AbstractContextManager[bool]:
        """Let nobody trip control meanwhile; tell whether torques are withheld."""
