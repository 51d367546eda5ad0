"""Catalogue: spacecraft, carrier plans, ephemerides; sources of measurements."""

import json
import re
from collections.abc import Sequence
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from service.api.access.auth import MAY_OPERATE, note_choice
from service.api.context import Context, Epochs, SpacecraftId, Widths
from service.api.problems.problems import MAX_FAULTS, invalid_request
from service.api.protocol.requests import (
    Body,
    MergePatch,
    accepts,
    decode,
    is_json,
    media_type,
    patched,
    raw_body,
    unsupported_media,
)
from service.api.schemas.base import NAME_PATTERN, CatalogueWarning, RowList
from service.api.schemas.catalogue import (
    CARRIER_PLAN_ADAPTER,
    SPACECRAFT_ADAPTER,
    CarrierPlanAnswer,
    CarrierPlanDocument,
    EphemerisAnswer,
    EphemerisDocument,
    EphemerisReceiptAnswer,
    PlanReceiptAnswer,
    SpacecraftAnswer,
    SpacecraftDocument,
    content_digest,
)
from service.api.schemas.measurements import SourceAnswer, SourceListAnswer
from service.errors import ConflictError, FieldError, InvalidInputError, NotFoundError
from service.formats.carrier_plan_csv import read_carrier_plan, write_carrier_plan
from service.pipeline.inputs.catalogue_checks import (
    CatalogueFindings,
    Position,
    check_carriers,
    check_positions,
    contradiction_of,
)
from service.records.catalogue import ControlMode, Ephemeris, Method

carriers_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carriers", tags=["catalogue"])
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


@carriers_router.put("", dependencies=[MAY_OPERATE], openapi_extra=accepts(CarrierPlanDocument, is_csv=True))
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


@carriers_router.get("", response_model=CarrierPlanAnswer, responses=_CSV_ANSWER)
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


