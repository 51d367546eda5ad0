"""Judgement of a closed loop: known angles give known figures; a spacecraft that needs no control proves nothing."""

import numpy as np
import pytest

from service.study.demonstration.closed_judgement import (
    TRUTH_BOUNDS_DEG,
    FlightAlone,
    judge_control,
    missed_control,
    within_bounds_since_us,
)
from service.study.demonstration.control_centre import ControlLog
from service.study.demonstration.demonstration import Story
from service.study.demonstration.figures import draw_control
from service.study.demonstration.judgement import TrackedAngles

START = "2026-11-05T10:00:00Z"
START_US = 1_793_872_800_000_000
HOURS = np.arange(100) / 60.0
STILL = np.zeros((100, 3))
#: roll leaves its bound after an hour
ALONE = FlightAlone(HOURS, np.stack([0.0 * HOURS, 0.3 * HOURS, 0.0 * HOURS], axis=1))


def story(angles_deg: np.ndarray) -> Story:
    """Return a story with an hour before operation in which the spacecraft was turned far."""
    before = {START_US - 60_000_000 * k: (5.0, 5.0, 5.0) for k in range(1, 60)}
    rows = {START_US + 60_000_000 * k: tuple(row) for k, row in enumerate(angles_deg.tolist())}
    return Story(phases={"operation": (START, "2026-11-06T10:00:00Z")}, truth_deg={**rows, **before})


def test_the_figures_are_those_of_the_operation_alone():
    angles_deg = np.zeros((100, 3))
    angles_deg[:, 0] = np.linspace(-0.3, 0.1, 100)
    angles_deg[7, 1] = -0.15
    log = ControlLog(rows=100, inhibited_rows=3)
    log.inhibitions["fade"] = 3
    found = judge_control(story(angles_deg), log, ALONE)
    assert found["largest_deg"] == {"yaw": 0.3, "roll": 0.15, "pitch": 0.0}
    assert found["size_95_deg"]["yaw"] == pytest.approx(0.28, abs=0.002)
    assert found["size_95_deg"]["roll"] == 0.0
    assert (found["inhibited_share"], found["inhibited_rows"]) == (0.03, {"fade": 3})
    assert (found["missed"], missed_control(found)) == ([], [])


@pytest.mark.parametrize(("axis", "name"), list(enumerate(TRUTH_BOUNDS_DEG)))
def test_one_row_at_its_bound_misses_it(axis, name):
    angles_deg = np.zeros((100, 3))
    angles_deg[50, axis] = -TRUTH_BOUNDS_DEG[name]
    found = judge_control(story(angles_deg), ControlLog(), ALONE)
    assert found["missed"] == [
        f"true {name} reached {TRUTH_BOUNDS_DEG[name]:.3f} deg, not below {TRUTH_BOUNDS_DEG[name]}"
    ]
    assert missed_control(found) == found["missed"]


def test_a_craft_that_needs_no_control_proves_nothing():
    found = judge_control(story(np.zeros((100, 3))), ControlLog(), FlightAlone(HOURS, STILL))
    assert missed_control(found) == ["the spacecraft keeps its bounds without control"]
    assert found["control_off"]["hours_within_bounds"] is None
    assert missed_control(None) == []


def test_the_craft_left_alone_is_judged_by_the_same_bounds():
    found = ALONE.statistics()
    assert (found["hours"], found["hours_within_bounds"]) == (1.65, 1.0)
    assert found["largest_deg"] == {"yaw": 0.0, "roll": 0.495, "pitch": 0.0}
    assert found["missed"] == ["true roll reached 0.495 deg, not below 0.3"]


@pytest.mark.parametrize(("row", "since_row"), [(None, 0), (50, 51), (98, 99), (99, None)])
def test_the_bounds_are_kept_since_the_row_after_the_last_that_left_them(row, since_row):
    angles_deg = np.zeros((100, 3))
    if row is not None:
        angles_deg[row, 2] = TRUTH_BOUNDS_DEG["pitch"]
    wanted = None if since_row is None else START_US + 60_000_000 * since_row
    assert within_bounds_since_us(story(angles_deg)) == wanted


def test_the_attitude_without_control_is_that_of_the_same_time():
    assert ALONE.angles_deg(0.5) == pytest.approx((0.0, 0.15, 0.0))
    assert ALONE.angles_deg(1.65) == pytest.approx((0.0, 0.495, 0.0))
    assert ALONE.angles_deg(1.66) is None


def test_the_drawn_figure_is_written(tmp_path):
    tracked = TrackedAngles(START_US + 60_000_000 * np.arange(100), STILL, STILL + 0.1, STILL, HOURS < 1.0)
    draw_control(tracked, ALONE, tmp_path / "closed.png")
    assert (tmp_path / "closed.png").read_bytes().startswith(b"\x89PNG")
