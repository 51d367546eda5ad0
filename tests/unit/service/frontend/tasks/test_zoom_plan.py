"""Narrow carriers are moved to sweeps of their own, with noise beside them, within the period."""

import json
from typing import Any

import pytest

from service.frontend.acquisition.evaluation import TaskEvaluation
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.tasks.task_plan import cycle_s
from service.frontend.tasks.zoom_plan import plan_with_zoom, zoom_rbw_hz

NOISE = [[951e6, 954e6], [988e6, 989.5e6]]


def task(zoom: str = "auto", period_s: float = 10.0, **narrow: Any) -> MeasurementTask:
    """Return a task of a wide carrier and a narrow one of 128 000 symbols a second."""
    wide = {"id": "wide", "sweep": "tp1", "fc_hz": 960e6, "symbol_rate": 2e6, "integ_bw_hz": 2.5e6, "noise": NOISE}
    small = {"id": "small", "sweep": "tp1", "fc_hz": 965e6, "symbol_rate": 128e3, "integ_bw_hz": 160e3, "noise": NOISE}
    document = {
        "task": {"id": "ku1", "period_s": period_s, "zoom": zoom},
        "sweeps": [{"id": "tp1", "start_hz": 950e6, "stop_hz": 990e6, "rbw_hz": 30e3, "points": 4001, "time_s": 2.0}],
        "carriers": [wide, small | narrow],
    }
    return parse_task(json.dumps(document).encode())[0]


def test_without_zoom_the_narrow_carrier_is_refused_by_name_and_rule() -> None:
    made, plan = plan_with_zoom(task("off"))
    assert [(finding.rule, finding.subject) for finding in plan.errors] == [("rbw.too_wide", "small")]
    assert made == task("off")


def test_a_narrow_carrier_gets_a_sweep_of_its_own() -> None:
    made, plan = plan_with_zoom(task())
    assert plan.errors == ()
    assert [(finding.rule, finding.subject) for finding in plan.warnings] == [("zoom.moved", "small")]
    own = next(sweep for sweep in made.sweeps if sweep.id == "small.zoom")
    moved = made.carriers[1]
    assert moved.sweep == own.id
    assert own.rbw_hz == 3000.0
    assert (own.stop_hz - own.start_hz) < NEAR * moved.integ_bw_hz
    assert all(own.start_hz <= low < high <= own.stop_hz for low, high in moved.noise)
    assert [carrier.id for carrier in made.carriers] == ["wide", "small"]
    TaskEvaluation(made)


#: carrier, guard and a window of its width on both sides
NEAR = 4.0


def test_the_goal_of_scatter_is_met_and_the_period_kept() -> None:
    goal = {"limits": {"sigma_goal_db": 0.15}}
    _, before = plan_with_zoom(task("off", **goal))
    made, plan = plan_with_zoom(task(**goal))
    assert before.sigma_db["small"] > 0.25
    assert plan.sigma_db["small"] <= 0.15
    assert cycle_s(made) <= 10.0


def test_a_goal_that_the_period_does_not_allow_is_told() -> None:
    made, plan = plan_with_zoom(task(period_s=2.5, limits={"sigma_goal_db": 0.02}))
    assert ("sigma.goal", "small") in [(finding.rule, finding.subject) for finding in plan.warnings]
    assert plan.errors == ()
    assert cycle_s(made) <= 2.5


def test_no_time_at_all_leaves_the_carrier_where_it_is() -> None:
    made, plan = plan_with_zoom(task(period_s=2.15))
    assert made == task(period_s=2.15)
    assert ("zoom.no_time", "small") in [(finding.rule, finding.subject) for finding in plan.findings]
    assert ("rbw.too_wide", "small") in [(finding.rule, finding.subject) for finding in plan.errors]


def test_windows_of_the_task_are_kept_where_they_are_near() -> None:
    near = [[964.7e6, 964.85e6]]
    made, plan = plan_with_zoom(task(noise=near))
    assert [list(window) for window in made.carriers[1].noise] == near
    assert plan.errors == ()


def test_a_carrier_between_neighbours_has_no_room() -> None:
    document = json.loads(task().model_dump_json())
    base = document["carriers"][1]
    for name, centre in (("left", 965e6 - 172e3), ("right", 965e6 + 172e3)):
        document["carriers"].append(base | {"id": name, "fc_hz": centre})
    crowded = parse_task(json.dumps(document).encode())[0]
    _, plan = plan_with_zoom(crowded)
    rules = [(finding.rule, finding.subject) for finding in plan.findings]
    assert ("zoom.no_room", "small") in rules
    assert ("zoom.moved", "left") in rules


@pytest.mark.parametrize(("rate", "rbw_hz"), [(64e3, 3e3), (128e3, 3e3), (256e3, 10e3), (1e6, 30e3)])
def test_the_filter_is_a_twentieth_at_most_and_one_that_all_families_have(rate: float, rbw_hz: float) -> None:
    carrier = task(symbol_rate=rate, integ_bw_hz=1.25 * rate).carriers[1]
    assert zoom_rbw_hz(carrier) == rbw_hz
    assert rbw_hz <= rate / 20
