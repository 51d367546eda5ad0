"""Work in other processes: analyses, closed loops, replays, and the jobs that run them."""

import asyncio
import math
from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Path, Response

from service.api.access.auth import MAY_OPERATE
from service.api.context import Context, SpacecraftId
from service.api.problems.problems import RequestProblemError
from service.api.protocol.paging import Page
from service.api.protocol.requests import accepts, body_of
from service.api.schemas.access import JobAnswer
from service.api.schemas.analyses import (
    CaptureAnswer,
    CaptureDocument,
    ClosedLoopAnswer,
    ClosedLoopDocument,
    ClosedLoopStartedAnswer,
    LimitCycleAnswer,
    LimitCycleDocument,
    ScheduleAnswer,
    ScheduleDocument,
)
from service.api.schemas.calibrations import ReplayAnswer, ReplayDocument, ReplayPage, ReplayStartedAnswer
from service.api.views.present import RESULTS, job_answer
from service.core.flexible.capture import analyse_capture
from service.core.flexible.limit_cycle import analyse_limit_cycle
from service.core.flexible.schedule import analyse_schedule
from service.records.operations.work import JobState
from service.runtime.jobs.flight_analysis_job import KIND, MOST_RESULTS
from service.runtime.jobs.workers import Workers


async def _room(context: Context) -> None:
    """Refuse an analysis that could not be queued, before its body is decoded."""
    context.workers.check_room()


analyses_router = APIRouter(prefix="/analyses", tags=["analyses"], dependencies=[Depends(_room)])
Found = TypeVar("Found")


@analyses_router.post("/limit-cycle", openapi_extra=accepts(LimitCycleDocument))
async def limit_cycle(
    body: Annotated[LimitCycleDocument, body_of(LimitCycleDocument)], context: Context
) -> LimitCycleAnswer:
    """Return limit cycles, multipliers and the succession map of a relay of pulses on a wheel."""
    return LimitCycleAnswer.of(await _computed(context.workers, analyse_limit_cycle, body.model_dump()))


@analyses_router.post("/capture-boundary", openapi_extra=accepts(CaptureDocument))
async def capture_boundary(
    body: Annotated[CaptureDocument, body_of(CaptureDocument)], context: Context
) -> CaptureAnswer:
    """Return the swing above which a flexible mode captures the regulator, and the verdict on one swing."""
    given = body.model_dump()
    given["pulse_s"] = math.inf if body.pulse_s is None else body.pulse_s
    return CaptureAnswer.of(await _computed(context.workers, analyse_capture, given))


@analyses_router.post("/torque-schedule", openapi_extra=accepts(ScheduleDocument))
async def torque_schedule(
    body: Annotated[ScheduleDocument, body_of(ScheduleDocument)], context: Context
) -> ScheduleAnswer:
    """Return whether a torque schedule may be sent without exciting flexible modes, and what would be better."""
    given = body.model_dump(exclude={"pulses", "modes", "carried"})
    given["pulse_s"] = math.inf if body.pulse_s is None else body.pulse_s
    limit = body.momentum_limit_n_m_s
    given["momentum_limit_n_m_s"] = math.inf if limit is None else limit
    given["pulses"] = tuple((each.start_s, each.duration_s, each.torque_n_m) for each in body.pulses)
    given["modes"] = tuple((each.omega_rad_s, each.damping_ratio, each.coupling) for each in body.modes)
    if body.carried is not None:
        given["carried_rad"] = tuple(complex(each.re, each.im) for each in body.carried)
    return ScheduleAnswer.of(await _computed(context.workers, analyse_schedule, given))


async def _computed(workers: Workers, work: Callable[..., Found], given: dict[str, Any]) -> Found:
    """Return the result of a worker process; an unphysical parameter becomes a 422 that names it and the reason."""
    try:
        return await asyncio.wrap_future(workers.analyse(work, **given))
    except (ValueError, ArithmeticError) as error:
        raise RequestProblemError(
            HTTPStatus.UNPROCESSABLE_ENTITY, "analysis.not_physical", str(error)[:1000]
        ) from error


closed_loop_router = APIRouter(prefix="/analyses/closed-loop", tags=["analyses"])


@closed_loop_router.post("", status_code=HTTPStatus.ACCEPTED, openapi_extra=accepts(ClosedLoopDocument))
def start_closed_loop(
    body: Annotated[ClosedLoopDocument, body_of(ClosedLoopDocument)], context: Context, response: Response
) -> ClosedLoopStartedAnswer:
    """Fly a spacecraft in the orbital frame under the gyro-orbitant law; the job shows when its result can be read."""
    try:
        job = context.flights.start(body.to_request(), body.points)
    except ValueError as error:
        raise RequestProblemError(
            HTTPStatus.UNPROCESSABLE_ENTITY, "analysis.not_physical", str(error)[:1000]
        ) from error
    response.headers["Location"] = f"/api/v1/jobs/{job.id}"
    return ClosedLoopStartedAnswer(job=job.id, result=f"{RESULTS}/{job.id}")


@closed_loop_router.get("/{job_id}")
def get_closed_loop(job_id: Annotated[str, Path(max_length=64)], context: Context) -> ClosedLoopAnswer:
    """Return time series and figures of merit of a flight that is over."""
    found = context.flights.result(job_id)
    if found is not None:
        return ClosedLoopAnswer.of(job_id, found)
    job = context.storage.results.job(job_id)
    if job.kind != KIND:
        raise RequestProblemError(HTTPStatus.NOT_FOUND, "job.unknown", f"job {job_id} is no closed loop")
    if job.state is JobState.FAILED:
        raise RequestProblemError(
            HTTPStatus.CONFLICT, "analysis.failed", f"the flight failed: {job.error or ''}"[:1000]
        )
    if job.state is not JobState.DONE:
        detail = f"the flight is {job.state.value}"
        raise RequestProblemError(HTTPStatus.CONFLICT, "analysis.unfinished", detail)
    detail = f"the newest {MOST_RESULTS} results are kept until the service ends"
    raise RequestProblemError(HTTPStatus.GONE, "analysis.gone", detail)


jobs_router = APIRouter(prefix="/jobs", tags=["jobs"])


@jobs_router.get("/{job_id}")
def get_job(job_id: Annotated[str, Path(max_length=64)], context: Context) -> JobAnswer:
    """Return how far a job is."""
    return job_answer(context, context.storage.results.job(job_id))


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
