"""Campaigns of the study of estimation and what they measure."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from service.study import executors
from service.study.estimation import campaign as campaign_module
from service.study.estimation.bounds import AXES, BOUNDS, Bound, Mark, at_least, at_most
from service.study.estimation.campaign import (
    CampaignPlan,
    Course,
    Drawn,
    Rain,
    Unit,
    assess,
    collect_metrics,
    night_statistics,
    run_unit,
    versions,
)
from service.study.estimation.figures import draw_campaign
from service.study.estimation.flight.baselines import BASELINES, UNINFORMED
from service.study.estimation.flight.drive import UndrivenError
from service.study.estimation.measures import measure_method
from service.study.estimation.report import (
    MARKER_BEGIN,
    MARKER_END,
    _number,
    as_document,
    markdown,
    tables,
    verdict_lines,
)
from service.study.executors import ClusterError

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
    assert assessed([judged_unit()], all_bounds=easy).idle == tuple(("octants", name) for name in UNINFORMED)
    hard = [*easy, Bound("octants", "skill.roll", at_least(0.5), None, "test")]
    assert assessed([judged_unit()], all_bounds=hard).idle == ()


def test_only_scenarios_that_were_run_are_judged(judged_unit):
    assert {judged.bound.scenario for judged in assessed([judged_unit()]).judged} == {"octants"}


def test_an_eclipse_is_held_against_the_same_craft_without_one(judged_unit):
    dark, bright = judged_unit("eclipse"), judged_unit("nominal")
    dark.course.is_night[1000:1100] = True
    dark.course.methods["robust"].estimate_deg[1000:1100, 1] += 0.03
    figures = collect_metrics([dark, bright])
    assert figures["eclipse", "robust"]["shift_deg.roll"] == pytest.approx(0.03, abs=1e-6)  # float32
    assert "shift_deg.roll" not in collect_metrics([dark])["eclipse", "robust"]


def test_what_made_the_figures_is_told():
    assert versions()["numpy"] == np.__version__
    assert set(versions()) == {"python", "soo", "numpy", "scipy"}


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (UndrivenError("calibration refused: no rows"), "calibration refused: no rows"),
        (ZeroDivisionError("by zero"), "the product failed: ZeroDivisionError: by zero"),
    ],
)
def test_a_world_that_cannot_be_driven_is_a_refusal(monkeypatch, toured_world, error, words):
    def drive(ground):
        raise error

    monkeypatch.setattr(campaign_module, "simulated_world", lambda *_: toured_world)
    monkeypatch.setattr(campaign_module, "drive", drive)
    result = run_unit(Unit("octants", 1))
    assert result.refusal == words
    assert (result.methods, result.course) == ({}, None)


def test_what_was_said_is_measured_and_kept_for_the_figures(monkeypatch, toured_world, said, driven_world):
    driven = driven_world({"robust": said(toured_world.truth.attitude_deg)})
    monkeypatch.setattr(campaign_module, "simulated_world", lambda *_: toured_world)
    monkeypatch.setattr(campaign_module, "drive", lambda _: driven)
    oracle = said(0.9 * toured_world.truth.attitude_deg)
    monkeypatch.setattr(campaign_module, "oracle_series", lambda _world, _rows: oracle)
    result = run_unit(Unit("octants", 1))
    assert result.refusal == ""
    assert set(result.methods) == {"robust", "oracle"}
    assert set(result.yardsticks) == {"robust", "never allow", "always allow", "three sigma", "oracle"}
    assert set(result.baselines) == {"zero", "corrections", "coupling", "corrections_read"}
    assert result.course.hours[-1] == pytest.approx(2999 / 60, rel=1e-6)  # float32
    # the zero answer's error is the truth's own size, after the first hour
    assert result.baselines["zero"].answered == 1.0


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


COMMAND = "soo study estimation --scenario octants --seeds 1"


@pytest.fixture
def campaign(judged_unit):
    results = (judged_unit(), judged_unit("corrections_lost"))
    return assess(CampaignPlan(("octants", "corrections_lost"), 1), 12.34, results, collect_metrics(results))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0944, 3, "0.094"),
        (-0.784, 2, "-0.78"),
        (1.0, 3, "1.000"),
        (0.85, None, "0.85"),
        (6.0, None, "6"),
        (0.0, None, "0"),
        (-0.2, 0, "0"),
        (-112.34, 2, "-112"),
        (math.inf, 0, "never"),
        (math.nan, 3, "-"),
        (None, 3, "-"),
    ],
)
def test_numbers_stand_without_needless_characters(value, digits, text):
    assert _number(value, digits) == text


def test_tables_have_a_row_for_each_method_and_none_for_what_did_not_happen(campaign):
    reported = {table.title: table for table in tables(campaign)}
    assert list(reported) == ["Errors", "Rms of answers without powers", "Control", "Bounds"]
    assert [row[:2] for row in reported["Errors"].rows] == [
        ("octants", "robust"),
        ("octants", "paper"),
        ("corrections_lost", "robust"),
        ("corrections_lost", "paper"),
    ]
    assert all(len(row) == len(table.columns) for table in reported.values() for row in table.rows)


def test_the_axes_of_a_bound_stand_in_one_row(campaign):
    (bounds,) = (table for table in tables(campaign) if table.title == "Bounds")
    skill = next(row for row in bounds.rows if row[:3] == ("octants", "robust", "skill"))
    assert skill[3:] == ("1/1/1", ">= 0.7/0.97/0.97", ">= 0.85/0.99/0.99 (asked)", "goal")
    greatest = next(row for row in bounds.rows if row[2].startswith("max_deg"))
    assert greatest[2:] == ("max_deg roll/pitch", "0/0", "<= 0.1", "-", "must")


def test_the_document_is_json_and_holds_figures_bounds_and_how_it_was_made(campaign):
    document = json.loads(json.dumps(as_document(campaign, COMMAND), allow_nan=False))
    assert (document["command"], document["seeds"], document["seconds"]) == (COMMAND, [1], 12.3)
    assert document["figures"]["octants"]["zero"]["skill.roll"] == 0.0
    # an answer that states no sigma has no ratio to it
    assert document["figures"]["octants"]["zero"]["rms_over_sigma.roll"] is None
    alarm = next(bound for bound in document["bounds"] if bound["figure"] == "alarm_delay_min")
    # never raised: no number that JSON can hold, and missed
    assert (alarm["value"], alarm["mark"], alarm["must"]) == (None, "missed", [None, 30.0])
    assert document["missed"] == len(campaign.missed) > 0


def test_every_miss_is_named_in_words(campaign):
    lines = verdict_lines(campaign)
    assert lines[0].startswith(f"{len(campaign.judged)} bounds: ")
    assert "missed: corrections_lost, robust, alarm_delay_min = never, must be <= 30" in lines


def test_a_refusal_is_told(judged_unit):
    results = (judged_unit(is_silent=True),)
    campaign = assess(CampaignPlan(("octants",), 1), 1.0, results, collect_metrics(results))
    assert "refused: octants, seed 1: calibration refused: no rows" in verdict_lines(campaign)
    assert [table.title for table in tables(campaign)] == ["Bounds"]


def test_the_page_stands_between_markers_and_fits_a_screen(campaign):
    page = markdown(campaign, COMMAND)
    lines = page.splitlines()
    assert (lines[0], lines[-1]) == (MARKER_BEGIN, MARKER_END)
    assert f"Made by `{COMMAND}`" in page.replace("\n", " ")
    assert "### Errors" in lines
    assert max(map(len, lines)) <= 125  # a row of errors with long numbers


def test_every_scenario_and_the_overview_are_drawn(judged_unit, tmp_path):
    results = (judged_unit(), judged_unit(seed=2), judged_unit("nominal"), judged_unit("white", is_silent=True))
    campaign = assess(CampaignPlan(("octants", "nominal", "white"), 2), 1.0, results, collect_metrics(results))
    paths = draw_campaign(campaign, tmp_path)
    # nothing could be driven in `white`
    assert [path.name for path in paths] == ["octants.png", "nominal.png", "overview.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_the_storm_over_most_stations_is_drawn(judged_unit, tmp_path):
    results = []
    for seed, stations in ((1, 3), (2, 5), (3, 2)):
        one = judged_unit("octants", seed)
        shape = (len(one.course.hours), 6)
        rain = Rain(np.where(np.arange(6) < stations, 1.0, 0.0) * np.ones(shape), np.zeros(shape, dtype=int))
        results.append(replace(one, course=one.course._replace(rain=rain)))
    few, most = (
        draw_campaign(assess(CampaignPlan(("octants",), 1), 1.0, some, collect_metrics(some)), tmp_path)
        for some in (results[2:], results)
    )
    assert [path.name for path in few] == ["octants.png", "overview.png"]
    assert [path.name for path in most] == ["octants.png", "storm_octants.png", "overview.png"]


def test_a_campaign_of_refusals_draws_nothing(judged_unit, tmp_path):
    results = (judged_unit(is_silent=True),)
    campaign = assess(CampaignPlan(("octants",), 1), 1.0, results, collect_metrics(results))
    assert draw_campaign(campaign, tmp_path) == []


@pytest.mark.parametrize("name", ["soo", "numba", "python"])
def test_a_worker_of_another_version_is_refused_by_name(monkeypatch, name):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    here = executors._programs()
    assert executors._run_checked(here, lambda: 7) == 7
    refused = rf"{name} {here[name]} in place of 0\.0: bring it to the state of this machine"
    with pytest.raises(ClusterError, match=refused):
        executors._run_checked(here | {name: "0.0"}, lambda: 7)
