"""Measurements on their way out."""

import math

import numpy as np
import pytest

from service.records.epoch import format_epoch
from service.records.levels.measurement import CarrierDetails

pytestmark = pytest.mark.anyio


async def test_newest_row_before_anything_is_calibrated(bench, make):
    assert await bench.get("/measurements") == []
    nan = math.nan
    stated = np.float32(
        [[[0.05, nan, 1, 1, 1, 1]], [[71.3, nan, 1, 1, 1, 1]], [[nan] * 6], [[-1250.5, 0.0, 1, 1, 1, 1]]]
    )
    bench.append(
        [make.now_us],
        [-42.1, nan, -43.3, -44.0, -45.0, -46.0],
        flags=(0, 16, 512, 0, 0, 0),
        details=CarrierDetails(*stated),
    )
    newest = await bench.get("/measurements")
    nobody_asked = {"hypothesis": None, "hypothesis_probability": None, "hypothesis_since": None}
    assert newest[:2] == [
        {
            "carrier": "c00",
            "epoch": format_epoch(make.now_us),
            "power_dbm": -42.1,
            "expected_dbm": None,
            "deviation_db": None,
            "residual_db": None,
            "sigma_db": None,
            "measured_sigma_db": 0.05,
            "c_n0_db_hz": 71.3,
            "occupied_bandwidth_hz": None,
            "centroid_offset_hz": -1250.5,
            "flags": 0,
            "flag_names": [],
            "state": "uncalibrated",
            **nobody_asked,
        },
        {
            "carrier": "c01",
            "epoch": format_epoch(make.now_us),
            "power_dbm": None,
            "expected_dbm": None,
            "deviation_db": None,
            "residual_db": None,
            "sigma_db": None,
            "measured_sigma_db": None,
            "c_n0_db_hz": None,
            "occupied_bandwidth_hz": None,
            "centroid_offset_hz": 0.0,
            "flags": 16,
            "flag_names": ["NO_CARRIER"],
            "state": "absent",
            **nobody_asked,
        },
    ]
    assert [row["carrier"] for row in newest] == [f"c{k:02d}" for k in range(6)]


async def test_history_tells_powers_by_carrier_under_each_plan(bench, make):
    bench.append([make.now_us], [-42.1, math.nan, -43.3, -44.0, -45.0, -46.0], flags=(1, 2, 3, 4, 5, 6))
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(9), make.carrier(0)], "second")
    bench.append([make.now_us + 1], [-50.5, -51.25], source="sa-2", plan_id=plan.id)
    first, second = (await bench.get("/measurements/history"))["rows"]
    assert first["power_dbm"] == {"c00": -42.1, "c01": None, "c02": -43.3, "c03": -44.0, "c04": -45.0, "c05": -46.0}
    assert first["flag_names"]["c02"] == ["CLOCK_UNSYNC", "LATE"]
    assert (first["measured_sigma_db"], second["flag_names"]) == (None, None)
    assert first["flags"] == {"c00": 1, "c01": 2, "c02": 3, "c03": 4, "c04": 5, "c05": 6}
    assert (first["source"], first["plan_id"], first["late"]) == ("sa-1", 1, False)
    assert second["power_dbm"] == {"c09": -50.5, "c00": -51.25}
    assert (second["flags"], second["plan_id"], second["feeds_estimator"]) == (None, plan.id, False)
    (only,) = (await bench.get("/measurements/history", source="sa-2"))["rows"]
    assert only == second
    chosen = (await bench.get("/measurements/history", carrier="c00"))["rows"]
    assert [row["power_dbm"] for row in chosen] == [{"c00": -42.1}, {"c00": -51.25}]


async def test_told_powers_round_to_the_stored_float32(bench, make):
    seed = 20261121
    print("seed", seed)
    sent = np.random.default_rng(seed).uniform(-120.0, 10.0, (20, 6)).astype(np.float32)
    bench.append([make.now_us + k for k in range(20)], sent)
    rows = (await bench.get("/measurements/history"))["rows"]
    reported = np.array([list(row["power_dbm"].values()) for row in rows])
    # exact: the fewest digits that name a float32 read back to it
    assert np.array_equal(reported.astype(np.float32), sent)


async def test_history_pages(bench, make):
    epochs_us = [make.now_us + k for k in range(5)]
    bench.append(epochs_us)
    first = await bench.get("/measurements/history", limit=2)
    second = await bench.get("/measurements/history", limit=2, cursor=first["next"])
    third = await bench.get("/measurements/history", limit=2, cursor=second["next"])
    reported = [row["epoch"] for page in (first, second, third) for row in page["rows"]]
    assert reported == [format_epoch(epoch_us) for epoch_us in epochs_us]
    assert third["next"] is None
