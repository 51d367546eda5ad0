"""Spacecraft that no catalogue accepts, refused by code and place."""

from typing import Any

import pytest

pytestmark = pytest.mark.anyio
URL = "/api/v1/spacecraft"
FED_FORWARD = {
    "epoch": "2026-11-21T06:00:00.000000Z",
    "period_s": 86_164.0,
    "constant_n_m": {"yaw": 1e-7, "roll": 0.0, "pitch": -2e-7},
    "cosine_n_m": {"yaw": 7.6e-6, "roll": 1.29e-5, "pitch": 0.0},
    "sine_n_m": {"yaw": 0.0, "roll": 0.0, "pitch": 6.8e-6},
    "relative_error": 0.1,
    "axis_relative_error": 0.02,
}
_FED = "/onboard/fed_forward_torque"
GYRO = {
    "roll_stiffness_n_m": 0.02,
    "roll_damping_n_m_s": 6.0,
    "pitch_stiffness_n_m": 0.01,
    "pitch_damping_n_m_s": 3.0,
    "yaw_stiffness_n_m": 2e-3,
    "yaw_damping_n_m_s": 6.0,
}
_GYRO = "/control/gyro_orbitant"


def gyro(**changes: Any) -> dict[str, Any]:
    """Return control by the gyro-orbitant law, commands every minute."""
    control = {"law": "gyro_orbitant", "command_period_s": 60.0, "gyro_orbitant": {**GYRO, **changes}}
    return {"control": control}


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
    ("inertia zero", {"inertia_kg_m2": inertia(0, 0, 0)}, "inertia.not_positive", "/inertia_kg_m2"),
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
    ("a gain below zero", gyro(roll_damping_n_m_s=-6.0), "value.range", f"{_GYRO}/roll_damping_n_m_s"),
    ("a gain that saturates", gyro(roll_stiffness_n_m=40.0), "control.gyro_orbitant", _GYRO),
    ("gains that do not settle", gyro(roll_damping_n_m_s=1e-3), "control.gyro_orbitant", _GYRO),
    (
        "gains for more frequent commands",
        {"control": {**gyro()["control"], "command_period_s": 900.0}},
        "control.gyro_orbitant",
        _GYRO,
    ),
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
