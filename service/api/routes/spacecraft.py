"""Spacecraft of the catalogue."""

from collections.abc import Sequence
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Request, Response

from service.api.access.auth import MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.epoch_limits import EpochLimits
from service.api.context.plan_widths import PlanWidths
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.merge_patch import MergePatch, patched
from service.api.schemas.base import CatalogueWarning, RowList
from service.api.schemas.spacecraft import SPACECRAFT_ADAPTER, SpacecraftAnswer, SpacecraftDocument
from service.api.views.catalogue_findings import accepted_findings
from service.errors import ConflictError, FieldError
from service.pipeline.inputs.catalogue_checks import Position, check_positions

router = APIRouter(prefix="/spacecraft", tags=["catalogue"])


class SpacecraftList(RowList):
    """All spacecraft in order of id."""

    rows: list[SpacecraftDocument]


@router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE], openapi_extra=accepts(SpacecraftDocument))
def create_spacecraft(
    body: Annotated[SpacecraftDocument, body_of(SpacecraftDocument)], context: Context, response: Response
) -> SpacecraftAnswer:
    """Add a spacecraft; 409 when its id exists or has existed."""
    if "mode" in body.control.model_fields_set:
        _check_ground_control(body)
    _check_gains(body)
    _check_release(body, None)
    warnings = _site_warnings(body)
    context.storage.catalogue.add_spacecraft(body.to_record())
    context.on_accepted(body.id)
    response.headers["Location"] = f"/api/v1/spacecraft/{body.id}"
    return _answer(body, warnings)


@router.get("")
def list_spacecraft(context: Context) -> SpacecraftList:
    """List all spacecraft."""
    return SpacecraftList(rows=[SpacecraftDocument.of(record) for record in context.storage.catalogue.all_spacecraft()])


@router.get("/{spacecraft_id}")
def get_spacecraft(spacecraft_id: SpacecraftId, context: Context) -> SpacecraftDocument:
    """Return one spacecraft with all defaults filled in."""
    return SpacecraftDocument.of(context.storage.catalogue.spacecraft(spacecraft_id))


@router.patch("/{spacecraft_id}", dependencies=[MAY_OPERATE], openapi_extra=accepts(MergePatch))
def change_spacecraft(
    spacecraft_id: SpacecraftId, body: Annotated[MergePatch, body_of(MergePatch)], context: Context, request: Request
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
    warnings = _site_warnings(changed) if {"longitude_deg", "receiving_site"} & set(body.root) else []
    if {"control", "inertia_kg_m2", "torque_limit_n_m", "wheels"} & set(body.root):
        _check_gains(changed)
    context.storage.catalogue.replace_spacecraft(changed.to_record())
    epoch_limits: EpochLimits = request.app.state.epoch_limits
    epoch_limits.forget(spacecraft_id)
    context.on_accepted(spacecraft_id)
    return _answer(changed, warnings)


@router.delete("/{spacecraft_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_spacecraft(spacecraft_id: SpacecraftId, context: Context, request: Request) -> None:
    """Delete a spacecraft that never had a measurement; its id is not given again."""
    context.storage.catalogue.delete_spacecraft(spacecraft_id)
    epoch_limits: EpochLimits = request.app.state.epoch_limits
    epoch_limits.forget(spacecraft_id)
    plan_widths: PlanWidths = request.app.state.plan_widths
    plan_widths.forget(spacecraft_id)


def _answer(document: SpacecraftDocument, warnings: Sequence[CatalogueWarning]) -> SpacecraftAnswer:
    """Return a stored spacecraft with what is doubtful about it."""
    return SpacecraftAnswer(**dict(document), warnings=tuple(warnings))


def _site_warnings(document: SpacecraftDocument) -> list[CatalogueWarning]:
    """Return what is doubtful about the receiving site; 422 when it has the satellite below its horizon."""
    site = document.receiving_site
    position = Position("/receiving_site", site.latitude_deg, site.longitude_deg, site.height_m)
    return accepted_findings(check_positions([position], document.longitude_deg))


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
