"""The REST contract as methods to be awaited: those of `service.client.service_client`, for use in an event loop.

``tests/unit/service/client/test_async_service_client.py`` holds both to the same methods and the same requests.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, Literal, Self, cast

from service.client import endpoints
from service.client.async_transport import AsyncTransport
from service.client.call import Call, Epoch
from service.client.documents import Attitude, Command, Control, Job, Json, Measurement, PlanPut, Receipt, Status
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

    # Release of torques

    async def prepare_torques(
        self,
        spacecraft_id: str,
        reason: str,
        *,
        attitude_epoch: Epoch | None = None,
        start: Epoch | None = None,
        duration_s: float | None = None,
        max_torque_n_m: float | None = None,
        dry_run: bool = False,
    ) -> Command:
        """Return a command that waits for another person to confirm its digest.

        Parameters
        ----------
        spacecraft_id, reason : str
            Spacecraft, and why.
        attitude_epoch, start : str or int, optional
            Estimate that was looked at, default the newest; begin of the schedule, default as soon as can be.
        duration_s, max_torque_n_m : float, optional
            Default the forecast horizon of the spacecraft, and the limits of craft and wheels.
        dry_run : bool
            Only look: nothing is stored, and failing checks are told instead of refused.
        """
        epochs = {"attitude_epoch": attitude_epoch, "start": start}
        figures = {"duration_s": duration_s, "max_torque_n_m": max_torque_n_m}
        call = endpoints.prepare_torques(spacecraft_id, reason, epochs, figures, dry_run=dry_run)
        return await self._transport.send(call)

    async def command(self, spacecraft_id: str, command_id: int) -> Command:
        """Return one command as it stands."""
        return await self._transport.send(endpoints.command(spacecraft_id, command_id))

    def commands(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> AsyncIterator[Command]:
        """Yield every command that was prepared in an interval; parameters as for `attitude_history`."""
        params = endpoints.window(start, stop, limit)
        return cast("AsyncIterator[Command]", self.pages(below(spacecraft_id, "/torques/commands"), params))

    async def confirm_torques(self, spacecraft_id: str, command_id: int, digest: str, comment: str = "") -> Command:
        """Return a command that another person prepared, released."""
        return await self._transport.send(endpoints.confirm_torques(spacecraft_id, command_id, digest, comment))

    async def cancel_torques(self, spacecraft_id: str, command_id: int, comment: str = "") -> Command:
        """Take a prepared command back."""
        return await self._transport.send(endpoints.cancel_torques(spacecraft_id, command_id, comment))

    async def report_torques(
        self,
        spacecraft_id: str,
        command_id: int,
        turn: Literal["sent", "executed", "failed"],
        *,
        at: Epoch | None = None,
        executed_from: Epoch | None = None,
        executed_until: Epoch | None = None,
    ) -> Command:
        """Report what became of a released command; repeating a report is safe.

        Parameters
        ----------
        spacecraft_id, command_id : str and int
            Which command.
        turn : str
            ``sent``, ``executed`` or ``failed``.
        at : str or int, optional
            When; default now.
        executed_from, executed_until : str or int, optional
            Part that was carried out; default all of it (executed) or nothing (failed).
        """
        told = {"at": at, "executed_from": executed_from, "executed_until": executed_until}
        return await self._transport.send(endpoints.report_torques(spacecraft_id, command_id, turn, told))

    async def uplink(self, spacecraft_id: str, command_id: int) -> Json:
        """Return what goes up of a released command."""
        return await self._transport.send(endpoints.uplink(spacecraft_id, command_id))

    async def attitude_uplink(self, spacecraft_id: str) -> Json:
        """Return the newest angles for a spacecraft in mode onboard."""
        return await self._transport.send(endpoints.attitude_uplink(spacecraft_id))

    async def control(self, spacecraft_id: str) -> Control:
        """Return what the interlock says, and why."""
        return await self._transport.send(endpoints.control(spacecraft_id))

    async def order_control(
        self, spacecraft_id: str, order: Literal["arm", "disengage", "reset", "stop"], comment: str = ""
    ) -> Control:
        """Give the interlock an order; a comment goes to the shift log."""
        return await self._transport.send(endpoints.order_control(spacecraft_id, order, {"comment": comment}))

    async def engage_control(
        self, spacecraft_id: str, until: Epoch, envelope: Mapping[str, float] | None = None, comment: str = ""
    ) -> Control:
        """Ask for standing authorisation, or join another person who asked for the same."""
        return await self._transport.send(endpoints.engage_control(spacecraft_id, until, envelope, comment))

    async def check_sign(self, spacecraft_id: str, axis: str | None = None, comment: str = "") -> Control:
        """Begin to prove the sign of an axis; default the first that is not proven."""
        body = {"axis": axis, "comment": comment}
        return await self._transport.send(endpoints.order_control(spacecraft_id, "sign-check", body))

    # Analyses

    async def start_closed_loop(self, wish: Mapping[str, Any]) -> Json:
        """Start a flight in the orbital frame; the answer names its job."""
        return await self._transport.send(endpoints.start_closed_loop(wish))

    async def closed_loop(self, job_id: str) -> Json:
        """Return time series and figures of merit of a flight that is over."""
        return await self._transport.send(endpoints.closed_loop(job_id))
