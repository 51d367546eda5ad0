"""Slow inputs in batches: references, corrections, telemetry, weather, polarisation; and the archive of each."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Protocol, TypeVar

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel

from service.api.access.auth import MAY_SEND
from service.api.context.dependencies import ApiContext, Context, SpacecraftId
from service.api.context.epoch_limits import EpochLimits
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.paging import Page, PageQuery, Position
from service.api.routes.measurements_ingest import check_batch_size
from service.api.schemas.base import Answer
from service.api.schemas.inputs import (
    CorrectionAnswer,
    CorrectionBatchDocument,
    CorrectionPage,
    Fault,
    InputReceiptAnswer,
    InputRefusalAnswer,
    PolarizationAnswer,
    PolarizationBatchDocument,
    PolarizationDocument,
    PolarizationPage,
    ReferenceAnswer,
    ReferenceBatchDocument,
    ReferencePage,
    TelemetryAnswer,
    TelemetryBatchDocument,
    TelemetryPage,
    WeatherAnswer,
    WeatherBatchDocument,
    WeatherDocument,
    WeatherPage,
)
from service.records.epoch import format_epoch
from service.records.journal import JournalEntry, SlowInput
from service.records.levels.series import InputReceipt

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["inputs"])
_NOTHING_STORED = InputReceipt(0, 0, ())


class _Row(Protocol):
    """A row that knows why it cannot be."""

    def fault(self) -> Fault | None:
        """Return why the row is refused."""


R = TypeVar("R", bound=_Row)
M = TypeVar("M", bound=BaseModel)


@router.post("/attitude-references:batch", dependencies=[MAY_SEND], openapi_extra=accepts(ReferenceBatchDocument))
def send_references(
    spacecraft_id: SpacecraftId,
    body: Annotated[ReferenceBatchDocument, body_of(ReferenceBatchDocument)],
    context: Context,
) -> InputReceiptAnswer:
    """Store attitude references of one sensor.

    Signs: seen from the satellite with North up and East right, positive roll moves every station South, positive pitch
    moves it West, and positive yaw moves a station in the East to the North and one in the North to the West
    (`docs/images/sign-convention.svg`). Body axes at zero: x roll East, y pitch South, z yaw to the Earth; 3-2-1. A
    calibration refuses references whose signs or axes the powers contradict.
    """
    check_batch_size(len(body.references), context, "/references")
    return _append(spacecraft_id, context, body.references, lambda row: row.to_record(body.source))


@router.post("/corrections:batch", dependencies=[MAY_SEND], openapi_extra=accepts(CorrectionBatchDocument))
def send_corrections(
    spacecraft_id: SpacecraftId,
    body: Annotated[CorrectionBatchDocument, body_of(CorrectionBatchDocument)],
    context: Context,
) -> InputReceiptAnswer:
    """Store attitude changes that were commanded through other channels."""
    check_batch_size(len(body.corrections), context, "/corrections")
    return _append(spacecraft_id, context, body.corrections, lambda row: row.to_record())


@router.post("/telemetry:batch", dependencies=[MAY_SEND], openapi_extra=accepts(TelemetryBatchDocument))
def send_telemetry(
    spacecraft_id: SpacecraftId,
    body: Annotated[TelemetryBatchDocument, body_of(TelemetryBatchDocument)],
    context: Context,
) -> InputReceiptAnswer:
    """Store on-board telemetry."""
    check_batch_size(len(body.records), context, "/records")
    return _append(spacecraft_id, context, body.records, lambda row: row.to_record())


@router.post("/weather:batch", dependencies=[MAY_SEND], openapi_extra=accepts(WeatherBatchDocument))
async def send_weather(
    spacecraft_id: SpacecraftId,
    body: Annotated[WeatherBatchDocument, body_of(WeatherBatchDocument)],
    context: Context,
    request: Request,
) -> InputReceiptAnswer:
    """Store reports of rain over uplink stations, which make "wet" likelier or less likely for their carriers.

    The robust method asks them every ten minutes; a report holds for half an hour, and two hours after rain an antenna
    still counts as wet. A wrong report costs certainty, not truth: the powers decide.
    """
    check_batch_size(len(body.reports), context, "/reports")
    limits: EpochLimits = request.app.state.epoch_limits
    latest_us = (await limits.present(spacecraft_id)).latest_us
    return await run_in_threadpool(_append_weather, spacecraft_id, context, body, latest_us)


@router.post("/polarization:batch", dependencies=[MAY_SEND], openapi_extra=accepts(PolarizationBatchDocument))
async def send_polarization(
    spacecraft_id: SpacecraftId,
    body: Annotated[PolarizationBatchDocument, body_of(PolarizationBatchDocument)],
    context: Context,
    request: Request,
) -> InputReceiptAnswer:
    """Store polarisation records of one polarimeter of the catalogue, which measure yaw.

    The robust method takes their median each five minutes; a record more than 15 minutes older than the newest row
    tells nothing. Wrong angles are left out, and what they did is reported as `advice`.
    """
    check_batch_size(len(body.records), context, "/records")
    limits: EpochLimits = request.app.state.epoch_limits
    latest_us = (await limits.present(spacecraft_id)).latest_us
    return await run_in_threadpool(_append_polarization, spacecraft_id, context, body, latest_us)


@router.get("/attitude-references")
def list_references(spacecraft_id: SpacecraftId, page: Page, context: Context) -> ReferencePage:
    """List attitude references in order of epoch."""
    return input_page(spacecraft_id, "reference", page, context, ReferencePage, ReferenceAnswer)


@router.get("/corrections")
def list_corrections(spacecraft_id: SpacecraftId, page: Page, context: Context) -> CorrectionPage:
    """List corrections that overlap the range, in order of start."""
    return input_page(spacecraft_id, "correction", page, context, CorrectionPage, CorrectionAnswer)


@router.get("/telemetry")
def list_telemetry(spacecraft_id: SpacecraftId, page: Page, context: Context) -> TelemetryPage:
    """List telemetry in order of epoch."""
    return input_page(spacecraft_id, "telemetry", page, context, TelemetryPage, TelemetryAnswer)


@router.get("/weather")
def list_weather(spacecraft_id: SpacecraftId, page: Page, context: Context) -> WeatherPage:
    """List weather reports in order of epoch."""
    return input_page(spacecraft_id, "weather", page, context, WeatherPage, WeatherAnswer)


@router.get("/polarization")
def list_polarization(spacecraft_id: SpacecraftId, page: Page, context: Context) -> PolarizationPage:
    """List polarisation records in order of epoch."""
    return input_page(spacecraft_id, "polarization", page, context, PolarizationPage, PolarizationAnswer)


def _append_polarization(
    spacecraft_id: str, context: ApiContext, body: PolarizationBatchDocument, latest_us: int
) -> InputReceiptAnswer:
    """Store the records of a polarimeter that the catalogue states."""
    sources = sorted(each.source for each in context.storage.catalogue.spacecraft(spacecraft_id).polarimeters)

    def fault(row: PolarizationDocument) -> Fault | None:
        if body.source not in sources:
            known = ", ".join(sources) or "none"
            return "polarimeter.unknown", f"the catalogue states no polarimeter {body.source!r}; it states: {known}"
        if row.epoch > latest_us:
            return "time.future", f"the epoch lies after {format_epoch(latest_us)}"
        return row.fault()

    return _append(spacecraft_id, context, body.records, lambda row: row.to_record(body.source), fault)


def _append_weather(
    spacecraft_id: str, context: ApiContext, body: WeatherBatchDocument, latest_us: int
) -> InputReceiptAnswer:
    """Store the reports about stations of the newest plan; a forecast is no report."""
    carriers = context.storage.catalogue.plan(spacecraft_id).carriers
    stations = {carrier.station.name for carrier in carriers if carrier.station and carrier.station.name}

    def fault(row: WeatherDocument) -> Fault | None:
        if row.station not in stations:
            known = ", ".join(sorted(stations)) or "none has a name"
            return "station.unknown", f"the newest carrier plan has no station {row.station!r}; it has: {known}"
        if row.epoch > latest_us:
            return "time.future", f"the epoch lies after {format_epoch(latest_us)}; a forecast is no report"
        return row.fault()

    return _append(spacecraft_id, context, body.reports, lambda row: row.to_record(body.source), fault)


def _append(
    spacecraft_id: str,
    context: ApiContext,
    rows: Sequence[R],
    to_record: Callable[[R], SlowInput],
    fault_of: Callable[[R], Fault | None] = lambda row: row.fault(),
) -> InputReceiptAnswer:
    """Store the rows without a fault and return the receipt of all."""
    faults = [fault_of(row) for row in rows]
    kept = [index for index, fault in enumerate(faults) if fault is None]
    refused = [(index, *fault) for index, fault in enumerate(faults) if fault is not None]
    # an unknown spacecraft is a 404 whatever the rows say
    context.storage.catalogue.spacecraft(spacecraft_id)
    receipt = _NOTHING_STORED
    if kept:
        receipt = context.storage.archive.append_inputs(spacecraft_id, [to_record(rows[index]) for index in kept])
    if receipt.accepted:
        context.on_accepted(spacecraft_id)
    refused += [(kept[refusal.index], refusal.code, refusal.detail) for refusal in receipt.refused]
    return InputReceiptAnswer(
        received=len(rows),
        accepted=receipt.accepted,
        duplicates=receipt.duplicates,
        refused=[InputRefusalAnswer.of_fault(index, (code, detail)) for index, code, detail in sorted(refused)],
    )


def input_page(
    spacecraft_id: str, kind: str, page: PageQuery, context: ApiContext, model: type[M], row: type[Answer]
) -> M:
    """Return the page of inputs of a kind."""
    read = context.storage.archive.inputs
    entries = read(spacecraft_id, kind, page.window, page.most, page.after, newest_first=page.newest_first)
    return page.answer(model, entries, _position, lambda entry: row.of(entry.content))


def _position(entry: JournalEntry) -> Position:
    """Return the position of an entry in its list."""
    content: Any = entry.content
    return content.start_us if hasattr(content, "start_us") else content.epoch_us, entry.number