@carriers_router.post("/{plan_id}:withdraw", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def withdraw_carriers(
    spacecraft_id: SpacecraftId, plan_id: Annotated[int, Path(ge=1, le=2**31 - 1)], context: Context, widths: Widths
) -> None:
    """Withdraw a plan without rows; the newest of the others holds again, its number is not given again."""
    context.storage.catalogue.withdraw_plan(spacecraft_id, plan_id)
    widths.forget(spacecraft_id)
    context.on_accepted(spacecraft_id)


ephemeris_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/ephemeris", tags=["catalogue"])


@ephemeris_router.put("", dependencies=[MAY_OPERATE])
def put_ephemeris(
    spacecraft_id: SpacecraftId, body: Body[EphemerisDocument], context: Context, request: Request
) -> EphemerisReceiptAnswer:
    """Put an ephemeris; it holds from here on, the former ones stay."""
    # an unknown spacecraft is a 404 whatever the orbit says
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    ephemeris = _ephemeris_of(body)
    contradiction = contradiction_of(ephemeris, spacecraft.longitude_deg)
    if body.relocating:
        note_choice(request.scope, "relocating=true")
    elif contradiction is not None:
        detail = contradiction
        raise invalid_request([FieldError(_pointer(body), "ephemeris.contradicts_catalogue", detail)])
    stored = context.storage.catalogue.put_ephemeris(spacecraft_id, ephemeris)
    context.on_accepted(spacecraft_id)
    return EphemerisReceiptAnswer.of(stored)


@ephemeris_router.get("")
def get_ephemeris(
    spacecraft_id: SpacecraftId,
    context: Context,
    ephemeris_id: Annotated[int | None, Query(ge=1, le=2**31 - 1, description="The newest by default")] = None,
) -> EphemerisAnswer:
    """Return an ephemeris with its track."""
    return EphemerisAnswer.of(context.storage.catalogue.ephemeris(spacecraft_id, ephemeris_id))


def _ephemeris_of(body: EphemerisDocument) -> Ephemeris:
    """Return the ephemeris that a document states; faults point to the form that was given."""
    try:
        return body.to_record()
    except InvalidInputError as error:
        field = FieldError("/track" if error.code == "ephemeris.track" else _pointer(body), error.code, error.detail)
        raise InvalidInputError(error.code, error.detail, (field,)) from None


def _pointer(body: EphemerisDocument) -> str:
    return "/tle" if body.tle is not None else "/oem" if body.oem is not None else "/ascending_nodes"


_NAME = re.compile(NAME_PATTERN.strip("^$"), re.ASCII)
sources_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/sources", tags=["measurements"])


@sources_router.get("")
def list_sources(spacecraft_id: SpacecraftId, context: Context) -> SourceListAnswer:
    """List the sources seen so far."""
    return SourceListAnswer(rows=[SourceAnswer.of(state) for state in context.storage.archive.sources(spacecraft_id)])


@sources_router.post("/{source}:select", dependencies=[MAY_OPERATE])
def select_source(
    spacecraft_id: SpacecraftId, source: Annotated[str, Path(description="Id of a source")], context: Context
) -> SourceAnswer:
    """Make a source the prime one; its rows feed the estimator from now on."""
    if _NAME.fullmatch(source) is None:  # a name that cannot exist never reaches the database
        raise NotFoundError("source.unknown", f"no source {source[:64]!r}")
    state = context.storage.archive.select_source(spacecraft_id, source)
    context.on_accepted(spacecraft_id)
    return SourceAnswer.of(state)


spacecraft_router = APIRouter(prefix="/spacecraft", tags=["catalogue"])


class SpacecraftList(RowList[SpacecraftDocument]):
    """All spacecraft in order of id."""


@spacecraft_router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE])
def create_spacecraft(body: Body[SpacecraftDocument], context: Context, response: Response) -> SpacecraftAnswer:
    """Add a spacecraft; 409 when its id exists or has existed."""
    if "mode" in body.control.model_fields_set:
        _check_ground_control(body)
    _check_gains(body)
    _check_release(body, None)
    warnings = (*_site_warnings(body), *_control_warnings(body))
    context.storage.catalogue.add_spacecraft(body.to_record())
    context.on_accepted(body.id)
    response.headers["Location"] = f"/api/v1/spacecraft/{body.id}"
    return _answer(body, warnings)


@spacecraft_router.get("")
def list_spacecraft(context: Context) -> SpacecraftList:
    """List all spacecraft."""
    return SpacecraftList(rows=[SpacecraftDocument.of(record) for record in context.storage.catalogue.all_spacecraft()])


@spacecraft_router.get("/{spacecraft_id}")
def get_spacecraft(spacecraft_id: SpacecraftId, context: Context) -> SpacecraftDocument:
    """Return one spacecraft with all defaults filled in."""
    return SpacecraftDocument.of(context.storage.catalogue.spacecraft(spacecraft_id))


@spacecraft_router.patch("/{spacecraft_id}", dependencies=[MAY_OPERATE])
def change_spacecraft(
    spacecraft_id: SpacecraftId, body: Body[MergePatch], context: Context, epochs: Epochs
) -> SpacecraftAnswer:
    """Change fields of a spacecraft, the others stay; what POST accepts with these fields, PATCH accepts too."""
    stored = SpacecraftDocument.of(context.storage.catalogue.spacecraft(spacecraft_id))
    changed = patched(SPACECRAFT_ADAPTER, stored.model_dump(mode="json"), body)
    if changed.id != spacecraft_id:
        detail = "the id of a spacecraft cannot change"
        raise invalid_request([FieldError("/id", "spacecraft.id_fixed", detail)])
    if changed.simulated != stored.simulated and context.storage.archive.sources(stored.id):
        detail = f"{spacecraft_id!r} has measurements, so it stays {'simulated' if stored.simulated else 'a real one'}"
        raise ConflictError("spacecraft.simulated_fixed", detail)
    if not stored.lacks_fast_loop or "mode" in (body.root.get("control") or {}):
        _check_ground_control(changed)
    _check_release(changed, stored)
    about_control = _control_warnings(changed) if {"control", "onboard"} & set(body.root) else ()
    about_site = _site_warnings(changed) if {"longitude_deg", "receiving_site"} & set(body.root) else []
    if {"control", "inertia_kg_m2", "torque_limit_n_m", "wheels"} & set(body.root):
        _check_gains(changed)
    context.storage.catalogue.replace_spacecraft(changed.to_record())
    epochs.forget(spacecraft_id)
    context.on_accepted(spacecraft_id)
    return _answer(changed, (*about_site, *about_control))


