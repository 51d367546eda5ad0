"""Live stream of one spacecraft: server-sent events that resume without loss and without doubling.

Every event has the id ``<number>.<sequence>``: all measurements up to that journal number and all results up to that
sequence were sent. A stream subscribes first, then reads from the archive what it missed, then drops queued events at
or below what was sent. A client too slow for its queue is told how many events were dropped and gets them from the
archive, so that a stream may lag but has no hole.
"""

import asyncio
import logging
import re
from collections.abc import AsyncIterator, Sequence

from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from service.api.carrier_names import CarrierNames
from service.api.deps import ApiContext
from service.api.open_streams import OpenStreams
from service.api.problems import invalid_request
from service.api.schemas.attitude import AttitudeAnswer
from service.api.schemas.base import Answer
from service.api.schemas.measurement_rows import MeasurementAnswer
from service.api.schemas.status import StatusAnswer
from service.api.schemas.torques import TorqueAnswer
from service.api.status import status_of
from service.errors import FieldError, StorageError
from service.ports import LIVE
from service.records.attitude import AttitudeRow
from service.records.command import TorqueCommand
from service.records.measurement import Measurement
from service.runtime.live_feed import Cursor, FeedEvent, Subscription

_LOG = logging.getLogger(__name__)
_EVENT_ID = re.compile(r"(\d{1,18})\.(\d{1,18})", re.ASCII)
#: journal entries and results read from the archive in one go
_ENTRIES_AT_ONCE = 200
#: events encoded before other connections get their turn
_EVENTS_AT_ONCE = 50
#: a client waits so long before it connects again
_RETRY_MS = 2000


class MissedAnswer(Answer):
    """A client did not keep up; what its queue dropped follows from the archive."""

    count: int


def cursor_of(event_id: str | None) -> Cursor | None:
    """Return the place after which a client goes on; 422 for an id that no stream gave, None without one."""
    if not event_id:
        return None
    match = _EVENT_ID.fullmatch(event_id)
    if match is None:
        detail = "this is no event id of a stream; send the last id received, or leave the header out"
        raise invalid_request([FieldError("/header/Last-Event-ID", "cursor.invalid", detail)])
    return Cursor(int(match.group(1)), int(match.group(2)))


