"""Live stream of one spacecraft: server-sent events that resume without loss and without doubling."""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Collection, Sequence
from http import HTTPStatus
from typing import Any

from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from service.api.context import ApiContext, CarrierNameCache
from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError
from service.api.schemas.shift import StatusAnswer
from service.api.stream.events import (
    EVENT_NAMES,
    READERS,
    ArchiveReader,
    DroppedAnswer,
    EventTexts,
    PresentRecords,
    advanced,
    beyond_the_archive,
    event_id,
    missed_by_slowness,
)
from service.errors import StorageError
from service.records.levels.measurement import Measurement
from service.runtime.live.live_feed import Cursor, DroppedRows, FeedEvent, Subscription


class OpenStreams:
    """Subscriptions being read; used inside the server's event loop.

    Parameters
    ----------
    limit : int
        Most streams at once.
    """

    def __init__(self, limit: int = 500) -> None:
        self._subscriptions: set[Subscription] = set()
        #: streams that are open or about to be
        self._positions = 0
        self._limit = limit
        self._is_closed = False
        #: events sent since the start of the process, by kind
        self.sent: Counter[str] = Counter()
        #: events that clients were too slow for
        self.dropped = 0

    @property
    def is_closed(self) -> bool:
        """Return whether streams are to end."""
        return self._is_closed

    @property
    def count(self) -> int:
        """How many streams are open."""
        return self._positions

    def acquire(self) -> None:
        """Count a stream that is about to open, or raise the 503 that refuses one too many."""
        if self.count >= self._limit:
            detail = f"{self.count} streams are open, the service gives {self._limit}"
            headers = {"Retry-After": str(RETRY_AFTER_S)}
            raise RequestProblemError(HTTPStatus.SERVICE_UNAVAILABLE, "stream.too_many", detail, headers=headers)
        self._positions += 1

    def leave(self) -> None:
        """Give a place back."""
        self._positions -= 1

    def add(self, subscription: Subscription) -> None:
        """Remember a subscription, to wake its stream at the end."""
        self._subscriptions.add(subscription)

    def discard(self, subscription: Subscription) -> None:
        """Forget a subscription whose stream has ended."""
        self._subscriptions.discard(subscription)

    def close(self) -> None:
        """End all streams; each wakes up and sees it."""
        self._is_closed = True
        for subscription in tuple(self._subscriptions):
            subscription.wake()


_LOG = logging.getLogger(__name__)
#: events encoded before other connections get their turn
_EVENTS_AT_ONCE = 50
#: a client waits so long before it connects again
_RETRY_MS = 2000
#: streams that look for a changed state at about the same time share one look
_STATUS_SHARED_S = 1.0


class StreamParts:
    """Shared parts of the streams of one application.

    Parameters
    ----------
    context : ApiContext
        Archive, results and feed.
    names : CarrierNameCache
        Carriers of the plans.
    streams : OpenStreams
        Open streams, and the stop of the service.
    """

    def __init__(self, context: ApiContext, names: CarrierNameCache, streams: OpenStreams) -> None:
        self.context = context
        self.names = names
        self.streams = streams
        self.texts = EventTexts(names)
        self.present = PresentRecords(context)


