"""Outside the base path: whether the process lives, whether it can keep what it is sent, figures, reference page."""

from http import HTTPStatus
from typing import Literal

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from service.api.access.auth import authenticated, known_or_counted
from service.api.context.dependencies import Context
from service.api.monitoring.metrics import MEDIA_TYPE, Metrics
from service.api.monitoring.readiness import SharedReadiness, require_ready
from service.api.protocol.reference_page import render_page
from service.runtime.live.chain_restart import Restarting

router = APIRouter(tags=["health"])


class HealthAnswer(BaseModel):
    """State of the process."""

    status: Literal["ok"] = "ok"


class PartHealth(BaseModel):
    """One part of the service that is ready."""

    name: str
    detail: str


class CatchingUp(BaseModel):
    """Chain that consumes its journal again after a restart: its newest row grows old meanwhile, rows are kept."""

    spacecraft: str
    rows_left: int
    seconds_left: float | None
    """At the pace so far; null at the beginning."""


class Leader(BaseModel):
    """Process that estimates, alarms and releases a spacecraft."""

    spacecraft: str
    process: str


class ReadinessAnswer(BaseModel):
    """State of a service that is ready; one that is not answers 503 with a problem that names the parts."""

    status: Literal["ready"] = "ready"
    parts: list[PartHealth]
    catching_up: CatchingUp | None = None
    leaders: list[Leader] = []
    """Of the spacecraft of an archive on a server; one that is missing is led by nobody."""


@router.get("/healthz")
async def get_health() -> HealthAnswer:
    """Tell that the process lives."""
    return HealthAnswer()


@router.get("/readyz")
async def get_readiness(request: Request, context: Context) -> ReadinessAnswer:
    """Tell whether every part is ready: database, disk, consumers; 503 names those that are not.

    A service that catches up after a restart is ready: it keeps what it is sent.
    """
    readiness: SharedReadiness = request.app.state.readiness
    parts = await readiness.parts()
    require_ready(parts)
    restarting = context.supervisor.restarts.under_way
    leaders = await run_in_threadpool(context.leaders)
    return ReadinessAnswer(
        parts=[PartHealth(name=part.name, detail=part.detail) for part in parts],
        catching_up=None if restarting is None else _catching_up(restarting),
        leaders=[Leader(spacecraft=name, process=process) for name, process in sorted(leaders.items()) if name],
    )


def _catching_up(restarting: Restarting) -> CatchingUp:
    """Return what is told of a restart under way."""
    return CatchingUp(
        spacecraft=restarting.spacecraft_id, rows_left=restarting.entries_left, seconds_left=restarting.seconds_left
    )


@router.get(
    "/metrics",
    response_class=Response,
    responses={HTTPStatus.OK: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Metrics"}},
)
async def get_metrics(request: Request, context: Context) -> Response:
    """Return the figures of the service in the text form of Prometheus; a key is needed by setting only."""
    # the key first: wrong ones of others behind the same address keep no holder of a valid one out
    await (authenticated if context.monitoring.metrics_need_key else known_or_counted)(request)
    metrics: Metrics = request.app.state.metrics
    return Response(await run_in_threadpool(metrics.render), media_type=MEDIA_TYPE)


@router.get("/docs", include_in_schema=False)
def get_reference(request: Request) -> HTMLResponse:
    """Return the reference of this interface as a page."""
    return HTMLResponse(render_page(request.app.openapi()))
