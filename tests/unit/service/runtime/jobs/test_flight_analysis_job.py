"""Flights on demand: bounded in number and length, and a failure leaves room for the next."""

import threading
from functools import partial

import pytest

from service.core.dynamics.orbital_frame_analysis import SettlingRequest
from service.core.dynamics.orbital_frame_flight import Start
from service.core.dynamics.orbital_frame_model import rigid_spacecraft
from service.errors import BusyError
from service.records.operations.job import JobState
from service.runtime.jobs.flight_analysis_job import MOST_WAITING, FlightAnalyses, fly_thinned


@pytest.fixture
def ground(new_ground):
    """A station; no alignment is needed."""
    return new_ground()


FLOWN = partial(fly_thinned, kernels="numpy")
SHORT = SettlingRequest(rigid_spacecraft(), Start(yaw_deg=1.0), 1.0)


def test_a_flight_is_kept_thinned(ground):
    flights = FlightAnalyses(ground.jobs, FLOWN)
    job = flights.start(SHORT, points=3)
    assert ground.finish(job.id) is JobState.DONE
    found = flights.result(job.id)
    assert found.flight.time_s.tolist() == [0.0, 0.375, 0.75]
    assert found.merit.peak_deg[2] == pytest.approx(1.0)
    assert flights.result("closed-loop-0") is None


def test_too_many_are_refused_until_one_is_over_even_by_failing(ground):
    may_go = threading.Event()

    def flown(_wish, _points):
        assert may_go.wait(120)
        raise ValueError("no kernel")

    flights = FlightAnalyses(ground.jobs, flown)
    waiting = [flights.start(SHORT, 3) for _ in range(MOST_WAITING)]
    assert all(waiting)
    with pytest.raises(BusyError, match=r"analysis\.busy: 4 analyses wait or fly"):
        flights.start(SHORT, 3)
    may_go.set()
    for job in waiting:
        assert ground.finish(job.id) is JobState.FAILED
    assert ground.storage.results.job(waiting[0].id).error == "no kernel"
    assert flights.start(SHORT, 3) is not None


def test_the_longest_flight_is_that_of_the_kernel(ground):
    flights = FlightAnalyses(ground.jobs, FLOWN, most_steps=8)
    with pytest.raises(ValueError, match="8 steps"):
        flights.start(SHORT._replace(duration_s=1.2), 3)
