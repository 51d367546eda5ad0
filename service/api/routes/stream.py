"""Stream: measurements, results, alarms, and changes of what is looked up, as server-sent events."""

import asyncio
import logging
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool
from starlette.types import Message, Receive, Scope, Send

from service.api.context import Context, SpacecraftId
from service.api.stream.event_stream import EventStream, OpenStreams, StreamParts
from service.api.stream.events import EVENT_NAMES, MAX_ID_LENGTH, EventName, cursor_of

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/stream", tags=["stream"])
_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
_LOG = logging.getLogger(__name__)


class EventStreamResponse(StreamingResponse):
    """A stream whose source is let go of when the client leaves, or takes nothing for long."""

    media_type = "text/event-stream"

    #: a client that takes nothing for so long is gone, s
    stall_s = 60.0
    #: where the stream has a place
    streams: OpenStreams

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream; its place is given back however that ends."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self.streams.leave()

    async def stream_response(self, send: Send) -> None:
        """Send chunks until there are no more or the client has gone."""

        async def send_in_time(message: Message) -> None:
            async with asyncio.timeout(self.stall_s):
                await send(message)

        try:
            await super().stream_response(send_in_time)
        except TimeoutError:
            # the connection is cut by leaving the answer unfinished
            _LOG.warning("stream closed: its client read nothing for %g s", self.stall_s)
        finally:
            close = getattr(self.body_iterator, "aclose", None)
            if close is not None:
                await close()


@router.get(
    "",
    response_class=EventStreamResponse,
    responses={200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}, "description": "Events"}},
)
async def stream(
    spacecraft_id: SpacecraftId,
    context: Context,
    request: Request,
    last_event_id: Annotated[
        str | None, Header(max_length=MAX_ID_LENGTH, description="Id of the last event received")
    ] = None,
    events: Annotated[list[EventName] | None, Query(description="Default all; may be repeated")] = None,
) -> EventStreamResponse:
    """Follow a spacecraft: events measurement, attitude, torque, alarm, status, dropped; Last-Event-ID resumes.

    Without Last-Event-ID the stream starts with the present: the status, then the rows that are not computed yet, then
    what is stored from then on. Earlier rows, results and alarms do not come. A result comes after its measurement.
    Events command, job, link, note and smoothed tell changes while the stream is open, within some seconds; after a new
    connection the lists tell what was missed of these. An attitude row comes with the results of its carriers.
    """
    parts: StreamParts = request.app.state.stream_parts
    resume = cursor_of(spacecraft_id, last_event_id)
    await run_in_threadpool(context.storage.catalogue.spacecraft, spacecraft_id)
    # nothing is waited for between the look and the place: requests that come together cannot pass it
    parts.streams.acquire()
    response = EventStreamResponse(
        EventStream(parts, spacecraft_id, resume, events or EVENT_NAMES).chunks(), headers=_HEADERS
    )
    response.stall_s, response.streams = context.limits.stream_stall_s, parts.streams
    return response
