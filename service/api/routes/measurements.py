"""Measurements on their way in and out, and evidence traces."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import TypeAdapter
from starlette.responses import JSONResponse

from service.api.access.auth import CurrentPrincipal, Principal, may_send
from service.api.context import (
    ApiContext,
    CommitWaiter,
    Context,
    EpochLimits,
    Names,
    PlanWidths,
    PresentBounds,
    SpacecraftId,
    SpacecraftIdText,
    checked_spacecraft_id,
)
from service.api.monitoring.access_log import RequestMetrics
from service.api.problems.next_steps import NEXT_STEPS
from service.api.problems.problems import RequestProblemError, invalid_request
from service.api.protocol.paging import EpochTextError, Page, ParsedEpochs, by_epoch, parse_epochs, path_epoch
from service.api.protocol.requests import Body, accepts, read_body
from service.api.schemas import measurements as documents
from service.api.schemas.base import NAME_PATTERN
from service.errors import FieldError, source_not_yours
from service.formats.numbers import text_of_float32
from service.pipeline.ingest_screening import EpochBounds, ReceivedRows, screen
from service.records.epoch import format_epoch
from service.records.levels.attitude import CarrierState
from service.records.levels.measurement import BatchReceipt, KeptTrace, Measurement, Ring, RowNotice, RowRefusal, Sender
from service.records.operations.access import DataKind

measurements_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/measurements", tags=["measurements"])


@measurements_router.get("")
def get_measurements(spacecraft_id: SpacecraftId, context: Context, names: Names) -> list[documents.CarrierStateAnswer]:
    """Return the newest row carrier by carrier; empty before the first."""
    known = context.supervisor.carrier_states(spacecraft_id) or _archived(spacecraft_id, context, names)
    if known is None:
        return []
    measurement, states = known
    return [documents.CarrierStateAnswer.of(measurement, k, state) for k, state in enumerate(states)]


@measurements_router.get("/history")
def list_measurements(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    names: Names,
    source: Annotated[str | None, Query(max_length=64, description="Only rows of this source")] = None,
    carrier: Annotated[list[str] | None, Query(max_length=1000, description="Only these carriers")] = None,
) -> documents.MeasurementPage:
    """List rows of carrier powers of every source in order of epoch."""
    read = context.storage.archive.measurements
    found = read(spacecraft_id, page.part, source)
    wanted = None if carrier is None else frozenset(carrier)

    def of(row: Measurement) -> documents.MeasurementAnswer:
        return documents.MeasurementAnswer.of(row, names.of(spacecraft_id, row.plan_id), wanted)

    return page.answer(documents.MeasurementPage, found, by_epoch, of)


def _archived(
    spacecraft_id: str, context: ApiContext, names: Names
) -> tuple[Measurement, tuple[CarrierState, ...]] | None:
    """Return the newest row of the archive before the chain has consumed any since the start."""
    row = context.storage.archive.newest_measurement(spacecraft_id)
    if row is None:
        return None
    nan = float("nan")
    states = []
    for k, name in enumerate(names.of(spacecraft_id, row.plan_id)):
        power_dbm = float(row.power_dbm[k])
        flags = 0 if row.flags is None else int(row.flags[k])
        word = "absent" if power_dbm != power_dbm else "uncalibrated"
        states.append(CarrierState(name, power_dbm, nan, nan, nan, nan, flags, word))
    return row, tuple(states)


measurements_ingest_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["measurements"])
_ADAPTER = TypeAdapter(documents.MeasurementBatchDocument)
_NOTHING_STORED = BatchReceipt(0, 0, 0, ())


@measurements_ingest_router.post(
    "/measurements:batch",
    dependencies=[may_send(DataKind.POWERS)],
    openapi_extra=accepts(documents.MeasurementBatchDocument),
    response_model=documents.MeasurementReceiptAnswer,
)
async def send_measurements(spacecraft_id: SpacecraftIdText, request: Request) -> Response:
    """Store rows of carrier powers; the answer leaves after the commit that made them durable."""
    context: ApiContext = request.app.state.context
    widths: PlanWidths = request.app.state.plan_widths
    checked_spacecraft_id(spacecraft_id)
    body = await read_body(request, _ADAPTER)
    check_batch_size(len(body.measurements), context, "/measurements")
    if body.first_seq is not None and body.first_seq + len(body.measurements) > documents.MAX_SEQ:
        detail = f"the sequence number of the last row would exceed {documents.MAX_SEQ}; begin again at 0"
        raise invalid_request([FieldError("/first_seq", "value.range", detail)])
    epochs = _epochs(body)
    width = await widths.width(spacecraft_id, body.plan_id)
    principal: Principal = request.state.principal
    rows = ReceivedRows(
        spacecraft_id=spacecraft_id,
        source=body.source,
        plan_id=body.plan_id,
        received_at_us=context.clock.system_us(),
        first_seq=body.first_seq,
        epochs_us=epochs.epochs_us,
        power_dbm=[row["power_dbm"] for row in body.measurements],
        flags=[row.get("flags") for row in body.measurements],
        details=body.details(),
        leap_positions=epochs.leap_positions,
        sender=Sender(principal.key_id, context.limits.max_sources_per_key, principal.station),
    )
    epoch_limits: EpochLimits = request.app.state.epoch_limits
    batch, screened = screen(rows, width, await epoch_limits.known(spacecraft_id))
    if any(refusal.code == "time.future" for refusal in screened):
        batch, screened = screen(rows, width, await epoch_limits.present(spacecraft_id))
    receipt = _NOTHING_STORED
    if len(batch.index):
        waiter: CommitWaiter = request.app.state.waiter
        receipt = await waiter.of(context.storage.archive.append_measurements(batch))
    statistics: RequestMetrics = request.app.state.request_statistics
    statistics.add_receipt(spacecraft_id, receipt, screened)
    if receipt.first_number is not None:
        context.on_accepted(spacecraft_id, receipt.first_number + receipt.accepted - 1)
    return JSONResponse(_answer(body, receipt, screened, epochs.leap_positions))


def check_batch_size(size: int, context: ApiContext, pointer: str) -> None:
    """Refuse a batch of more rows than the limit."""
    limit = context.limits.max_rows_per_batch
    if size > limit:
        detail = f"the batch has {size} rows, the limit is {limit}"
        raise RequestProblemError(422, "batch.too_long", detail, [FieldError(pointer, "batch.too_long", detail)])


def _epochs(body: documents.MeasurementBatchDocument) -> ParsedEpochs:
    """Return the epochs of a batch; 422 names the first that is none."""
    try:
        return parse_epochs([row["epoch"] for row in body.measurements])
    except EpochTextError as error:
        pointer = f"/measurements/{error.index}/epoch"
        raise invalid_request([FieldError(pointer, "epoch.malformed", error.detail)]) from None


def _answer(
    body: documents.MeasurementBatchDocument,
    receipt: BatchReceipt,
    screened: tuple[RowRefusal, ...],
    leap_positions: Sequence[int],
) -> dict[str, Any]:
    received = len(body.measurements)
    refused = (*screened, *receipt.refused)
    flagged = list(receipt.flagged)
    if leap_positions:
        reported = {each.index for each in (*refused, *flagged) if each.code != "seq.jump"}
        flagged += [_leap_notice(position, body.first_seq) for position in leap_positions if position not in reported]
    return {
        "received": received,
        "accepted": receipt.accepted,
        "duplicates": receipt.duplicates,
        "late": receipt.late,
        "durable": True,
        "last_seq": body.first_seq + received - 1 if body.first_seq is not None and received else None,
        "refused": _listed(refused),
        "flagged": _listed(flagged),
    }


def _leap_notice(position: int, first_seq: int | None) -> RowNotice:
    """Return what is said of a row within a leap second."""
    seq = None if first_seq is None else first_seq + position
    return RowNotice(position, seq, "time.leap_second", "measured within a leap second: stored in the second after it")


def _listed(notices: Sequence[RowNotice]) -> list[dict[str, Any]]:
    """Return remarks in order of place."""
    ordered = sorted(notices, key=lambda notice: notice.index)
    return [asdict(notice) | {"next_step": NEXT_STEPS.get(notice.code, "")} for notice in ordered]


traces_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/traces", tags=["measurements"])
_CSV = "text/csv"
_CSV_ANSWER: dict[int | str, dict[str, Any]] = {200: {"content": {_CSV: {"schema": {"type": "string"}}}}}
SourceParameter = Annotated[str | None, Query(pattern=NAME_PATTERN, description="Only traces of this source")]
SweepParameter = Annotated[str | None, Query(pattern=NAME_PATTERN, description="Only traces of this sweep")]


@traces_router.post("", dependencies=[may_send(DataKind.POWERS)])
def send_traces(
    spacecraft_id: SpacecraftId,
    body: Body[documents.TraceBatchDocument],
    context: Context,
    bounds: PresentBounds,
    principal: CurrentPrincipal,
) -> documents.TraceReceiptAnswer:
    """Keep traces of one source; the oldest ones of the source make place."""
    _require_own(context, spacecraft_id, body.source, principal)
    faults = [_fault(trace, bounds) for trace in body.traces]
    kept = [trace.to_record() for trace, fault in zip(body.traces, faults, strict=True) if fault is None]
    refused = [
        documents.TraceRefusalAnswer.of_fault(index, fault) for index, fault in enumerate(faults) if fault is not None
    ]
    ring = Ring(context.limits.evidence_traces, context.limits.evidence_bytes)
    now_us = context.clock.system_us()
    receipt = context.storage.traces.append(spacecraft_id, body.source, kept, now_us, ring)
    return documents.TraceReceiptAnswer.of(receipt, refused)


@traces_router.get("")
def list_traces(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    source: SourceParameter = None,
    sweep: SweepParameter = None,
) -> documents.TracePage:
    """List kept traces, without their points, in order of epoch."""
    read = context.storage.traces.heads
    found = read(spacecraft_id, page.part, source, sweep)
    return page.answer(documents.TracePage, found, by_epoch, documents.TraceHeadAnswer.of)


@traces_router.get("/{epoch}", response_model=documents.TraceAnswer, responses=_CSV_ANSWER)
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
        return documents.TraceAnswer.of_trace(trace)
    name = f"{spacecraft_id}-{trace.head.source}-{trace.head.sweep}-{trace.head.epoch_us}.csv".replace(":", "_")
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Vary": "Accept"}
    return Response(_as_csv(trace), media_type=_CSV, headers=headers)


def _require_own(context: ApiContext, spacecraft_id: str, name: str, principal: Principal) -> None:
    """Raise ForbiddenError ``source.not_yours`` for the key of another station than that of a source."""
    for source in context.storage.archive.sources(spacecraft_id):
        if source.id == name and principal.station is not None and source.station not in (None, principal.station):
            raise source_not_yours(name, source.station, principal.station)


def _fault(trace: documents.TraceDocument, bounds: EpochBounds) -> tuple[str, str] | None:
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
