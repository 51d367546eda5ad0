"""Measures of accuracy: bounds, the yardstick and the gain of smoothing."""

import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.study.estimation.bounds import (
    AXES,
    BOUNDS,
    Bound,
    Limit,
    Mark,
    accuracy_statistics,
    at_least,
    at_most,
    idle_baselines,
    judge,
    measure_accuracy,
    within,
)
from service.study.estimation.campaign import GROUPS, SNAPSHOT, CampaignPlan, assess, collect_metrics
from service.study.estimation.flight.drive import PastSeries
from service.study.estimation.measures import gain_statistics, measure_gain, measure_method, statistics_of
from service.study.estimation.report import tables
from service.study.estimation.trials.snapshot_trials import SnapshotTrials, trial_statistics
from service.study.estimation.yardstick import dry_rows, measure_yardstick, measure_yardsticks, yardstick_statistics

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


ROLL = Bound("nominal", "rms_deg.roll", at_most(0.025), at_most(0.015), "test")
ROOT = Path(__file__).resolve().parents[5]
SCENARIOS = set(re.findall(r"^\| `(\w+)` \| \d+ \|", (ROOT / "docs/evidence/scenarios.md").read_text(), re.MULTILINE))


@pytest.mark.parametrize(
    ("value", "mark"),
    [
        (0.0, Mark.GOAL),
        (0.015, Mark.GOAL),
        (0.0151, Mark.MUST),
        (0.025, Mark.MUST),
        (0.0251, Mark.MISSED),
        (math.nan, Mark.MISSED),
        (math.inf, Mark.MISSED),
        (None, Mark.OPEN),
    ],
)
def test_both_limits_are_inclusive_and_what_is_no_number_misses(value, mark):
    assert ROLL.mark(value) is mark


def test_where_only_a_goal_was_set_nothing_can_be_missed():
    beaten = Bound("steps", "rms_deg.roll", None, at_most(0.029), "test")
    assert [beaten.mark(value) for value in (0.02, 0.04, math.nan)] == [Mark.GOAL, Mark.SHORT, Mark.SHORT]


def test_where_no_goal_was_set_a_must_is_all():
    asked = Bound("flicker", "wrong_min", at_most(10.0), None, "test")
    assert [asked.mark(value) for value in (0.0, 11.0)] == [Mark.MUST, Mark.MISSED]


@pytest.mark.parametrize(
    ("limit", "text"),
    [(at_most(0.5), "<= 0.5"), (at_least(0.9), ">= 0.9"), (within(1.0, 0.15), "0.85..1.15"), (Limit(1, 2), "1..2")],
)
def test_limits_read_as_a_reader_would_write_them(limit, text):
    assert str(limit) == text


def test_a_scenario_that_was_run_without_a_figure_has_missed_it():
    (judged,) = judge([ROLL], {("nominal", "robust"): {}})
    assert judged.mark is Mark.MISSED


def test_a_scenario_that_was_not_run_is_not_judged():
    (judged,) = judge([ROLL], {("octants", "robust"): {"rms_deg.roll": 0.01}})
    assert judged.mark is Mark.OPEN


def test_an_event_beyond_a_short_operation_is_not_judged():
    rain = Bound("downlink_rain", "rain_delay_min", at_most(3.0), None, "test")
    (judged,) = judge([rain], {("downlink_rain", "robust"): {}})
    assert judged.mark is Mark.OPEN


def test_a_baseline_that_keeps_every_bound_is_named():
    skill = Bound("nominal", "skill.roll", at_least(0.8), None, "test")
    figures = {
        ("nominal", "zero"): {"rms_deg.roll": 0.01, "skill.roll": 0.0},
        ("nominal", "coupling"): {"rms_deg.roll": 0.01, "skill.roll": 0.9},
    }
    assert idle_baselines([ROLL], figures, ("zero", "coupling")) == (("nominal", "zero"), ("nominal", "coupling"))
    assert idle_baselines([ROLL, skill], figures, ("zero", "coupling")) == (("nominal", "coupling"),)


