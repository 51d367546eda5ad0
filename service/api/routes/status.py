"""Status: what is newest, what is pending, what is in force."""

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.schemas.status import StatusAnswer
from service.api.views.status import status_of

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/status", tags=["status"])


@router.get("")
def get_status(spacecraft_id: SpacecraftId, context: Context) -> StatusAnswer:
    """Return the state of a spacecraft."""
    return status_of(context, spacecraft_id)
