"""The planner names the carrier and the rule it breaks."""

import json
from typing import Any

import pytest

from service.frontend.measurement_task import MeasurementTask, TaskError, load_task, parse_task
from service.frontend.tasks.task_plan import plan_task, recheck
from service.records.levels.sweep import SweepSettings


def document(**changes: Any) -> dict[str, Any]:
    """Return a good task of two carriers."""
    noise = [[951e6, 954e6], [988e6, 989.5e6]]
    base: dict[str, Any] = {
        "task": {"id": "ku1", "period_s": 5.0},
        "sweeps": [{"id": "tp1", "start_hz": 950e6, "stop_hz": 990e6, "rbw_hz": 40e3, "points": 2401, "time_s": 2.0}],
        "carriers": [
            {"id": "c00", "sweep": "tp1", "fc_hz": 960e6, "symbol_rate": 1e6, "integ_bw_hz": 1.25e6, "noise": noise},
            {"id": "c01", "sweep": "tp1", "fc_hz": 964e6, "symbol_rate": 1e6, "integ_bw_hz": 1.25e6, "noise": noise},
        ],
    }
    return base | changes


def task(**changes: Any) -> MeasurementTask:
    """Return a task."""
    return parse_task(json.dumps(document(**changes)).encode())[0]


def carriers(**changes: Any) -> list[dict[str, Any]]:
    """Return the good carriers, the second one changed."""
    first, second = document()["carriers"]
    return [first, second | changes]


def sweeps(**changes: Any) -> list[dict[str, Any]]:
    """Return the good sweep, changed."""
    return [document()["sweeps"][0] | changes]


def test_a_good_task_has_no_findings_and_a_prediction() -> None:
    plan = plan_task(task())
    assert plan.findings == ()
    # 4.343 / sqrt(1.505 RBW T B / span) is 0.079 dB; noise at 10 dB C/N adds an eighth
    assert plan.sigma_db["c00"] == pytest.approx(0.079 * 1.13, rel=0.03)


@pytest.mark.parametrize(
    ("rule", "subject", "changes"),
    [
        ("id.unique", "c00", {"carriers": carriers(id="c00")}),
        ("sweep.unknown", "c01", {"carriers": carriers(sweep="tp9")}),
        ("sweep.outside", "c01", {"carriers": carriers(fc_hz=989.9e6)}),
        ("sweep.outside", "c01", {"carriers": carriers(noise=[[940e6, 941e6]])}),
        ("sweep.too_fast", "tp1", {"sweeps": sweeps(time_s=0.05)}),
        ("sweep.points", "tp1", {"sweeps": sweeps(points=1001)}),
        ("period.too_short", "ku1", {"task": {"id": "ku1", "period_s": 1.5}}),
        ("rbw.too_wide", "c01", {"carriers": carriers(symbol_rate=150e3, integ_bw_hz=190e3)}),
        ("carriers.overlap", "c00", {"carriers": carriers(fc_hz=961e6)}),
        ("noise.overlap", "c00", {"carriers": carriers(fc_hz=952.5e6, noise=[[988e6, 989.5e6]])}),
    ],
)
def test_errors(rule: str, subject: str, changes: dict[str, Any]) -> None:
    found = [(finding.rule, finding.subject) for finding in plan_task(task(**changes)).errors]
    assert (rule, subject) in found


@pytest.mark.parametrize(
    ("rule", "subject", "changes"),
    [
        ("rbw.wide", "c01", {"carriers": carriers(symbol_rate=500e3, integ_bw_hz=625e3)}),
        ("neighbour.close", "c00", {"carriers": carriers(fc_hz=961.3e6)}),
        ("noise.close", "c01", {"carriers": carriers(noise=[[964.65e6, 965.5e6]])}),
        ("sigma.goal", "c01", {"carriers": carriers(limits={"sigma_goal_db": 0.01})}),
        ("sweep.empty", "tp2", {"sweeps": [*sweeps(), *sweeps(id="tp2")]}),
        ("vbw.narrow", "tp1", {"sweeps": sweeps(vbw_hz=10e3)}),
        ("points.fixed", "tp1", {"task": {"id": "ku1", "analyzer": {"dialect": "siglent"}}}),
        (
            "level.reference",
            "tp1",
            {"input": {"ref_level_dbm": -40.0}, "carriers": carriers(limits={"nominal_dbm": -42.9})},
        ),
    ],
)
def test_warnings(rule: str, subject: str, changes: dict[str, Any]) -> None:
    plan = plan_task(task(**changes))
    assert (rule, subject) in [(finding.rule, finding.subject) for finding in plan.warnings]
    assert plan.errors == ()


def test_what_the_analyzer_made_of_a_sweep_is_checked_again() -> None:
    made = task()
    fewer = SweepSettings(950e6, 990e6, 751, 40e3, 42.6e3, 400e3, 2.0, "RMS")
    assert [finding.rule for finding in recheck(made, made.sweeps[0], fewer)] == ["sweep.points"]
    wider = SweepSettings(950e6, 990e6, 2401, 100e3, 106e3, 1e6, 2.0, "RMS")
    assert {(finding.rule, finding.subject) for finding in recheck(made, made.sweeps[0], wider)} == {
        ("rbw.wide", "c00"),
        ("rbw.wide", "c01"),
    }
    same = SweepSettings(950e6, 990e6, 2401, 40e3, 42.6e3, 400e3, 2.0, "RMS")
    assert recheck(made, made.sweeps[0], same) == []


def test_a_free_running_task_has_no_period() -> None:
    assert plan_task(task(), 0.0).errors == ()


def test_a_beacon_is_predicted_by_its_line() -> None:
    beacon = {"kind": "beacon", "integ_bw_hz": 400e3, "symbol_rate": None, "limits": {"c_n0_min": 65.0}}
    plan = plan_task(task(carriers=carriers(**beacon)))
    assert plan.errors == ()
    # 65 - 10 lg(42.6e3) = 18.7 dB in the filter, ENBW t = 90: 6.14 10^(-0.935) / sqrt(90) = 0.075 dB
    assert plan.sigma_db["c01"] == pytest.approx(0.075, rel=0.1)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b'{"task":{"id":"x"},"sweeps":[],"carriers":[]}',
        json.dumps(document(format=2)).encode(),
        json.dumps(document(unknown=1)).encode(),
        json.dumps(document(carriers=carriers(noise=[[2e6, 1e6]]))).encode(),
        json.dumps(document(carriers=carriers(symbol_rate=None))).encode(),
        json.dumps(document(sweeps=sweeps(stop_hz=940e6))).encode(),
        json.dumps(document(sweeps=sweeps(rbw_hz=float("nan")))).encode(),
    ],
)
def test_what_is_no_task_is_refused(content: bytes) -> None:
    with pytest.raises(TaskError):
        parse_task(content)


def test_the_head_may_stand_at_the_top() -> None:
    flat = document()
    head = flat.pop("task")
    assert parse_task(json.dumps(head | flat).encode())[0] == task()


def test_the_hash_is_that_of_the_bytes() -> None:
    one, other = json.dumps(document()).encode(), json.dumps(document(), indent=1).encode()
    assert parse_task(one)[1] != parse_task(other)[1]
    assert parse_task(one)[1] == parse_task(one)[1]


def test_a_missing_file_is_named(tmp_path: Any) -> None:
    with pytest.raises(TaskError, match=r"absent\.json"):
        load_task(tmp_path / "absent.json")
    (tmp_path / "good.json").write_text(json.dumps(document()))
    assert load_task(tmp_path / "good.json")[0].task.id == "ku1"
