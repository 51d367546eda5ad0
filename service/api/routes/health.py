"""Outside the base path: whether the process lives, whether it can keep what it is sent, and the reference page."""

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from pydantic import BaseModel

from service.api.deps import Context
from service.api.reference_page import render_page

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


@router.get("/docs", include_in_schema=False)
def get_reference(request: Request) -> HTMLResponse:
    """Return the reference of this interface as a page."""
    return HTMLResponse(render_page(request.app.openapi()))
