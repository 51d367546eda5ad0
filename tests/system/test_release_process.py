"""Release of torques by a real service over sockets: from preparation to report, with what must not happen in between.

Every test has a spacecraft of its own in one service under the clock of the data.
"""

import signal
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from release_ground import ReleaseGround, record, seed_archive

pytestmark = pytest.mark.system
CRAFTS = (record("whole"), record("crowd"))
GOOD_ROWS = 15
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
    # answers of orders leave the predicted angles out
    assert ground.post(f"{path}:sent", key=anna) == ground.get(path) | {"predicted_angles": None}
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


@pytest.mark.slow
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
            assert ground.get(f"/torques/{command['id']}") | {"predicted_angles": None} == released
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
