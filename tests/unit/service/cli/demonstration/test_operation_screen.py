"""The screen of the operation: every answer stands on it, and it fits a terminal of 80 columns and 24 lines."""

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from service.cli.demonstration.operation_screen import operation_screen
from service.records.epoch import parse_epoch
from service.study.demonstration.closed_judgement import FlightAlone
from service.study.demonstration.demonstration import Scene, Story

START = "2026-11-05T10:00:00.000000Z"
EPOCH = "2026-11-05T11:00:00.000000Z"
REASON = {"code": "yaw_sign", "text": "the sign of yaw is not proven", "since": None, "next_step": "prove it"}
ALLOWED = {"allowed": True, "state": "ENGAGED", "reasons": []}
ANGLES = {"yaw": 0.1, "roll": 0.02, "pitch": 0.02}


class Client:
    """A service that says one row."""

    service_url = "http://127.0.0.1:43210"

    def __init__(self, verdict):
        self.verdict = verdict

    def attitude(self, _spacecraft_id, method="robust"):
        estimate = {f"{axis}_deg": None if method == "paper" else 0.123 for axis in ANGLES}
        excluded = [{"carrier": "c07", "reason": "step"}]
        rest = {"control": ALLOWED, "excluded": excluded, "carriers_used": 15, "sigma_deg": ANGLES}
        return {"epoch": EPOCH, "status": "ACQUIRED", **estimate, **rest}

    def status(self, _spacecraft_id):
        return {"control": self.verdict, "newest_measurement": EPOCH}

    def control(self, _spacecraft_id):
        return {"conditions": [], "open_commands": [], "unreported_commands": []}

    def torques(self, _spacecraft_id):
        return {"yaw_n_m": None, "roll_n_m": 1e-5, "pitch_n_m": -2e-6}


def scene(*, is_flown=True, roll_deg=0.02, verdict=ALLOWED) -> Scene:
    truth = {parse_epoch(START): (0.1, 0.0, 0.0), parse_epoch(EPOCH): (0.1, roll_deg, 0.0)}
    centre = object() if is_flown else None
    story = Story("yamal-202", {"operation": (START, "2026-11-06T10:00:00Z")}, truth, centre=centre)
    return Scene("operation", EPOCH, story, Client(verdict))


def printed(moment: Scene, alone: FlightAlone | None = None, width: int = 80) -> list[str]:
    out = io.StringIO()
    folder = Path("soo-demo-abcdefgh")
    keys = {"key": folder / "administrator.key", "Anna": folder / "operator.key"}
    Console(file=out, width=width).print(operation_screen(moment, alone, keys))
    return out.getvalue().splitlines()


def alone(largest_deg: float) -> FlightAlone:
    hours = np.array([0.0, 1.0, 2.0])
    return FlightAlone(hours, np.outer([0.0, 0.5, 1.0], [largest_deg, 0.0, 0.0]))


def test_it_says_where_how_sure_since_when_the_torque_and_what_happens_without_control():
    lines = printed(scene(), alone(2.0))
    text = "\n".join(lines)
    assert len(lines) <= 24
    assert lines[0].startswith("roll, pitch known to 0.04 deg; ")
    assert "4 Operation, 1.0 h" in lines[1]
    assert "within its bounds since 2026-11-05T10:00Z, 1.0 h" in text
    assert "Without control it leaves them after 1.0 h" in text
    assert "http://127.0.0.1:43210/console/" in text
    assert "Anna    soo-demo-abcdefgh/operator.key" in lines
    assert "carriers used 15, excluded: c07 (step)" in text
    yaw, roll = (next(line.split() for line in lines if line.split()[:1] == [axis]) for axis in ("yaw", "roll"))
    assert yaw == ["yaw", "+0.123", "0.100", "+0.100", "-", "0.5", "+1.000", "-"]
    assert roll == ["roll", "+0.123", "0.020", "+0.020", "-", "0.3", "+0.000", "+1.0e-05"]


@pytest.mark.parametrize(
    ("flight", "words"),
    [
        (None, "Without control: being flown"),
        (alone(0.1), "Without control it stays for 2.0 h"),
        (
            alone(2.0)._replace(hours=np.array([0.0, 0.4, 0.8])),
            "Without control it leaves them after 0.4 h; it was flown for 0.8 h",
        ),
    ],
)
def test_the_flight_without_control_is_shown_as_far_as_it_is_known(flight, words):
    assert words in "\n".join(printed(scene(), flight))


def test_a_true_attitude_beyond_its_bounds_is_said():
    assert "The true attitude is out of its bounds" in "\n".join(printed(scene(roll_deg=0.3)))


def test_a_story_that_is_only_followed_has_neither_bounds_nor_another_flight():
    text = "\n".join(printed(scene(is_flown=False)))
    assert "Nobody keeps the spacecraft" in text
    assert "bound" not in text.partition("deg")[2]
    assert "left alone" not in text


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ({**ALLOWED, "reasons": [REASON]}, "torques may go, but the sign of yaw is not proven: run the sign check"),
        ({"allowed": False, "state": "TRIPPED", "reasons": [REASON]}, "no torque: the sign of yaw is not proven"),
    ],
)
def test_the_verdict_comes_first_in_the_words_of_the_console(verdict, words):
    assert words in " ".join(printed(scene(verdict=verdict), width=200)[0].split())
