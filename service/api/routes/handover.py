"""Hand-over: what the next shift must know."""

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.schemas.handover import HandoverAnswer
from service.api.views.handover import handover_of

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/handover", tags=["shift log"])


@router.get("")
def get_handover(spacecraft_id: SpacecraftId, context: Context) -> HandoverAnswer:
    """Return alarms, control, ages, links, missing rows and newest notes of a spacecraft."""
    return handover_of(context, spacecraft_id)