def test_where_a_goal_was_asked_for_a_baseline_is_held_to_it():
    asked = Bound("mixed", "rms_deg.roll", at_most(0.06), at_most(0.03), "test", is_goal_asked=True)
    figures = {("mixed", "zero"): {"rms_deg.roll": 0.056}}
    assert idle_baselines([asked], figures, ("zero",)) == ()


def test_bounds_that_no_baseline_can_be_held_to_do_not_count():
    control = Bound("nominal", "wrong_min", at_most(0.0), None, "test")
    goal_only = Bound("nominal", "rms_deg.yaw", None, at_most(1.0), "test")
    assert idle_baselines([control, goal_only], {("nominal", "zero"): {"rms_deg.yaw": 0.0}}, ("zero",)) == ()


def test_every_bound_is_set_once():
    counts = Counter((bound.scenario, bound.method, bound.figure) for bound in BOUNDS)
    assert [key for key, count in counts.items() if count > 1] == []


def test_every_bound_names_a_scenario_that_is_run():
    assert {bound.scenario for bound in BOUNDS} - {SNAPSHOT} <= SCENARIOS
    assert {bound.scenario for bound in BOUNDS} <= set(GROUPS["all"])


def test_the_group_all_holds_every_scenario_of_the_simulator_once():
    assert len(SCENARIOS) > 40, "the page of the scenarios was not read"
    assert Counter(GROUPS["all"]) == Counter([*SCENARIOS, SNAPSHOT])
    assert all(set(group) <= set(GROUPS["all"]) for group in GROUPS.values())


def test_no_goal_is_easier_than_what_must_be():
    for bound in BOUNDS:
        if bound.must is not None and bound.goal is not None:
            assert bound.must.low <= bound.goal.low, bound
            assert bound.goal.high <= bound.must.high, bound


def test_a_bound_without_any_limit_would_judge_nothing():
    assert [bound for bound in BOUNDS if bound.must is None and bound.goal is None] == []
    assert [bound for bound in BOUNDS if bound.is_goal_asked and bound.goal is None] == []


ROWS = 3000


@pytest.fixture
def erring(toured_world, said):
    """Return the truth with 20 min of 0.2 deg in roll, 10 of them later by seven hours, and 0.5 deg in yaw once."""
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[100:110, 1] += 0.2
    estimate[530:540, 1] += 0.2
    estimate[2000, 0] += 0.5
    return said(estimate)


def test_wrong_torque_counts_roll_and_pitch_while_control_is_allowed(toured_world, driven_world, erring):
    driven = driven_world({"robust": erring})
    assert measure_yardstick(toured_world, driven, erring).wrong_min == 20.0
    allowed = np.ones(ROWS, dtype=bool)
    allowed[105:110] = False
    assert measure_yardstick(toured_world, driven, replace(erring, is_control_allowed=allowed)).wrong_min == 15.0


def test_the_first_hour_counts(toured_world, driven_world, said):
    estimate = toured_world.truth.attitude_deg.copy()
    estimate[:10, 2] += 0.16
    series = said(estimate)
    assert measure_yardstick(toured_world, driven_world({"robust": series}), series).wrong_min == 10.0


def test_rms_stands_beside_the_stated_sigma(toured_world, driven_world, said):
    series = said(toured_world.truth.attitude_deg + np.array([0.04, 0.02, 0.01]), sigma_deg=0.02)
    found = measure_yardstick(toured_world, driven_world({"robust": series}), series)
    np.testing.assert_allclose(found.rms_deg, [0.04, 0.02, 0.01], atol=1e-12)  # rounding
    np.testing.assert_allclose(found.rms_over_sigma, [2.0, 1.0, 0.5], atol=1e-9)  # rounding


