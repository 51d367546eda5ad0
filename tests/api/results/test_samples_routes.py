"""Samples and gaps: every row is counted once, no peak is lost, what is missing is said."""

import numpy as np
import pytest

from service.core.rows.row_gaps import STRETCH_ROWS
from service.ports import Outcome
from service.records.epoch import format_epoch
from service.records.levels.attitude import NO_ANGLES, Axes

pytestmark = pytest.mark.anyio


async def test_history_samples_and_export_count_the_same_rows(bench, make):
    seed = 3
    print("seed", seed)
    rng = np.random.default_rng(seed)
    epochs = np.unique(make.now_us + rng.integers(0, 7 * 86_400_000_000, 700))
    levels = rng.uniform(-60.0, -40.0, (len(epochs), 6)).astype(np.float32)
    levels[rng.random(levels.shape) < 0.1] = np.nan
    bench.append(epochs.tolist(), levels)
    reported = await bench.get("/measurements/samples", count=37)
    history = await bench.get("/measurements/history", limit=10_000)
    exported = (await bench.client.get(f"{bench.url}/archive/measurements:export")).text.splitlines()
    assert len(history["rows"]) == len(exported) - 1 == len(epochs)
    assert reported["range"] == {"start": format_epoch(int(epochs[0])), "stop": format_epoch(int(epochs[-1]) + 1)}
    for k in range(6):
        samples, column = reported["power_dbm"][f"c{k:02d}"], levels[:, k]
        assert sum(each["n"] for each in samples) == np.isfinite(column).sum()
        assert max(each["max"] for each in samples) == np.nanmax(column)
        assert min(each["min"] for each in samples) == np.nanmin(column)
        peak = next(each for each in samples if each["max"] == np.nanmax(column))
        assert peak["max_epoch"] == format_epoch(int(epochs[np.nanargmax(column)]))
        mean = sum(each["n"] * each["avg"] for each in samples) / np.isfinite(column).sum()
        assert mean == pytest.approx(np.nanmean(column.astype(float)), abs=1e-9)


async def test_samples_of_one_source_and_some_carriers(bench, make):
    bench.append([make.now_us, make.now_us + make.s], -42.0)
    bench.append([make.now_us], -50.0, source="sa-2")
    reported = await bench.get("/measurements/samples", source="sa-2", carrier=["c01", "c03", "none"], count=1)
    assert {name: [(each["n"], each["avg"]) for each in rows] for name, rows in reported["power_dbm"].items()} == {
        "c01": [(1, -50.0)],
        "c03": [(1, -50.0)],
    }
    both = await bench.get("/measurements/samples", count=1)
    assert both["power_dbm"]["c00"][0]["n"] == 3


async def test_samples_of_attitude(bench, make):
    rows = bench.append([make.now_us + k * make.s for k in range(10)])
    angles = [Axes(0.1 * k, -0.2, 0.0) if k != 4 else NO_ANGLES for k in range(10)]
    bench.consume([Outcome((make.row(row, attitude_deg=axes),), None) for row, axes in zip(rows, angles, strict=True)])
    span = {"start": format_epoch(make.now_us), "stop": format_epoch(make.now_us + 10 * make.s)}
    reported = await bench.get("/attitude/samples", count=2, **span)
    assert (reported["method"], reported["version"], reported["range"]) == ("paper", "live", span)
    assert [each["n"] for each in reported["yaw_deg"]] == [4, 5]
    assert reported["yaw_deg"][1]["epoch"] == format_epoch(make.now_us + 5 * make.s)
    assert (reported["yaw_deg"][1]["max"], reported["yaw_deg"][1]["max_epoch"]) == (
        0.9,
        format_epoch(make.now_us + 9 * make.s),
    )
    assert [(each["min"], each["max"]) for each in reported["roll_deg"]] == [(-0.2, -0.2)] * 2
    version = bench.replay()
    empty = await bench.get("/attitude/samples", version=version)
    assert empty["yaw_deg"] == []


async def test_too_many_cells_are_refused(bench, make):
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(k) for k in range(60)], "wide")
    bench.append([make.now_us], -50.0, plan_id=plan.id)
    refusal = await bench.refused("GET", f"/spacecraft/{make.sc}/measurements/samples", params={"count": 10_000})
    assert refusal == (422, "samples.count", ["/query/count"])


async def test_gaps_are_told_with_the_rows_that_are_missing(bench, make):
    start = make.now_us - 4 * STRETCH_ROWS * 10 * make.s
    epochs = [start + k * 10 * make.s for k in range(4 * STRETCH_ROWS - 60)]
    lost = {5, 6, 7, STRETCH_ROWS - 1, STRETCH_ROWS, 1700}
    bench.append([epoch for k, epoch in enumerate(epochs) if k not in lost])
    bench.append([epochs[1] + 3], source="sa-2")  # a backup source fills no gap
    reported = await bench.get("/archive/gaps")
    assert [(gap["start"], gap["stop"], gap["rows_missing"]) for gap in reported["gaps"]] == [
        (format_epoch(epochs[5]), format_epoch(epochs[8]), 3),
        (format_epoch(epochs[STRETCH_ROWS - 1]), format_epoch(epochs[STRETCH_ROWS + 1]), 2),
        (format_epoch(epochs[1700]), format_epoch(epochs[1701]), 1),
        # nothing has come for ten minutes
        (format_epoch(epochs[-1] + 10 * make.s), format_epoch(make.now_us), 60),
    ]
    assert reported["range"] == {"start": format_epoch(epochs[0]), "stop": format_epoch(make.now_us)}
    assert [(each["id"], each["role"]) for each in reported["sources"]] == [("sa-1", "prime"), ("sa-2", "backup")]
    inside = await bench.get("/archive/gaps", start=format_epoch(epochs[6]), stop=format_epoch(epochs[20]))
    assert [(gap["start"], gap["rows_missing"]) for gap in inside["gaps"]] == [(format_epoch(epochs[6]), 2)]


async def test_before_the_first_row_nothing_is_missing(bench):
    reported = await bench.get("/archive/gaps")
    assert (reported["gaps"], reported["sources"]) == ([], [])


async def test_a_cursor_belongs_to_its_query(bench, make):
    bench.append([make.now_us + k for k in range(5)])
    page = await bench.get("/measurements/history", limit=2)
    again = await bench.get("/measurements/history", limit=1, cursor=page["next"])
    assert again["rows"][0]["epoch"] == format_epoch(make.now_us + 2)
    for path, params in (("/measurements/history", {"source": "sa-1"}), ("/attitude/history", {})):
        refusal = await bench.refused("GET", f"/spacecraft/{make.sc}{path}", params={**params, "cursor": page["next"]})
        assert refusal == (422, "cursor.invalid", ["/query/cursor"])
