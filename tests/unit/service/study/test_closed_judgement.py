"""Judgement of a closed loop: known angles give known figures, and a craft that needs no control proves nothing."""

import numpy as np
import pytest

from service.study.closed_judgement import TRUTH_BOUNDS_DEG, judge_control, missed_control
from service.study.control_centre import ControlLog
from service.study.demonstration import Story

START = "2026-11-05T10:00:00Z"
START_US = 1_793_872_800_000_000
MISSED = {"missed": ["true roll reached 0.362 deg, not below 0.2"]}


def story(angles_deg: np.ndarray) -> Story:
    """Return a story with an hour before operation in which the craft was turned far."""
    before = {START_US - 60_000_000 * k: (5.0, 5.0, 5.0) for k in range(1, 60)}
    rows = {START_US + 60_000_000 * k: tuple(row) for k, row in enumerate(angles_deg.tolist())}
    return Story(phases={"operation": (START, "2026-11-06T10:00:00Z")}, truth_deg={**rows, **before})


def test_the_figures_are_those_of_the_operation_alone():
    angles_deg = np.zeros((100, 3))
    angles_deg[:, 0] = np.linspace(-0.3, 0.1, 100)
    angles_deg[7, 1] = -0.15
    log = ControlLog(rows=100, inhibited_rows=3)
    log.inhibitions["fade"] = 3
    found = judge_control(story(angles_deg), log, MISSED)
    assert found["largest_deg"] == {"yaw": 0.3, "roll": 0.15, "pitch": 0.0}
    assert found["size_95_deg"]["yaw"] == pytest.approx(0.28, abs=0.002)
    assert found["size_95_deg"]["roll"] == 0.0
    assert (found["inhibited_share"], found["inhibited_rows"]) == (0.03, {"fade": 3})
    assert (found["missed"], missed_control(found)) == ([], [])


@pytest.mark.parametrize(("axis", "name"), list(enumerate(TRUTH_BOUNDS_DEG)))
def test_one_row_at_its_bound_misses_it(axis, name):
    angles_deg = np.zeros((100, 3))
    angles_deg[50, axis] = -TRUTH_BOUNDS_DEG[name]
    found = judge_control(story(angles_deg), ControlLog(), MISSED)
    assert found["missed"] == [
        f"true {name} reached {TRUTH_BOUNDS_DEG[name]:.3f} deg, not below {TRUTH_BOUNDS_DEG[name]}"
    ]
    assert missed_control(found) == found["missed"]


def test_a_craft_that_needs_no_control_proves_nothing():
    found = judge_control(story(np.zeros((100, 3))), ControlLog(), {"missed": []})
    assert missed_control(found) == ["the craft keeps its bounds without control"]
    assert missed_control(None) == []