def test_misleading_rows_closer_than_six_hours_are_one_episode(toured_world, driven_world, erring):
    level = np.full((ROWS, 3), 0.1)
    driven = driven_world({"robust": erring})
    protection = measure_yardstick(toured_world, driven, replace(erring, protection_deg=level)).protection
    assert (protection.misleading_share, protection.episodes) == (21 / ROWS, 3)
    level[:, 0] = 0.6
    level[530:540] = np.nan
    protection = measure_yardstick(toured_world, driven, replace(erring, protection_deg=level)).protection
    assert (protection.misleading_share, protection.episodes, protection.without_share) == (10 / ROWS, 1, 10 / ROWS)
    np.testing.assert_allclose(protection.median_dry_deg, 0.1)


def test_a_row_is_dry_while_fewer_than_two_stations_are_wet(toured_world, said, driven_world):
    loss = np.zeros((ROWS, 4))
    loss[:600, 0] = 0.31
    loss[300:600, 1] = 0.31
    loss[600:900] = 0.29
    truth = replace(toured_world.truth, station_loss_db=loss)
    assert (~dry_rows(truth)).nonzero()[0].tolist() == list(range(300, 600))
    # two carriers of one station are one station
    assert dry_rows(replace(truth, stations=("s0", "s0", "s2", "s3"))).all()
    allowed = np.zeros(ROWS, dtype=bool)
    allowed[600:1140] = True
    world = toured_world._replace(truth=truth)
    series = said(truth.attitude_deg, is_control_allowed=allowed)
    assert measure_yardstick(world, driven_world({"robust": series}), series).allowed_dry == 540 / 2700


def test_trivial_answers_stand_beside_the_method(toured_world, driven_world, erring):
    allowed = np.ones(ROWS, dtype=bool)
    allowed[100:110] = False
    series = replace(erring, is_control_allowed=allowed)
    found = measure_yardsticks(toured_world, driven_world({"robust": series}), "robust")
    assert {name: (one.wrong_min, one.allowed_dry) for name, one in found.items()} == {
        "robust": (10.0, (ROWS - 10) / ROWS),
        "never allow": (0.0, 0.0),
        "always allow": (20.0, 1.0),
        "three sigma": (10.0, (ROWS - 10) / ROWS),
    }
    # errors of 0.2 and 0.5 deg at a sigma of 0.02
    assert found["three sigma"].protection.episodes == 3
    assert measure_yardsticks(toured_world, driven_world({"robust": series}), "paper") == {}


def test_means_and_the_worst_seed(toured_world, driven_world, erring, said):
    right = said(toured_world.truth.attitude_deg)
    seeds = {
        seed: measure_yardsticks(toured_world, driven_world({"robust": series}), "robust")["three sigma"]
        for seed, series in ((4, right), (7, erring))
    }
    figures = yardstick_statistics(seeds)
    assert [figures[f"yardstick.wrong_min{end}"] for end in ("", ".worst", ".worst_seed")] == [10.0, 20.0, 7.0]
    assert (figures["yardstick.episodes"], figures["yardstick.misleading_share"]) == (3.0, 10.5 / ROWS)
    assert figures["yardstick.level_deg.roll"] == pytest.approx(0.06)


def test_the_table_has_a_row_for_each_answer(judged_unit, toured_world, driven_world, erring):
    yardsticks = measure_yardsticks(toured_world, driven_world({"robust": erring}), "robust")
    results = [replace(judged_unit(seed=seed), yardsticks=yardsticks) for seed in (1, 2)]
    campaign = assess(CampaignPlan(("octants",), 2), 1.0, tuple(results), collect_metrics(results))
    reported = {table.title.partition(":")[0]: table for table in tables(campaign)}
    wrong = {row[1]: row[2] for row in reported["Confident and wrong"].rows}
    assert wrong == {
        "robust": "20; 20 (1)",
        "never allow": "0; 0 (1)",
        "always allow": "20; 20 (1)",
        "three sigma": "20; 20 (1)",
    }
    # only one of them states a level
    assert [row[1:4] for row in reported["Protection levels"].rows] == [("three sigma", "0.0070; 0.0070 (1)", "6")]
    # what only the yardstick measures is no answer of the other tables
    assert {row[1] for row in tables(campaign)[0].rows} == {"robust", "paper"}


