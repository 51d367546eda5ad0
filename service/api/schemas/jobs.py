"""Documents of jobs."""

from typing import Self

from service.api.schemas.base import Answer, EpochAnswer
from service.records.operations.job import Job, JobState


class JobAnswer(Answer):
    """One piece of long work."""

    id: str
    kind: str
    state: JobState
    progress: float
    """0..1"""
    created_at: EpochAnswer
    error: str | None
    """Why it failed, and what to do."""
    result: str | None
    """Path of its result while that is kept; null for jobs whose result is another resource."""

    @classmethod
    def of(cls, job: Job, result: str | None = None) -> Self:
        """Return the answer for a job."""
        return super().of(job, result=result)
