"""Measurements on their way in: decoded in one pass, screened as arrays, answered after the commit.

This is the hot path: no thread, no look-up beyond memory, one await. The route asks for its parts directly, because
each dependency that the framework resolves costs as much as reading ten rows.
"""

from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import TypeAdapter
from starlette.responses import JSONResponse

from service.api.auth import MAY_SEND
from service.api.bodies import accepts, read_body
from service.api.deps import ApiContext, SpacecraftIdText, checked_spacecraft_id
from service.api.epoch_limits import EpochLimits
from service.api.epochs import EpochTextError, parse_epochs
from service.api.landings import Landings
from service.api.plan_widths import PlanWidths
from service.api.problems import ProblemError, invalid_request
from service.api.request_figures import RequestFigures
from service.api.schemas.measurements import MeasurementBatchDocument, MeasurementReceiptAnswer
from service.errors import FieldError
from service.pipeline.ingest import ReceivedRows, screen
from service.records.attitude import IntArray
from service.records.measurement import BatchReceipt, Refusal

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["measurements"])
_ADAPTER = TypeAdapter(MeasurementBatchDocument)
_NOTHING_STORED = BatchReceipt(0, 0, 0, ())


@router.post(
    "/measurements:batch",
    dependencies=[MAY_SEND],
    openapi_extra=accepts(MeasurementBatchDocument),
    response_model=MeasurementReceiptAnswer,
)
async def send_measurements(spacecraft_id: SpacecraftIdText, request: Request) -> Response:
    """Store rows of carrier powers; the answer leaves after the commit that made them durable."""
    context: ApiContext = request.app.state.context
    widths: PlanWidths = request.app.state.plan_widths
    checked_spacecraft_id(spacecraft_id)
    body = await read_body(request, _ADAPTER)
    check_batch_size(len(body.measurements), context, "/measurements")
    width = await widths.width(spacecraft_id, body.plan_id)
    rows = ReceivedRows(
        spacecraft_id=spacecraft_id,
        source=body.source,
        plan_id=body.plan_id,
        received_at_us=context.clock.system_us(),
        first_seq=body.first_seq,
        epochs_us=_epochs(body),
        power_dbm=[row["power_dbm"] for row in body.measurements],
        flags=[row.get("flags") for row in body.measurements],
        details=body.details(),
    )
    epoch_limits: EpochLimits = request.app.state.epoch_limits
    batch, screened = screen(rows, width, await epoch_limits.known(spacecraft_id))
    if any(refusal.code == "time.future" for refusal in screened):
        batch, screened = screen(rows, width, await epoch_limits.present(spacecraft_id))
    receipt = _NOTHING_STORED
    if len(batch.index):
        landings: Landings = request.app.state.landings
        receipt = await landings.of(context.storage.archive.append_measurements(batch))
    figures: RequestFigures = request.app.state.request_figures
    figures.add_receipt(spacecraft_id, receipt, screened)
    if receipt.first_number is not None:
        context.on_rows_accepted(spacecraft_id, receipt.first_number + receipt.accepted - 1)
    return JSONResponse(_answer(body, receipt, screened))


def check_batch_size(size: int, context: ApiContext, pointer: str) -> None:
    """Refuse a batch of more rows than the limit."""
    limit = context.limits.max_rows_per_batch
    if size > limit:
        detail = f"the batch has {size} rows, the limit is {limit}; send it in smaller batches"
        raise ProblemError(422, "batch.too_long", detail, [FieldError(pointer, "batch.too_long", detail)])


def _epochs(body: MeasurementBatchDocument) -> IntArray:
    """Return the epochs of a batch; 422 names the first that is none."""
    try:
        return parse_epochs([row["epoch"] for row in body.measurements])
    except EpochTextError as error:
        pointer = f"/measurements/{error.index}/epoch"
        raise invalid_request([FieldError(pointer, "epoch.malformed", error.detail)]) from None


def _answer(body: MeasurementBatchDocument, receipt: BatchReceipt, screened: tuple[Refusal, ...]) -> dict[str, Any]:
    """Return the receipt as it is sent."""
    received = len(body.measurements)
    refused = sorted((*screened, *receipt.refused), key=lambda refusal: refusal.index)
    return {
        "received": received,
        "accepted": receipt.accepted,
        "duplicates": receipt.duplicates,
        "late": receipt.late,
        "durable": True,
        "last_seq": body.first_seq + received - 1 if body.first_seq is not None and received else None,
        "refused": [{"index": r.index, "seq": r.seq, "code": r.code, "detail": r.detail} for r in refused],
    }