TIME = np.linspace(0.0, 12.0 * np.pi, 2000)
TRUTH = np.column_stack([0.3 * np.sin(TIME), 0.2 * np.cos(TIME), 0.1 * np.sin(2.0 * TIME)])
SIGMA = np.full_like(TRUTH, 0.02)


def accuracy_of(estimate, truth=TRUTH, sigma=SIGMA):
    return accuracy_statistics([measure_accuracy(estimate, sigma, truth)])


def test_a_scaled_answer_has_its_slope_and_a_sigma_that_fits_is_honest():
    found = accuracy_of(0.5 * TRUTH, sigma=np.abs(0.5 * TRUTH))
    for axis in AXES:
        assert found[f"slope.{axis}"] == pytest.approx(0.5, rel=1e-9)
        # mean of the squared errors is exactly that of the squared sigmas
        assert found[f"rms_over_sigma.{axis}"] == pytest.approx(1.0, rel=1e-12)
        assert found[f"skill.{axis}"] == pytest.approx(0.75, rel=1e-12)


def test_rms_is_the_mean_of_seeds_and_skill_is_pooled():
    small, large = measure_accuracy(0.9 * TRUTH, SIGMA, TRUTH), measure_accuracy(np.zeros((9, 3)), SIGMA[:9], TRUTH[:9])
    found = accuracy_statistics([small, large])
    own = [np.sqrt(seed.mean_square_error[1]) for seed in (small, large)]
    assert found["rms_deg.roll"] == pytest.approx(np.mean(own), rel=1e-12)
    error = small.mean_square_error[1] + large.mean_square_error[1]
    truth = small.mean_square_truth[1] + large.mean_square_truth[1]
    assert found["skill.roll"] == pytest.approx(1.0 - error / truth, rel=1e-12)


def test_rows_without_an_answer_do_not_count_while_they_are_few():
    estimate = TRUTH.copy()
    estimate[::20] = np.nan
    found = accuracy_of(estimate)
    assert found["answered"] == pytest.approx(0.95)
    assert found["rms_deg.yaw"] == 0.0


@pytest.mark.parametrize("share", [0.0, 0.5, 0.89])
def test_silence_has_no_accuracy(share):
    estimate = TRUTH.copy()
    estimate[int(share * len(TRUTH)) :] = np.nan
    found = accuracy_of(estimate)
    assert found["answered"] == pytest.approx(share, abs=1e-3)
    assert all(np.isnan(found[f"{name}.{axis}"]) for name in ("rms_deg", "skill", "slope") for axis in AXES)


def test_one_silent_seed_takes_the_figures_of_all():
    good = measure_accuracy(TRUTH, SIGMA, TRUTH)
    silent = measure_accuracy(np.full_like(TRUTH, np.nan), SIGMA, TRUTH)
    assert np.isnan(accuracy_statistics([good, silent])["rms_deg.roll"])


def test_no_rows_at_all_are_no_answer():
    assert measure_accuracy(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))).answered == 0.0


@pytest.fixture
def gained(toured_world, driven_world, said):
    """Measure a filter that is off by a known error, and a smoother that is off by another, on every fifth row."""

    def make(filter_error, smoothed_error, sigma_deg=0.01):
        truth = toured_world.truth.attitude_deg
        rows = np.arange(0, len(truth), 5)
        past = PastSeries(
            toured_world.ground.epochs_us[rows], truth[rows] + smoothed_error, np.full((len(rows), 3), sigma_deg)
        )
        return measure_gain(toured_world, driven_world({}), said(truth + filter_error), past)

    return make


