"""Measurements on their way in: decoded in one pass, screened as arrays, answered after the commit.

This is the hot path: no thread, no look-up beyond memory, one await. The route asks for its parts directly, because
each dependency that the framework resolves costs as much as reading ten rows.
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import TypeAdapter
from starlette.responses import JSONResponse

from service.api.access.auth import MAY_SEND
from service.api.context.commit_waiter import CommitWaiter
from service.api.context.dependencies import ApiContext, SpacecraftIdText, checked_spacecraft_id
from service.api.context.epoch_limits import EpochLimits
from service.api.context.plan_widths import PlanWidths
from service.api.monitoring.request_metrics import RequestMetrics
from service.api.problems.next_steps import NEXT_STEPS
from service.api.problems.problems import RequestProblemError, invalid_request
from service.api.protocol.bodies import accepts, read_body
from service.api.protocol.epochs import EpochTextError, ParsedEpochs, parse_epochs
from service.api.schemas.measurements import MAX_SEQ, MeasurementBatchDocument, MeasurementReceiptAnswer
from service.errors import FieldError
from service.pipeline.ingest_screening import ReceivedRows, screen
from service.records.levels.measurement import BatchReceipt, RowNotice, RowRefusal, Sender
from service.records.levels.quality_flag import QualityFlag

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
    if body.first_seq is not None and body.first_seq + len(body.measurements) > MAX_SEQ:
        detail = f"the sequence number of the last row would exceed {MAX_SEQ}; begin again at 0"
        raise invalid_request([FieldError("/first_seq", "value.range", detail)])
    epochs = _epochs(body)
    width = await widths.width(spacecraft_id, body.plan_id)
    rows = ReceivedRows(
        spacecraft_id=spacecraft_id,
        source=body.source,
        plan_id=body.plan_id,
        received_at_us=context.clock.system_us(),
        first_seq=body.first_seq,
        epochs_us=epochs.epochs_us,
        power_dbm=[row["power_dbm"] for row in body.measurements],
        flags=_flags(body, epochs.leap_positions),
        details=body.details(),
        sender=Sender(request.state.principal.key_id, context.limits.max_sources_per_key),
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


def _flags(body: MeasurementBatchDocument, leap_positions: Sequence[int]) -> list[Sequence[int] | None]:
    """Return the bit masks of each row, those of a leap second marked."""
    flags: list[Sequence[int] | None] = [row.get("flags") for row in body.measurements]
    for position in leap_positions:
        masks = flags[position]
        blank = [0] * len(body.measurements[position]["power_dbm"])
        flags[position] = [mask | QualityFlag.LEAP_SECOND for mask in (blank if masks is None else masks)]
    return flags


def _epochs(body: MeasurementBatchDocument) -> ParsedEpochs:
    """Return the epochs of a batch; 422 names the first that is none."""
    try:
        return parse_epochs([row["epoch"] for row in body.measurements])
    except EpochTextError as error:
        pointer = f"/measurements/{error.index}/epoch"
        raise invalid_request([FieldError(pointer, "epoch.malformed", error.detail)]) from None


def _answer(
    body: MeasurementBatchDocument,
    receipt: BatchReceipt,
    screened: tuple[RowRefusal, ...],
    leap_positions: Sequence[int],
) -> dict[str, Any]:
    """Return the receipt as it is sent."""
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
