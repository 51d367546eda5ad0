"""Release of torques over the interface: what reaches the service, how its answers and refusals leave, who may what."""

import math
from dataclasses import replace
from typing import Any

import pytest
from scripted_release_service import AT_US, S, ScriptedReleaseService

from service.core.control.slew_schedule import Envelope
from service.errors import (
    ConflictError,
    ForbiddenError,
    GoneError,
    InvalidInputError,
    NotFoundError,
    StorageError,
)
from service.pipeline.control.release.control_verdict import reason_of
from service.records.levels.attitude import Axes
from service.records.operations.release import CommandRequest

pytestmark = pytest.mark.anyio
SC = "yamal-202"
URL = f"/api/v1/spacecraft/{SC}"
UNTIL = "2026-11-21T06:00:00.000000Z"
UNTIL_US = AT_US + 3 * 3600 * S
PREPARE = {"reason": "roll is off"}


@pytest.fixture
async def service(soo, spacecraft, monkeypatch) -> ScriptedReleaseService:
    """The service of the service under test, and a spacecraft."""
    assert (await soo.client.post("/api/v1/spacecraft", json=spacecraft)).status_code == 201
    scripted = ScriptedReleaseService()
    object.__setattr__(soo.app.state.context, "release_service", scripted)
    for name in ("commands", "product"):
        monkeypatch.setattr(soo.storage.releases, name, getattr(scripted, name))
    return scripted


async def key(soo: Any, name: str, role: str) -> dict[str, str]:
    """Return the header of a new key."""
    made = await soo.client.post("/api/v1/keys", json={"name": name, "role": role})
    assert made.status_code == 201, made.text
    return {"Authorization": f"Bearer {made.json()['key']}"}


async def test_a_request_reaches_the_service_and_the_command_comes_back(soo, service):
    anna = await key(soo, "Anna", "operator")
    request = {
        "reason": "roll is off",
        "attitude_epoch": "2026-11-21T02:59:30Z",
        "start": "2026-11-21T03:01:00Z",
        "duration_s": 600.0,
        "max_torque_n_m": 0.01,
    }
    answer = await soo.client.post(f"{URL}/torques:prepare", json=request, headers=anna)
    assert answer.status_code == 201, answer.text
    wanted = CommandRequest("roll is off", AT_US - 30 * S, AT_US + 60 * S, 600.0, 0.01)
    assert service.asked == [("prepare", SC, "Anna", wanted, False)]
    assert answer.headers["location"] == f"{URL}/torques/7"
    reported = answer.json()
    assert (reported["id"], reported["counter"], reported["state"], reported["digest"]) == (7, 7, "PREPARED", "ab" * 32)
    assert reported["expires_at"] == "2026-11-21T03:01:00.000000Z"
    assert reported["needs_approver"] is True
    assert reported["checks"] == [{"name": "envelope", "ok": True, "detail": ""}]
    assert reported["schedule"][0]["start"] == "2026-11-21T03:01:00.000000Z"
    assert reported["schedule"][0]["roll_n_m"] == 0.002
    assert reported["impulse_n_m_s"] == {"yaw": 0.0, "roll": 0.0, "pitch": 0.0}
    assert reported["predicted"]["angle_change_deg"]["roll"] == 0.04
    assert reported["schedule_check"] is None


async def test_a_dry_run_stores_nothing_and_says_so(soo, service):
    answer = await soo.client.post(f"{URL}/torques:prepare", json={**PREPARE, "dry_run": True})
    assert (answer.status_code, answer.json()["dry_run"]) == (200, True)
    assert "location" not in answer.headers
    assert service.asked[0][-1] is True


async def test_confirm_takes_digest_and_person(soo, service):
    boris = await key(soo, "Boris", "approver")
    body = {"digest": "ab" * 32, "comment": "looked at the pulses"}
    answer = await soo.client.post(f"{URL}/torques/7:confirm", json=body, headers=boris)
    assert answer.status_code == 200, answer.text
    said = {"is_approver": True, "comment": "looked at the pulses"}
    assert service.asked == [("confirm", SC, 7, "Boris", "ab" * 32, said)]
    assert (answer.json()["state"], answer.json()["confirmed_by"]) == ("RELEASED", "Boris")
    assert answer.json()["needs_approver"] is False


