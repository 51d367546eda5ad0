"""Documents of jobs."""

from service.api.schemas.base import Answer
from service.api.schemas.record_answers import members_of
from service.records.operations.job import Job


class JobAnswer(members_of(Job, number=float), Answer):
    """One piece of long work."""

    result: str | None
    """Path of its result while that is kept; null for jobs whose result is another resource."""
