"""Jobs as operators see them."""

from service.api.context.dependencies import ApiContext
from service.api.schemas.jobs import JobAnswer
from service.records.operations.job import Job

#: path below which results of closed loops stand, each under the id of its job
RESULTS = "/api/v1/analyses/closed-loop"


def job_answer(context: ApiContext, job: Job) -> JobAnswer:
    """Return a job with the path of its result."""
    has_result = context.flights.result(job.id) is not None
    return JobAnswer.of(job, result=f"{RESULTS}/{job.id}" if has_result else None)
