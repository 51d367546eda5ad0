"""Marks: what a figure earns, and where bounds prove nothing."""

import math
import re
from collections import Counter
from pathlib import Path

import pytest

from service.study.estimation.bound_table import BOUNDS
from service.study.estimation.bounds import Bound, Limit, Mark, at_least, at_most, idle_baselines, judge, within
from service.study.estimation.scenarios import GROUPS, SNAPSHOT

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
