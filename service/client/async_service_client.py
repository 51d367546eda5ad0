"""The REST contract as methods to be awaited: those of `service.client.service_client`, for use in an event loop.

``tests/unit/service/client/test_async_service_client.py`` holds both to the same methods and the same requests.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, Self, cast

from service.client import endpoints
from service.client.async_transport import AsyncTransport
from service.client.call import Call, Epoch
from service.client.documents import Attitude, Job, Json, Measurement, PlanPut, Receipt, Status
from service.client.endpoints import PAGE_ROWS, Rows, below
from service.client.event_lines import Follower, StreamEvent
from service.client.jobs import JobWatch


class AsyncServiceClient:
    """Client of one service for programs that run an event loop.

    Parameters
    ----------
    service_url : str
        For example ``http://127.0.0.1:8000``.
    key : str or None
        Bearer key.
    **options
        Those of `service.client.async_transport.AsyncTransport`.

    Examples
    --------
    ::

        async with AsyncServiceClient("http://127.0.0.1:8000", "key") as client:
            async for event in client.stream("yamal-202"):
                print(event.kind, event.data)
    """

    def __init__(self, service_url: str, key: str | None = None, **options: Any) -> None:
        self.service_url = service_url
        self._transport = AsyncTransport(service_url, key, **options)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._transport.close()

    async def request(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        params: Mapping[str, Any] | None = None,
        is_keyed: bool = False,
    ) -> Any:
        """Send any request below ``/api/v1``; see `service.client.call.Call`."""
        call: Call[Any] = Call(method, path, body, params or {}, is_keyed)
        return await self._transport.send(call)

    def download(self, path: str, params: Mapping[str, Any] | None = None) -> AsyncIterator[bytes]:
        """Yield what an export streams; see `service.client.async_transport.AsyncTransport.download`."""
        return self._transport.download(path, params)

    async def pages(
        self, path: str, params: Mapping[str, Any] | None = None, *, rows: str = "rows"
    ) -> AsyncIterator[Json]:
        """Yield every row of a list below ``/api/v1``, page after page; ``rows`` names the field that holds them."""
        cursor: str | None = None
        while True:
            page = await self._transport.send(endpoints.page(path, params or {}, cursor))
            for row in page[rows]:
                yield row
            cursor = page.get("next")
            if not cursor:
                return

    def stream(
        self, spacecraft_id: str, *, last_event_id: str | None = None, patience_s: float | None = None
    ) -> AsyncIterator[StreamEvent]:
        """Yield what happens to a spacecraft, without end; lost connections are made anew where they broke off.

        Parameters
        ----------
        spacecraft_id : str
            Spacecraft.
        last_event_id : str, optional
            ``id`` of the last event that was dealt with; None starts with the present.
        patience_s : float, optional
            How long the service may be away at a stretch; None: for ever.
        """
        follower = Follower(last_event_id, patience_s)
        return self._transport.follow(below(spacecraft_id, "/stream"), follower)

    # Catalogue

    async def create_spacecraft(self, spacecraft: Mapping[str, Any]) -> Json:
        """Add a spacecraft."""
        return await self._transport.send(endpoints.create_spacecraft(spacecraft))

    async def spacecraft(self, spacecraft_id: str) -> Json:
        """Return one spacecraft."""
        return await self._transport.send(endpoints.spacecraft(spacecraft_id))

    async def put_carriers(self, spacecraft_id: str, carriers: Rows) -> PlanPut:
        """Store a carrier plan; the same content gives the same plan_id."""
        return await self._transport.send(endpoints.put_carriers(spacecraft_id, carriers))

    async def carriers(self, spacecraft_id: str, plan_id: int | None = None) -> Json:
        """Return the newest carrier plan, or the one with this number."""
        return await self._transport.send(endpoints.carriers(spacecraft_id, plan_id))

    async def put_ephemeris(self, spacecraft_id: str, ephemeris: Mapping[str, Any]) -> Json:
        """Store an ephemeris: nodes and period, TLE, or OEM."""
        return await self._transport.send(endpoints.put_ephemeris(spacecraft_id, ephemeris))

    # Into the service

    async def post_measurements(
        self,
        spacecraft_id: str,
        plan_id: int,
        measurements: Rows,
        *,
        source: str | None = None,
        first_seq: int | None = None,
    ) -> Receipt:
        """Send rows of carrier powers; repeating a batch is safe."""
        call = endpoints.post_measurements(spacecraft_id, plan_id, measurements, source, first_seq)
        return await self._transport.send(call)

    async def post_traces(self, spacecraft_id: str, source: str, traces: Rows) -> Json:
        """Send evidence traces of one source; repeating them is safe, the service keeps a ring of the newest."""
        return await self._transport.send(endpoints.post_traces(spacecraft_id, source, traces))

    async def report_links(self, links: Rows) -> list[Json]:
        """Report the state of links and return what the operator wants of each: id, enabled, reset."""
        return cast("list[Json]", (await self._transport.send(endpoints.report_links(links)))["links"])

    async def post_references(self, spacecraft_id: str, source: str, references: Rows) -> Json:
        """Send attitude references."""
        body = {"source": source, "references": list(references)}
        return await self._transport.send(endpoints.post_batch(spacecraft_id, "attitude-references", body))

    async def post_corrections(self, spacecraft_id: str, corrections: Rows) -> Json:
        """Send attitude changes commanded through other channels."""
        body = {"corrections": list(corrections)}
        return await self._transport.send(endpoints.post_batch(spacecraft_id, "corrections", body))

    async def post_operation(self, spacecraft_id: str, operation: Mapping[str, Any]) -> Json:
        """Announce an operation (station keeping, eclipse, carrier work)."""
        return await self._transport.send(endpoints.post_operation(spacecraft_id, operation))

    # Calibration and alignment

    async def start_calibration(self, spacecraft_id: str, calibration: Mapping[str, Any]) -> Json:
        """Start a calibration; the answer names its job."""
        return await self._transport.send(endpoints.start_calibration(spacecraft_id, calibration))

    async def calibration(self, spacecraft_id: str, calibration_id: int) -> Json:
        """Return one calibration with its carriers."""
        return await self._transport.send(endpoints.calibration(spacecraft_id, calibration_id))

    async def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> Json:
        """Make a calibration the active one of its method."""
        return await self._transport.send(endpoints.activate_calibration(spacecraft_id, calibration_id))

    async def align(self, spacecraft_id: str, alignment: Mapping[str, Any]) -> Json:
        """Tie the estimator to known angles."""
        return await self._transport.send(endpoints.align(spacecraft_id, alignment))

    async def job(self, job_id: str) -> Job:
        """Return the state and progress of a job."""
        return await self._transport.send(endpoints.job(job_id))

    async def wait_job(
        self,
        job_id: str,
        *,
        timeout_s: float = 600.0,
        poll_s: float = 0.2,
        on_progress: Callable[[float], None] | None = None,
    ) -> Job:
        """Return a job when it is done.

        Parameters
        ----------
        job_id : str
            From the answer that started it.
        timeout_s, poll_s : float
            Bound on the wait, and time between two looks.
        on_progress : callable, optional
            Gets the progress 0..1 at every look.

        Raises
        ------
        JobFailedError
            The job failed, or is not done in time.
        """
        watch = JobWatch(job_id, timeout_s, on_progress)
        while not watch.is_done(job := await self.job(job_id)):
            await asyncio.sleep(poll_s)
        return job

    # Out of the service

    async def status(self, spacecraft_id: str) -> Status:
        """Return what is newest, pending and in force."""
        return await self._transport.send(endpoints.status(spacecraft_id))

    async def measurements(self, spacecraft_id: str) -> Json:
        """Return the newest row of carrier powers."""
        return await self._transport.send(endpoints.measurements(spacecraft_id))

    async def attitude(self, spacecraft_id: str, method: str | None = None) -> Attitude:
        """Return the newest attitude."""
        return await self._transport.send(endpoints.attitude(spacecraft_id, method))

    async def torques(self, spacecraft_id: str) -> Json:
        """Return the newest computed torque command."""
        return await self._transport.send(endpoints.torques(spacecraft_id))

    def measurement_history(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> AsyncIterator[Measurement]:
        """Yield every row of carrier powers of an interval; parameters as for `attitude_history`."""
        params = endpoints.window(start, stop, limit)
        return cast("AsyncIterator[Measurement]", self.pages(below(spacecraft_id, "/measurements/history"), params))

    def attitude_history(
        self,
        spacecraft_id: str,
        start: Epoch | None = None,
        stop: Epoch | None = None,
        *,
        method: str | None = None,
        version: str | None = None,
        limit: int = PAGE_ROWS,
    ) -> AsyncIterator[Attitude]:
        """Yield every attitude row of an interval, page after page.

        Parameters
        ----------
        spacecraft_id : str
            Spacecraft.
        start, stop : str or int, optional
            RFC 3339 text or microseconds UTC; start inclusive, stop exclusive.
        method, version : str, optional
            ``robust`` or ``paper``; ``live`` or the version of a replay.
        limit : int
            Rows a page.
        """
        params = endpoints.window(start, stop, limit, method=method, version=version)
        return cast("AsyncIterator[Attitude]", self.pages(below(spacecraft_id, "/attitude/history"), params))