def test_figures_are_ratios_of_what_was_put_in(gained):
    found = gain_statistics("smoothed", [gained(0.02, 0.01)])
    for axis in AXES:
        assert found[f"smoothed.rms_deg.{axis}"] == pytest.approx(0.01, rel=1e-9)
        assert found[f"smoothed.over_filter.{axis}"] == pytest.approx(0.5, rel=1e-9)
        assert found[f"smoothed.over_sigma.{axis}"] == pytest.approx(1.0, rel=1e-9)
    # nothing happened in this world
    assert not any("event" in name or "dark" in name for name in found)


def test_seeds_are_pooled_by_squares(gained):
    found = gain_statistics("smoothed", [gained(0.02, 0.02), gained(0.04, 0.0)])
    expected = np.sqrt(0.02**2 / (0.02**2 + 0.04**2))
    assert found["smoothed.over_filter.roll"] == pytest.approx(expected, rel=1e-9)


def test_large_errors_count_near_events_alone(gained, toured_world):
    toured_world.truth.flags[1500:, 1] = 4
    found = gain_statistics("smoothed", [gained(0.001, 0.05)])
    assert found["smoothed.large_near_events.yaw"] == 1.0
    assert found["smoothed.filter_large_near_events.yaw"] == 0.0


def test_rows_without_carriers_give_the_largest_error(gained, toured_world):
    toured_world.truth.flags[1000:1200] = 2
    found = gain_statistics("smoothed", [gained(0.02, -0.03)])
    assert found["smoothed.dark_deg.pitch"] == pytest.approx(0.03, rel=1e-9)
    assert found["smoothed.filter_dark_deg.pitch"] == pytest.approx(0.02, rel=1e-9)


def test_no_row_no_figure(gained, toured_world):
    assert gain_statistics("smoothed", []) == {}


def trials(far=(0, 0, 0, 0, 0, 0, 0, 40), square=1.0, covariance=1.0, excluded=0.0):
    count = len(far)
    return SnapshotTrials(
        np.full(3, square),
        np.array([1.0, 1.21, 1.44]),
        covariance,
        1.0,
        np.full(count, 100.0),
        np.array(far, dtype=float),
        np.full(count, 1000.0),
        np.full(count, excluded),
        np.array([0.0004, -0.0001]),
    )


def test_ratios_are_pooled_as_squares():
    found = trial_statistics([trials(square=1.0), trials(square=3.0)])
    assert found["over_bound_true.yaw"] == pytest.approx(np.sqrt(2.0))
    assert [found[f"over_bound_fitted.{axis}"] for axis in ("yaw", "roll", "pitch")] == pytest.approx([1.0, 1.1, 1.2])


def test_the_yaw_scale_is_pooled():
    assert trial_statistics([trials(covariance=0.9), trials(covariance=1.2)])["yaw_scale"] == pytest.approx(1.05)


@pytest.mark.parametrize(
    ("far", "breakdown"), [((0, 0, 0, 0, 0, 0, 0, 40), 6), ((0, 0, 5, 0, 0, 0, 0, 0), 1), ((0,) * 8, 7), ((1,) * 8, -1)]
)
def test_the_breakdown_is_the_last_number_up_to_which_all_is_well(far, breakdown):
    # one far fix of a hundred is 1 %, which is too many
    assert trial_statistics([trials(far=far)])["breakdown"] == breakdown


def test_exclusions_are_counted_up_to_the_breakdown():
    found = trial_statistics([trials(excluded=2.0)])
    assert found["false_exclusion_share"] == pytest.approx(0.002)


def test_the_error_of_the_level_is_pooled_and_never_below_nothing():
    found = trial_statistics([trials(), trials()])
    assert (found["level_day1_db"], found["level_day7_db"]) == (pytest.approx(0.02), 0.0)