class EventStream:
    """One client's stream; ``chunks`` is read once.

    Parameters
    ----------
    parts : StreamParts
        Shared parts of all streams.
    spacecraft_id : str
        An existing spacecraft.
    resume : Cursor or None
        Position of the client; None: it starts with the present.
    wanted : collection of str
        Kinds of events that the client chose.
    """

    def __init__(
        self,
        parts: StreamParts,
        spacecraft_id: str,
        resume: Cursor | None,
        wanted: Collection[str] = EVENT_NAMES,
    ) -> None:
        self._parts = parts
        self._streams = parts.streams
        self._spacecraft_id = spacecraft_id
        self._resume = resume
        self._position = Cursor(0, 0)
        self._reader = ArchiveReader(parts.context.storage, parts.names, spacecraft_id)
        self._wanted = frozenset(wanted)
        self._reported_status: StatusAnswer | None = None
        #: marks of the records of each kind by id, as of the last look
        self._marks: dict[str, dict[Any, bytes]] = {}
        self._sent_position: Cursor | None = None

    async def chunks(self) -> AsyncIterator[bytes]:
        """Yield the stream until the client goes or the service stops."""
        feed = self._parts.context.feed
        subscription = feed.subscribe(self._spacecraft_id)
        self._streams.add(subscription)
        try:
            async for chunk in self._events(subscription):
                # an empty chunk would end the body
                if chunk:
                    yield chunk
        except StorageError as error:
            # the client comes back with the last id it got
            _LOG.warning("stream of %s closed, the archive cannot be read: %s", self._spacecraft_id, error)
        finally:
            self._streams.discard(subscription)
            feed.unsubscribe(self._spacecraft_id, subscription)

    async def _events(self, subscription: Subscription) -> AsyncIterator[bytes]:
        """Yield the status, what was missed, then what comes."""
        loop = asyncio.get_running_loop()
        present, end = await run_in_threadpool(self._reader.present_and_end)
        # an id beyond the archive's end comes from before it was set back to a backup; the present is all we know
        is_known = self._resume is not None and all(at <= last for at, last in zip(self._resume, end, strict=True))
        self._position = self._resume if self._resume is not None and is_known else present
        yield f"retry: {_RETRY_MS}\n\n".encode() + await self._changed(loop.time()) + self._id_alone()
        if self._resume is not None and not is_known:
            yield self._dropped(beyond_the_archive())
        async for chunk in self._missed():
            yield chunk
        heartbeat_s = self._parts.context.limits.stream_heartbeat_s
        beat = loop.time() + heartbeat_s
        while not self._streams.is_closed:
            events, dropped = await subscription.next_events(max(0.0, beat - loop.time()))
            async for chunk in self._fresh(events, dropped):
                yield chunk
            if loop.time() >= beat:
                beat = loop.time() + heartbeat_s
                changed = await self._changed(loop.time() - min(_STATUS_SHARED_S, heartbeat_s))
                yield b": heartbeat\n\n" + changed + self._id_alone()

    async def _fresh(self, events: Sequence[FeedEvent], dropped: DroppedRows) -> AsyncIterator[bytes]:
        """Yield queued events that were not sent yet."""
        taken_s = asyncio.get_running_loop().time()
        if dropped:
            self._streams.dropped += sum(dropped.counts.values())
            missed = missed_by_slowness(self._spacecraft_id, dropped, self._wanted)
            if missed.counts:
                yield self._dropped(missed)
        if dropped or self._has_hole(events):
            async for chunk in self._missed():
                yield chunk
        await self._update_plans(events)
        async for chunk in self._sent(events):
            yield chunk
        if any(event.content is None for event in events):
            yield await self._changed(taken_s)

    def _has_hole(self, events: Sequence[FeedEvent]) -> bool:
        """Return whether the next results do not follow those sent, or are in the archive only."""
        sequence = self._position.sequence
        for event in events:
            if event.cursor.sequence <= sequence or event.kind in {"measurement", "alarm"}:
                continue
            if event.content is None or event.cursor.sequence != sequence + 1:
                return True
            sequence = event.cursor.sequence
        return False

    async def _missed(self) -> AsyncIterator[bytes]:
        """Yield the events of the archive after the position, page by page."""
        while not self._streams.is_closed:
            page = await run_in_threadpool(self._reader.next_page, self._position)
            if page.lost is not None:
                yield self._dropped(page.lost)
            async for chunk in self._sent(page.events):
                yield chunk
            if page.position == self._position and not page.events:
                return
            self._position = page.position

    async def _sent(self, events: Sequence[FeedEvent]) -> AsyncIterator[bytes]:
        """Yield events as they are sent, a few at a time so that other connections get their turn."""
        for start in range(0, len(events), _EVENTS_AT_ONCE):
            if start:
                await asyncio.sleep(0)
            yield b"".join(self._reported(event) for event in events[start : start + _EVENTS_AT_ONCE])

    def _reported(self, event: FeedEvent) -> bytes:
        """Return an event as it is sent and move the place beyond it; nothing for one that was sent already."""
        position = advanced(self._position, event)
        if position is None:
            return b""
        self._position = position
        if event.content is None or event.kind not in self._wanted:
            return b""
        return self._event(event.kind, self._parts.texts.of(self._spacecraft_id, event))

    async def _update_plans(self, events: Sequence[FeedEvent]) -> None:
        """Look up plans that rows name for the first time, outside the event loop."""
        names = self._parts.names
        rows = [event.content for event in events if isinstance(event.content, Measurement)]
        carriers = [event.carriers for event in events if event.carriers is not None]
        for plan_id in {row.plan_id for row in rows} | {each.plan_id for each in carriers}:
            if not names.knows(self._spacecraft_id, plan_id):
                await run_in_threadpool(names.of, self._spacecraft_id, plan_id)

    async def _changed(self, since_s: float) -> bytes:
        """Return what has changed since the last look, as it was at an instant of the loop's clock or later."""
        events = [await self._changed_status(since_s)] if "status" in self._wanted else []
        # in the order of the table: a client finds the same one each time
        events += [await self._changed_records(kind, since_s) for kind in READERS if kind in self._wanted]
        return b"".join(events)

    async def _changed_status(self, since_s: float) -> bytes:
        """Return the status event when more than the time of day has changed, otherwise nothing."""
        former = self._reported_status
        status = await self._parts.present.status(self._spacecraft_id, since_s)
        if former is not None and former.model_copy(update={"now": status.now}) == status:
            return b""
        self._reported_status = status
        return self._event("status", _json(status))

    async def _changed_records(self, kind: str, since_s: float) -> bytes:
        """Return an event for each record of a kind that is new or another than at the last look; at the first, none.

        A client that begins reads the lists, of which a stream would give the newest only.
        """
        present = await self._parts.present.records(self._spacecraft_id, kind, since_s)
        former = self._marks.get(kind)
        self._marks[kind] = {name: record.mark for name, record in present.items()}
        if former is None:
            return b""
        changed = (record.text for name, record in present.items() if former.get(name) != record.mark)
        return b"".join(self._event(kind, text) for text in changed)

    def _id_alone(self) -> bytes:
        """Return the id alone where it has moved by events that the client did not choose, so that it can resume."""
        if self._position == self._sent_position:
            return b""
        self._sent_position = self._position
        return f"id: {event_id(self._spacecraft_id, self._position)}\n\n".encode()

    def _dropped(self, answer: DroppedAnswer) -> bytes:
        """Return the event that tells of events which did not come."""
        return self._event("dropped", _json(answer))

    def _event(self, kind: str, data: bytes) -> bytes:
        self._streams.sent[kind] += 1
        self._sent_position = self._position
        head = f"id: {event_id(self._spacecraft_id, self._position)}\nevent: {kind}\ndata: "
        return b"".join((head.encode(), data, b"\n\n"))


def _json(document: BaseModel) -> bytes:
    return document.model_dump_json().encode()
