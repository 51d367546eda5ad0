"""Live feed: bounded fan-out of what the service accepted and computed.

A subscriber has a queue of its own. One that does not keep up loses the oldest events and is told how many; it never
slows the estimator or other subscribers. Events carry a cursor from which a stream resumes: the archive holds all
that was published, so nothing is lost by a reconnect.
"""

import asyncio
import threading
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from service.records.attitude import AttitudeRow
from service.records.command import TorqueCommand
from service.records.measurement import Measurement


class Cursor(NamedTuple):
    """Place in a live stream: the newest journal number of a measurement and the newest result sequence sent."""

    number: int
    sequence: int


@dataclass(frozen=True, slots=True)
class FeedEvent:
    """One event of one spacecraft."""

    #: measurement, attitude, torque or status
    kind: str
    cursor: Cursor
    content: Measurement | AttitudeRow | TorqueCommand | None


class Subscription:
    """One subscriber's bounded queue; made by LiveFeed.subscribe inside a running event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        self._loop = loop
        self._events: deque[FeedEvent] = deque()
        self._capacity = capacity
        self._arrived = asyncio.Event()
        self._missed = 0

    def offer(self, events: tuple[FeedEvent, ...]) -> None:
        """Hand over events from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._take, events)

    def _take(self, events: tuple[FeedEvent, ...]) -> None:
        """Queue events in the subscriber's own loop; drop the oldest when full."""
        self._events.extend(events)
        while len(self._events) > self._capacity:
            self._events.popleft()
            self._missed += 1
        self._arrived.set()

    async def next_events(self, timeout_s: float) -> tuple[tuple[FeedEvent, ...], int]:
        """Return the queued events and how many were lost before them; nothing after the timeout."""
        if not self._events:
            self._arrived.clear()
            try:
                await asyncio.wait_for(self._arrived.wait(), timeout_s)
            except TimeoutError:
                return (), 0
        events, missed = tuple(self._events), self._missed
        self._events.clear()
        self._missed = 0
        return events, missed


class LiveFeed:
    """Fan-out of events, by spacecraft.

    Parameters
    ----------
    capacity : int
        Events that one slow subscriber may hold.
    """

    def __init__(self, capacity: int = 10_000) -> None:
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
        """Hand events to every subscriber of a spacecraft; called from the supervisor's thread."""
        with self._lock:
            subscribers = tuple(self._subscribers.get(spacecraft_id, ()))
        for subscription in subscribers:
            subscription.offer(events)
