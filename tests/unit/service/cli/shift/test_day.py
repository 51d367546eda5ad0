"""Figures of a span by hand: rows weigh by their number, empty intervals count for nothing."""

from typing import Any

import pytest

from service.cli.shift.day import drawn, figures, happened

AXES = ("yaw", "roll", "pitch")
NOW = "2027-01-15T10:30:00Z"


def samples(**changes: Any) -> dict[str, Any]:
    values = {"n": [30, 10, 0], "avg": [0.1, 0.2, None], "min": [-0.1, 0.1, None], "max": [0.3, 0.5, None]}
    names = [f"{axis}_{kind}" for axis in AXES for kind in ("deg", "sigma_deg", "protection_deg")]
    series = [{"quantity": name, **values} for name in (*names, "downlink_fade_db")]
    allowed = {"quantity": "control_allowed", **values, "avg": [1.0, 0.0, None], **changes}
    epochs = ["2027-01-15T10:00:00Z", "2027-01-15T10:15:00Z", "2027-01-15T10:30:00Z"]
    return {"range": {"start": epochs[0]}, "epochs": epochs, "series": [*series, allowed]}


def test_ranges_and_the_share_of_control() -> None:
    first, *axes, fade = figures(samples())
    assert first == "40 rows since 2027-01-15 10:00:00; the estimate allowed control in 75.0% of them"
    assert axes[1] == "Roll: -0.100 to 0.500 deg; Protection level at most 0.500 deg"
    assert fade == "Downlink fade: at most 0.500 dB"


def test_without_rows_the_figures_say_so() -> None:
    assert figures(samples(n=[0, 0, 0])) == ["There are no rows in this span."]


@pytest.mark.parametrize("epochs", [3, 0])
def test_the_picture_is_one_with_rows_and_without(epochs: int) -> None:
    found = samples()
    found["epochs"] = found["epochs"][:epochs]
    for series in found["series"]:
        series |= {name: series[name][:epochs] for name in ("n", "avg", "min", "max")}
    assert drawn(found).startswith(b"\x89PNG")


def test_what_happened_is_in_order_of_time() -> None:
    command = {"id": 1, "state": "EXECUTED", "reason": "roll\x1b[2J", "prepared_at": NOW, "prepared_by": "Anna"}
    state = {"kind": "exclusion", "carrier": "c03", "name": "step", "start": "2027-01-15T09:00:00Z", "stop": NOW}
    operation = {"kind": "eclipse", "start": "2027-01-15T08:00:00Z", "stop": NOW, "comment": ""}
    timeline = {
        "alarms": [],
        "commands": [command],
        "operations": [operation],
        "states": [state | {"rows": 90}, state | {"kind": "status"}],
        "calibrations": [],
    }
    assert happened(timeline) == [
        "2027-01-15 08:00:00 eclipse, 2027-01-15 08:00:00 – 2027-01-15 10:30:00: ",
        "2027-01-15 09:00:00 c03: stands at another level, until 2027-01-15 10:30:00, rows: 90",
        "2027-01-15 10:30:00 Command 1, executed: roll�[2J; Anna",
    ]
    assert happened({name: [] for name in timeline}) == ["none"]
