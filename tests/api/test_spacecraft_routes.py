"""Spacecraft: what is taken, what is refused by code and place, and why."""

import math
from typing import Any

import pytest

from service.api.schemas.catalogue import SpacecraftDocument
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


_FED = "/onboard/fed_forward_torque"
_GYRO = "/control/gyro_orbitant"


def inertia(*diagonal: float, xy: float = 0.0, yx: float | None = None) -> list[list[float]]:
    x, y, z = diagonal
    return [[x, xy, 0], [xy if yx is None else yx, y, 0], [0, 0, z]]


BAD: list[tuple[str, dict[str, Any], str, str]] = [
    ("unknown field", {"colour": "red"}, "field.unknown", "/colour"),
    ("unknown nested field", {"wheels": {"mass_kg": 3}}, "field.unknown", "/wheels/mass_kg"),
    ("id in capitals", {"id": "Yamal"}, "value.pattern", "/id"),
    ("id with a line feed", {"id": "yamal\n"}, "value.pattern", "/id"),
    ("id too long", {"id": "y" * 65}, "value.pattern", "/id"),
    ("id no text", {"id": 202}, "value.type", "/id"),
    ("empty name", {"name": ""}, "value.length", "/name"),
    ("control character", {"name": "a\u0000b"}, "value.pattern", "/name"),
    ("longitude", {"longitude_deg": 361}, "value.range", "/longitude_deg"),
    ("number as text", {"longitude_deg": "90"}, "value.type", "/longitude_deg"),
    ("truth as number", {"longitude_deg": True}, "value.type", "/longitude_deg"),
    ("site without place", {"receiving_site": {"longitude_deg": 37}}, "field.missing", "/receiving_site/latitude_deg"),
    (
        "inertia not symmetric",
        {"inertia_kg_m2": inertia(3, 3, 3, xy=1, yx=0)},
        "inertia.not_symmetric",
        "/inertia_kg_m2",
    ),
    ("inertia not positive", {"inertia_kg_m2": inertia(3, -3, 3)}, "inertia.not_positive", "/inertia_kg_m2"),
    ("inertia triangle", {"inertia_kg_m2": inertia(1, 1, 3)}, "inertia.triangle", "/inertia_kg_m2"),
    ("inertia shape", {"inertia_kg_m2": [[1, 0], [0, 1]]}, "request.invalid", ""),
    ("torque limit", {"torque_limit_n_m": 0}, "value.range", "/torque_limit_n_m"),
    ("wheel axis zero", {"wheels": {"axes": [[0, 0, 0], [0, 1, 0], [0, 0, 1]]}}, "wheels.axis_zero", "/wheels/axes"),
    ("wheels in a plane", {"wheels": {"axes": [[1, 0, 0], [0, 1, 0], [1, 1, 0]]}}, "wheels.axes_span", "/wheels/axes"),
    ("two wheels", {"wheels": {"axes": [[1, 0, 0], [0, 1, 0]]}}, "value.length", "/wheels/axes"),
    ("gains that saturate", {"control": {"period_s": 60.0}}, "control.gains", "/control/period_s"),
    ("another law", {"control": {"law": "best"}}, "value.choice", "/control/law"),
    ("gyro-orbitant without gains", {"control": {"law": "gyro_orbitant"}}, "control.gyro_orbitant", _GYRO),
    (
        "gyro-orbitant with half of them",
        {"control": {"gyro_orbitant": dict(list(GYRO.items())[1:])}},
        "field.missing",
        _GYRO,
    ),
    ("a gain of nothing", gyro(yaw_stiffness_n_m=0.0), "value.range", f"{_GYRO}/yaw_stiffness_n_m"),
    ("a gain that saturates", gyro(roll_stiffness_n_m=40.0), "control.gyro_orbitant", _GYRO),
    ("gains that do not settle", gyro(roll_damping_n_m_s=1e-3), "control.gyro_orbitant", _GYRO),
    ("quantum above limit", {"wheels": {"torque_quantum_n_m": 0.06}}, "wheels.quantum", "/wheels"),
    ("momentum limit", {"wheels": {"momentum_limit_n_m_s": -1}}, "value.range", "/wheels/momentum_limit_n_m_s"),
    (
        "mode axis",
        {"modes": [{"axis": "x", "omega_rad_s": 1, "damping_ratio": 0, "coupling": 0}]},
        "value.choice",
        "/modes/0/axis",
    ),
    ("method", {"control": {"method": "best"}}, "value.choice", "/control/method"),
    ("smoothed rows", {"control": {"method": "robust_smoothed"}}, "method.smoothed", "/control/method"),
    ("damping", {"control": {"damping": 0}}, "value.range", "/control/damping"),
    ("ground without fast loop", {"control": {"mode": "ground"}}, "control.no_fast_loop", "/control/mode"),
    (
        "ground without forecast mode",
        {"control": {"mode": "ground"}, "onboard": {"fast_loop": True}},
        "control.no_fast_loop",
        "/control/mode",
    ),
    (
        "residual torque below zero",
        {"onboard": {"residual_torque_n_m": -1e-9}},
        "value.range",
        "/onboard/residual_torque_n_m",
    ),
    (
        "residual torque of a thruster",
        {"onboard": {"residual_torque_n_m": 0.1}},
        "value.range",
        "/onboard/residual_torque_n_m",
    ),
    *(
        (f"fed forward: {name}", {"onboard": {"fed_forward_torque": FED_FORWARD | change}}, code, f"{_FED}{position}")
        for name, change, code, position in (
            ("period of nothing", {"period_s": 0.0}, "value.range", "/period_s"),
            ("torque of a thruster", {"sine_n_m": {"yaw": 0.1}}, "value.range", "/sine_n_m/yaw"),
            ("error above all of it", {"relative_error": 1.5}, "value.range", "/relative_error"),
            ("error below nothing", {"axis_relative_error": -0.01}, "value.range", "/axis_relative_error"),
            ("epoch that is none", {"epoch": "noon"}, "epoch.malformed", "/epoch"),
            ("unknown part", {"tangent_n_m": {"yaw": 0.0}}, "field.unknown", "/tangent_n_m"),
        )
    ),
    ("cospar id", {"cospar_id": "2003"}, "value.pattern", "/cospar_id"),
]


