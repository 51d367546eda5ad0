"""Health: whether the process lives, and whether it can keep what it is sent."""

from fastapi import APIRouter
from pydantic import BaseModel

from service.api.deps import Context

router = APIRouter(tags=["health"])


class HealthAnswer(BaseModel):
    """State of the service."""

    status: str


@router.get("/healthz")
async def get_health() -> HealthAnswer:
    """Tell that the process lives."""
    return HealthAnswer(status="ok")


@router.get("/readyz")
def get_readiness(context: Context) -> HealthAnswer:
    """Tell whether the database answers; 503 with Retry-After when it does not."""
    context.storage.check()
    return HealthAnswer(status="ready")
