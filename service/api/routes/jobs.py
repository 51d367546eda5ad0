"""Jobs: how far long work is."""

from typing import Annotated

from fastapi import APIRouter, Path

from service.api.context.dependencies import Context
from service.api.routes.closed_loop import RESULTS
from service.api.schemas.jobs import JobAnswer

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.get("/{job_id}")
def get_job(job_id: Annotated[str, Path(max_length=64)], context: Context) -> JobAnswer:
    """Return how far a job is."""
    job = context.storage.results.job(job_id)
    has_result = context.flights.result(job_id) is not None
    return JobAnswer.of(job, result=f"{RESULTS}/{job_id}" if has_result else None)
