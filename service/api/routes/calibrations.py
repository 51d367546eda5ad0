"""Calibrations: made by a job, looked at, then made the active one."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal
from service.api.context.dependencies import ApiContext, Context, SpacecraftId
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.calibrations import (
    CalibrationAnswer,
    CalibrationDocument,
    CalibrationList,
    CalibrationStartedAnswer,
)
from service.records.calibration import Calibration

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/calibrations", tags=["calibration"])
CalibrationId = Annotated[int, Path(ge=1, le=2**31 - 1)]


@router.post(
    "",
    status_code=HTTPStatus.ACCEPTED,
    dependencies=[MAY_OPERATE],
    openapi_extra=accepts(CalibrationDocument),
)
def start_calibration(
    spacecraft_id: SpacecraftId,
    body: Annotated[CalibrationDocument, body_of(CalibrationDocument)],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> CalibrationStartedAnswer:
    """Start a calibration; its job shows when the draft is complete."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    draft, job = context.calibrator.start(spacecraft_id, body.to_record(), principal.name)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/calibrations/{draft.id}"
    return CalibrationStartedAnswer(id=draft.id, job=job.id)


@router.get("")
def list_calibrations(spacecraft_id: SpacecraftId, context: Context) -> CalibrationList:
    """List calibrations, newest first."""
    found = context.storage.results.calibrations(spacecraft_id)
    return CalibrationList(rows=[_answer(context, spacecraft_id, calibration) for calibration in found])


@router.get("/{calibration_id}")
def get_calibration(spacecraft_id: SpacecraftId, calibration_id: CalibrationId, context: Context) -> CalibrationAnswer:
    """Return one calibration."""
    return _answer(context, spacecraft_id, context.storage.results.calibration(spacecraft_id, calibration_id))


@router.delete("/{calibration_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_calibration(spacecraft_id: SpacecraftId, calibration_id: CalibrationId, context: Context) -> None:
    """Delete a draft or a failed calibration; its number is not given again."""
    context.storage.results.delete_calibration(spacecraft_id, calibration_id)


@router.post("/{calibration_id}:activate", dependencies=[MAY_OPERATE])
def activate_calibration(
    spacecraft_id: SpacecraftId, calibration_id: CalibrationId, context: Context
) -> CalibrationAnswer:
    """Make a calibration the active one of its method; the one before it is superseded, history stays."""
    calibration = context.calibrator.activate(spacecraft_id, calibration_id)
    context.supervisor.notify(spacecraft_id)
    return CalibrationAnswer.of(calibration)


def _answer(context: ApiContext, spacecraft_id: str, calibration: Calibration) -> CalibrationAnswer:
    return CalibrationAnswer.of(calibration, job=context.calibrator.job_id(spacecraft_id, calibration.id))
