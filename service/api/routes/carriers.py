"""Carrier plans, as JSON and as CSV in both directions."""

import json
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from service.api.access.auth import MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.plan_widths import PlanWidths
from service.api.protocol.bodies import accepts, decode, is_json, media_type, raw_body, unsupported_media
from service.api.schemas.carriers import (
    CARRIER_PLAN_ADAPTER,
    CarrierPlanAnswer,
    CarrierPlanDocument,
    PlanReceiptAnswer,
    content_digest,
)
from service.api.views.catalogue_findings import accepted_findings
from service.formats.carrier_plan_csv import read_carrier_plan, write_carrier_plan
from service.pipeline.inputs.catalogue_checks import check_carriers

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carriers", tags=["catalogue"])
_CSV = "text/csv"
_CSV_ANSWER: dict[int | str, dict[str, Any]] = {200: {"content": {_CSV: {"schema": {"type": "string"}}}}}


async def _plan_document(request: Request) -> CarrierPlanDocument:
    """Return the plan that a body states, in either form."""
    media = media_type(request)
    if media == _CSV:
        raw = await raw_body(request)
        documents = await run_in_threadpool(read_carrier_plan, raw)
        return decode(CARRIER_PLAN_ADAPTER, json.dumps({"carriers": documents}).encode())
    if not is_json(media):
        raise unsupported_media(f"application/json or {_CSV}")
    return decode(CARRIER_PLAN_ADAPTER, await raw_body(request))


@router.put("", dependencies=[MAY_OPERATE], openapi_extra=accepts(CarrierPlanDocument, is_csv=True))
def put_carriers(
    spacecraft_id: SpacecraftId, body: Annotated[CarrierPlanDocument, Depends(_plan_document)], context: Context
) -> PlanReceiptAnswer:
    """Put a carrier plan; the same content keeps its plan_id, any change makes a new plan."""
    carriers = body.to_records()
    longitude_deg = context.storage.catalogue.spacecraft(spacecraft_id).longitude_deg
    warnings = accepted_findings(check_carriers(carriers, longitude_deg))
    plan = context.storage.catalogue.put_plan(spacecraft_id, carriers, content_digest(carriers))
    context.on_accepted(spacecraft_id)
    return PlanReceiptAnswer(plan_id=plan.id, sha256=plan.sha256, carriers=len(plan.carriers), warnings=warnings)


@router.get("", response_model=CarrierPlanAnswer, responses=_CSV_ANSWER)
def get_carriers(
    spacecraft_id: SpacecraftId,
    context: Context,
    request: Request,
    plan_id: Annotated[int | None, Query(ge=1, le=2**31 - 1, description="The plan put last by default")] = None,
    form: Annotated[
        Literal["json", "csv"] | None, Query(alias="format", description="Overrides the Accept header")
    ] = None,
) -> Any:
    """Return a carrier plan, as CSV when the client accepts text/csv."""
    plan = context.storage.catalogue.plan(spacecraft_id, plan_id)
    wants_csv = _CSV in request.headers.get("accept", "").lower() if form is None else form == "csv"
    if not wants_csv:
        return CarrierPlanAnswer.of(plan)
    name = f"{spacecraft_id}-plan-{plan.id}.csv"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "X-Plan-Id": str(plan.id), "Vary": "Accept"}
    return Response(write_carrier_plan(plan.carriers), media_type=_CSV, headers=headers)


@router.post("/{plan_id}:withdraw", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def withdraw_carriers(
    spacecraft_id: SpacecraftId, plan_id: Annotated[int, Path(ge=1, le=2**31 - 1)], context: Context, request: Request
) -> None:
    """Withdraw a plan without rows; the newest of the others holds again, its number is not given again."""
    context.storage.catalogue.withdraw_plan(spacecraft_id, plan_id)
    plan_widths: PlanWidths = request.app.state.plan_widths
    plan_widths.forget(spacecraft_id)
    context.on_accepted(spacecraft_id)
