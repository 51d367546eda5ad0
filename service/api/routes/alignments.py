"""Alignments: the step after which no outside angle reaches the estimator."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal
from service.api.access.principals import Permission, Principal
from service.api.context.dependencies import Context, SpacecraftId
from service.api.problems.problems import RequestProblemError
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.alignments import AlignmentAnswer, AlignmentDocument, AlignmentList, AlignmentMadeAnswer

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alignments", tags=["calibration"])


@router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE], openapi_extra=accepts(AlignmentDocument))
def align(
    spacecraft_id: SpacecraftId,
    body: Annotated[AlignmentDocument, body_of(AlignmentDocument)],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> AlignmentMadeAnswer:
    """Set angles and reference powers of every method; angles by hand need an approver's key.

    Rows that an earlier alignment computed stay, also at the same epoch: `rows_kept`.
    """
    if body.is_manual:
        _require_approver(principal)
    alignment = context.aligner.align(spacecraft_id, body.to_request(principal.name))
    recomputed, kept = context.storage.results.rows_after(spacecraft_id, alignment)
    context.supervisor.notify(spacecraft_id)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/alignments/{alignment.id}"
    return AlignmentMadeAnswer.of(alignment, rows_recomputed=recomputed, rows_kept=kept)


@router.get("")
def list_alignments(spacecraft_id: SpacecraftId, context: Context) -> AlignmentList:
    """List alignments, newest first; the newest holds."""
    found = context.storage.results.alignments(spacecraft_id)
    return AlignmentList(rows=[AlignmentAnswer.of(alignment) for alignment in found])


@router.get("/{alignment_id}")
def get_alignment(
    spacecraft_id: SpacecraftId, alignment_id: Annotated[int, Path(ge=1, le=2**31 - 1)], context: Context
) -> AlignmentAnswer:
    """Return one alignment."""
    return AlignmentAnswer.of(context.storage.results.alignment(spacecraft_id, alignment_id))


def _require_approver(principal: Principal) -> None:
    """Refuse angles by hand from a key that may not approve."""
    if not principal.may(Permission.APPROVE):
        detail = f"angles by hand need an approver's key, this one has the role {principal.role}"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "key.forbidden", detail)
