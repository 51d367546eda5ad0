"""``soo study limit-cycles``: what is printed, what is drawn, and the exit code."""

import json

import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.study.limit_cycles import figures as figures_module
from service.study.limit_cycles import report as report_module
from service.study.limit_cycles.comparison import Compared, ComparedTable
from service.study.limit_cycles.report import Reproduction

GOOD = Compared("A0", "T, s", 190.0, 190.0, 1e-8)
BAD = Compared("A0", "T, s", 190.0, 191.0, 1e-8)


@pytest.fixture
def ran(monkeypatch):
    """Run the command with tables that are made up."""

    def run(*arguments, row=GOOD):
        done = Reproduction((ComparedTable("T1", "Limit cycles", (row,)),), 2.0)
        monkeypatch.setattr(report_module, "reproduce", lambda: done)
        return CliRunner().invoke(app, ["study", "limit-cycles", *arguments])

    return run


def test_tables_and_time_are_printed(ran):
    result = ran()
    assert result.exit_code == 0, result.output
    assert "T1 Limit cycles" in result.output
    assert "1 figures, 1 within their tolerance, 2.0 s" in result.output


def test_a_missed_figure_is_an_exit_code(ran):
    result = ran(row=BAD)
    assert result.exit_code == 1
    assert "missed: T1, A0, T, s: 191, reference 190" in result.output


def test_json_alone(ran):
    document = json.loads(ran("--json", row=BAD).stdout)
    assert (document["missed"], document["tables"]["T1"]["rows"][0]["found"]) == (1, 191.0)


def test_markdown_alone(ran):
    assert ran("--markdown").stdout.startswith("### T1 Limit cycles\n")


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
