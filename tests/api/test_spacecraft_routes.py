"""Spacecraft: what is taken, what is refused and why."""

import math
from typing import Any

import pytest

from service.api.schemas.spacecraft import SpacecraftDocument
from service.records.catalogue import ControlLaw, GyroOrbitantGains

pytestmark = pytest.mark.anyio
URL = "/api/v1/spacecraft"
POLARIMETER = {
    "source": "pol-1",
    "feed_offset_deg": -5.0,
    "frequency_hz": 11.2e9,
    "site": {"name": "B", "latitude_deg": 50.0, "longitude_deg": 30.0, "height_m": 100.0},
    "field_t": 4e-5,
    "white_deg": 0.1,
    "daily_deg": 0.04,
    "wander_deg": 0.03,
    "wander_h": 3.0,
    "offset_walk_deg_sqrt_h": 0.001,
    "used": False,
}
FED_FORWARD = {
    "epoch": "2026-11-21T06:00:00.000000Z",
    "period_s": 86_164.0,
    "constant_n_m": {"yaw": 1e-7, "roll": 0.0, "pitch": -2e-7},
    "cosine_n_m": {"yaw": 7.6e-6, "roll": 1.29e-5, "pitch": 0.0},
    "sine_n_m": {"yaw": 0.0, "roll": 0.0, "pitch": 6.8e-6},
    "relative_error": 0.1,
    "axis_relative_error": 0.02,
}
GYRO = {
    "roll_stiffness_n_m": 0.02,
    "roll_damping_n_m_s": 6.0,
    "pitch_stiffness_n_m": 0.01,
    "pitch_damping_n_m_s": 3.0,
    "yaw_stiffness_n_m": 2e-3,
    "yaw_damping_n_m_s": 6.0,
}


def gyro(**changes: Any) -> dict[str, Any]:
    """Return control by the gyro-orbitant law, commands every minute."""
    control = {"law": "gyro_orbitant", "command_period_s": 60.0, "gyro_orbitant": {**GYRO, **changes}}
    return {"control": control}


async def test_minimal_spacecraft_gets_the_defaults_of_the_contract(soo, spacecraft):
    created = await soo.client.post(URL, json=spacecraft)
    assert created.status_code == 201
    assert created.headers["location"] == f"{URL}/yamal-202"
    document = created.json()
    assert document["simulated"] is False
    assert document["wheels"] == {
        "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "torque_limit_n_m": 0.05,
        "momentum_limit_n_m_s": 20,
        "torque_quantum_n_m": 0.002,
    }
    assert document["control"] == {
        "method": "robust",
        "mode": "ground",
        "release": "two_step",
        "period_s": 7200,
        "damping": 0.9,
        "command_period_s": 900.0,
        "forecast_horizon_s": 3600.0,
        "law": "proportional_derivative",
        "gyro_orbitant": None,
    }
    assert document["onboard"] == {
        "fast_loop": False,
        "forecast_mode": False,
        "roll_yaw_coupling": None,
        "residual_torque_n_m": None,
        "fed_forward_torque": None,
        "momentum": None,
        "rate_sensor": None,
    }
    assert (await soo.client.get(f"{URL}/yamal-202")).json() | {"warnings": []} == document
    del document["warnings"]
    assert (await soo.client.get(URL)).json() == {"rows": [document], "next": None}
    assert soo.accepted == ["yamal-202"]


async def test_full_spacecraft_reads_back_as_sent(soo, spacecraft):
    document = spacecraft | {
        "simulated": True,
        "wheels": {
            "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0]],
            "torque_limit_n_m": 0.1,
            "momentum_limit_n_m_s": 18,
            "torque_quantum_n_m": 0.001,
        },
        "modes": [{"axis": "roll", "omega_rad_s": 0.6, "damping_ratio": 0.003, "coupling": 0.4}],
        "onboard": {
            "fast_loop": True,
            "forecast_mode": True,
            "roll_yaw_coupling": False,
            "residual_torque_n_m": 5e-7,
            "fed_forward_torque": FED_FORWARD,
            "momentum": None,
            "rate_sensor": None,
        },
        "control": {
            "method": "paper",
            "mode": "ground",
            "release": "automatic",
            "period_s": 3600,
            "damping": 0.7,
            "command_period_s": 1200,
            "forecast_horizon_s": 2400,
            "law": "gyro_orbitant",
            "gyro_orbitant": GYRO,
        },
        "polarimeters": [POLARIMETER],
    }
    created = await soo.client.post(URL, json=document)
    assert created.status_code == 201, created.text
    assert created.json() == document | {"warnings": []}


