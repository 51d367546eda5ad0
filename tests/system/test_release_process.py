"""Release of torques by a real service over sockets: from preparation to report, with what must not happen in between.

Every test has a spacecraft of its own in one service under the clock of the data.
"""

import signal
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import numpy as np
import pytest
from release_ground import ReleaseGround, record, seed_archive

pytestmark = pytest.mark.system
CRAFTS = (*map(record, ("whole", "expired", "crowd", "forged", "impulse")), record("real", simulated=False))
GOOD_ROWS = 15
IMPULSE_N_M_S = 0.02
WHY = {"reason": "roll is off"}


def armed(client: httpx.Client, name: str, roll_deg: float = 0.03) -> ReleaseGround:
    """Return a station whose spacecraft is aligned, has had good rows, and is armed."""
    ground = ReleaseGround(client, name)
    ground.align()
    ground.rows(GOOD_ROWS, (0.0, roll_deg, 0.0))
    assert ground.post("/control:arm")["state"] == "ARMED"
    return ground


def deeds(client: httpx.Client, spacecraft_id: str) -> list[tuple[str, str, str]]:
    """Return action, who and outcome of everything about a spacecraft in the audit log."""
    found = client.get("/api/v1/audit", params={"limit": 10_000}).json()["rows"]
    return [(each["action"], each["who"], each["outcome"]) for each in found if f"/{spacecraft_id}" in each["target"]]


def test_a_command_from_preparation_to_report_and_every_wrong_step_on_its_way(client):
    ground = ReleaseGround(client, "whole")
    anna, boris = ground.key("Anna", "operator"), ground.key("Boris", "approver")
    assert ground.refused("/torques:prepare", WHY, anna) == (409, "command.no_estimate")
    ground.align()
    ground.rows(GOOD_ROWS, (0.0, 0.03, 0.0))
    assert ground.refused("/torques:prepare", WHY, anna) == (409, "interlock.not_armed")
    ground.post("/control:arm", key=anna)
    # looked at first, then prepared
    looked_at = ground.post("/torques:prepare", {**WHY, "dry_run": True}, key=anna)
    assert all(check["ok"] for check in looked_at["checks"])
    command = ground.post("/torques:prepare", WHY, status=201, key=anna)
    path, digest = f"/torques/{command['id']}", {"digest": command["digest"]}
    assert command["digest"] == looked_at["digest"]
    assert ground.refused("/torques:prepare", WHY, boris) == (409, "command.open")
    # confirmed by nobody but another person who may, and has seen this very command
    assert ground.refused(f"{path}:confirm", digest, anna) == (403, "key.forbidden")
    anna = ground.key("Anna", "approver")
    assert ground.refused(f"{path}:confirm", digest, anna) == (403, "command.second_person")
    assert ground.refused(f"{path}:confirm", {"digest": "0" * 64}, boris) == (409, "command.digest")
    assert ground.refused("/torques/99:confirm", digest, boris) == (404, "command.unknown")
    for turn in ("sent", "executed", "failed"):
        assert ground.refused(f"{path}:{turn}", key=anna) == (409, "command.state")
        assert ground.refused(f"/torques/99:{turn}", key=anna) == (404, "command.unknown")
    assert ground.client.get(f"{ground.base}{path}/uplink").status_code == 404
    released = ground.post(f"{path}:confirm", {**digest, "comment": "pulses seen"}, key=boris)
    assert (released["state"], released["confirmed_by"], released["comment"]) == ("RELEASED", "Boris", "pulses seen")
    # gone out: once, and not to be called back
    assert ground.refused(f"{path}:confirm", digest, boris) == (409, "command.state")
    assert ground.refused(f"{path}:cancel", key=anna) == (409, "command.state")
    assert ground.refused("/torques:prepare", WHY, anna) == (409, "command.unreported")
    product = ground.get(f"{path}/uplink")
    assert (product["counter"], product["digest"], product["simulated"]) == (command["id"], command["digest"], True)
    assert product["schedule"] == command["schedule"]
    # reports: the same again changes nothing, another one is refused
    assert ground.post(f"{path}:sent", key=anna)["state"] == "SENT"
    assert ground.post(f"{path}:sent", key=anna) == ground.get(path)
    half = {"executed_until": command["schedule"][2]["start"]}
    executed = ground.post(f"{path}:executed", half, key=anna)
    assert executed["executed"] == command["schedule"][:2]
    assert ground.post(f"{path}:executed", half, key=anna) == executed
    assert ground.refused(f"{path}:executed", key=anna) == (409, "command.state")
    assert ground.refused(f"{path}:failed", key=anna) == (409, "command.state")
    control = ground.get("/control")
    assert ground.get("/status")["interlock"] == {name: control[name] for name in ("state", "reasons")}
    assert control["sent_impulse_n_m_s"] == command["gross_impulse_n_m_s"]
    assert control["open_commands"] == control["unreported_commands"] == []
    # each order that was done stands in the audit log once, and every refusal beside it
    done = [(action, who) for action, who, outcome in deeds(client, "whole") if outcome == "done"]
    assert [each for each in done if each[1] in ("Anna", "Boris")] == [
        ("arm_control", "Anna"),
        ("prepare_torques", "Anna"),
        ("prepare_torques", "Anna"),
        ("confirm_torques", "Boris"),
        ("report_sent", "Anna"),
        ("report_sent", "Anna"),
        ("report_executed", "Anna"),
        ("report_executed", "Anna"),
    ]


