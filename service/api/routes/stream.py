"""Stream: measurements, attitude, torques and status as they come, as server-sent events."""

from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool
from starlette.types import Send

from service.api.deps import Context, Names, SpacecraftId, Streams
from service.api.event_stream import EventStream, cursor_of

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/stream", tags=["stream"])
_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


class EventStreamResponse(StreamingResponse):
    """A stream whose source is let go of at once when the client leaves."""

    media_type = "text/event-stream"

    async def stream_response(self, send: Send) -> None:
        """Send chunks until there are no more or the client has gone."""
        try:
            await super().stream_response(send)
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
    names: Names,
    streams: Streams,
    last_event_id: Annotated[str | None, Header(max_length=64, description="Id of the last event received")] = None,
) -> EventStreamResponse:
    """Follow a spacecraft: events measurement, attitude, torque, status; Last-Event-ID resumes without loss."""
    resume = cursor_of(last_event_id)
    await run_in_threadpool(context.storage.catalogue.spacecraft, spacecraft_id)
    source = EventStream(context, names, streams, spacecraft_id, resume)
    return EventStreamResponse(source.chunks(), headers=_HEADERS)