@spacecraft_router.delete("/{spacecraft_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_spacecraft(spacecraft_id: SpacecraftId, context: Context, epochs: Epochs, widths: Widths) -> None:
    """Delete a spacecraft that never had a measurement; its id is not given again."""
    context.storage.catalogue.delete_spacecraft(spacecraft_id)
    epochs.forget(spacecraft_id)
    widths.forget(spacecraft_id)


def _answer(document: SpacecraftDocument, warnings: Sequence[CatalogueWarning]) -> SpacecraftAnswer:
    """Return a stored spacecraft with what is doubtful about it."""
    return SpacecraftAnswer(**dict(document), warnings=tuple(warnings))


def _site_warnings(document: SpacecraftDocument) -> list[CatalogueWarning]:
    """Return what is doubtful about the receiving site; 422 when it has the satellite below its horizon."""
    site = document.receiving_site
    position = Position("/receiving_site", site.latitude_deg, site.longitude_deg, site.height_m)
    return accepted_findings(check_positions([position], document.longitude_deg))


def _control_warnings(document: SpacecraftDocument) -> tuple[CatalogueWarning, ...]:
    """Return what is doubtful about the control of a document."""
    has_profile = document.onboard.fed_forward_torque is not None
    if document.control.method != Method.PAPER or document.control.mode == ControlMode.OFF or has_profile:
        return ()
    detail = (
        "in a loop the published method sees yaw through roll alone, where a torque without a stated profile hides it: "
        "roll and pitch hold, yaw left 8 deg within two days in half of the flights of two plants"
    )
    return (CatalogueWarning(pointer="/control/method", code="control.paper", detail=detail),)


def _check_release(document: SpacecraftDocument, stored: SpacecraftDocument | None) -> None:
    """Refuse that one operator lets torques go to a real spacecraft without a person."""
    if document.is_released_unattended and not (stored is not None and stored.is_released_unattended):
        detail = "release automatic of a real spacecraft needs two approvers"
        raise ConflictError("control.needs_two_approvers", detail)


def _check_gains(document: SpacecraftDocument) -> None:
    """Refuse gains that saturate, and those of the gyro-orbitant law that do not settle."""
    fault = document.fault_of_gains
    if fault is not None:
        raise invalid_request([FieldError("/control/period_s", "control.gains", fault)])
    fault = document.fault_of_gyro_orbitant
    if fault is not None:
        raise invalid_request([FieldError("/control/gyro_orbitant", "control.gyro_orbitant", fault)])


def _check_ground_control(document: SpacecraftDocument) -> None:
    """Refuse ground control of a spacecraft without a fast loop of its own."""
    if document.lacks_fast_loop:
        detail = (
            "mode ground needs onboard.fast_loop and onboard.forecast_mode; without a fast loop 1 N m s of stored "
            "momentum alone turns the spacecraft 0.3 deg in ten minutes"
        )
        raise invalid_request([FieldError("/control/mode", "control.no_fast_loop", detail)])


def accepted_findings(found: CatalogueFindings) -> list[CatalogueWarning]:
    """Return the warnings of what was found; a 422 names the faults when there are any."""
    if found.faults:
        raise invalid_request(found.faults[:MAX_FAULTS])
    return [CatalogueWarning.model_validate(warning) for warning in found.warnings]
