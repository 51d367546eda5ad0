"""Analyses over the interface: published cases, nulls for what is unbounded, and clear refusals."""

from typing import Any

import pytest

pytestmark = pytest.mark.anyio
BASE = "/api/v1/analyses"
AXIS = {
    "inertia_kg_m2": 1000.0,
    "motor_torque_n_m": 0.2,
    "dry_friction_n_m": 1e-3,
    "viscous_loss_n_m": 1e-4,
    "momentum_limit_n_m_s": 20.0,
    "momentum_n_m_s": 10.0,
    "alpha_rad": 0.0175,
    "beta_rad": 0.0349,
    "pulse_s": 1.0,
}
SWITCHING = {
    "omega_rad_s": 1.0,
    "damping_ratio": 0.01,
    "coupling": 0.5,
    "inertia_kg_m2": 1000.0,
    "motor_torque_n_m": 0.2,
    "friction_torque_n_m": 0.00105,
    "alpha_rad": 0.0175,
    "beta_rad": 0.0349,
    "rate_rad_s": 1e-4,
}
SCHEDULE = {
    "pulses": [{"start_s": 0.0, "duration_s": 1.0, "torque_n_m": 0.2}],
    "inertia_kg_m2": 5000.0,
    "modes": [{"omega_rad_s": 0.6, "damping_ratio": 0.003, "coupling": 0.4}],
    "peak_allowed_rad": 1e-4,
}


async def test_limit_cycle_of_the_published_axis(soo):
    answer = await soo.client.post(f"{BASE}/limit-cycle", json=AXIS)
    assert answer.status_code == 200, answer.text
    (cycle,) = answer.json()["cycles"]
    assert cycle["period_s"] == pytest.approx(190.4761905, rel=1e-8)
    assert cycle["multiplier"] == pytest.approx(-1.009914, abs=1e-4)
    assert cycle["is_stable"] is False
    assert len(answer.json()["speeds_rad_s"]) == len(answer.json()["next_speeds_rad_s"]) == 200
    assert all(len(corner) == 2 for corner in answer.json()["ladder_rad_s"])


async def test_capture_boundary_of_a_relay(soo):
    answer = await soo.client.post(f"{BASE}/capture-boundary", json=SWITCHING)
    assert answer.status_code == 200, answer.text
    assert answer.json()["p_cr_rad"] == pytest.approx(8.266190184e-3, rel=1e-6)
    assert answer.json()["verdict"] == "free"
    swinging = await soo.client.post(f"{BASE}/capture-boundary", json={**SWITCHING, "amplitude_rad": 0.0084})
    assert swinging.json()["verdict"] == "captured"


@pytest.mark.parametrize("pulse_s", [None, 1.0])
async def test_capture_boundary_without_damping(soo, pulse_s):
    body = {**SWITCHING, "damping_ratio": 0.0, "pulse_s": pulse_s}
    answer = await soo.client.post(f"{BASE}/capture-boundary", json=body)
    assert answer.status_code == 200, answer.text
    reported = answer.json()
    assert reported["p_min_rad"] == pytest.approx(reported["p_cr_rad"], rel=1e-9)
    assert (reported["p_inf_rad"], reported["perpetual_capture"]) == (
        (None, "possible") if pulse_s is None else (0.0, "none")
    )


@pytest.mark.parametrize(
    ("changes", "reported", "over_both"),
    [
        ({}, "", []),
        ({"pulse_count": 2, "line_step_rad": 1.5e-3}, "only in jumps", []),
        ({"pulse_s": 4.0}, "ends slower than it began", [[2, 1]]),
    ],
)
async def test_no_cycle_without_its_reason(soo, changes, reported, over_both):
    answer = (await soo.client.post(f"{BASE}/limit-cycle", json={**AXIS, **changes})).json()
    assert reported in answer["reason"]
    assert (answer["reason"] == "") is bool(answer["cycles"])
    assert [cycle["pulses"] for cycle in answer["cycles_over_both_lines"]] == over_both


async def test_torque_schedule_with_and_without_a_regulator(soo):
    answer = await soo.client.post(f"{BASE}/torque-schedule", json=SCHEDULE)
    assert answer.status_code == 200, answer.text
    reported = answer.json()
    assert (reported["verdict"], reported["p_cr_rad"], reported["margin_rad"]) == ("accept", None, None)
    assert reported["peak_rad"] == pytest.approx(3.088803e-5, rel=1e-6)
    resonant = [{"start_s": 10.47197551 * k, "duration_s": 1.0, "torque_n_m": 0.2} for k in range(10)]
    worse = (await soo.client.post(f"{BASE}/torque-schedule", json={**SCHEDULE, "pulses": resonant})).json()
    assert (worse["verdict"], worse["reasons"]) == ("reject", ["peak"])
    assert worse["suggestions"]


async def test_what_a_schedule_leaves_is_carried_to_the_next(soo):
    first = (await soo.client.post(f"{BASE}/torque-schedule", json=SCHEDULE)).json()
    carried = (await soo.client.post(f"{BASE}/torque-schedule", json={**SCHEDULE, "carried": first["phasors"]})).json()
    assert carried["peak_rad"] > 1.5 * first["peak_rad"]


@pytest.mark.parametrize(
    ("path", "body", "names"),
    [
        ("limit-cycle", {**AXIS, "inertia_kg_m2": 0.0}, "inertia_kg_m2"),
        ("limit-cycle", {**AXIS, "alpha_rad": 0.05}, "alpha_rad"),
        ("limit-cycle", {**AXIS, "pulse_s": -1.0}, "pulse_s"),
        ("limit-cycle", {**AXIS, "external_torque_n_m": 0.5}, "external_torque_n_m"),
        ("capture-boundary", {**SWITCHING, "damping_ratio": -0.1}, "damping_ratio"),
        ("capture-boundary", {**SWITCHING, "damping_ratio": 1.0}, "damping_ratio"),
        ("capture-boundary", {**SWITCHING, "friction_torque_n_m": 0.3}, "friction_torque_n_m"),
        ("torque-schedule", {**SCHEDULE, "alpha_rad": 0.01}, "regulator"),
        ("torque-schedule", {**SCHEDULE, "pulses": 2 * SCHEDULE["pulses"]}, "begins before"),
        ("torque-schedule", {**SCHEDULE, "carried": []}, "carried_rad"),
        ("torque-schedule", {**SCHEDULE, "modes": [{**SCHEDULE["modes"][0], "damping_ratio": 1.5}]}, "damping_ratio"),
    ],
)
async def test_what_is_not_physical_is_refused_by_name(soo, path: str, body: dict[str, Any], names: str):
    answer = await soo.client.post(f"{BASE}/{path}", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "analysis.not_physical"), answer.text
    assert names in answer.json()["detail"]


@pytest.mark.parametrize(
    "body",
    [{}, {**AXIS, "mass_kg": 1.0}, {**AXIS, "pulse_s": "1"}, {**AXIS, "beta_rad": 1e300}, {**AXIS, "returns": 0}],
)
async def test_documents_are_strict(soo, body: dict[str, Any]):
    assert (await soo.client.post(f"{BASE}/limit-cycle", json=body)).status_code == 422
