"""Flights of the orbital-frame model on demand: a queue of their own, results in memory only.

An analysis keeps no state beside its job: the newest results can be read until the process ends, and flown again from
the same request to the same figures. Its queue is apart from that of calibrations and replays, which never wait for it.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Literal

from service.core.dynamics.orbital_frame_analysis import (
    MOST_STEPS,
    ClosedLoop,
    SettlingRequest,
    check_closed_loop,
    fly_closed_loop,
)
from service.core.dynamics.orbital_frame_kernel import compiled_fly, fly
from service.errors import BusyError
from service.records.operations.work import Job
from service.runtime.jobs.job_runner import JobAbortedError, JobRunner, Progress

KIND = "closed-loop"
#: analyses that wait or fly at once
MOST_WAITING = 4
#: results kept; a whole one of 60 000 s takes 45 MB, which is why the service keeps them thinned
MOST_RESULTS = 32


class FlightAnalyses:
    """Starts flights and keeps the newest results.

    Parameters
    ----------
    jobs : JobRunner
        Queue of this alone.
    flown : callable
        Flies a wish and thins its record to so many points, as `fly_thinned` does.
    most_steps : int
        Longest flight, Runge-Kutta steps.
    """

    def __init__(
        self, jobs: JobRunner, flown: Callable[[SettlingRequest, int], ClosedLoop], most_steps: int = MOST_STEPS
    ) -> None:
        self._jobs = jobs
        self._flown = flown
        self._most_steps = most_steps
        self._lock = threading.Lock()
        self._waiting = 0
        self._results: OrderedDict[str, ClosedLoop] = OrderedDict()

    def start(self, request: SettlingRequest, points: int) -> Job:
        """Queue a flight whose record is thinned to so many points.

        Raises
        ------
        ValueError
            The flight cannot be, or would take too long; the text says why.
        BusyError
            ``analysis.busy``: too many wait already.
        """
        check_closed_loop(request, self._most_steps)
        with self._lock:
            if self._waiting >= MOST_WAITING:
                raise BusyError("analysis.busy", f"{MOST_WAITING} analyses wait or fly already")
            self._waiting += 1
        try:
            job = self._jobs.add(KIND)
            self._jobs.run(job, lambda report: self._fly(job.id, request, points, report))
        except BaseException:
            self._leave()
            raise
        return job

    def result(self, job_id: str) -> ClosedLoop | None:
        """Return the result of a flight, None where it is not over, failed, or is no longer kept."""
        with self._lock:
            return self._results.get(job_id)

    def _fly(self, job_id: str, request: SettlingRequest, points: int, report: Progress) -> None:
        """Fly and keep the result."""
        try:
            report(0.1)
            flown = self._flown(request, points)
        except (ValueError, ArithmeticError) as error:
            raise JobAbortedError(str(error)) from error
        finally:
            self._leave()
        with self._lock:
            self._results[job_id] = flown
            while len(self._results) > MOST_RESULTS:
                self._results.popitem(last=False)

    def _leave(self) -> None:
        with self._lock:
            self._waiting -= 1


def fly_thinned(request: SettlingRequest, points: int, kernels: Literal["numba", "numpy"]) -> ClosedLoop:
    """Return a flight with so many rows of its record at most; for a worker process, whose kernel stays compiled."""
    return fly_closed_loop(request, compiled_fly() if kernels == "numba" else fly).thinned(points)
