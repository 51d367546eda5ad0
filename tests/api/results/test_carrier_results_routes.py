"""Why a carrier was left out: what a method made of it, row by row."""

import numpy as np
import pytest

from service.ports import Outcome
from service.records.catalogue import Method
from service.records.levels.carrier_results import CarrierResults

pytestmark = pytest.mark.anyio


def results_of(plan_id, carriers):
    levels_db = np.linspace(-0.5, 0.5, carriers)
    levels_db[1] = np.nan
    codes = np.arange(carriers) % 5
    return CarrierResults(plan_id, levels_db, levels_db / 2, codes, codes)


async def test_rows_tell_state_reason_and_levels(bench, make):
    rows = bench.append([make.now_us - seconds * make.s for seconds in (90, 60, 30)])
    carriers = len(rows[0].power_dbm)
    known = results_of(rows[0].plan_id, carriers)
    outcomes = [
        Outcome((make.row(row),), None, carriers=() if position == 1 else (known,)) for position, row in enumerate(rows)
    ]
    bench.consume(outcomes)
    page = await bench.get("/carriers/c02/results", method="paper")
    assert (page["carrier"], page["method"], page["version"], page["next"]) == ("c02", "paper", "live", None)
    first, without, last = page["rows"]
    assert first == {
        "epoch": "2026-11-21T02:58:30.000000Z",
        "state": "excluded",
        "reason": None,
        "deviation_db": pytest.approx(known.deviation_db[2], abs=0.003),
        "residual_db": pytest.approx(known.residual_db[2], abs=0.003),
        "hypothesis": "wet",
        "plan_id": rows[0].plan_id,
    }
    assert {**last, "epoch": first["epoch"]} == first
    assert [without[name] for name in ("state", "deviation_db", "hypothesis", "plan_id")] == [None] * 4
    absent = (await bench.get("/carriers/c01/results"))["rows"][0]
    assert (absent["state"], absent["deviation_db"]) == ("absent", None)
    assert (await bench.get("/carriers/c03/results"))["rows"][0]["reason"] == "uplink_fade"
    robust = await bench.get("/carriers/c02/results", method="robust")
    assert {row["state"] for row in robust["rows"]} == {None}
    # sealed it is the same
    list(bench.storage.results.seal(make.sc, 1 << 60))
    assert await bench.get("/carriers/c02/results", method="paper") == page


async def test_pages_meet(bench, make):
    rows = bench.append([make.now_us - seconds * make.s for seconds in range(50, 0, -10)])
    known = results_of(rows[0].plan_id, len(rows[0].power_dbm))
    bench.consume([Outcome((make.row(row, method=Method.PAPER),), None, carriers=(known,)) for row in rows])
    whole = (await bench.get("/carriers/c02/results"))["rows"]
    first = await bench.get("/carriers/c02/results", limit=3)
    second = await bench.get("/carriers/c02/results", limit=3, cursor=first["next"])
    assert first["rows"] + second["rows"] == whole
    assert len(whole) == 5


async def test_a_carrier_that_no_plan_has_is_refused(bench, make):
    bench.append([make.now_us])
    path = f"/spacecraft/{make.sc}/carriers/c99/results"
    assert await bench.refused("GET", path) == (404, "carrier.unknown", [])
