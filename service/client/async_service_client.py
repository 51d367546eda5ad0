"""Client for event loops: the methods of `service.client.endpoints`, each to be awaited."""

import asyncio
from collections.abc import Callable

from service.client.async_transport import AsyncTransport
from service.client.call import JobWatch
from service.client.documents import JobReply
from service.client.endpoints import Endpoints
from service.client.service_client import ServiceClient


class AsyncServiceClient(AsyncTransport, Endpoints):
    """Client of one service for programs that run an event loop.

    Options are those of `service.client.async_transport.AsyncTransport`.

    Parameters
    ----------
    service_url : str
        For example ``http://127.0.0.1:8000``.
    key : str or None
        Bearer key.

    Examples
    --------
    ::

        async with AsyncServiceClient("http://127.0.0.1:8000", "key") as client:
            async for event in client.stream("yamal-202"):
                print(event.kind, event.data)
    """

    async def wait_job(  # noqa: D102 below
        self,
        job_id: str,
        *,
        timeout_s: float = 600.0,
        poll_s: float = 0.2,
        on_progress: Callable[[float], None] | None = None,
    ) -> JobReply:
        watch = JobWatch(job_id, timeout_s, on_progress)
        while not watch.is_done(job := await self.job(job_id)):
            await asyncio.sleep(poll_s)
        return job

    wait_job.__doc__ = ServiceClient.wait_job.__doc__
