"""Samples and gaps: every row is counted once, no peak is lost, what is missing is said."""

import numpy as np
import pytest

from service.core.rows import STRETCH_ROWS
from service.ports.archive import Outcome
from service.records.catalogue import LIVE_METHODS
from service.records.epoch import format_epoch, parse_epoch
from service.records.levels.attitude import NO_ANGLES, Axes, CarrierResults
from service.records.levels.measurement import CarrierDetails

pytestmark = pytest.mark.anyio


async def test_history_samples_and_export_count_the_same_rows(bench, make):
    seed = 3
    print("seed", seed)
    rng = np.random.default_rng(seed)
    epochs = np.unique(make.now_us + rng.integers(0, 7 * 86_400_000_000, 700))
    levels = rng.uniform(-60.0, -40.0, (len(epochs), 6)).astype(np.float32)
    levels[rng.random(levels.shape) < 0.1] = np.nan
    bench.append(epochs.tolist(), levels)
    answer = await bench.get("/samples", quantity="power_dbm", count=37)
    history = await bench.get("/measurements/history", limit=10_000)
    exported = (await bench.client.get(f"{bench.url}/archive/measurements:export")).text.splitlines()
    assert len(history["rows"]) == len(exported) - 1 == len(epochs)
    begin_us, end_us = (parse_epoch(answer["range"][end]) for end in ("start", "stop"))
    assert (answer["interval_s"], answer["source"]) == (21_600, None)
    # open ends are those of the rows, widened to whole intervals
    assert begin_us <= epochs[0] < begin_us + 21_600 * make.s
    assert end_us - 21_600 * make.s <= epochs[-1] < end_us
    by_name = series_of(answer)
    assert list(by_name) == [("power_dbm", None, f"c{k:02d}") for k in range(6)]
    for k, samples in enumerate(by_name.values()):
        column = levels[:, k]
        counts, means, least, greatest, _, greatest_epochs = zip(*(each[1:] for each in samples), strict=True)
        assert sum(counts) == np.isfinite(column).sum()
        assert (max(greatest), min(least)) == (np.nanmax(column), np.nanmin(column))
        assert greatest_epochs[greatest.index(max(greatest))] == format_epoch(int(epochs[np.nanargmax(column)]))
        assert np.average(means, weights=counts) == pytest.approx(np.nanmean(column.astype(float)), abs=1e-9)


async def test_samples_of_one_source_and_some_carriers(bench, make):
    bench.append([make.now_us, make.now_us + make.s], -42.0)
    bench.append([make.now_us - 60 * make.s], -50.0, source="sa-2")
    chosen = {"quantity": "power_dbm", "carrier": ["c01", "c03", "none"], "count": 1}
    backup = await bench.get("/samples", source="sa-2", **chosen)
    assert [(each["carrier"], each["n"], each["avg"]) for each in backup["series"]] == [
        ("c01", [1], [-50.0]),
        ("c03", [1], [-50.0]),
    ]
    # open ends are those of the rows of the source
    second_of_row = (make.now_us // make.s - 60) * make.s
    whole = {"start": format_epoch(second_of_row), "stop": format_epoch(second_of_row + make.s)}
    assert (backup["source"], backup["interval_s"], backup["range"]) == ("sa-2", 1, whole)
    assert [each["n"] for each in (await bench.get("/samples", **chosen))["series"]] == [[3], [3]]
    nothing = await bench.get("/samples", source="sa-3", **chosen)
    assert nothing["epochs"] == []


@pytest.mark.parametrize("quantity", ["roll_deg", "yaw_impulse_n_m_s", "residual_db", "expected_dbm"])
async def test_a_result_has_no_source(bench, make, quantity):
    bench.append([make.now_us], -42.0)
    params = {"quantity": ["power_dbm", quantity], "source": "sa-1"}
    refusal = await bench.refused("GET", f"/spacecraft/{make.sc}/samples", params=params)
    assert refusal == (422, "samples.source", ["/query/source"])


async def test_too_many_cells_are_refused(bench, make):
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(k) for k in range(60)], "wide")
    bench.append([make.now_us, make.now_us + 9000 * make.s], -50.0, plan_id=plan.id)
    for chosen in ({"quantity": "power_dbm"}, {"quantity": "residual_db", "method": "robust"}):
        params = {"count": 10_000, **chosen}
        refusal = await bench.refused("GET", f"/spacecraft/{make.sc}/samples", params=params)
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


