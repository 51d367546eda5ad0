"""``soo study``: what is run, printed and drawn, and the exit codes."""

import json

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.study.estimation import campaign as campaign_module
from service.study.estimation.campaign import GROUPS, CampaignPlan, assess
from service.study.estimation.flight.world import ExportFailedError
from service.study.executors import WorkerChoice
from service.study.limit_cycles import figures as figures_module
from service.study.limit_cycles import report as report_module
from service.study.published import row as published_row

GOOD = published_row("T, s", "A0", 190.0, 190.0, "", digits=10)
BAD = published_row("T, s", "A0", 190.0, 191.0, "", digits=10)


@pytest.fixture
def ran(monkeypatch):
    """Run the command with tables that are made up."""

    def run(*arguments, row=GOOD):
        monkeypatch.setattr(report_module, "reproduce", lambda: {"T1 Limit cycles": [row]})
        return CliRunner().invoke(app, ["study", "limit-cycles", *arguments])

    return run


def test_tables_are_printed(ran):
    result = ran()
    assert result.exit_code == 0, result.output
    assert "T1 Limit cycles" in result.output
    assert "1 figures, 0 missed" in result.output


def test_a_missed_figure_is_an_exit_code(ran):
    result = ran(row=BAD)
    assert result.exit_code == 1
    assert "missed: T1 Limit cycles: T, s, A0, 190, 191" in result.output


def test_json_alone(ran):
    document = json.loads(ran("--json", row=BAD).stdout)
    assert (document["missed"], document["rows"][0]["reproduced"]) == (1, 191.0)


def test_markdown_alone(ran):
    assert ran("--markdown").stdout.startswith("| figure | parameters |")


@pytest.mark.parametrize(("options", "suffix"), [((), "png"), (("--svg",), "svg")])
def test_figures_go_where_they_are_told(ran, monkeypatch, tmp_path, options, suffix):
    drawn = []

    def draw(folder, *, suffix):
        drawn.append((folder, suffix))
        return [folder / f"one.{suffix}"]

    monkeypatch.setattr(figures_module, "draw_figures", draw)
    result = ran("--figures", str(tmp_path / "new"), *options)
    assert result.exit_code == 0, result.output
    assert drawn == [(tmp_path / "new", suffix)]
    assert (tmp_path / "new").is_dir()
    assert f"one.{suffix}" in result.stderr


STUDY_GOOD = {
    "answered": 1.0,
    "rms_deg.roll": 0.01,
    "rms_deg.pitch": 0.01,
}


@pytest.fixture
def study_ran(monkeypatch):
    """Run the command with a campaign that is made up; give result and plan."""
    plans = []

    def run(*arguments, figures=STUDY_GOOD, error=None):
        def run_campaign(plan, show):
            plans.append(plan)
            show(1, 2)
            if error is not None:
                raise error
            return assess(plan, 1.0, (), {("maneuver", "robust"): figures})

        monkeypatch.setattr(campaign_module, "run_campaign", run_campaign)
        return CliRunner().invoke(app, ["study", "estimation", *arguments]), plans[-1] if plans else None

    return run


def test_everything_is_run_with_ten_seeds_unless_something_is_named(study_ran):
    _, plan = study_ran()
    assert plan == CampaignPlan(GROUPS["all"], 10, WorkerChoice(2), None)


def test_a_scenario_alone_is_run_alone(study_ran):
    _, plan = study_ran("--scenario", "white", "--scenario", "octants", "--seeds", "3", "--workers", "1")
    assert plan == CampaignPlan(("white", "octants"), 3, WorkerChoice(1), None)


def test_a_group_and_scenarios_are_run_together_and_each_once(study_ran):
    words = ("--group", "quick", "--scenario", "white", "--scenario", "nominal", "--operation-days", "0.5")
    _, plan = study_ran(*words, "--scheduler", "tcp://host:8786")
    assert plan == CampaignPlan((*GROUPS["quick"], "white"), 10, WorkerChoice(2, "tcp://host:8786"), 0.5)


def test_an_unknown_group_is_refused(study_ran):
    result, plan = study_ran("--group", "nosuch")
    assert (result.exit_code, plan) == (2, None)
    assert "no group 'nosuch'; there are quick" in result.output


def test_kept_bounds_end_with_zero_and_are_printed(study_ran):
    result, _ = study_ran("--scenario", "maneuver")
    assert result.exit_code == 0, result.output
    assert "2 bounds: 2 goal" in result.output
    assert "Bounds" in result.output


def test_a_missed_bound_ends_with_one(study_ran):
    result, _ = study_ran("--scenario", "maneuver", figures={**STUDY_GOOD, "rms_deg.roll": 0.2})
    assert result.exit_code == 1
    assert "missed: maneuver, robust, rms_deg.roll = 0.2, must be <= 0.035" in result.output


def test_json_is_one_document(study_ran):
    result, _ = study_ran("--scenario", "maneuver", "--json")
    document = json.loads(result.stdout)
    assert document["command"] == "soo study estimation --scenario maneuver --seeds 10"
    assert document["figures"]["maneuver"]["robust"]["rms_deg.roll"] == 0.01


def test_markdown_stands_between_markers(study_ran):
    result, _ = study_ran("--scenario", "maneuver", "--markdown")
    assert result.stdout.startswith("<!-- soo study estimation: begin -->")
    assert result.stdout.endswith("<!-- soo study estimation: end -->\n")


@pytest.mark.parametrize(
    ("error", "words"),
    [(ExportFailedError("the simulator wrote no world"), "wrote no world"), (KeyboardInterrupt(), "stopped")],
)
def test_what_could_not_be_run_ends_with_two(study_ran, error, words):
    result, _ = study_ran("--scenario", "maneuver", error=error)
    assert result.exit_code == 2
    assert words in result.output


def test_figures_are_drawn_into_a_folder_that_is_made(study_ran, tmp_path):
    result, _ = study_ran("--scenario", "maneuver", "--figures", str(tmp_path / "drawn"))
    # nothing was driven, so nothing is drawn
    assert result.exit_code == 0, result.output
    assert list((tmp_path / "drawn").iterdir()) == []
