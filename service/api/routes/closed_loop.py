"""Closed loops in the orbital frame: flown in a job, read while the result is kept. Nothing is stored but the job."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.context.dependencies import Context
from service.api.problems.problems import RequestProblemError
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.closed_loop import ClosedLoopAnswer, ClosedLoopDocument, ClosedLoopStartedAnswer
from service.api.views.jobs import RESULTS
from service.records.operations.job import JobState
from service.runtime.jobs.flight_analysis_job import KIND, MOST_RESULTS

router = APIRouter(prefix="/analyses/closed-loop", tags=["analyses"])


@router.post("", status_code=HTTPStatus.ACCEPTED, openapi_extra=accepts(ClosedLoopDocument))
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


@router.get("/{job_id}")
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
