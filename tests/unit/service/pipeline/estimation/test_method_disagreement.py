"""Disagreement of the methods: apart for long, about roll or pitch, and only where both tell angles."""

import math
from dataclasses import replace

import pytest

from service.pipeline.config import RobustConfig
from service.pipeline.estimation.method_disagreement import Disagreement, compare
from service.records.catalogue import Method
from service.records.levels.attitude import Axes, Status, row_without_attitude

CONFIG = RobustConfig(disagreement_deg=0.15, disagreement_s=900.0)
MINUTE = 60_000_000


def pair(minute, one, other, status=Status.ACQUIRED):
    blank = row_without_attitude(minute * MINUTE, minute * MINUTE, minute, Method.ROBUST, ())
    first = replace(blank, attitude_deg=Axes(*one), status=Status.ACQUIRED)
    return first, replace(blank, method=Method.PAPER, attitude_deg=Axes(*other), status=status)


def test_apart_for_long_enough_it_stands_and_together_again_it_ends():
    watch = Disagreement()
    for minute in range(10, 40):
        watch = compare(watch, pair(minute, (0, 0.1, 0), (0, -0.06, 0)), CONFIG)
        assert watch.is_standing == (minute >= 25)
        assert watch.apart_deg == pytest.approx(0.16 if minute >= 25 else 0.0)
    assert watch.since_us == 10 * MINUTE
    watch = compare(watch, pair(40, (0, 0.1, 0), (0, -0.04, 0)), CONFIG)
    assert watch == Disagreement(apart_deg=0.0)


@pytest.mark.parametrize(
    ("other", "is_apart"),
    [
        pytest.param((9.0, 0.0, 0.0), False, id="yaw is not compared"),
        pytest.param((0.0, 0.0, -0.2), True, id="pitch is"),
        pytest.param((0.0, 0.149, 0.149), False, id="each axis alone"),
    ],
)
def test_roll_and_pitch_are_compared(other, is_apart):
    watch = compare(Disagreement(), pair(1, (0, 0, 0), other), CONFIG)
    assert (watch.since_us is not None) == is_apart


def test_a_row_without_angles_says_nothing():
    apart = Disagreement(5, True, 0.2)
    for rows in (pair(1, (0, 0, 0), (0, 0, 0), Status.INVALID), pair(1, (0, 0, 0), (0, 0, 0))[:1], ()):
        reported = compare(apart, rows, CONFIG)
        assert (reported.since_us, reported.is_standing, math.isnan(reported.apart_deg)) == (5, True, True)


def test_time_without_angles_does_not_make_it_stand():
    watch = compare(Disagreement(), pair(1, (0, 0.2, 0), (0, 0, 0)), CONFIG)
    for minute in range(2, 40):
        watch = compare(watch, pair(minute, (0, 0.2, 0), (0, 0, 0), Status.INVALID), CONFIG)
    assert not watch.is_standing