def test_a_command_that_nobody_confirms_in_time_is_over(client):
    ground = armed(client, "expired")
    boris = ground.key("Boris", "approver")
    command = ground.post("/torques:prepare", WHY, status=201)
    ground.rows(6, (0.0, 0.03, 0.0))
    path = f"/torques/{command['id']}"
    assert ground.refused(f"{path}:confirm", {"digest": command["digest"]}, boris) == (410, "command.expired")
    assert ground.get(path)["state"] == "EXPIRED"
    assert ground.refused(f"{path}:cancel") == (409, "command.state")
    # one that is taken back makes room for the next, which has the next counter
    second = ground.post("/torques:prepare", WHY, status=201)
    assert ground.post(f"/torques/{second['id']}:cancel", {"comment": "not now"})["state"] == "CANCELLED"
    third = ground.post("/torques:prepare", WHY, status=201)
    assert [each["id"] for each in ground.get("/torques/commands")["rows"]] == [1, 2, third["id"]] == [1, 2, 3]
    # what lies in the past, or too far ahead, is refused
    ground.post("/torques/3:cancel")
    for wish in ({"start": ground.epoch(-60.0)}, {"start": ground.epoch(9000.0)}, {"duration_s": 86_400.0}):
        assert ground.refused("/torques:prepare", {**WHY, **wish})[0] in (409, 422)


def test_of_many_at_once_one_gets_through(client, service):
    ground = armed(client, "crowd")
    keys = [ground.key(f"operator {k}", "operator") for k in range(4)]
    approvers = [ground.key(f"approver {k}", "approver") for k in range(4)]

    def ask(order: tuple[str, Any, str]) -> tuple[int, Any]:
        path, body, key = order
        with service.client() as own:
            answer = ReleaseGround(own, "crowd").ask(path, body, key)
        return answer.status_code, answer.json()

    with ThreadPoolExecutor(8) as threads:
        prepared = list(threads.map(ask, [("/torques:prepare", WHY, key) for key in 2 * keys]))
        assert sorted(status for status, _ in prepared) == [201] + 7 * [409]
        command = next(told for status, told in prepared if status == 201)
        confirm = (f"/torques/{command['id']}:confirm", {"digest": command["digest"]})
        confirmed = list(threads.map(ask, [(*confirm, key) for key in 2 * approvers]))
        assert sorted(status for status, _ in confirmed) == [200] + 7 * [409]
        reported = list(threads.map(ask, [(f"/torques/{command['id']}:executed", {}, key) for key in 2 * keys]))
    assert [status for status, _ in reported] == 8 * [200]
    assert len({told["reported_by"] for _, told in reported}) == 1
    done = [action for action, who, outcome in deeds(client, "crowd") if outcome == "done"]
    assert done.count("prepare_torques") == done.count("confirm_torques") == 1
    ground.rows(3, (0.0, 0.03, 0.0))
    assert ground.get("/control")["sent_impulse_n_m_s"] == command["gross_impulse_n_m_s"]


def test_a_forged_jump_stops_what_is_prepared_and_what_follows(client):
    ground = armed(client, "forged")
    boris = ground.key("Boris", "approver")
    command = ground.post("/torques:prepare", WHY, status=201)
    ground.rows(2, (0.0, 2.03, 0.0))
    status, code = ground.refused(f"/torques/{command['id']}:confirm", {"digest": command["digest"]}, boris)
    assert (status, code) in {(409, "interlock.inhibited"), (409, "interlock.tripped"), (409, "command.state")}
    control = ground.get("/control")
    assert control["state"] in ("INHIBITED", "TRIPPED")
    assert set(control["reasons"]) & {"estimator", "hand_over", "redundancy", "sigma_roll"}
    assert ground.refused("/torques:prepare", WHY)[0] == 409
    assert control["sent_impulse_n_m_s"] == {"yaw": 0.0, "roll": 0.0, "pitch": 0.0}
    stopped = ground.post("/control:stop", {"comment": "forged powers"})
    assert (stopped["state"], "stop" in stopped["trips"]) == ("TRIPPED", True)
    assert ground.refused("/torques:prepare", WHY) == (409, "interlock.tripped")
    assert ground.refused("/control:arm") == (409, "interlock.tripped")


