"""Calibration, alignment, replays, analyses, and the jobs that these start."""

from collections.abc import Mapping
from typing import Any

from service.client.call import Call, Epoch, window
from service.client.documents import JobReply, Json
from service.client.endpoint_methods import Series, endpoint, series
from service.client.endpoints.paths import PAGE_ROWS, below


class JobEndpoints:
    """Methods that start what takes time, and look at it."""

    @endpoint
    def start_calibration(self, spacecraft_id: str, calibration: Mapping[str, Any]) -> Call[Json]:
        """Start a calibration; the answer names its job."""
        return Call("POST", below(spacecraft_id, "/calibrations"), calibration)

    @endpoint
    def calibration(self, spacecraft_id: str, calibration_id: int) -> Call[Json]:
        """Return one calibration with its carriers."""
        return Call("GET", below(spacecraft_id, f"/calibrations/{calibration_id}"))

    @endpoint
    def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> Call[Json]:
        """Make a calibration the active one of its method."""
        return Call("POST", below(spacecraft_id, f"/calibrations/{calibration_id}:activate"))

    @endpoint
    def align(self, spacecraft_id: str, alignment: Mapping[str, Any]) -> Call[Json]:
        """Tie the estimator to known angles."""
        return Call("POST", below(spacecraft_id, "/alignments"), alignment)

    @endpoint
    def job(self, job_id: str) -> Call[JobReply]:
        """Return the state and progress of a job."""
        return Call("GET", f"/jobs/{job_id}")

    @endpoint
    def start_replay(self, spacecraft_id: str, replay: Mapping[str, Any]) -> Call[Json]:
        """Start a replay; the answer names its job and its version."""
        return Call("POST", below(spacecraft_id, "/replays"), replay)

    @endpoint
    def replay(self, spacecraft_id: str, replay_id: int) -> Call[Json]:
        """Return one replay: span, state, rows, bytes."""
        return Call("GET", below(spacecraft_id, f"/replays/{replay_id}"))

    @series
    def replays(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[Json]:
        """Yield the replays whose span overlaps an interval, in order of their numbers."""
        return Series(below(spacecraft_id, "/replays"), window(start, stop, limit))

    @endpoint
    def delete_replay(self, spacecraft_id: str, replay_id: int) -> Call[None]:
        """Delete a replay and its rows; one that runs or waits ends."""
        return Call("DELETE", below(spacecraft_id, f"/replays/{replay_id}"))

    @endpoint
    def start_closed_loop(self, request: Mapping[str, Any]) -> Call[Json]:
        """Start a flight in the orbital frame; the answer names its job."""
        return Call("POST", "/analyses/closed-loop", request)

    @endpoint
    def closed_loop(self, job_id: str) -> Call[Json]:
        """Return time series and figures of merit of a flight that is over."""
        return Call("GET", f"/analyses/closed-loop/{job_id}")
