"""Blocking client: the methods of `service.client.endpoints`, each of which returns the answer itself."""

import time
from collections.abc import Callable

from service.client.call import Epoch, JobFailedError, JobWatch, StreamEvent, epoch_text
from service.client.documents import JobReply
from service.client.endpoints import Endpoints
from service.client.transport import Transport

__all__ = ["Epoch", "JobFailedError", "ServiceClient", "StreamEvent", "epoch_text"]


class ServiceClient(Transport, Endpoints):
    """Synchronous client of one service.

    Options are those of `service.client.transport.Transport`.

    Parameters
    ----------
    service_url : str
        For example ``http://127.0.0.1:8000``.
    key : str or None
        Bearer key.

    Examples
    --------
    >>> with ServiceClient("http://127.0.0.1:8000", "key") as client:
    ...     client.service_url
    'http://127.0.0.1:8000'
    """

    def wait_job(
        self,
        job_id: str,
        *,
        timeout_s: float = 600.0,
        poll_s: float = 0.2,
        on_progress: Callable[[float], None] | None = None,
    ) -> JobReply:
        """Return a job when it is done.

        Parameters
        ----------
        job_id : str
            From the answer that started it.
        timeout_s, poll_s : float
            Bound on the wait without progress, and time between two polls.
        on_progress : callable, optional
            Gets the progress 0..1 at every poll.

        Raises
        ------
        JobFailedError
            The job failed, or made no progress in time.
        """
        watch = JobWatch(job_id, timeout_s, on_progress)
        while not watch.is_done(job := self.job(job_id)):
            time.sleep(poll_s)
        return job
