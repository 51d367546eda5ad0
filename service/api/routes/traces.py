"""Evidence traces: sweeps of the front ends, kept in a ring a source."""

from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from service.api.access.auth import MAY_SEND
from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.epoch_limits import EpochLimits
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.paging import Page, by_epoch, path_epoch
from service.api.schemas.base import NAME_PATTERN
from service.api.schemas.traces import (
    TraceAnswer,
    TraceBatchDocument,
    TraceDocument,
    TraceHeadAnswer,
    TracePage,
    TraceReceiptAnswer,
    TraceRefusalAnswer,
)
from service.formats.numbers import text_of_float32
from service.pipeline.ingest_screening import EpochBounds
from service.records.epoch import format_epoch
from service.records.levels.trace import KeptTrace, Ring

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/traces", tags=["measurements"])
_CSV = "text/csv"
_CSV_ANSWER: dict[int | str, dict[str, Any]] = {200: {"content": {_CSV: {"schema": {"type": "string"}}}}}
SourceParameter = Annotated[str | None, Query(pattern=NAME_PATTERN, description="Only traces of this source")]
SweepParameter = Annotated[str | None, Query(pattern=NAME_PATTERN, description="Only traces of this sweep")]


@router.post("", dependencies=[MAY_SEND], openapi_extra=accepts(TraceBatchDocument))
async def send_traces(
    spacecraft_id: SpacecraftId,
    body: Annotated[TraceBatchDocument, body_of(TraceBatchDocument)],
    context: Context,
    request: Request,
) -> TraceReceiptAnswer:
    """Keep traces of one source; the oldest ones of the source make place."""
    limits: EpochLimits = request.app.state.epoch_limits
    bounds = await limits.present(spacecraft_id)
    faults = [_fault(trace, bounds) for trace in body.traces]
    kept = [trace.to_record() for trace, fault in zip(body.traces, faults, strict=True) if fault is None]
    refused = [TraceRefusalAnswer.of_fault(index, fault) for index, fault in enumerate(faults) if fault is not None]
    ring = Ring(context.limits.evidence_traces, context.limits.evidence_bytes)
    now_us = context.clock.system_us()
    receipt = await run_in_threadpool(context.storage.traces.append, spacecraft_id, body.source, kept, now_us, ring)
    return TraceReceiptAnswer.of(receipt, refused)


@router.get("")
def list_traces(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    source: SourceParameter = None,
    sweep: SweepParameter = None,
) -> TracePage:
    """List kept traces, without their points, in order of epoch."""
    read = context.storage.traces.heads
    found = read(spacecraft_id, page.window, page.most, page.after, source, sweep, newest_first=page.newest_first)
    return page.answer(TracePage, found, by_epoch, TraceHeadAnswer.of)


@router.get("/{epoch}", response_model=TraceAnswer, responses=_CSV_ANSWER)
def get_trace(
    spacecraft_id: SpacecraftId,
    epoch: Annotated[str, Path(max_length=64, description="RFC 3339, middle of the dwell")],
    context: Context,
    request: Request,
    source: SourceParameter = None,
    sweep: SweepParameter = None,
    form: Annotated[
        Literal["json", "csv"] | None, Query(alias="format", description="Overrides the Accept header")
    ] = None,
) -> Any:
    """Return one trace, as CSV when the client accepts text/csv."""
    trace = context.storage.traces.trace(spacecraft_id, path_epoch("epoch", epoch), source, sweep)
    wants_csv = _CSV in request.headers.get("accept", "").lower() if form is None else form == "csv"
    if not wants_csv:
        return TraceAnswer.of_trace(trace)
    name = f"{spacecraft_id}-{trace.head.source}-{trace.head.sweep}-{trace.head.epoch_us}.csv".replace(":", "_")
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Vary": "Accept"}
    return Response(_as_csv(trace), media_type=_CSV, headers=headers)


def _fault(trace: TraceDocument, bounds: EpochBounds) -> tuple[str, str] | None:
    """Return why a trace is refused; one from the future would push all others out of the ring."""
    if trace.epoch < bounds.earliest_us:
        return "time.too_old", f"nothing before {format_epoch(bounds.earliest_us)} is kept"
    if trace.epoch > bounds.latest_us:
        return "time.future", f"the epoch lies after {format_epoch(bounds.latest_us)}; check the clock of the source"
    return None


def _as_csv(trace: KeptTrace) -> str:
    """Return a trace as two columns; a point without a number has an empty power."""
    settings = trace.head.settings
    frequency_hz = (settings.start_hz + settings.step_hz * np.arange(trace.head.points)).tolist()
    lines = [
        f"{frequency!r},{power}"
        for frequency, power in zip(frequency_hz, text_of_float32(trace.power_dbm), strict=True)
    ]
    return "\r\n".join(["frequency_hz,power_dbm", *lines, ""])
