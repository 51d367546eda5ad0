"""One verdict over HTTP: through stop, reset and arming every answer about the present says the same."""

import json
from typing import Any

import httpx
import pytest
from release_ground import ReleaseGround, record

from service.client.service_client import ServiceClient
from service.records.catalogue import ControlMode, ControlSettings, Method, Release

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]
KEY = "a-key-for-tests-only"
AUTOMATIC = ControlSettings(Method.ROBUST, ControlMode.GROUND, Release.AUTOMATIC)
CRAFTS = (record("steps"), record("automatic", control=AUTOMATIC))


def verdict(ground: ReleaseGround) -> Any:
    """Return the verdict, the same in every answer about the present."""
    control, handover = ground.get("/control"), ground.get("/handover")
    reported = control["control"]
    answers = {path: ground.get(path)["control"] for path in ("/attitude", "/attitude?method=paper", "/status")}
    answers |= {"/torques": ground.get("/torques")["control"], "hand-over": handover["status"]["control"]}
    answers["hand-over, control"] = {name: handover["control"][name] for name in reported}
    answers["stream"] = streamed_status(ground)["control"]
    with ServiceClient(str(ground.client.base_url), KEY, timeout_s=120) as library:
        answers["client"] = library.status(ground.spacecraft_id)["control"]
    assert answers == dict.fromkeys(answers, reported)
    interlock = ground.get("/status")["interlock"]
    assert interlock == {"state": control["state"], "reasons": control["reasons"]}
    assert interlock == {"state": reported["state"], "reasons": [one["code"] for one in reported["reasons"]]}
    metrics = ground.client.get("/metrics").text
    assert f'soo_control_allowed{{spacecraft="{ground.spacecraft_id}"}} {float(reported["allowed"])}' in metrics
    assert all(one["text"] and one["next_step"] for one in reported["reasons"])
    return reported


def streamed_status(ground: ReleaseGround) -> Any:
    """Return the first event of a stream, which tells the status."""
    with ground.client.stream("GET", f"{ground.base}/stream", timeout=120.0) as response:
        lines = response.iter_lines()
        assert next(line for line in lines if line.startswith("event:")) == "event: status"
        return json.loads(next(line for line in lines if line.startswith("data:"))[5:])


def codes(reported: Any) -> list[str]:
    """Return the codes of its reasons."""
    return [one["code"] for one in reported["reasons"]]


def test_through_stop_reset_and_arming_all_answers_agree(client: httpx.Client) -> None:
    ground = ReleaseGround(client, "steps")
    assert "not_aligned" in codes(verdict(ground))
    ground.align()
    ground.rows(15)
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)) == (False, "INHIBITED", ["yaw_sign", "not_armed"])
    ground.post("/control:arm")
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)) == (True, "ARMED", ["yaw_sign"])
    assert ground.post("/control:stop")["control"] == verdict(ground)
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)[0]) == (False, "TRIPPED", "stop")
    assert reported["reasons"][0]["since"] == ground.epoch()
    # the stored row keeps its own word
    newest = ground.get("/attitude")
    assert (newest["control_allowed"], newest["inhibitions"]) == (True, [])
    ground.rows(1)
    ground.post("/control:reset")
    assert codes(verdict(ground)) == ["yaw_sign", "good_minutes", "not_armed"]
    assert ground.refused("/control:arm") == (409, "interlock.inhibited")
    ground.rows(12)
    ground.post("/control:arm")
    assert verdict(ground)["allowed"]


def test_under_automatic_release_a_reset_lets_no_torque_go_before_ten_good_minutes(client: httpx.Client) -> None:
    ground = ReleaseGround(client, "automatic")
    ground.align()
    ground.rows(15, (0.0, 0.03, 0.0))
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)) == (True, "ENGAGED", [])
    assert ground.get("/torques")["control_allowed"]
    ground.post("/control:stop")
    stopped = ground.epoch()
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)[0]) == (False, "TRIPPED", "stop")
    torques = ground.get("/torques")
    assert (torques["roll_n_m"], torques["schedule"], torques["inhibitions"]) == (0.0, [], ["tripped"])
    ground.rows(3, (0.0, 0.03, 0.0))
    ground.post("/control:reset")
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)) == (
        False,
        "INHIBITED",
        ["good_minutes"],
    )
    reset = ground.epoch()
    ground.rows(9, (0.0, 0.03, 0.0))
    assert not verdict(ground)["allowed"]
    ground.rows(5, (0.0, 0.03, 0.0))
    reported = verdict(ground)
    assert (reported["allowed"], reported["state"], codes(reported)) == (True, "ENGAGED", [])
    ground.rows(1, (0.0, 0.03, 0.0))
    page = ground.get(f"/torques/history?from={stopped}&to={ground.epoch(60.0)}&limit=100")["rows"]
    withheld = [row["attitude_epoch"] for row in page if "tripped" in row["inhibitions"]]
    assert len(withheld) >= 3 + 9
    assert max(withheld) > reset
    assert page[-1]["control_allowed"]
