"""Slow inputs in batches and their archive; operations that the control centre declares."""

from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Annotated, Any, Protocol, TypeVar

from fastapi import APIRouter, Path, Response
from pydantic import BaseModel, TypeAdapter

from service.api.access.auth import MAY_OPERATE, may_send
from service.api.context import ApiContext, Context, PresentBounds, SpacecraftId
from service.api.protocol.paging import Page, PageQuery, Position
from service.api.protocol.requests import Body, MergePatch, patched
from service.api.routes.measurements import check_batch_size
from service.api.schemas import inputs as documents
from service.api.schemas.base import Answer
from service.pipeline.ingest_screening import HORIZON_US
from service.records.catalogue import Spacecraft
from service.records.epoch import LATEST_EPOCH_US, format_epoch
from service.records.inputs import JournalEntry, SlowInput
from service.records.levels.measurement import InputReceipt
from service.records.operations.access import DataKind

inputs_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["inputs"])
_NOTHING_STORED = InputReceipt(0, 0, ())


class _Row(Protocol):
    """A row that knows why it cannot be."""

    def fault(self) -> documents.Fault | None:
        """Return why the row is refused."""


R = TypeVar("R", bound=_Row)
M = TypeVar("M", bound=BaseModel)


@inputs_router.post("/attitude-references:batch", dependencies=[may_send(DataKind.REFERENCES)])
def send_references(
    spacecraft_id: SpacecraftId, body: Body[documents.ReferenceBatchDocument], context: Context
) -> documents.InputReceiptAnswer:
    """Store attitude references of one sensor.

    Signs: seen from the satellite with North up and East right, positive roll moves every station South, positive pitch
    moves it West, and positive yaw moves a station in the East to the North and one in the North to the West
    (`docs/images/sign-convention.svg`). Body axes at zero: x roll East, y pitch South, z yaw to the Earth; 3-2-1. A
    calibration refuses references whose signs or axes the powers contradict.
    """
    check_batch_size(len(body.references), context, "/references")
    return _append(spacecraft_id, context, body.references, lambda row: row.to_record(body.source))


@inputs_router.post("/corrections:batch", dependencies=[may_send(DataKind.CORRECTIONS)])
def send_corrections(
    spacecraft_id: SpacecraftId, body: Body[documents.CorrectionBatchDocument], context: Context
) -> documents.InputReceiptAnswer:
    """Store attitude changes that were commanded through other channels."""
    check_batch_size(len(body.corrections), context, "/corrections")
    return _append(spacecraft_id, context, body.corrections, lambda row: row.to_record())


@inputs_router.post("/telemetry:batch", dependencies=[may_send(DataKind.TELEMETRY)])
def send_telemetry(
    spacecraft_id: SpacecraftId, body: Body[documents.TelemetryBatchDocument], context: Context
) -> documents.InputReceiptAnswer:
    """Store on-board telemetry; a momentum beyond the catalogue's limit is refused, and alarms after three records."""
    check_batch_size(len(body.records), context, "/records")
    limit_n_m_s = context.storage.catalogue.spacecraft(spacecraft_id).wheels.momentum_limit_n_m_s
    momenta = [row for row in body.records if row.wheel_momentum_n_m_s]
    context.storage.alarms.count_refused(spacecraft_id, [row.greatest_n_m_s > limit_n_m_s for row in momenta])

    def fault(row: documents.TelemetryDocument) -> documents.Fault | None:
        if row.greatest_n_m_s > limit_n_m_s:
            return "telemetry.momentum", f"a wheel stores at most {limit_n_m_s:g} N m s by the catalogue"
        return row.fault()

    return _append(spacecraft_id, context, body.records, lambda row: row.to_record(), fault)


