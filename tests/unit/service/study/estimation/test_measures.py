"""Measures of an answer: the truth itself keeps every bound of its scenario, the answer zero misses them."""

from dataclasses import replace

import numpy as np
import pytest

from service.study.estimation.bound_table import BOUNDS
from service.study.estimation.bounds import Mark, judge
from service.study.estimation.measures import measure_method, statistics_of

HOUR = 60


def measured(world, driven_world, series):
    return measure_method(world, driven_world({"robust": series}), series)


def figures(world, driven_world, series):
    return statistics_of([measured(world, driven_world, series)])


def marks(scenario, reported):
    """Return the marks of the robust method by figure; integrity has a yardstick and an oracle of its own."""
    own = [bound for bound in BOUNDS if (bound.scenario, bound.method) == (scenario, "robust")]
    own = [bound for bound in own if not bound.figure.startswith(("yardstick", "rms_over_oracle"))]
    return {judged.bound.figure: judged.mark for judged in judge(own, {(scenario, "robust"): reported})}


def test_a_perfect_answer_meets_every_goal(toured_world, said, driven_world):
    reported = figures(toured_world, driven_world, said(toured_world.truth.attitude_deg))
    earned = marks("octants", reported)
    assert len(earned) == 9
    # no goal was set for the false rain
    assert {figure for figure, mark in earned.items() if mark is not Mark.GOAL} == {"rain_false_share"}
    assert earned["rain_false_share"] is Mark.MUST


def test_the_answer_that_never_moves_misses_every_bound_of_accuracy(toured_world, said, driven_world):
    reported = figures(toured_world, driven_world, said(np.zeros((3000, 3))))
    earned = marks("octants", reported)
    assert {figure for figure, mark in earned.items() if mark is not Mark.MISSED} == {"rain_false_share"}


def test_the_first_hour_is_not_judged(toured_world, said, driven_world):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[:HOUR] += 1.0
    reported = figures(toured_world, driven_world, said(estimate))
    assert reported["max_deg.roll"] == 0.0
    assert reported["wrong_min"] == 0.0


@pytest.mark.parametrize(
    ("error_deg", "roll_pitch", "yaw"),
    [
        ((0.0, 0.151, 0.0), 10.0, 0.0),
        ((0.0, 0.0, -0.151), 10.0, 0.0),
        ((0.301, 0.0, 0.0), 0.0, 10.0),
        ((0.29,) * 3, 10.0, 0.0),
    ],
)
def test_a_torque_is_wrong_beyond_the_limit_of_its_axis(toured_world, said, driven_world, error_deg, roll_pitch, yaw):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110] += error_deg
    reported = figures(toured_world, driven_world, said(estimate))
    assert (reported["wrong_min.roll_pitch"], reported["wrong_min.yaw"], reported["wrong_min"]) == (
        roll_pitch,
        yaw,
        10.0,
    )


def test_what_is_not_allowed_is_no_wrong_torque(toured_world, said, driven_world):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110] += [0.4, 0.2, 0.0]
    allowed = np.ones((3000, 3), dtype=bool)
    allowed[:, 0] = False
    allowed[105:110, 1] = False
    reported = figures(toured_world, driven_world, said(estimate, is_axis_allowed=allowed))
    assert (reported["wrong_min.roll_pitch"], reported["wrong_min.yaw"]) == (5.0, 0.0)


def test_minutes_follow_the_period_of_the_rows(toured_world, said, driven_world):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110, 1] += 0.2
    reported = figures(toured_world._replace(row_period_s=10.0), driven_world, said(estimate))
    assert reported["wrong_min"] == pytest.approx(10.0 / 6.0)


def test_availability_counts_in_the_dry_only(toured_world, said, driven_world):
    fade_db = np.zeros(3000)
    fade_db[1000:1500] = 2.0
    world = toured_world._replace(truth=replace(toured_world.truth, downlink_fade_db=fade_db))
    allowed = np.ones(3000, dtype=bool)
    allowed[1000:1500] = False
    allowed[2000:2100] = False
    reported = figures(world, driven_world, said(world.truth.attitude_deg, is_control_allowed=allowed))
    assert reported["available_dry"] == pytest.approx(1.0 - 100 / (3000 - HOUR - 500))


def test_a_night_counts_the_minutes_without_control(toured_world, said, driven_world):
    flags = toured_world.truth.flags.copy()
    flags[1000:1100] |= toured_world.truth.flag_bits["eclipse"]
    world = toured_world._replace(truth=replace(toured_world.truth, flags=flags))
    allowed = np.ones(3000, dtype=bool)
    allowed[1010:1030] = False
    reported = figures(world, driven_world, said(world.truth.attitude_deg, is_control_allowed=allowed))
    assert reported["night_off_min"] == 20.0


def test_a_lost_correction_is_alarmed_after_some_minutes(toured_world, said, driven_world):
    alarm = np.zeros(3000, dtype=bool)
    alarm[9 * HOUR + 12], alarm[30 * HOUR + 25] = True, True
    world = toured_world._replace(scenario="corrections_lost")
    reported = figures(world, driven_world, said(world.truth.attitude_deg, is_alarm=alarm))
    assert reported["alarm_delay_min"] == 25.0


def test_shares_are_pooled_and_minutes_are_means_of_the_seeds(toured_world, said, driven_world):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110, 1] += 0.2
    good = measured(toured_world, driven_world, said(toured_world.truth.attitude_deg))
    bad = measured(toured_world, driven_world, said(estimate, is_fade=np.arange(3000) >= 2970))
    reported = statistics_of([good, bad])
    assert reported["wrong_min"] == 5.0
    assert reported["rain_false_share"] == pytest.approx(30 / (2 * (3000 - HOUR)))


def test_what_did_not_happen_has_no_figure(toured_world, said, driven_world):
    reported = figures(toured_world, driven_world, said(toured_world.truth.attitude_deg))
    absent = {"rain_delay_min", "faults", "night_off_min", "alarm_delay_min", "dark_rms_deg.yaw"}
    assert absent.isdisjoint(reported)
