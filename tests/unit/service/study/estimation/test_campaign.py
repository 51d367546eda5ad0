"""A campaign's figures and verdict from results that are known."""

import numpy as np
import pytest

from service.study.estimation.accuracy import AXES
from service.study.estimation.bound_table import BOUNDS
from service.study.estimation.bounds import Bound, Mark, at_least, at_most
from service.study.estimation.campaign import CampaignPlan, assess, collect_metrics, versions
from service.study.estimation.flight.baselines import BASELINES, UNINFORMED
from service.study.estimation.measures import measure_method

PLAN = CampaignPlan(("octants",), 2)


def assessed(results, **options):
    return assess(PLAN, 1.0, tuple(results), collect_metrics(results), **options)


def test_a_right_answer_misses_nothing_and_no_baseline_keeps_the_bounds(judged_unit):
    campaign = assessed([judged_unit(seed=1), judged_unit(seed=2)])
    # half the truth, which the paper method answers, is off by 0.07 deg rms: its bounds are 0.08 and 0.10
    assert campaign.missed == ()
    assert campaign.idle == ()
    assert campaign.refusals == ()


def test_figures_stand_for_both_methods_and_every_baseline(judged_unit):
    figures = collect_metrics([judged_unit()])
    assert set(figures) == {("octants", answer) for answer in ("robust", "paper", *BASELINES)}
    assert figures["octants", "zero"]["skill.roll"] == 0.0
    assert figures["octants", "robust"]["rms_deg.roll"] == 0.0


def test_the_covariance_bound_is_what_the_oracle_states_of_itself(judged_unit, said, toured_world, driven_world):
    unit = judged_unit()
    truth = toured_world.truth.attitude_deg
    oracle = said(truth + 0.03, sigma_deg=0.04)
    unit.methods["oracle"] = measure_method(toured_world, driven_world({}), oracle)
    figures = collect_metrics([unit])
    for axis in AXES:
        assert figures["octants", "oracle"][f"bound_deg.{axis}"] == pytest.approx(0.04, rel=1e-12)
        assert figures["octants", "oracle"][f"rms_over_bound.{axis}"] == pytest.approx(0.75, rel=1e-12)
        half = figures["octants", "paper"]
        assert half[f"rms_over_bound.{axis}"] == pytest.approx(half[f"rms_deg.{axis}"] / 0.04, rel=1e-12)


def test_quiet_scenarios_are_not_judged_by_skill_and_slope():
    judged = {bound.scenario for bound in BOUNDS if bound.figure.startswith(("skill", "slope"))}
    assert judged == {"octants", "yaw_hold"}


def test_a_refused_seed_misses_every_bound_of_its_scenario(judged_unit):
    campaign = assessed([judged_unit(seed=1), judged_unit(seed=2, is_silent=True)])
    accuracy = [judged for judged in campaign.judged if judged.bound.is_of_accuracy]
    assert len(accuracy) == 10
    assert all(judged.mark is Mark.MISSED for judged in accuracy)
    assert [refused.unit.seed for refused in campaign.refusals] == [2]


def test_bounds_that_a_baseline_keeps_are_named(judged_unit):
    easy = [Bound("octants", "rms_deg.roll", at_most(1.0), None, "test")]
    assert assessed([judged_unit()], bounds=easy).idle == tuple(("octants", name) for name in UNINFORMED)
    hard = [*easy, Bound("octants", "skill.roll", at_least(0.5), None, "test")]
    assert assessed([judged_unit()], bounds=hard).idle == ()


def test_only_scenarios_that_were_run_are_judged(judged_unit):
    assert {judged.bound.scenario for judged in assessed([judged_unit()]).judged} == {"octants"}


def test_an_eclipse_is_held_against_the_same_craft_without_one(judged_unit):
    dark, bright = judged_unit("eclipse"), judged_unit("nominal")
    assert dark.course is not None
    dark.course.is_night[1000:1100] = True
    dark.course.methods["robust"].estimate_deg[1000:1100, 1] += 0.03
    figures = collect_metrics([dark, bright])
    assert figures["eclipse", "robust"]["shift_deg.roll"] == pytest.approx(0.03, abs=1e-6)  # float32
    assert "shift_deg.roll" not in collect_metrics([dark])["eclipse", "robust"]


def test_what_made_the_figures_is_told():
    assert versions()["numpy"] == np.__version__
    assert set(versions()) == {"python", "soo", "numpy", "scipy"}