@pytest.mark.parametrize("turn", ["sent", "executed", "failed"])
async def test_reports_reach_the_service_with_and_without_a_body(soo, service, turn):
    plain = await soo.client.post(f"{URL}/torques/7:{turn}")
    assert (plain.status_code, plain.json()["state"]) == (200, turn.upper())
    times = {"at": "2026-11-21T03:05:00Z", "executed_from": "2026-11-21T03:01:00Z", "executed_until": None}
    await soo.client.post(f"{URL}/torques/7:{turn}", json=times)
    nothing = {"by": "bootstrap", "at_us": None, "executed_from_us": None, "executed_until_us": None}
    some = {**nothing, "at_us": AT_US + 300 * S, "executed_from_us": AT_US + 60 * S}
    assert [(asked[:4], asked[4]) for asked in service.asked] == [
        (("report", SC, 7, turn), nothing),
        (("report", SC, 7, turn), some),
    ]


@pytest.mark.parametrize("order", ["arm", "disengage", "reset", "stop"])
async def test_orders_reach_the_service_and_what_is_said_goes_to_the_shift_log(soo, service, order):
    anna = await key(soo, "Anna", "operator")
    for body in ({"content": b""}, {"json": {"comment": "shift begins"}}):
        answer = await soo.client.post(f"{URL}/control:{order}", headers=anna, **body)
        assert (answer.status_code, answer.json()["state"]) == (200, "ARMED"), answer.text
    assert service.asked == [("order", SC, order, "Anna")] * 2
    notes = (await soo.client.get("/api/v1/notes", params={"spacecraft_id": SC})).json()["rows"]
    assert [(note["text"], note["author"], note["tags"]) for note in notes] == [
        (f"{order}: shift begins", "Anna", ["control"])
    ]


async def test_engage_asks_with_the_limits_that_are_given_and_the_rest_as_wide_as_allowed(soo, service):
    boris = await key(soo, "Boris", "approver")
    body = {"until": UNTIL, "envelope": {"impulse_n_m_s": 0.01}}
    answer = await soo.client.post(f"{URL}/control:engage", json=body, headers=boris)
    assert answer.status_code == 200, answer.text
    terms = {"is_approver": True, "until_us": UNTIL_US, "envelope": Envelope(0.2, 3e-4, 0.01, 0.1)}
    assert service.asked == [("control", SC), ("engage", SC, "Boris", terms)]
    await soo.client.post(f"{URL}/control:engage", json={"until": UNTIL}, headers=boris)
    assert service.asked[-1][-1]["envelope"] is None


async def test_a_sign_check_takes_the_axis_or_the_first_that_is_not_proven(soo, service):
    assert (await soo.client.post(f"{URL}/control:sign-check", json={"axis": "yaw"})).status_code == 200
    assert (await soo.client.post(f"{URL}/control:sign-check")).status_code == 200
    orders = [asked for asked in service.asked if asked[0] == "sign_check"]
    assert [order[2] for order in orders] == ["yaw", "pitch"]