async def test_wheel_axes_become_unit_vectors(soo, spacecraft):
    wheels = {"axes": [[2, 0, 0], [0, 3, 0], [0, 1, 1]]}
    created = (await soo.client.post(URL, json=spacecraft | {"wheels": wheels})).json()
    half = math.sqrt(0.5)
    # one rounding of a division
    assert created["wheels"]["axes"] == [
        [1, 0, 0],
        [0, 1, 0],
        [0, pytest.approx(half, abs=1e-15), pytest.approx(half, abs=1e-15)],
    ]


async def test_the_same_id_twice_is_a_conflict(soo, spacecraft):
    assert (await soo.client.post(URL, json=spacecraft)).status_code == 201
    again = await soo.client.post(URL, json=spacecraft | {"name": "Other"})
    assert (again.status_code, again.json()["code"]) == (409, "spacecraft.exists")
    assert (await soo.client.get(f"{URL}/yamal-202")).json()["name"] == "Yamal-202"


async def test_patch_merges_at_every_depth_and_null_restores_a_default(soo, spacecraft):
    await soo.client.post(URL, json=spacecraft | {"wheels": {"torque_limit_n_m": 0.2, "momentum_limit_n_m_s": 5}})
    patch = {"name": "New", "cospar_id": None, "wheels": {"torque_limit_n_m": 0.1, "momentum_limit_n_m_s": None}}
    answer = await soo.client.patch(f"{URL}/yamal-202", json=patch)
    assert answer.status_code == 200, answer.text
    document = answer.json()
    assert (document["name"], document["cospar_id"]) == ("New", None)
    assert (document["wheels"]["torque_limit_n_m"], document["wheels"]["momentum_limit_n_m_s"]) == (0.1, 20)
    assert document["longitude_deg"] == 90
    assert (await soo.client.get(f"{URL}/yamal-202")).json() | {"warnings": []} == document
    assert soo.accepted == ["yamal-202", "yamal-202"]


@pytest.mark.parametrize(
    ("raw", "status", "code"),
    [
        ('{"id": "other"}', 422, "spacecraft.id_fixed"),
        ('{"colour": 1}', 422, "field.unknown"),
        ('{"name": null}', 422, "field.missing"),
        ('{"longitude_deg": NaN}', 422, "value.not_finite"),
        ('{"wheels": {"torque_quantum_n_m": 1}}', 422, "wheels.quantum"),
        ('{"wheels": 3}', 422, "value.type"),
        ('{"control": {"mode": "ground"}}', 422, "control.no_fast_loop"),
        ("[]", 422, "value.type"),
        ("", 400, "json.malformed"),
    ],
)
async def test_patches_are_judged_by_what_they_make(soo, spacecraft, raw, status, code):
    before = (await soo.client.post(URL, json=spacecraft)).json()
    answer = await soo.client.patch(f"{URL}/yamal-202", content=raw)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert (await soo.client.get(f"{URL}/yamal-202")).json() | {"warnings": []} == before


async def test_patch_of_anything_else_leaves_default_ground_mode_alone(soo, spacecraft):
    await soo.client.post(URL, json=spacecraft)
    assert (await soo.client.patch(f"{URL}/yamal-202", json={"control": {"damping": 0.8}})).status_code == 200
    onboard = {"fast_loop": True, "forecast_mode": True}
    answer = await soo.client.patch(f"{URL}/yamal-202", json={"onboard": onboard, "control": {"mode": "ground"}})
    assert answer.status_code == 200


async def test_the_gyro_orbitant_law_is_chosen_and_left(soo, spacecraft):
    created = await soo.client.post(URL, json=spacecraft | gyro())
    assert created.status_code == 201
    assert created.json()["control"]["gyro_orbitant"] == GYRO
    stored = soo.storage.catalogue.spacecraft("yamal-202").control
    assert (stored.law, stored.gyro_orbitant) == (ControlLaw.GYRO_ORBITANT, GyroOrbitantGains(**GYRO))
    refused = await soo.client.patch(f"{URL}/yamal-202", json={"control": {"command_period_s": 900.0}})
    assert refused.json()["code"] == "control.gyro_orbitant"
    assert "do not settle" in refused.json()["errors"][0]["detail"]
    stronger = await soo.client.patch(
        f"{URL}/yamal-202", json={"control": {"gyro_orbitant": {"roll_damping_n_m_s": 7}}}
    )
    assert stronger.json()["control"]["gyro_orbitant"] == {**GYRO, "roll_damping_n_m_s": 7.0}
    left = await soo.client.patch(f"{URL}/yamal-202", json={"control": {"law": None, "gyro_orbitant": None}})
    assert left.json()["control"]["law"] == "proportional_derivative"
    assert soo.storage.catalogue.spacecraft("yamal-202").control.gyro_orbitant is None