def plain_samples(rows, start_us, stop_us, interval_us):
    """Return epoch, n, avg, min, max, epochs of the extremes of (epoch, value) pairs, the slow way."""
    found = []
    for begin_us in range(start_us, stop_us, interval_us):
        held = [(epoch_us, value) for epoch_us, value in rows if begin_us <= epoch_us < begin_us + interval_us]
        held = [(epoch_us, float(value)) for epoch_us, value in held if not np.isnan(value)]
        if held:
            values = [value for _, value in held]
            extremes = [extreme(values) for extreme in (min, max)]
            epochs = [format_epoch(next(epoch_us for epoch_us, v in held if v == each)) for each in extremes]
            found.append((format_epoch(begin_us), len(held), pytest.approx(np.mean(values)), *extremes, *epochs))
    return found


def series_of(reported):
    """Return the samples of each series by quantity, method and carrier, empty intervals left out."""
    names = ("n", "avg", "min", "max", "min_epoch", "max_epoch")
    by_name = {}
    for each in reported["series"]:
        cells = zip(reported["epochs"], *(each[name] for name in names), strict=True)
        by_name[each["quantity"], each["method"], each["carrier"]] = [cell for cell in cells if cell[1]]
    return by_name


ANGLES = ("yaw_deg", "roll_deg", "pitch_deg")


def attitudes(rng):
    """Return the angles of a row by both methods; a tenth of them are not known."""
    return [Axes(*rng.normal(0, 1, 3)) if rng.random() < 0.9 else NO_ANGLES for _ in LIVE_METHODS]


@pytest.mark.parametrize("seed", range(3))
async def test_quantities_are_those_of_the_rows(bench, make, seed):
    """Two methods, two plans, closed days summarised, a late row behind them, any span and number of intervals."""
    rng = np.random.default_rng(seed)
    turned = bench.storage.catalogue.put_plan(make.sc, [make.carrier(k) for k in range(5, -1, -1)], "turned").id
    begin_us = make.now_us // 86_400_000_000 * 86_400_000_000
    epochs_us = np.unique(begin_us + rng.integers(0, 3 * 86_400_000_000, 400)).tolist()
    late_us = epochs_us.pop(50)
    held = []

    def store(some_us, plan_id):
        powers, stated = (rng.normal(-50, 1, (len(some_us), 6)).astype(np.float32) for _ in range(2))
        powers[rng.random(powers.shape) < 0.1] = np.nan
        details = CarrierDetails(*np.full((4, 1, 1), 1.0, dtype=np.float32) * stated)
        for row in bench.append(some_us, powers, plan_id=plan_id, details=details):
            levels_db = rng.normal(0, 1, (2, 6))
            levels_db[rng.random(levels_db.shape) < 0.1] = np.nan
            carriers = CarrierResults(row.plan_id, *levels_db, *np.zeros((2, 6), dtype=np.int64))
            rows = tuple(
                make.row(row, method=method, attitude_deg=angles, residual_rms_db=rng.random())
                for method, angles in zip(LIVE_METHODS, attitudes(rng), strict=True)
            )
            held.append((row, rows, carriers))
        new = held[-len(some_us) :]
        bench.consume([Outcome(rows, None, carriers=(carriers, carriers)) for _, rows, carriers in new])

    store(epochs_us[:200], 1)
    store(epochs_us[200:], turned)
    list(bench.storage.archive.seal(make.sc, 1 << 60, 1 << 60))
    assert sum(part.rows for part in bench.storage.results.seal(make.sc, 1 << 60)) == 2 * len(held)
    store([late_us], turned)
    held.sort(key=lambda each: each[0].epoch_us)
    bounds = sorted(rng.choice(3 * 86_400, 2, replace=False).tolist())
    span = {"start": format_epoch(begin_us + bounds[0] * make.s), "stop": format_epoch(begin_us + bounds[1] * make.s)}
    quantities = [*ANGLES, "residual_rms_db", "control_allowed", "deviation_db", "residual_db", "expected_dbm"]
    quantities += ["power_dbm", "c_n0_db_hz"]
    for count in (1, 9, int(rng.integers(1, 400))):
        reported = await bench.get("/samples", quantity=quantities, carrier=["c01", "c04"], count=count, **span)
        bounds_us = [parse_epoch(reported["range"][name]) for name in ("start", "stop")]
        interval_us = reported["interval_s"] * make.s
        assert bounds_us[0] <= begin_us + bounds[0] * make.s
        assert bounds_us[1] >= begin_us + bounds[1] * make.s
        assert (bounds_us[1] - bounds_us[0]) // interval_us <= count
        found = series_of(reported)
        assert len(found) == 5 * 2 + 3 * 2 * 2 + 2 * 2
        for (quantity, method, carrier), samples in found.items():
            pairs = [(row.epoch_us, value_of(quantity, method, carrier, row, rows, each)) for row, rows, each in held]
            assert samples == plain_samples(pairs, *bounds_us, interval_us), quantity
        chosen = {"quantity": quantities, "carrier": ["c01", "c04"], "count": count, **span}
        assert await bench.get("/samples", **chosen | {"quantity": quantities * 2}) == reported
        without = await bench.get("/samples", extreme_epochs=False, **chosen)
        for each in reported["series"]:
            each["min_epoch"] = each["max_epoch"] = []
        assert without == reported