async def test_what_stands_can_be_read(soo, service):
    viewer = await key(soo, "Vera", "viewer")
    control = (await soo.client.get(f"{URL}/control", headers=viewer)).json()
    assert (control["state"], control["proven_axes"]) == ("ARMED", ["roll"])
    assert control["reasons"] == ["no_attitude", "yaw_sign"]
    assert (control["control"]["allowed"], control["control"]["state"]) == (False, "ARMED")
    assert control["control"]["reasons"][1] == {
        "code": "yaw_sign",
        "text": "the sign of yaw is not proven",
        "since": "2026-11-21T03:00:00.000000Z",
        "next_step": "POST .../control:sign-check for yaw; roll and pitch go on.",
    }
    assert (control["since"], control["authorised_until"]) == ("2026-11-21T03:00:00.000000Z", None)
    assert control["envelope"]["impulse_n_m_s"] == 0.02
    assert control["sign_check"]["log_ratio"] == {"plus": 0.0, "nothing": -12.0, "minus": -40.0}
    command = (await soo.client.get(f"{URL}/torques/7", headers=viewer)).json()
    assert (command["prepared_by"], command["executed"]) == ("Anna", [])
    product = (await soo.client.get(f"{URL}/torques/7/uplink", headers=viewer)).json()
    assert (product["form"], product["counter"], product["simulated"]) == ("torques", 7, True)
    assert [pulse["duration_s"] for pulse in product["schedule"]] == [4.0, 4.0]
    angles = (await soo.client.get(f"{URL}/attitude/uplink", headers=viewer)).json()
    assert (angles["form"], angles["counter"], angles["digest"]) == ("attitude", 41, None)
    assert angles["attitude_deg"] == {"yaw": None, "roll": 0.02, "pitch": -0.01}


async def test_status_tells_the_interlock_and_goes_on_where_it_cannot_be_read(soo, service):
    reported = (await soo.client.get(f"{URL}/status")).json()
    assert reported["interlock"] == {"state": "ARMED", "reasons": ["no_attitude", "yaw_sign"]}
    stop = (reason_of("stop", AT_US),)
    tripped = replace(service.control_view, state="TRIPPED", reasons=stop, is_withheld=True, release="automatic")
    service.control_view = tripped
    reported = (await soo.client.get(f"{URL}/status")).json()
    assert reported["interlock"] == {"state": "TRIPPED", "reasons": ["stop", "no_attitude"]}
    service.error = StorageError("storage.unavailable", "the archive is away")
    reported = await soo.client.get(f"{URL}/status")
    assert reported.status_code == 200, "what was estimated can be read all the same"
    assert reported.json()["interlock"] == {
        "state": "INHIBITED",
        "reasons": ["release_unreadable", "no_attitude"],
    }


async def test_one_command_has_the_angles_of_a_rigid_body_and_a_list_has_none(soo, service, spacecraft):
    (xx, *_), (_, yy, _), _ = spacecraft["inertia_kg_m2"]
    assert spacecraft["inertia_kg_m2"] == [
        [xx, 0.0, 0.0],
        [0.0, yy, 0.0],
        [0.0, 0.0, spacecraft["inertia_kg_m2"][2][2]],
    ]
    # two pulses of 4 s, 240 s apart: between them roll sails at the rate of the first
    turned_deg = math.degrees(0.002 * 4.0 * 240.0 / xx)
    service.command_view = replace(service.command_view, angle_change_deg=Axes(0.0, turned_deg, 0.0))
    for answer in (
        await soo.client.get(f"{URL}/torques/7"),
        await soo.client.post(f"{URL}/torques:prepare", json=PREPARE),
        await soo.client.post(f"{URL}/torques:prepare", json={**PREPARE, "dry_run": True}),
    ):
        reported = answer.json()
        angles = reported["predicted_angles"]
        assert (angles[0]["at"], angles[-1]["at"]) == (reported["start"], reported["stop"])
        assert angles[-1]["angle_change_deg"] == pytest.approx({"yaw": 0.0, "roll": turned_deg, "pitch": 0.0})
        middle = angles[len(angles) // 2]
        assert middle["at"] == "2026-11-21T03:03:02.000000Z"
        assert middle["angle_change_deg"]["roll"] == pytest.approx(math.degrees(0.002 * 4.0 * 120.0 / xx))
    listed = (await soo.client.get(f"{URL}/torques/commands")).json()["rows"]
    assert [row["predicted_angles"] for row in listed] == [None] * len(listed)
    heavier = [[2.0 * value for value in row] for row in spacecraft["inertia_kg_m2"]]
    changed = await soo.client.patch(URL, json={"inertia_kg_m2": heavier})
    assert changed.status_code == 200, changed.text
    assert (await soo.client.get(f"{URL}/torques/7")).json()["predicted_angles"] is None, "not those it was prepared by"


async def test_commands_are_listed_page_by_page(soo, service):
    first = (await soo.client.get(f"{URL}/torques/commands", params={"limit": 1})).json()
    assert [row["id"] for row in first["rows"]] == [7]
    second = (await soo.client.get(f"{URL}/torques/commands", params={"limit": 1, "cursor": first["next"]})).json()
    assert ([row["id"] for row in second["rows"]], second["next"]) == ([8], None)
    assert (await soo.client.get("/api/v1/spacecraft/nobody/torques/commands")).status_code == 404


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (ConflictError("interlock.inhibited", "control is inhibited: fade"), 409),
        (ConflictError("interlock.simulated", "the data clock runs"), 409),
        (ConflictError("command.digest", "another digest"), 409),
        (ConflictError("envelope.exceeded", "roll: impulse .03 N m s, allowed .02"), 409),
        (GoneError("command.expired", "prepare it again"), 410),
        (ForbiddenError("command.second_person", "another person"), 403),
        (NotFoundError("command.unknown", "no command 7"), 404),
        (InvalidInputError("report.interval", "ends before it begins"), 422),
    ],
)
async def test_refusals_of_the_service_leave_as_problems_and_stand_in_the_audit_log(soo, service, error, status):
    service.error = error
    calls = [
        ("torques:prepare", PREPARE),
        ("torques/7:confirm", {"digest": "ab"}),
        ("torques/7:cancel", {}),
        ("torques/7:executed", {}),
        ("control:arm", {"comment": "not told: it was refused"}),
        ("control:engage", {"until": UNTIL}),
        ("control:sign-check", {"axis": "roll"}),
    ]
    for path, body in calls:
        answer = await soo.client.post(f"{URL}/{path}", json=body)
        problem = answer.json()
        assert (answer.status_code, problem["code"], problem["detail"]) == (status, error.code, error.detail), path
    audit = (await soo.client.get("/api/v1/audit", params={"outcome": "done"})).json()
    assert [entry for entry in audit["rows"] if SC in entry["target"]] == []
    assert (await soo.client.get("/api/v1/notes")).json()["rows"] == []


