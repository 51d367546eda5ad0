"""The REST contract as methods: one thin method an endpoint, dictionaries as the contract shows them.

Epochs go in as RFC 3339 text or as int64 microseconds UTC. Nothing is interpreted here; errors are those of
`service.client.problem`.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Self

from service.client.problem import ClientError
from service.client.transport import Json, Transport
from service.records.epoch import format_epoch

Epoch = str | int


class JobFailedError(ClientError):
    """A job of the service ended with an error, or did not end in time."""


def epoch_text(epoch: Epoch) -> str:
    """Return RFC 3339 text of an epoch given as text or as microseconds UTC."""
    return format_epoch(epoch) if isinstance(epoch, int) else epoch


class ServiceClient:
    """Synchronous client of one service.

    Parameters
    ----------
    service_url : str
        For example ``http://127.0.0.1:8000``.
    key : str or None
        Bearer key.
    **options
        Those of `service.client.transport.Transport`.

    Examples
    --------
    >>> with ServiceClient("http://127.0.0.1:8000", "key") as client:
    ...     client.service_url
    'http://127.0.0.1:8000'
    """

    def __init__(self, service_url: str, key: str | None = None, **options: Any) -> None:
        self.service_url = service_url
        self._transport = Transport(service_url, key, **options)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def request(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        params: Mapping[str, Any] | None = None,
        is_keyed: bool = False,
    ) -> Any:
        """Send any request below ``/api/v1``; see `service.client.transport.Transport.request`."""
        return self._transport.request(method, path, body, params=params, is_keyed=is_keyed)

    def download(self, path: str, params: Mapping[str, Any] | None = None, **options: Any) -> Iterator[bytes]:
        """Yield what an export streams; see `service.client.transport.Transport.download`."""
        return self._transport.download(path, params, **options)

    # Catalogue

    def create_spacecraft(self, spacecraft: Mapping[str, Any]) -> Json:
        """Add a spacecraft."""
        return self._json("POST", "/spacecraft", spacecraft)

    def spacecraft(self, spacecraft_id: str) -> Json:
        """Return one spacecraft."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}")

    def put_carriers(self, spacecraft_id: str, carriers: Sequence[Mapping[str, Any]]) -> Json:
        """Store a carrier plan; the same content gives the same plan_id."""
        return self._json("PUT", f"/spacecraft/{spacecraft_id}/carriers", {"carriers": list(carriers)})

    def carriers(self, spacecraft_id: str, plan_id: int | None = None) -> Json:
        """Return the newest carrier plan, or the one with this number."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/carriers", params={"plan_id": plan_id})

    def put_ephemeris(self, spacecraft_id: str, ephemeris: Mapping[str, Any]) -> Json:
        """Store an ephemeris: nodes and period, TLE, or OEM."""
        return self._json("PUT", f"/spacecraft/{spacecraft_id}/ephemeris", ephemeris)

    # Into the service

    def post_measurements(
        self,
        spacecraft_id: str,
        plan_id: int,
        measurements: Sequence[Mapping[str, Any]],
        *,
        source: str | None = None,
        first_seq: int | None = None,
    ) -> Json:
        """Send rows of carrier powers; repeating a batch is safe."""
        body: Json = {"plan_id": plan_id, "measurements": list(measurements)}
        if source is not None:
            body["source"] = source
        if first_seq is not None:
            body["first_seq"] = first_seq
        return self._batch(spacecraft_id, "measurements", body)

    def post_traces(self, spacecraft_id: str, source: str, traces: Sequence[Mapping[str, Any]]) -> Json:
        """Send evidence traces of one source; repeating them is safe, the service keeps a ring of the newest."""
        body = {"source": source, "traces": list(traces)}
        answer: Json = self._transport.request("POST", f"/spacecraft/{spacecraft_id}/traces", body, is_keyed=True)
        return answer

    def report_links(self, links: Sequence[Mapping[str, Any]]) -> list[Json]:
        """Report the state of links and return what the operator wants of each: id, enabled, reset."""
        # a report that is told twice says the same twice
        answer: Json = self._transport.request("POST", "/links:report", {"links": list(links)}, is_keyed=True)
        wanted: list[Json] = answer["links"]
        return wanted

    def post_references(self, spacecraft_id: str, source: str, references: Sequence[Mapping[str, Any]]) -> Json:
        """Send attitude references."""
        return self._batch(spacecraft_id, "attitude-references", {"source": source, "references": list(references)})

    def post_corrections(self, spacecraft_id: str, corrections: Sequence[Mapping[str, Any]]) -> Json:
        """Send attitude changes commanded through other channels."""
        return self._batch(spacecraft_id, "corrections", {"corrections": list(corrections)})

    def post_operation(self, spacecraft_id: str, operation: Mapping[str, Any]) -> Json:
        """Announce an operation (station keeping, eclipse, carrier work)."""
        return self._json("POST", f"/spacecraft/{spacecraft_id}/operations", operation)

    # Calibration and alignment

    def start_calibration(self, spacecraft_id: str, calibration: Mapping[str, Any]) -> Json:
        """Start a calibration; the answer names its job."""
        return self._json("POST", f"/spacecraft/{spacecraft_id}/calibrations", calibration)

    def calibration(self, spacecraft_id: str, calibration_id: int) -> Json:
        """Return one calibration with its carriers."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/calibrations/{calibration_id}")

    def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> Json:
        """Make a calibration the active one of its method."""
        return self._json("POST", f"/spacecraft/{spacecraft_id}/calibrations/{calibration_id}:activate")

    def align(self, spacecraft_id: str, alignment: Mapping[str, Any]) -> Json:
        """Tie the estimator to known angles."""
        return self._json("POST", f"/spacecraft/{spacecraft_id}/alignments", alignment)

    def job(self, job_id: str) -> Json:
        """Return the state and progress of a job."""
        return self._json("GET", f"/jobs/{job_id}")

    def wait_job(
        self,
        job_id: str,
        *,
        timeout_s: float = 600.0,
        poll_s: float = 0.2,
        on_progress: Callable[[float], None] | None = None,
    ) -> Json:
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
        deadline = time.monotonic() + timeout_s
        while True:
            job = self.job(job_id)
            if on_progress is not None:
                on_progress(float(job.get("progress") or 0.0))
            if job["state"] == "done":
                return job
            if job["state"] == "failed":
                message = f"job {job_id} failed: {job.get('error')}"
                raise JobFailedError(message)
            if time.monotonic() > deadline:
                message = f"job {job_id} is {job['state']} after {timeout_s:g} s"
                raise JobFailedError(message)
            time.sleep(poll_s)

    # Out of the service

    def status(self, spacecraft_id: str) -> Json:
        """Return what is newest, pending and in force."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/status")

    def measurements(self, spacecraft_id: str) -> Json:
        """Return the newest row of carrier powers."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/measurements")

    def attitude(self, spacecraft_id: str, method: str | None = None) -> Json:
        """Return the newest attitude."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/attitude", params={"method": method})

    def torques(self, spacecraft_id: str) -> Json:
        """Return the newest computed torque command."""
        return self._json("GET", f"/spacecraft/{spacecraft_id}/torques")

    def attitude_history(
        self,
        spacecraft_id: str,
        start: Epoch | None = None,
        stop: Epoch | None = None,
        *,
        method: str | None = None,
        version: str | None = None,
        limit: int = 10_000,
    ) -> Iterator[Json]:
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
        params: Json = {
            "start": None if start is None else epoch_text(start),
            "stop": None if stop is None else epoch_text(stop),
            "method": method,
            "version": version,
            "limit": limit,
        }
        while True:
            page = self._json("GET", f"/spacecraft/{spacecraft_id}/attitude/history", params=params)
            yield from page["rows"]
            if not page.get("next"):
                return
            params["cursor"] = page["next"]

    def _json(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        *,
        params: Mapping[str, Any] | None = None,
    ) -> Json:
        """Send one request whose answer is an object (or whatever the endpoint documents)."""
        answer: Json = self._transport.request(method, path, body, params=params)
        return answer

    def _batch(self, spacecraft_id: str, kind: str, body: Json) -> Json:
        """Send one batch; the service keys its rows by content, so repeating it is safe."""
        answer: Json = self._transport.request("POST", f"/spacecraft/{spacecraft_id}/{kind}:batch", body, is_keyed=True)
        return answer