@inputs_router.post("/weather:batch", dependencies=[may_send(DataKind.WEATHER)])
def send_weather(
    spacecraft_id: SpacecraftId, body: Body[documents.WeatherBatchDocument], context: Context, bounds: PresentBounds
) -> documents.InputReceiptAnswer:
    """Store reports of rain over uplink stations, which make "wet" likelier or less likely for their carriers.

    The robust method asks them every ten minutes; a report holds for half an hour, and two hours after rain an antenna
    still counts as wet. A wrong report costs certainty, not truth: the powers decide.
    """
    check_batch_size(len(body.reports), context, "/reports")
    carriers = context.storage.catalogue.plan(spacecraft_id).carriers
    stations = {carrier.station.name for carrier in carriers if carrier.station and carrier.station.name}

    def fault(row: documents.WeatherDocument) -> documents.Fault | None:
        if row.station not in stations:
            known = ", ".join(sorted(stations)) or "none has a name"
            return "station.unknown", f"the newest carrier plan has no station {row.station!r}; it has: {known}"
        if row.epoch > bounds.latest_us:
            return "time.future", f"the epoch lies after {format_epoch(bounds.latest_us)}; a forecast is no report"
        return row.fault()

    return _append(spacecraft_id, context, body.reports, lambda row: row.to_record(body.source), fault)


@inputs_router.post("/polarization:batch", dependencies=[may_send(DataKind.POLARIZATION)])
def send_polarization(
    spacecraft_id: SpacecraftId,
    body: Body[documents.PolarizationBatchDocument],
    context: Context,
    bounds: PresentBounds,
) -> documents.InputReceiptAnswer:
    """Store polarisation records of one polarimeter of the catalogue, which measure yaw.

    The robust method takes their median each five minutes; a record more than 15 minutes older than the newest row
    tells nothing. Wrong angles are left out, and what they did is reported as `advice`.
    """
    check_batch_size(len(body.records), context, "/records")
    sources = sorted(each.source for each in context.storage.catalogue.spacecraft(spacecraft_id).polarimeters)

    def fault(row: documents.PolarizationDocument) -> documents.Fault | None:
        if body.source not in sources:
            known = ", ".join(sources) or "none"
            return "polarimeter.unknown", f"the catalogue states no polarimeter {body.source!r}; it states: {known}"
        if row.epoch > bounds.latest_us:
            return "time.future", f"the epoch lies after {format_epoch(bounds.latest_us)}"
        return row.fault()

    return _append(spacecraft_id, context, body.records, lambda row: row.to_record(body.source), fault)