async def test_every_order_stands_in_the_audit_log_with_person_and_body(soo, service):
    anna, boris = await key(soo, "Anna", "operator"), await key(soo, "Boris", "approver")
    orders = [
        (anna, "torques:prepare", PREPARE, "prepare_torques"),
        (boris, "torques/7:confirm", {"digest": "ab"}, "confirm_torques"),
        (anna, "torques/7:cancel", {}, "cancel_torques"),
        (anna, "torques/7:sent", {}, "report_sent"),
        (anna, "torques/7:executed", {}, "report_executed"),
        (anna, "torques/7:failed", {}, "report_failed"),
        (anna, "control:arm", {}, "arm_control"),
        (boris, "control:engage", {"until": UNTIL}, "engage_control"),
        (anna, "control:disengage", {}, "disengage_control"),
        (anna, "control:reset", {}, "reset_control"),
        (anna, "control:sign-check", {}, "check_sign"),
        (anna, "control:stop", {}, "stop_control"),
    ]
    for headers, path, body, _ in orders:
        answer = await soo.client.post(f"{URL}/{path}", json=body, headers=headers)
        assert answer.status_code in (200, 201), answer.text
    found = (await soo.client.get("/api/v1/audit")).json()["rows"]
    reported = [entry for entry in found if SC in entry["target"]]
    assert [(entry["action"], entry["target"], entry["who"]) for entry in reported] == [
        (action, f"/spacecraft/{SC}/{path}", "Anna" if headers is anna else "Boris")
        for headers, path, _, action in orders
    ]
    assert all(entry["outcome"] == "done" and entry["body_sha256"] for entry in reported)


