"""Jobs: how far long work is."""

from typing import Annotated

from fastapi import APIRouter, Path

from service.api.context.dependencies import Context
from service.api.schemas.jobs import JobAnswer
from service.api.views.jobs import job_answer

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.get("/{job_id}")
def get_job(job_id: Annotated[str, Path(max_length=64)], context: Context) -> JobAnswer:
    """Return how far a job is."""
    return job_answer(context, context.storage.results.job(job_id))
