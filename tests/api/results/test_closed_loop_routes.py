"""Closed loops over the interface: flown in a job, bounded, refused by name, never clipped."""

import threading
from typing import Any

import pytest

from service.core.dynamics.orbital_frame_analysis import ClosedLoop, SettlingRequest
from service.runtime.jobs.flight_analysis_job import MOST_RESULTS, MOST_WAITING, FlightAnalyses, fly_thinned

pytestmark = pytest.mark.anyio
PATH = "/analyses/closed-loop"
URL = f"/api/v1{PATH}"
#: rigid, ideal sensors and wheels, no quantum: the case of the published transients
IDEAL = {
    "inertia_kg_m2": [[8000, 0, 0], [0, 6000, 0], [0, 0, 5000]],
    "computer": {"is_continuous": True},
    "vertical_sensor": None,
    "rate_sensor": None,
    "wheels": None,
    "tones": None,
}


def queue_is_empty(bench: Any) -> None:
    """Wait until everything that was queued is over."""
    bench.jobs._executor.submit(lambda: None).result(timeout=120)


async def flown(bench: Any, body: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Fly to the end; return the job and the answer under its result's path."""
    started = await bench.client.post(URL, json=body)
    assert started.status_code == 202, started.text
    reported = started.json()
    assert started.headers["location"] == f"/api/v1/jobs/{reported['job']}"
    queue_is_empty(bench)
    job = (await bench.client.get(started.headers["location"])).json()
    return job, await bench.client.get(reported["result"])


async def test_a_flight_gives_series_and_the_published_figures(bench):
    job, answer = await flown(bench, {**IDEAL, "start": {"yaw_deg": 10.0}, "duration_s": 500.0, "points": 101})
    assert (job["state"], job["kind"], job["progress"]) == ("done", "closed-loop", 1.0)
    assert answer.status_code == 200, answer.text
    reported = answer.json()
    assert job["result"] == f"{URL}/{reported['job']}"
    series, merit = reported["series"], reported["merit"]
    assert len(series["time_s"]) == len(series["yaw_deg"]) == len(series["torque_n_m"]["pitch"]) <= 101
    at_100_s = min(range(len(series["time_s"])), key=lambda k: abs(series["time_s"][k] - 100.0))
    # section 8.5 of the specification, tolerance .002 where the row falls on the second
    assert series["yaw_deg"][at_100_s] == pytest.approx(8.4130, abs=0.05)
    assert merit["peak_deg"]["roll"] == pytest.approx(0.440, abs=0.002)
    assert merit["peak_deg"]["yaw"] == pytest.approx(10.0, abs=1e-9)
    assert merit["time_within_bound_s"]["yaw"] is None
    assert merit["mean_yaw_deg"] is None
    assert [warning["code"] for warning in reported["warnings"]] == ["flight.short"]


async def test_the_same_seed_gives_the_same_flight_and_another_one_another(bench):
    body = {"duration_s": 20.0}
    first, again, other = [(await flown(bench, {**body, "seed": seed}))[1].json() for seed in (7, 7, 8)]
    assert first["series"] == again["series"]
    assert first["series"]["yaw_deg"] != other["series"]["yaw_deg"]


async def test_gains_that_saturate_are_told(bench):
    _, answer = await flown(bench, {**IDEAL, "start": {"roll_deg": 2.0}, "duration_s": 50.0})
    reported = answer.json()
    assert "torque.saturated" in [warning["code"] for warning in reported["warnings"]]
    assert 0.0 < reported["merit"]["saturated_share"]["roll"] < 1.0
    assert reported["merit"]["saturated_share"]["pitch"] == 0.0
    assert reported["merit"]["largest_torque_n_m"]["roll"] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("body", "code", "says"),
    [
        ({"inertia_kg_m2": [[1, 0, 0], [0, 1, 0], [0, 0, 5]]}, "inertia.triangle", "exceed"),
        ({"inertia_kg_m2": [[1, 9, 0], [9, 1, 0], [0, 0, 1]]}, "inertia.not_positive", "positive"),
        ({"inertia_kg_m2": [[2, 0.5, 0], [0, 2, 0], [0, 0, 2]]}, "inertia.not_symmetric", "symmetric"),
        ({"inertia_kg_m2": [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]}, "value.range", "between 1 and 1e8"),
        ({"start": {"rate_rad_s": {"roll": 1.04e-3}}}, "analysis.not_physical", "it tells no yaw"),
        (
            {"law": {"beyond_orbital_rate": "as_printed"}, "start": {"rate_rad_s": {"roll": 2.1e-3}}},
            "analysis.not_physical",
            "nu0 of the printed law is imaginary",
        ),
        ({"duration_s": 0.05}, "analysis.not_physical", "one period"),
        ({"duration_s": 60_001.0}, "value.range", "60000"),
        ({"duration_s": 59_000.0, "steps": 16}, "analysis.not_physical", "500000 steps"),
        ({"tones": {"damping_ratio": 0.0}}, "value.range", "greater than 0"),
        ({"wheels": {"momentum_limit_n_m_s": 0.0}}, "value.range", "greater than 0"),
        ({"law": {"gains": {"yaw_stiffness_n_m": -1.0}}}, "value.range", "must be 0.0 or greater"),
        ({"points": 5001}, "value.range", "5000"),
        ({"gravity": False}, "field.unknown", "unknown field"),
    ],
)
async def test_what_cannot_fly_is_refused_with_a_code_and_never_clipped(bench, body, code, says):
    answer = await bench.client.post(URL, json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), answer.text
    assert says in problem["detail"]