@pytest.mark.parametrize(
    ("path", "body", "code", "pointer"),
    [
        ("torques:prepare", {}, "field.missing", "/reason"),
        ("torques:prepare", {"reason": ""}, "value.length", "/reason"),
        ("torques:prepare", {**PREPARE, "duration_s": 0.0}, "value.range", "/duration_s"),
        ("torques:prepare", {**PREPARE, "max_torque_n_m": -0.1}, "value.range", "/max_torque_n_m"),
        ("torques:prepare", {**PREPARE, "max_torque_n_m": "0.1"}, "value.type", "/max_torque_n_m"),
        ("torques:prepare", {**PREPARE, "start": "soon"}, "epoch.malformed", "/start"),
        ("torques:prepare", {**PREPARE, "axis": "roll"}, "field.unknown", "/axis"),
        ("torques/7:confirm", {}, "field.missing", "/digest"),
        ("torques/7:confirm", {"digest": ""}, "value.length", "/digest"),
        ("torques/7:executed", {"at": 5}, "epoch.malformed", "/at"),
        ("torques/7:executed", {"until": UNTIL}, "field.unknown", "/until"),
        ("torques/x:executed", {}, "value.type", "/path/command_id"),
        ("torques/0:executed", {}, "value.range", "/path/command_id"),
        ("control:engage", {}, "field.missing", "/until"),
        ("control:engage", {"until": UNTIL, "envelope": {"impulse_n_m_s": 0.0}}, "value.range", None),
        ("control:engage", {"until": UNTIL, "envelope": {"impulse": 0.1}}, "field.unknown", None),
        ("control:arm", {"comment": "a\u0000b"}, "value.pattern", "/comment"),
        ("control:sign-check", {"axis": "x"}, "value.choice", "/axis"),
    ],
)
async def test_bad_bodies_are_refused_by_place_and_never_reach_the_service(soo, service, path, body, code, pointer):
    answer = await soo.client.post(f"{URL}/{path}", json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, code), answer.text
    assert pointer in (None, problem["errors"][0]["pointer"])
    assert service.asked == []


async def test_release_automatic_of_a_real_spacecraft_is_set_by_two_approvers(soo, service):
    anna, boris = await key(soo, "Anna", "approver"), await key(soo, "Boris", "approver")
    carl = await key(soo, "Carl", "operator")
    body = {"release": "automatic", "comment": "night shift"}

    async def arm(headers):
        answer = await soo.client.post(f"{URL}/control:arm", json=body, headers=headers)
        release = (await soo.client.get(URL)).json()["control"]["release"]
        return answer.status_code, answer.json().get("code"), release

    assert await arm(carl) == (403, "key.forbidden", "two_step")
    assert await arm(anna) == (200, None, "two_step")
    assert await arm(anna) == (403, "interlock.second_person", "two_step")
    # after a quarter of an hour the first request is forgotten
    object.__setattr__(soo.clock, "system", soo.clock.system + 901 * S)
    assert await arm(boris) == (200, None, "two_step")
    assert await arm(anna) == (200, None, "automatic")
    notes = (await soo.client.get("/api/v1/notes", params={"spacecraft_id": SC})).json()["rows"]
    assert any("release automatic set, asked for by Boris" in note["text"] for note in notes)
    # other fields can be changed while it stands, and it can be taken back by one operator
    assert (await soo.client.patch(URL, json={"name": "Y"}, headers=carl)).status_code == 200
    back = await soo.client.patch(URL, json={"control": {"release": "two_step"}}, headers=carl)
    assert back.json()["control"]["release"] == "two_step"


async def test_conditions_of_an_empty_archive_are_null_where_nothing_is_known(soo, spacecraft):
    assert (await soo.client.post("/api/v1/spacecraft", json=spacecraft)).status_code == 201
    control = (await soo.client.get(f"{URL}/control")).json()
    conditions = {each["code"]: each for each in control["conditions"]}
    unmet = {code for code, each in conditions.items() if each["met"] is False}
    assert unmet == set(control["reasons"]) > {"not_aligned", "no_attitude", "ephemeris"}
    assert conditions["sigma_roll"] == {
        "code": "sigma_roll",
        "met": None,
        "consequence": "inhibit",
        "value": None,
        "limit": 0.06,
        "bound": "greatest",
        "unit": "deg",
        "since": None,
    }
    assert control["good_minutes"] == {"since": None, "elapsed_s": 0.0, "needed_s": 600.0}
