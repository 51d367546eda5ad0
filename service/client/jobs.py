"""Waiting for a job of the service: what counts as done, as failed, as too long."""

import time
from collections.abc import Callable

from service.client.documents import JobReply
from service.client.problem import ClientError


class JobFailedError(ClientError):
    """A job of the service ended with an error, or made no progress for long."""


class JobWatch:
    """Judges one look at a job after another.

    Parameters
    ----------
    job_id : str
        Names the job in errors.
    timeout_s : float
        Bound on the wait without progress: a replay of years takes longer than any bound on the whole.
    on_progress : callable, optional
        Gets the progress 0..1 at every look.
    """

    def __init__(self, job_id: str, timeout_s: float, on_progress: Callable[[float], None] | None) -> None:
        self._job_id = job_id
        self._timeout_s = timeout_s
        self._deadline_s = time.monotonic() + timeout_s
        self._on_progress = on_progress
        self._progress = 0.0

    def is_done(self, job: JobReply) -> bool:
        """Return whether a job is done; JobFailedError when it failed or stands still."""
        progress = float(job.get("progress") or 0.0)
        if progress > self._progress:
            self._progress, self._deadline_s = progress, time.monotonic() + self._timeout_s
        if self._on_progress is not None:
            self._on_progress(progress)
        if job["state"] == "failed":
            message = f"job {self._job_id} failed: {job.get('error')}"
            raise JobFailedError(message)
        if job["state"] != "done" and time.monotonic() > self._deadline_s:
            message = f"job {self._job_id} is {job['state']}, without progress for {self._timeout_s:g} s"
            raise JobFailedError(message)
        return job["state"] == "done"
