"""Figures of closed loops on flights whose figures are known, and what they lead to."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from service.study.closed_loop.campaign import LoopCampaign, LoopPlan
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.figures import draw_campaign
from service.study.closed_loop.merit import MEASURED_SCENARIO, UNKNOWN_TORQUE_SCENARIOS, group_merit, run_merit
from service.study.closed_loop.report import COLUMNS, as_document, cells, markdown, verdict
from service.study.closed_loop.run import FlownRun, LoopResult, LoopUnit

ROWS = 600


def flight(largest_deg=(0.1, 0.1, 0.1), faded_rows=(0, 0), settles_at=0, inhibited=0) -> FlownRun:
    """Return ten hours at a row a minute; roll and pitch sit at their largest until a row, then at nothing."""
    truth = np.zeros((ROWS, 3))
    truth[0] = largest_deg
    truth[:settles_at, 1:] = largest_deg[1:]
    wet = np.zeros(ROWS, dtype=np.bool_)
    wet[slice(*faded_rows)] = True
    return FlownRun(
        hours=np.arange(ROWS) / 60.0,
        truth_deg=truth,
        estimate_deg=truth,
        is_inhibited=np.arange(ROWS) < inhibited,
        is_faded=wet,
        impulse_n_m_s=(0.01, 0.02, 0.03),
        sent=3,
        reported={"executed": 3},
    )


def results(flights, scenario="nominal", sensing=Sensing.AUTOMATIC) -> list[LoopResult]:
    return [
        LoopResult(LoopUnit(scenario, seed, sensing), 1.0, "" if flown else "refused", flown)
        for seed, flown in enumerate(flights, start=1)
    ]


def test_figures_of_a_run_are_those_of_its_rows():
    merit = run_merit(flight((0.3, -0.15, 0.1), inhibited=90))
    assert merit.largest_deg == (0.3, 0.15, 0.1)
    assert merit.inhibited_h == pytest.approx(1.5)
    assert merit.impulse_n_m_s == (0.01, 0.02, 0.03)
    assert merit.settled_h is None


@pytest.mark.parametrize(
    ("largest_deg", "is_narrow", "is_wide"),
    [
        ((0.39, 0.19, 0.19), True, True),
        ((0.41, 0.1, 0.1), False, True),
        ((0.1, 0.21, 0.1), False, True),
        ((0.1, 0.1, 0.31), False, False),
        ((0.51, 0.1, 0.1), False, False),
    ],
)
def test_limits_are_those_that_were_asked(largest_deg, is_narrow, is_wide):
    merit = run_merit(flight(largest_deg))
    assert (merit.is_narrow, merit.is_wide) == (is_narrow, is_wide)


def test_the_time_to_come_back_counts_from_the_end_of_the_fade():
    # wet until row 99, small again from row 160 on
    merit = run_merit(flight((0.0, 0.35, 0.35), (20, 100), 160))
    assert merit.settled_h == pytest.approx(61 / 60)
    assert merit.is_fade_survived
    assert not run_merit(flight((0.0, 0.41, 0.0), (20, 100), 160)).is_fade_survived
    assert not run_merit(flight((0.0, 0.35, 0.0), (20, 100), 290)).is_fade_survived
    never = run_merit(flight((0.0, 0.35, 0.0), (20, 100), ROWS))
    assert never.settled_h == math.inf


def test_an_unknown_torque_is_survived_within_its_limits_and_without_losing_control():
    for name in UNKNOWN_TORQUE_SCENARIOS:
        kept = group_merit(results([flight((0.99, 0.29, 0.29), inhibited=15)], name))
        assert kept.is_met
        assert kept.longest_inhibited_h == pytest.approx(0.25)
        for bad in (flight((1.01, 0.1, 0.1)), flight((0.1, 0.1, 0.31)), flight(inhibited=16)):
            assert not group_merit(results([flight(), bad], name)).is_met
    assert group_merit(results([flight(inhibited=16)])).is_met  # of any other story rows may be inhibited


def test_the_longest_inhibition_is_one_without_a_break():
    broken = replace(flight(), is_inhibited=np.arange(ROWS) % 20 < 12)
    merit = run_merit(broken)
    assert merit.longest_inhibited_h == pytest.approx(0.2)
    assert merit.inhibited_h == pytest.approx(6.0)
    assert run_merit(flight()).longest_inhibited_h == 0.0


def test_a_group_is_met_by_95_percent_within_the_narrow_and_all_within_the_wide_limits():
    good, odd, bad = flight(), flight((0.45, 0.1, 0.1)), flight((0.1, 0.5, 0.1))
    assert group_merit(results([good] * 19 + [odd])).is_met
    assert not group_merit(results([good] * 18 + [odd] * 2)).is_met
    assert not group_merit(results([good] * 19 + [bad])).is_met
    # a run that was refused is not kept
    refused = group_merit(results([good] * 9 + [None]))
    assert (refused.refused, refused.narrow_share, refused.is_met) == (1, 0.9, False)


def test_percentiles_are_runs_that_were_flown():
    announced = group_merit(results([flight((size, 0.0, 0.0)) for size in (0.1, 0.2, 0.4)]))
    assert [triple[0] for triple in announced.largest_deg] == [0.2, 0.4, 0.4]


def test_a_group_without_any_flight_is_missed():
    announced = group_merit(results([None]))
    assert not announced.is_met
    assert math.isnan(announced.largest_deg[0][0])


def test_no_control_that_does_not_fail_is_a_finding():
    calm = group_merit(results([flight()], sensing=Sensing.OFF))
    wild = group_merit(results([flight((3.0, 2.0, 1.0))], sensing=Sensing.OFF))
    assert (verdict(calm), verdict(wild)) == ("does not fail", "fails as it must")
    plan = LoopPlan(("nominal",), 1)
    assert LoopCampaign(plan, 1.0, (), (calm,)).missed == (calm,)
    assert LoopCampaign(plan, 1.0, (), (wild,)).missed == ()


def test_table_document_and_figure_hold_every_group(tmp_path):
    announced = [*results([flight()]), *results([None], sensing=Sensing.TRUTH)]
    groups = tuple(group_merit([result]) for result in announced)
    campaign = LoopCampaign(LoopPlan(("nominal",), 1), 1.0, tuple(announced), groups)
    assert all(len(cells(group)) == len(COLUMNS) for group in groups)
    assert markdown(campaign).count("\n") == 4
    document = json.loads(json.dumps(as_document(campaign, "command"), allow_nan=False))
    assert [run["refusal"] for run in document["runs"]] == ["", "refused"]
    assert document["groups"][1]["largest_deg"][0] == [None] * 3
    drawn = draw_campaign(campaign, tmp_path)
    assert [path.stem for path in drawn] == [f"closed-loop-nominal{kind}" for kind in ("", "-run", "-percentiles")]
    assert all(path.stat().st_size > 10_000 for path in drawn)


def test_yaw_by_reported_wheels_is_held_in_19_of_20_runs():
    good, odd = flight((0.25, 0.1, 0.1)), flight((0.26, 0.1, 0.1))
    assert group_merit(results([good] * 19 + [odd], MEASURED_SCENARIO)).is_met
    assert not group_merit(results([good] * 18 + [odd] * 2, MEASURED_SCENARIO)).is_met
    assert not group_merit(results([good] * 18 + [flight((0.1, 0.21, 0.1))] * 2, MEASURED_SCENARIO)).is_met