def test_no_command_changes_more_than_the_envelope_and_none_is_clipped_to_it(client):
    ground = ReleaseGround(client, "impulse")
    ground.align()
    # slower than what the estimator takes for a motion that nobody announced
    away_deg = np.zeros((100, 3))
    away_deg[:, 1] = np.minimum(np.linspace(0.0, 0.4, 100), 0.36)
    ground.rows(100, away_deg)
    ground.post("/control:arm")
    boris = ground.key("Boris", "approver")
    # the law plans within what one command may do; an hour has room for five of the largest
    shown = ground.post("/torques:prepare", {**WHY, "dry_run": True})
    assert abs(shown["predicted"]["angle_change_deg"]["roll"]) <= 0.1
    assert abs(shown["predicted"]["peak_rate_deg_s"]["roll"]) <= 3e-4
    gross = []
    while len(gross) < 10:
        answer = ground.ask("/torques:prepare", {**WHY, "duration_s": 600.0})
        if answer.status_code != 201:
            break
        command = answer.json()
        path = f"/torques/{command['id']}"
        gross.append(command["gross_impulse_n_m_s"]["roll"])
        ground.post(f"{path}:confirm", {"digest": command["digest"]}, key=boris)
        ground.post(f"{path}:failed")
    assert (answer.status_code, answer.json()["code"]) == (409, "envelope.exceeded"), answer.text
    assert "impulse_an_hour_n_m_s" in answer.json()["detail"]
    shown = ground.post("/torques:prepare", {**WHY, "duration_s": 600.0, "dry_run": True})
    assert [check["name"] for check in shown["checks"] if not check["ok"]] == ["envelope"]
    assert shown["gross_impulse_n_m_s"]["roll"] == pytest.approx(gross[0], rel=0.3), "not cut down to what is left"
    assert len(gross) >= 4
    assert 0.0 < max(gross) <= IMPULSE_N_M_S
    assert sum(gross) <= 5 * IMPULSE_N_M_S
    assert ground.get("/control")["sent_impulse_n_m_s"]["roll"] == pytest.approx(sum(gross))


def test_a_spacecraft_that_is_not_simulated_gets_nothing_under_the_clock_of_data(client):
    ground = ReleaseGround(client, "real")
    for path, body in (
        ("/control:arm", None),
        ("/torques:prepare", WHY),
        ("/control:engage", {"until": "2027-01-15T12:00:00Z"}),
        ("/control:sign-check", {"axis": "roll"}),
    ):
        assert ground.refused(path, body) == (409, "interlock.simulated")


def test_a_service_killed_between_release_and_report_never_releases_twice(serving, tmp_path):
    path = tmp_path / "soo.db"
    seed_archive(f"sqlite:///{path}", record("killed"))
    with serving(path) as first, first.client() as client:
        ground = armed(client, "killed")
        boris = ground.key("Boris", "approver")
        command = ground.post("/torques:prepare", WHY, status=201)
        confirm = (f"/torques/{command['id']}:confirm", {"digest": command["digest"]}, boris)
        released = ground.post(confirm[0], confirm[1], key=boris)
        product = ground.get(f"/torques/{command['id']}/uplink")
        first.end(signal.SIGKILL)
    with serving(path) as second:
        with second.client() as client:
            ground = ReleaseGround(client, "killed", ground.now_us)
            assert ground.get(f"/torques/{command['id']}") == released
            assert ground.get(f"/torques/{command['id']}/uplink") == product
            control = ground.get("/control")
            assert (control["state"], control["unreported_commands"]) == ("INHIBITED", [command["id"]])
            assert ground.refused(*confirm) == (409, "command.state")
            assert ground.refused("/torques:prepare", WHY)[0] == 409
            assert ground.get("/control")["sent_impulse_n_m_s"] == command["gross_impulse_n_m_s"]
            assert ground.post(f"/torques/{command['id']}:executed")["state"] == "EXECUTED"
            ground.rows(GOOD_ROWS, (0.0, 0.03, 0.0))
            # armed before, good again: the next command has the next counter
            assert ground.get("/control")["state"] == "ARMED"
            assert ground.post("/torques:prepare", WHY, status=201)["id"] == command["id"] + 1
        assert second.end()[0] == 0
