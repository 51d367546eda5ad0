"""Angles for uplink: what a spacecraft in mode onboard takes in place of its sensors."""

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.schemas.torque_commands import UplinkAnswer

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/attitude", tags=["release of torques"])


@router.get("/uplink")
def get_attitude_uplink(spacecraft_id: SpacecraftId, context: Context) -> UplinkAnswer:
    """Return the newest angles for a spacecraft in mode onboard, with their counter and how long they hold."""
    return UplinkAnswer.of(context.release_service.attitude_uplink(spacecraft_id))