async def test_a_roll_rate_beyond_the_orbital_one_is_flown_only_where_the_request_says_how(bench):
    spinning = {**IDEAL, "start": {"rate_rad_s": {"roll": 2.1e-3, "pitch": 1.033e-3}}, "duration_s": 200.0}
    job, answer = await flown(bench, {**spinning, "law": {"beyond_orbital_rate": "second_branch"}})
    assert (job["state"], answer.status_code) == ("done", 200)
    assert answer.json()["merit"]["largest_rate_ratio"] > 2.0
    assert (await bench.client.post(URL, json=spinning)).status_code == 422


async def test_a_flight_that_comes_beyond_the_orbital_rate_on_its_way_fails_with_the_reason(bench):
    # 20 deg of roll to turn away: the law asks for more roll rate than the orbital one
    body = {**IDEAL, "start": {"roll_deg": 20.0}, "duration_s": 300.0, "computer": {"is_continuous": True}}
    job, answer = await flown(bench, body)
    assert (job["state"], job["result"]) == ("failed", None)
    assert "it tells no yaw" in job["error"]
    assert (answer.status_code, answer.json()["code"]) == (409, "analysis.failed")


async def test_results_that_are_not_there_are_told_apart(bench):
    assert await bench.refused("GET", f"{PATH}/closed-loop-0") == (404, "job.unknown", [])
    other = bench.jobs.add("replay")
    assert await bench.refused("GET", f"{PATH}/{other.id}") == (404, "job.unknown", [])
    waiting = bench.jobs.add("closed-loop")
    assert await bench.refused("GET", f"{PATH}/{waiting.id}") == (409, "analysis.unfinished", [])
    first = None
    for _ in range(MOST_RESULTS + 1):
        job, answer = await flown(bench, {**IDEAL, "duration_s": 0.125})
        assert answer.status_code == 200
        first = first or job["id"]
    assert await bench.refused("GET", f"{PATH}/{first}") == (410, "analysis.gone", [])
    assert (await bench.client.get(f"/api/v1/jobs/{first}")).json()["result"] is None


async def test_only_so_many_wait_at_once(bench):
    begun = threading.Event()

    def flown_later(wish: SettlingRequest, points: int) -> ClosedLoop:
        assert begun.wait(120)
        return fly_thinned(wish, points, "numpy")

    object.__setattr__(bench.context, "flights", FlightAnalyses(bench.jobs, flown_later))
    body = {**IDEAL, "duration_s": 1.0}
    statuses = [(await bench.client.post(URL, json=body)).status_code for _ in range(MOST_WAITING + 1)]
    busy = await bench.client.post(URL, json=body)
    begun.set()
    assert statuses == [202] * MOST_WAITING + [429]
    assert (busy.json()["code"], busy.headers["retry-after"]) == ("analysis.busy", "5")
    queue_is_empty(bench)
    assert (await flown(bench, body))[0]["state"] == "done"