async def test_a_fed_forward_torque_is_changed_field_by_field_and_taken_back(soo, spacecraft):
    await soo.client.post(URL, json=spacecraft | {"onboard": {"fast_loop": True, "forecast_mode": True}})
    stated = {"epoch": "2026-11-21T06:00:00Z", "cosine_n_m": {"roll": 1e-5}}
    document = (await soo.client.patch(f"{URL}/yamal-202", json={"onboard": {"fed_forward_torque": stated}})).json()
    reported = document["onboard"]["fed_forward_torque"]
    assert reported["epoch"] == "2026-11-21T06:00:00.000000Z"
    assert reported["cosine_n_m"] == {"yaw": 0.0, "roll": 1e-5, "pitch": 0.0}
    assert (reported["period_s"], reported["relative_error"], reported["axis_relative_error"]) == (86_400.0, 0.06, 0.01)
    change = {"onboard": {"fed_forward_torque": {"sine_n_m": {"pitch": 2e-6}}}}
    changed = (await soo.client.patch(f"{URL}/yamal-202", json=change)).json()["onboard"]["fed_forward_torque"]
    assert changed == reported | {"sine_n_m": {"yaw": 0.0, "roll": 0.0, "pitch": 2e-6}}
    ended = await soo.client.patch(
        f"{URL}/yamal-202", json={"onboard": {"fed_forward_torque": None, "momentum": None, "rate_sensor": None}}
    )
    assert ended.json()["onboard"]["fed_forward_torque"] is None


async def test_what_post_accepts_patch_accepts_field_by_field(soo, spacecraft):
    minimal = {name: spacecraft[name] for name in SpacecraftDocument.model_json_schema()["required"]}
    stored = (await soo.client.post(URL, json=minimal)).json()
    # mode ground that is stated needs a fast loop, for both
    del stored["warnings"], stored["control"]["mode"]
    for name, value in stored.items():
        answer = await soo.client.patch(f"{URL}/yamal-202", json={name: value})
        assert answer.status_code == 200, (name, answer.text)
    for position, onboard in enumerate(
        ({"fast_loop": True}, {"residual_torque_n_m": 1e-7}, {"roll_yaw_coupling": False})
    ):
        assert (await soo.client.patch(f"{URL}/yamal-202", json={"onboard": onboard})).status_code == 200
        assert (
            await soo.client.post(URL, json=minimal | {"id": f"x{position}", "onboard": onboard})
        ).status_code == 201


async def test_ground_control_that_has_a_fast_loop_cannot_lose_it(soo, spacecraft):
    onboard = {"fast_loop": True, "forecast_mode": True}
    await soo.client.post(URL, json=spacecraft | {"onboard": onboard, "control": {"mode": "ground"}})
    answer = await soo.client.patch(f"{URL}/yamal-202", json={"onboard": {"fast_loop": False}})
    assert (answer.status_code, answer.json()["code"]) == (422, "control.no_fast_loop")


async def test_simulated_cannot_change_once_a_row_exists(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft | {"simulated": True}, carriers)
    row = {"epoch": "2026-11-20T00:00:00Z", "power_dbm": [-40.0] * len(carriers)}
    body = {"plan_id": plan_id, "measurements": [row]}
    assert (await soo.client.patch(f"{URL}/yamal-202", json={"simulated": False})).status_code == 200
    assert (await soo.client.post(f"{URL}/yamal-202/measurements:batch", json=body)).json()["accepted"] == 1
    refused = await soo.client.patch(f"{URL}/yamal-202", json={"simulated": True})
    assert (refused.status_code, refused.json()["code"]) == (409, "spacecraft.simulated_fixed")
    assert (await soo.client.patch(f"{URL}/yamal-202", json={"simulated": False})).status_code == 200


