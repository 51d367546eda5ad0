"""Live feed: bounded fan-out of what the service accepted and computed.

A subscriber has a queue of its own. One that does not keep up loses the oldest events and is told how many of each
kind; it never slows the estimator or other subscribers. Events carry a cursor from which a stream resumes: the archive
holds all that was published, so nothing is lost by a reconnect.
"""

import asyncio
import threading
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from service.records.levels.attitude import AttitudeRow
from service.records.levels.carrier_results import CarrierResults
from service.records.levels.command import TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.alarm import AlarmChange

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
                loop.call_soon_threadsafe(_hand_over, readers, events)


def _hand_over(readers: Sequence[Subscription], events: Sequence[FeedEvent]) -> None:
    """Give events to subscribers inside their loop."""
    for reader in readers:
        reader.consume(events)