class EventStream:
    """One client's stream; ``chunks`` is read once.

    Parameters
    ----------
    context : ApiContext
        Archive, results and feed.
    names : CarrierNames
        Carriers of the plans.
    streams : OpenStreams
        Says when the service stops.
    spacecraft_id : str
        An existing spacecraft.
    resume : Cursor or None
        What the client has; None: it starts with the present.
    """

    def __init__(
        self,
        context: ApiContext,
        names: CarrierNames,
        streams: OpenStreams,
        spacecraft_id: str,
        resume: Cursor | None,
    ) -> None:
        self._context = context
        self._names = names
        self._streams = streams
        self._spacecraft_id = spacecraft_id
        self._resume = resume
        self._place = Cursor(0, 0)
        self._told_status: StatusAnswer | None = None

    async def chunks(self) -> AsyncIterator[bytes]:
        """Yield the stream until the client goes or the service stops."""
        subscription = self._context.feed.subscribe(self._spacecraft_id)
        self._streams.add(subscription)
        try:
            async for chunk in self._events(subscription):
                # an empty chunk would end the body
                if chunk:
                    yield chunk
        except StorageError as error:
            # the client comes back with the last id it got
            _LOG.warning("stream of %s ends: %s", self._spacecraft_id, error)
        finally:
            self._streams.discard(subscription)
            self._context.feed.unsubscribe(self._spacecraft_id, subscription)

    async def _events(self, subscription: Subscription) -> AsyncIterator[bytes]:
        """Yield the status, what was missed, then what comes."""
        head = await run_in_threadpool(self._context.storage.archive.head, self._spacecraft_id)
        present = Cursor(head.consumed_number, head.result_sequence)
        # an id beyond the archive's end comes from before it was set back to a backup; the present is all we know
        ends = (head.newest_number, head.result_sequence)
        is_known = self._resume is not None and all(at <= end for at, end in zip(self._resume, ends, strict=True))
        self._place = self._resume if self._resume is not None and is_known else present
        yield f"retry: {_RETRY_MS}\n\n".encode() + await self._status()
        async for chunk in self._missed():
            yield chunk
        loop = asyncio.get_running_loop()
        heartbeat_s = self._context.limits.stream_heartbeat_s
        beat = loop.time() + heartbeat_s
        while not self._streams.is_closed:
            events, dropped = await subscription.next_events(max(0.0, beat - loop.time()))
            async for chunk in self._fresh(events, dropped):
                yield chunk
            if loop.time() >= beat:
                beat = loop.time() + heartbeat_s
                yield b": heartbeat\n\n" + await self._changed_status()

    async def _fresh(self, events: Sequence[FeedEvent], dropped: int) -> AsyncIterator[bytes]:
        """Yield queued events that were not sent yet."""
        if dropped:
            yield self._event("missed", MissedAnswer(count=dropped))
        if dropped or self._has_hole(events):
            async for chunk in self._missed():
                yield chunk
        await self._learn_plans(events)
        async for chunk in self._sent(events):
            yield chunk
        if any(event.content is None for event in events):
            yield await self._changed_status()

    def _has_hole(self, events: Sequence[FeedEvent]) -> bool:
        """Whether the next results do not follow what was sent, or the feed says that they are in the archive only."""
        sequence = self._place.sequence
        for event in events:
            if event.cursor.sequence <= sequence or event.kind == "measurement":
                continue
            if event.content is None or event.cursor.sequence != sequence + 1:
                return True
            sequence = event.cursor.sequence
        return False

    async def _missed(self) -> AsyncIterator[bytes]:
        """Yield what the archive holds beyond the place, page by page."""
        while not self._streams.is_closed:
            events = await run_in_threadpool(self._read_archive)
            if not events:
                return
            async for chunk in self._sent(events):
                yield chunk

    async def _sent(self, events: Sequence[FeedEvent]) -> AsyncIterator[bytes]:
        """Yield events as they are sent, a few at a time so that other connections get their turn."""
        for start in range(0, len(events), _EVENTS_AT_ONCE):
            yield b"".join(self._told(event) for event in events[start : start + _EVENTS_AT_ONCE])
            await asyncio.sleep(0)

    def _told(self, event: FeedEvent) -> bytes:
        """Return an event as it is sent and move the place beyond it; nothing for one that was sent already."""
        number, sequence = self._place
        is_result = event.kind in {"attitude", "torque"}
        is_new = event.cursor.sequence > sequence if is_result else event.cursor.number > number
        if not is_new:
            return b""
        self._place = Cursor(max(number, event.cursor.number), event.cursor.sequence if is_result else sequence)
        return b"" if event.content is None else self._event(event.kind, self._answer(event.content))

    def _read_archive(self) -> list[FeedEvent]:
        """Return the next measurements and results beyond the place, in this order."""
        number, sequence = self._place
        archive, results = self._context.storage.archive, self._context.storage.results
        events: list[FeedEvent] = []
        for entry in archive.journal(self._spacecraft_id, number, _ENTRIES_AT_ONCE):
            number = entry.number
            row = entry.content if isinstance(entry.content, Measurement) else None
            if row is not None:
                self._names.of(self._spacecraft_id, row.plan_id)
            events.append(FeedEvent("measurement", Cursor(number, sequence), row))
        for at, result in results.results_after(self._spacecraft_id, sequence, _ENTRIES_AT_ONCE):
            sequence = at
            kind = "attitude" if isinstance(result, AttitudeRow) else "torque"
            events.append(FeedEvent(kind, Cursor(number, sequence), result))
        return events

    async def _learn_plans(self, events: Sequence[FeedEvent]) -> None:
        """Look up plans that rows name for the first time, outside the event loop."""
        rows = (event.content for event in events)
        for plan_id in {row.plan_id for row in rows if isinstance(row, Measurement)}:
            if not self._names.knows(self._spacecraft_id, plan_id):
                await run_in_threadpool(self._names.of, self._spacecraft_id, plan_id)

    async def _status(self) -> bytes:
        """Return the status event."""
        self._told_status = await run_in_threadpool(status_of, self._context, self._spacecraft_id)
        return self._event("status", self._told_status)

    async def _changed_status(self) -> bytes:
        """Return the status event when more than the time of day has changed, otherwise nothing."""
        former = self._told_status
        event = await self._status()
        now = self._told_status
        is_same = former is not None and now is not None and former.model_copy(update={"now": now.now}) == now
        return b"" if is_same else event

    def _answer(self, content: Measurement | AttitudeRow | TorqueCommand) -> Answer:
        """Return the document that the REST interface tells for the same thing."""
        if isinstance(content, Measurement):
            return MeasurementAnswer.of(content, self._names.of(self._spacecraft_id, content.plan_id))
        return AttitudeAnswer.of(content, LIVE) if isinstance(content, AttitudeRow) else TorqueAnswer.of(content)

    def _event(self, kind: str, data: BaseModel) -> bytes:
        """Return one event as it is sent."""
        number, sequence = self._place
        return f"id: {number}.{sequence}\nevent: {kind}\ndata: {data.model_dump_json()}\n\n".encode()