async def test_a_spacecraft_without_rows_is_deleted_for_good(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    row = {"epoch": "2026-11-20T00:00:00Z", "power_dbm": [-40.0] * len(carriers)}
    body = {"plan_id": plan_id, "measurements": [row | {"epoch": "2150-01-01T00:00:00Z"}]}
    # the plan is known to memory by now, and nothing is stored
    assert (await soo.client.post(f"{URL}/yamal-202/measurements:batch", json=body)).json()["accepted"] == 0
    assert (await soo.client.delete(f"{URL}/yamal-202")).status_code == 204
    for path in ("", "/carriers", "/measurements/history"):
        assert (await soo.client.get(f"{URL}/yamal-202{path}")).status_code == 404
    body["measurements"] = [row]
    assert (await soo.client.post(f"{URL}/yamal-202/measurements:batch", json=body)).status_code == 404
    assert (await soo.client.post(URL, json=spacecraft)).json()["code"] == "spacecraft.exists"
    assert (await soo.client.get(URL)).json()["rows"] == []


async def test_a_plan_without_rows_is_withdrawn_and_takes_no_rows(soo, spacecraft, carriers):
    first = await soo.with_plan(spacecraft, carriers)
    url = f"{URL}/yamal-202"
    wrong = (await soo.client.put(f"{url}/carriers", json={"carriers": carriers[::-1]})).json()["plan_id"]
    row = {"epoch": "2026-11-20T00:00:00Z", "power_dbm": [-40.0] * len(carriers)}
    body = {"plan_id": wrong, "measurements": [row | {"epoch": "2150-01-01T00:00:00Z"}]}
    assert (await soo.client.post(f"{url}/measurements:batch", json=body)).json()["accepted"] == 0
    assert (await soo.client.post(f"{url}/carriers/{wrong}:withdraw")).status_code == 204
    body["measurements"] = [row]
    refused = await soo.client.post(f"{url}/measurements:batch", json=body)
    assert (refused.status_code, refused.json()["code"]) == (404, "plan.unknown")
    assert (await soo.client.get(f"{url}/carriers")).json()["plan_id"] == first
    body["plan_id"] = first
    assert (await soo.client.post(f"{url}/measurements:batch", json=body)).json()["accepted"] == 1
    refused = await soo.client.post(f"{url}/carriers/{first}:withdraw")
    assert (refused.status_code, refused.json()["code"]) == (409, "plan.in_use")
    refused = await soo.client.delete(url)
    assert (refused.status_code, refused.json()["code"]) == (409, "spacecraft.has_rows")


async def test_what_is_stated_can_become_unknown_again(soo, spacecraft):
    stated = {"fast_loop": True, "forecast_mode": True, "roll_yaw_coupling": True, "residual_torque_n_m": 0.0}
    created = (await soo.client.post(URL, json={**spacecraft, "onboard": stated})).json()
    assert created["onboard"] == {**stated, "fed_forward_torque": None, "momentum": None, "rate_sensor": None}
    patch = {"onboard": {"roll_yaw_coupling": None, "residual_torque_n_m": None}}
    changed = (await soo.client.patch(f"{URL}/yamal-202", json=patch)).json()["onboard"]
    assert (changed["roll_yaw_coupling"], changed["residual_torque_n_m"]) == (None, None)
    assert (await soo.client.get(f"{URL}/yamal-202")).json()["onboard"] == changed


async def test_momentum_of_the_wheels_reads_back_and_its_torque_is_stated_once(soo, spacecraft):
    await soo.client.post(URL, json=spacecraft)
    url = f"{URL}/yamal-202"
    torque = {"epoch": "2026-11-01T00:00:00Z", "constant_n_m": {"roll": 1e-5}}
    refused = await soo.client.patch(
        url, json={"onboard": {"momentum": {"torque": torque}, "residual_torque_n_m": None}}
    )
    assert (refused.status_code, "onboard.momentum_torque" in refused.text) == (422, True)
    stated = {"residual_torque_n_m": 0.0, "fed_forward_torque": None, "momentum": {"torque": torque}}
    momentum = (await soo.client.patch(url, json={"onboard": stated})).json()["onboard"]["momentum"]
    assert (momentum["sigma_n_m_s"], momentum["used"]) == (0.01, True)
    assert momentum["torque"]["constant_n_m"] == {"yaw": 0.0, "roll": 1e-5, "pitch": 0.0}
    assert (await soo.client.get(url)).json()["onboard"]["momentum"] == momentum


async def test_a_rate_sensor_beside_the_loop_states_all_its_errors(soo, spacecraft):
    await soo.client.post(URL, json=spacecraft)
    url = f"{URL}/yamal-202"
    refused = await soo.client.patch(url, json={"onboard": {"rate_sensor": {"in_loop": False, "bias_deg_h": 0.01}}})
    assert (refused.status_code, "onboard.rate_sensor_figures" in refused.text) == (422, True)
    sensor = {"in_loop": False, "bias_deg_h": 0.01, "bias_tau_h": 8.0, "noise_deg_sqrt_h": 0.003}
    stated = (await soo.client.patch(url, json={"onboard": {"rate_sensor": sensor}})).json()["onboard"]
    assert stated["rate_sensor"] == sensor
    assert (await soo.client.get(url)).json()["onboard"] == stated
    in_loop = (await soo.client.patch(url, json={"onboard": {"rate_sensor": {"in_loop": True}}})).json()["onboard"]
    assert in_loop["rate_sensor"]["in_loop"] is True