@pytest.mark.parametrize(("change", "code", "pointer"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
async def test_impossible_spacecraft_are_refused_by_code_and_place(soo, spacecraft, change, code, pointer):
    answer = await soo.client.post(URL, json=spacecraft | change)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code)
    assert any(error["pointer"].startswith(pointer) for error in problem["errors"])
    assert soo.storage.catalogue.all_spacecraft() == ()
    assert soo.accepted == []


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "9" * 400])
async def test_numbers_that_are_not_finite_are_refused(soo, token):
    raw = '{"id":"y","name":"Y","receiving_site":{"latitude_deg":1,"longitude_deg":2},"longitude_deg":' + token + ","
    raw += '"inertia_kg_m2":[[1,0,0],[0,1,0],[0,0,1]],"torque_limit_n_m":1}'
    answer = await soo.client.post(URL, content=raw)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/longitude_deg"
    assert soo.storage.catalogue.all_spacecraft() == ()


@pytest.mark.parametrize("spacecraft_id", ["nobody", "No_Body", "a" * 65, "%00", "..%2f", "a%0a"])
async def test_unknown_spacecraft_are_a_404(soo, spacecraft_id):
    for method in ("GET", "PATCH"):
        answer = await soo.client.request(method, f"{URL}/{spacecraft_id}", content="{}" if method == "PATCH" else None)
        assert answer.status_code == 404
        assert answer.json()["code"] in {"spacecraft.unknown", "path.unknown"}


async def test_a_real_spacecraft_is_not_released_automatically_by_one_operator(soo, spacecraft):
    automatic = {"control": {"release": "automatic"}}
    refused = await soo.client.post(URL, json=spacecraft | automatic)
    assert (refused.status_code, refused.json()["code"]) == (409, "control.needs_two_approvers")
    assert (await soo.client.get(f"{URL}/yamal-202")).status_code == 404
    assert (await soo.client.post(URL, json=spacecraft | automatic | {"simulated": True})).status_code == 201
    refused = await soo.client.patch(f"{URL}/yamal-202", json={"simulated": False})
    assert (refused.status_code, refused.json()["code"]) == (409, "control.needs_two_approvers")
    both = {"simulated": False, "control": {"release": "two_step"}}
    assert (await soo.client.patch(f"{URL}/yamal-202", json=both)).status_code == 200
    refused = await soo.client.patch(f"{URL}/yamal-202", json=automatic)
    assert (refused.status_code, refused.json()["code"]) == (409, "control.needs_two_approvers")


async def test_the_published_method_in_a_loop_without_a_profile_of_the_torque_is_warned_of(soo, spacecraft):
    onboard = {"fast_loop": True, "forecast_mode": True}
    control = {"method": "paper", "mode": "ground"}
    created = await soo.client.post(URL, json=spacecraft | {"onboard": onboard, "control": control})
    assert [(each["pointer"], each["code"]) for each in created.json()["warnings"]] == [
        ("/control/method", "control.paper")
    ]
    for change, codes in (
        ({"control": {"mode": "off"}}, []),
        ({"control": {"mode": "onboard"}}, ["control.paper"]),
        ({"onboard": {"fed_forward_torque": FED_FORWARD}}, []),
        ({"onboard": {"fed_forward_torque": None}}, ["control.paper"]),
        ({"control": {"method": "robust"}}, []),
    ):
        changed = await soo.client.patch(f"{URL}/yamal-202", json=change)
        assert [each["code"] for each in changed.json()["warnings"]] == codes


async def test_a_receiving_site_that_cannot_see_the_satellite_is_refused(soo, spacecraft):
    site = {"latitude_deg": 40.0, "longitude_deg": -100.0}
    refused = await soo.client.post(URL, json=spacecraft | {"receiving_site": site})
    assert (refused.status_code, refused.json()["code"]) == (422, "station.below_horizon")
    assert "exchanged" not in refused.json()["detail"]
    low = {"latitude_deg": 78.0, "longitude_deg": 85.0}
    created = await soo.client.post(URL, json=spacecraft | {"receiving_site": low})
    assert [each["code"] for each in created.json()["warnings"]] == ["station.low"]
    refused = await soo.client.patch(f"{URL}/yamal-202", json={"longitude_deg": 160.0})
    assert refused.json()["code"] == "station.below_horizon"
    exchanged = {"latitude_deg": 79.0, "longitude_deg": 21.0}
    refused = await soo.client.post(
        URL, json=spacecraft | {"id": "x", "receiving_site": exchanged, "longitude_deg": 95.0}
    )
    assert "latitude and longitude look exchanged" in refused.json()["detail"]


@pytest.mark.parametrize("wrong", ["true", 1, "unknown"])
async def test_a_coupling_that_is_neither_true_nor_false_is_refused(soo, spacecraft, wrong):
    answer = await soo.client.post(URL, json={**spacecraft, "onboard": {"roll_yaw_coupling": wrong}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/onboard/roll_yaw_coupling"
