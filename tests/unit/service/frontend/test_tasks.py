"""Tasks: station files, the plan of sweeps and the rule that a carrier breaks, zooms for narrow carriers."""

import json
from pathlib import Path
from typing import Any

import pytest

from service.frontend.acquisition.evaluation import TaskEvaluation
from service.frontend.measurement_task import MeasurementTask, TaskError, load_task, parse_task
from service.frontend.tasks.task_plan import cycle_s, load_station, plan_task, plan_with_zoom, recheck, zoom_rbw_hz
from service.records.levels.measurement import SweepSettings


def written(folder: Path, document: Any) -> Path:
    """Return a station file."""
    path = folder / "station.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("is_bare", [True, False])
def test_a_list_of_analyzers(tmp_path: Path, is_bare: bool) -> None:
    entries = [
        {"task": "ku.json", "spacecraft": "sc-1"},
        {
            "task": "c.json",
            "spacecraft": "sc-1",
            "source": "sa-2",
            "resource": "TCPIP::b::hislip0::INSTR",
            "period_s": 5,
        },
    ]
    first, second = load_station(written(tmp_path, entries if is_bare else {"analyzers": entries}))
    assert first.task == tmp_path / "ku.json"
    assert (first.source, first.period_s, first.epoch) == ("sa-1", None, "system")
    assert (second.source, second.resource, second.period_s) == ("sa-2", "TCPIP::b::hislip0::INSTR", 5.0)


@pytest.mark.parametrize(
    "document",
    [
        [],
        {},
        [{"task": "a.json"}],
        [{"task": "a.json", "spacecraft": "s", "epoch": "sundial"}],
        [{"task": "a.json", "spacecraft": "s", "period_s": -1}],
        [{"task": "a.json", "spacecraft": "s"}, {"task": "b.json", "spacecraft": "s"}],
        [{"task": "a.json", "spacecraft": "s", "colour": "red"}],
    ],
)
def test_what_is_no_station_is_refused(tmp_path: Path, document: Any) -> None:
    with pytest.raises(TaskError, match=r"station\.json"):
        load_station(written(tmp_path, document))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"absent\.json"):
        load_station(tmp_path / "absent.json")


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


def test_a_missing_task_is_named(tmp_path: Any) -> None:
    with pytest.raises(TaskError, match=r"absent\.json"):
        load_task(tmp_path / "absent.json")
    (tmp_path / "good.json").write_text(json.dumps(document()))
    assert load_task(tmp_path / "good.json")[0].task.id == "ku1"


NOISE = [[951e6, 954e6], [988e6, 989.5e6]]


def zoom_task(zoom: str = "auto", period_s: float = 10.0, **narrow: Any) -> MeasurementTask:
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
    made, plan = plan_with_zoom(zoom_task("off"))
    assert [(finding.rule, finding.subject) for finding in plan.errors] == [("rbw.too_wide", "small")]
    assert made == zoom_task("off")


def test_a_narrow_carrier_gets_a_sweep_of_its_own() -> None:
    made, plan = plan_with_zoom(zoom_task())
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
    _, before = plan_with_zoom(zoom_task("off", **goal))
    made, plan = plan_with_zoom(zoom_task(**goal))
    assert before.sigma_db["small"] > 0.25
    assert plan.sigma_db["small"] <= 0.15
    assert cycle_s(made) <= 10.0


def test_a_goal_that_the_period_does_not_allow_is_told() -> None:
    made, plan = plan_with_zoom(zoom_task(period_s=2.5, limits={"sigma_goal_db": 0.02}))
    assert ("sigma.goal", "small") in [(finding.rule, finding.subject) for finding in plan.warnings]
    assert plan.errors == ()
    assert cycle_s(made) <= 2.5


def test_no_time_at_all_leaves_the_carrier_where_it_is() -> None:
    made, plan = plan_with_zoom(zoom_task(period_s=2.15))
    assert made == zoom_task(period_s=2.15)
    assert ("zoom.no_time", "small") in [(finding.rule, finding.subject) for finding in plan.findings]
    assert ("rbw.too_wide", "small") in [(finding.rule, finding.subject) for finding in plan.errors]


def test_windows_of_the_task_are_kept_where_they_are_near() -> None:
    near = [[964.7e6, 964.85e6]]
    made, plan = plan_with_zoom(zoom_task(noise=near))
    assert [list(window) for window in made.carriers[1].noise] == near
    assert plan.errors == ()


def test_a_carrier_between_neighbours_has_no_room() -> None:
    document = json.loads(zoom_task().model_dump_json())
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
    carrier = zoom_task(symbol_rate=rate, integ_bw_hz=1.25 * rate).carriers[1]
    assert zoom_rbw_hz(carrier) == rbw_hz
    assert rbw_hz <= rate / 20
