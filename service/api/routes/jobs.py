"""Jobs, and replays, which run as jobs."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.access.auth import MAY_OPERATE
from service.api.context import Context, SpacecraftId
from service.api.protocol.paging import Page
from service.api.protocol.requests import accepts, body_of
from service.api.schemas.access import JobAnswer
from service.api.schemas.calibrations import ReplayAnswer, ReplayDocument, ReplayPage, ReplayStartedAnswer

jobs_router = APIRouter(prefix="/jobs", tags=["jobs"])


@jobs_router.get("/{job_id}")
def get_job(job_id: Annotated[str, Path(max_length=64)], context: Context) -> JobAnswer:
    """Return how far a job is."""
    return JobAnswer.of(context.storage.results.job(job_id))


ReplayId = Annotated[int, Path(ge=1, le=2**31 - 1)]

replays_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/replays", tags=["replay"])


@replays_router.post(
    "", status_code=HTTPStatus.ACCEPTED, dependencies=[MAY_OPERATE], openapi_extra=accepts(ReplayDocument)
)
def start_replay(
    spacecraft_id: SpacecraftId,
    body: Annotated[ReplayDocument, body_of(ReplayDocument)],
    context: Context,
    response: Response,
) -> ReplayStartedAnswer:
    """Start a replay; its rows are read by ?version= on history and export."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    replay, job = context.replayer.start(spacecraft_id, body.to_replay())
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/replays/{replay.id}"
    return ReplayStartedAnswer(id=replay.id, job=job.id, version=replay.version)


@replays_router.get("")
def list_replays(spacecraft_id: SpacecraftId, page: Page, context: Context) -> ReplayPage:
    """List the replays whose span overlaps an interval, in order of their numbers."""
    after_id = None if page.after is None else page.after[1]
    read = context.storage.results.replays
    found = read(spacecraft_id, page.window, page.most, after_id, newest_first=page.newest_first)
    return page.answer(ReplayPage, found, lambda each: (0, each.replay.id), ReplayAnswer.of)


@replays_router.get("/{replay_id}")
def get_replay(spacecraft_id: SpacecraftId, replay_id: ReplayId, context: Context) -> ReplayAnswer:
    """Return one replay."""
    return ReplayAnswer.of(context.storage.results.replay(spacecraft_id, f"replay-{replay_id}"))


@replays_router.delete("/{replay_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def delete_replay(spacecraft_id: SpacecraftId, replay_id: ReplayId, context: Context) -> None:
    """Delete a replay and its rows, which nobody reads from now on; one that runs or waits ends."""
    context.storage.results.delete_replay(spacecraft_id, f"replay-{replay_id}")
