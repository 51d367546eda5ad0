"""Nights of an eclipse: what the estimates of the same spacecraft with and without it differ by."""

import numpy as np
import pytest

from service.study.estimation.nights import night_statistics
from service.study.estimation.unit import Course, Drawn

ROWS = 900
HOURS = (np.arange(ROWS) / 60.0).astype(np.float32)


def course(estimate, night=()):
    """Return a course whose night lasts from one row to another."""
    is_night = np.zeros(ROWS, dtype=bool)
    is_night[slice(*night) if night else slice(0, 0)] = True
    drawn = Drawn(estimate.astype(np.float32), np.zeros((ROWS, 3), np.float32), np.ones(ROWS, dtype=bool))
    return Course(HOURS, np.zeros((ROWS, 3), np.float32), is_night, {"robust": drawn})


def test_a_shift_that_goes_leaves_nothing():
    dark = np.full((ROWS, 3), 0.3)
    dark[300:420] += [0.04, 0.01, -0.02]
    bright = np.full((ROWS, 3), 0.2)
    found = night_statistics([(course(dark, (300, 420)), course(bright))], "robust")
    assert [found[f"shift_deg.{axis}"] for axis in ("yaw", "roll", "pitch")] == pytest.approx(
        [0.04, 0.01, 0.02], abs=1e-6
    )
    # the answers differ by 0.1 deg before the night and after it: that is not the eclipse
    assert [found[f"left_deg.{axis}"] for axis in ("yaw", "roll", "pitch")] == pytest.approx([0.0] * 3, abs=1e-6)


def test_a_step_that_stays_is_left():
    dark = np.zeros((ROWS, 3))
    dark[350:, 1] = 0.05
    found = night_statistics([(course(dark, (300, 420)), course(np.zeros((ROWS, 3))))], "robust")
    assert found["left_deg.roll"] == pytest.approx(0.05, abs=1e-6)


def test_the_worst_of_all_nights_and_seeds_counts():
    pairs = []
    for size in (0.01, 0.03):
        dark = np.zeros((ROWS, 3))
        dark[300:420] += size
        pairs.append((course(dark, (300, 420)), course(np.zeros((ROWS, 3)))))
    assert night_statistics(pairs, "robust")["shift_deg.pitch"] == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize("pairs", [[], [(course(np.zeros((ROWS, 3))), course(np.zeros((ROWS, 3))))]])
def test_without_a_night_there_is_no_figure(pairs):
    assert night_statistics(pairs, "robust") == {}


def test_a_night_too_near_the_end_is_not_judged():
    night = (course(np.zeros((ROWS, 3)), (800, 880)), course(np.zeros((ROWS, 3))))
    assert night_statistics([night], "robust") == {}


def test_a_method_that_was_not_run_has_no_figure():
    night = (course(np.zeros((ROWS, 3)), (300, 420)), course(np.zeros((ROWS, 3))))
    assert night_statistics([night], "paper") == {}