def value_of(quantity, method, carrier, row, rows, carriers):
    """Return what a row says of a quantity."""
    position = None if carrier is None else int(carrier[1:]) if row.plan_id == 1 else 5 - int(carrier[1:])
    if quantity == "power_dbm":
        return row.power_dbm[position]
    if quantity == "c_n0_db_hz":
        return row.details.c_n0_db_hz[position]
    if quantity == "expected_dbm":
        return row.power_dbm[position] - np.rint(carriers.deviation_db[position] / 0.004) * 0.004
    if carrier is not None:
        return np.rint(getattr(carriers, quantity)[position] / 0.004) * 0.004
    of = next(each for each in rows if each.method == method)
    return of.attitude_deg[ANGLES.index(quantity)] if quantity in ANGLES else float(getattr(of, quantity))


@pytest.mark.parametrize(
    ("span", "pointer"),
    [
        ({"start": "0001-01-01T00:00:00Z", "stop": "9999-12-31T23:59:59Z"}, "/query/start"),
        ({"start": "2026-01-01T00:00:00Z", "stop": "9999-12-31T23:59:59Z"}, "/query/stop"),
        ({"start": "1969-01-01T00:00:00Z", "stop": "1971-01-01T00:00:00Z", "count": 1}, "/query/start"),
    ],
)
async def test_a_span_beyond_the_archive_is_refused(bench, span, pointer):
    """Before, the first was a 500, and no interval of any length holds both sides of 1970: it was sought for ever."""
    for quantity in ("roll_deg", "power_dbm", "deviation_db"):
        answer = await bench.client.get(f"{bench.url}/samples", params={"quantity": quantity, **span})
        assert (answer.status_code, answer.json()["code"]) == (422, "epoch.range")
        assert [each["pointer"] for each in answer.json()["errors"]] == [pointer]


async def test_quantities_of_nothing(bench):
    for version in ("live", bench.replay()):
        quantities = ["yaw_deg", "yaw_impulse_n_m_s", "residual_db", "power_dbm"]
        empty = await bench.get("/samples", quantity=quantities, version=version)
        assert empty["epochs"] == []
        assert all(each["n"] == [] for each in empty["series"])


async def test_expected_levels_of_too_many_rows(bench, make, monkeypatch):
    """The bound is on rows, the answer names what to ask for in their place."""
    monkeypatch.setattr("service.api.routes.archive._EXPECTED_ROWS", 5)
    monkeypatch.setattr("service.api.routes.archive._PAGE_ROWS", 2)
    bench.append([make.now_us + k for k in range(5)], -50.0)
    within = await bench.get("/samples", quantity="expected_dbm", count=1)
    assert (within["epochs"], within["series"]) == ([], [])
    bench.append([make.now_us + 5], -50.0)
    params = {"quantity": "expected_dbm"}
    refusal = await bench.refused("GET", f"/spacecraft/{make.sc}/samples", params=params)
    assert refusal == (422, "samples.rows", ["/query/quantity"])