@inputs_router.get("/attitude-references")
def list_references(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.ReferencePage:
    """List attitude references in order of epoch."""
    return input_page(spacecraft_id, "reference", page, context, documents.ReferencePage, documents.ReferenceAnswer)


@inputs_router.get("/corrections")
def list_corrections(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.CorrectionPage:
    """List corrections that overlap the range, in order of start."""
    return input_page(spacecraft_id, "correction", page, context, documents.CorrectionPage, documents.CorrectionAnswer)


@inputs_router.get("/telemetry")
def list_telemetry(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.TelemetryPage:
    """List telemetry in order of epoch."""
    return input_page(spacecraft_id, "telemetry", page, context, documents.TelemetryPage, documents.TelemetryAnswer)


@inputs_router.get("/weather")
def list_weather(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.WeatherPage:
    """List weather reports in order of epoch."""
    return input_page(spacecraft_id, "weather", page, context, documents.WeatherPage, documents.WeatherAnswer)


@inputs_router.get("/polarization")
def list_polarization(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.PolarizationPage:
    """List polarisation records in order of epoch."""
    return input_page(
        spacecraft_id, "polarization", page, context, documents.PolarizationPage, documents.PolarizationAnswer
    )


def _append(
    spacecraft_id: str,
    context: ApiContext,
    rows: Sequence[R],
    to_record: Callable[[R], SlowInput],
    fault_of: Callable[[R], documents.Fault | None] = lambda row: row.fault(),
) -> documents.InputReceiptAnswer:
    """Store the rows without a fault and return the receipt of all."""
    faults = [fault_of(row) for row in rows]
    # an unknown spacecraft is a 404 whatever the rows say
    horizon_us = _horizon_us(context, context.storage.catalogue.spacecraft(spacecraft_id))
    records = {index: to_record(rows[index]) for index, fault in enumerate(faults) if fault is None}
    for index, record in records.items():
        if _last_us(record) > horizon_us:
            faults[index] = (
                "time.future",
                f"the epoch lies after {format_epoch(horizon_us)}, 366 days past the newest row",
            )
    kept = [index for index, fault in enumerate(faults) if fault is None]
    refused = [(index, *fault) for index, fault in enumerate(faults) if fault is not None]
    receipt = _NOTHING_STORED
    if kept:
        receipt = context.storage.archive.append_inputs(spacecraft_id, [records[index] for index in kept])
    if receipt.accepted:
        context.on_accepted(spacecraft_id)
    refused += [(kept[refusal.index], refusal.code, refusal.detail) for refusal in receipt.refused]
    return documents.InputReceiptAnswer(
        received=len(rows),
        accepted=receipt.accepted,
        duplicates=receipt.duplicates,
        refused=[
            documents.InputRefusalAnswer.of_fault(index, (code, detail)) for index, code, detail in sorted(refused)
        ],
    )


def _horizon_us(context: ApiContext, spacecraft: Spacecraft) -> int:
    """Return the greatest epoch of a record; before the first row of a simulated spacecraft nothing bounds it."""
    newest_us = context.clock.now_us(spacecraft.id) if spacecraft.simulated else None
    return LATEST_EPOCH_US if newest_us is None else newest_us + HORIZON_US


def _last_us(record: Any) -> int:
    last_us: int = record.stop_us if hasattr(record, "stop_us") else record.epoch_us
    return last_us


def input_page(
    spacecraft_id: str, kind: str, page: PageQuery, context: ApiContext, model: type[M], row: type[Answer]
) -> M:
    """Return the page of inputs of a kind."""
    read = context.storage.archive.inputs
    entries = read(spacecraft_id, kind, page.part)
    return page.answer(model, entries, _position, lambda entry: row.of(entry.content))


def _position(entry: JournalEntry) -> Position:
    content: Any = entry.content
    return content.start_us if hasattr(content, "start_us") else content.epoch_us, entry.number


operations_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/operations", tags=["inputs"])
_ADAPTER = TypeAdapter(documents.OperationDocument)
OperationId = Annotated[int, Path(ge=1, le=2**31 - 1)]


@operations_router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE])
def declare_operation(
    spacecraft_id: SpacecraftId, body: Body[documents.OperationDocument], context: Context, response: Response
) -> documents.OperationAnswer:
    """Declare an operation, past, present or future."""
    stored = context.storage.archive.add_operation(spacecraft_id, body.to_record(0))
    context.on_accepted(spacecraft_id)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/operations/{stored.id}"
    return documents.OperationAnswer.of(stored)


@operations_router.get("")
def list_operations(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.OperationPage:
    """List the newest revision of operations that overlap the range."""
    return input_page(spacecraft_id, "operation", page, context, documents.OperationPage, documents.OperationAnswer)


@operations_router.get("/{operation_id}")
def get_operation(
    spacecraft_id: SpacecraftId, operation_id: OperationId, context: Context
) -> documents.OperationAnswer:
    """Return the newest revision of an operation."""
    return documents.OperationAnswer.of(context.storage.archive.operation(spacecraft_id, operation_id))


@operations_router.patch("/{operation_id}", dependencies=[MAY_OPERATE])
def change_operation(
    spacecraft_id: SpacecraftId, operation_id: OperationId, body: Body[MergePatch], context: Context
) -> documents.OperationAnswer:
    """Change fields of an operation; the change is a new revision, the former ones stay in the journal."""
    stored = documents.OperationAnswer.of(context.storage.archive.operation(spacecraft_id, operation_id))
    changed = patched(_ADAPTER, stored.model_dump(mode="json", exclude={"id", "revision"}), body)
    result = context.storage.archive.replace_operation(spacecraft_id, changed.to_record(operation_id))
    context.on_accepted(spacecraft_id)
    return documents.OperationAnswer.of(result)
