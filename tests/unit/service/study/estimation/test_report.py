"""What a campaign tells: one row a scenario and method, JSON without what JSON cannot hold, tables between markers."""

import json
import math

import pytest

from service.study.estimation.campaign import CampaignPlan, assess, collect_metrics
from service.study.estimation.report import (
    MARKER_BEGIN,
    MARKER_END,
    _number,
    markdown,
    tables,
    verdict_lines,
)
from service.study.estimation.report_document import as_document

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
