"""``soo calibrate``: what is asked of the service, and what is said of its answer."""

import json
from contextlib import contextmanager
from typing import Any

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation import operate as operate_module

QUIET = ("2026-11-01T00:00:00Z", "2026-11-04T00:00:00Z")
TURNS = ("2026-11-04T00:00:00Z", "2026-11-04T08:30:00Z")
RESULT: dict[str, Any] = {
    "id": 7,
    "carriers": [{"id": "c00", "selected": True}, {"id": "c01", "selected": False}],
    "quality": {"warnings": ["c01 was silent"]},
}


class Service:
    """A service that notes what it is asked and has its calibration done at once."""

    def __init__(self) -> None:
        self.bodies: list[dict[str, Any]] = []
        self.activated: list[int] = []

    def start_calibration(self, spacecraft_id: str, body: dict[str, Any]) -> dict[str, Any]:
        assert spacecraft_id == "yamal-202"
        self.bodies.append(body)
        return {"id": RESULT["id"], "job": "job-7"}

    def wait_job(self, job_id: str, *, on_progress: Any) -> None:
        assert job_id == "job-7"
        on_progress(1.0)

    def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> None:
        self.activated.append(calibration_id)

    def calibration(self, spacecraft_id: str, calibration_id: int) -> dict[str, Any]:
        assert calibration_id == RESULT["id"]
        return {**RESULT, "state": "active" if self.activated else "draft"}


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    made = Service()

    @contextmanager
    def connected(_service: str, _key_env: str) -> Any:
        yield made

    monkeypatch.setattr(operate_module, "connected", connected)
    return made


def calibrate(*options: str) -> Any:
    windows = ["--quiet", *QUIET, "--turns", *TURNS]
    return CliRunner().invoke(app, ["calibrate", "--spacecraft", "yamal-202", *windows, *options])


def test_a_calibration_is_by_geometry_unless_said_otherwise(service: Service) -> None:
    assert calibrate().exit_code == 0
    assert calibrate("--method", "paper", "--source", "earth_sensor").exit_code == 0
    window = {"quiet": dict(zip(("start", "stop"), QUIET, strict=True))}
    window |= {"turns": dict(zip(("start", "stop"), TURNS, strict=True))}
    assert service.bodies == [
        {**window, "method": "geometry", "source": "star_tracker"},
        {**window, "method": "paper", "source": "earth_sensor"},
    ]


def test_a_calibration_stays_a_draft_unless_it_is_to_be_activated(service: Service) -> None:
    result = calibrate()
    assert service.activated == []
    assert result.stdout == "calibration 7 is draft; selected: c00\nwarning: c01 was silent\n"
    assert calibrate("--activate").stdout.startswith("calibration 7 is active;")
    assert service.activated == [7]


def test_json_is_the_answer_of_the_service(service: Service) -> None:
    assert json.loads(calibrate("--json").stdout) == {**RESULT, "state": "draft"}


def test_an_alignment_says_which_rows_it_computes_and_names_the_replay_of_those_it_keeps(service: Service) -> None:
    made = {"id": 3, "epoch": "2026-11-04T09:29:00.000000Z", "created_at": "2026-11-04T11:00:00.000000Z"}
    made |= dict.fromkeys(("yaw_deg", "roll_deg", "pitch_deg"), 0.0)
    asked = ["align", "--spacecraft", "yamal-202", "--start", TURNS[1], "--stop", "2026-11-04T09:30:00Z"]
    service.align = lambda _spacecraft, _body: {**made, "rows_recomputed": 0, "rows_kept": 90}  # type: ignore[attr-defined]
    reported = CliRunner().invoke(app, asked).stdout
    assert "stored rows after it: 0 computed, 90 kept" in reported
    span = "--start 2026-11-04T09:29:00.000000Z --stop 2026-11-04T11:00:00.000000Z"
    assert f"soo replay --spacecraft yamal-202 {span} --alignment 3 --order epoch" in reported
    service.align = lambda _spacecraft, _body: {**made, "rows_recomputed": 4, "rows_kept": 0}  # type: ignore[attr-defined]
    assert "soo replay" not in CliRunner().invoke(app, asked).stdout


@pytest.mark.parametrize(("options", "commands"), [((), True), (("--no-commands",), False)])
def test_a_replay_leaves_torques_out_where_they_are_not_wanted(
    service: Service, options: tuple[str, ...], commands: bool
) -> None:
    asked = []

    def request(method: str, path: str, body: dict[str, Any]) -> dict[str, Any]:
        asked.append((method, path, body["commands"]))
        return {"id": 4, "version": "replay-4", "job": "job-7"}

    service.request = request  # type: ignore[attr-defined]
    span = ["--start", TURNS[0], "--stop", TURNS[1]]
    assert CliRunner().invoke(app, ["replay", "--spacecraft", "yamal-202", *span, *options]).exit_code == 0
    assert asked == [("POST", "/spacecraft/yamal-202/replays", commands)]
