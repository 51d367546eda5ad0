"""Ephemerides: node passages, two-line elements or OEM in, node passages and track out; versions are kept."""

from typing import Annotated

from fastapi import APIRouter, Query, Request

from service.api.access.audit_context import note_choice
from service.api.access.auth import MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.ephemeris import EphemerisAnswer, EphemerisDocument, EphemerisReceiptAnswer
from service.errors import FieldError, InvalidInputError
from service.pipeline.inputs.catalogue_checks import contradiction_of
from service.records.catalogue import Ephemeris

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/ephemeris", tags=["catalogue"])


@router.put("", dependencies=[MAY_OPERATE], openapi_extra=accepts(EphemerisDocument))
def put_ephemeris(
    spacecraft_id: SpacecraftId,
    body: Annotated[EphemerisDocument, body_of(EphemerisDocument)],
    context: Context,
    request: Request,
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


@router.get("")
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
    """Return the pointer to the form that was given."""
    return "/tle" if body.tle is not None else "/oem" if body.oem is not None else "/ascending_nodes"
