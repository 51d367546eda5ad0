"""Exports: columns, numbers, pages."""

import csv
import io
import math

import numpy as np
import pytest

from service.api.export import export_chunks as archive_chunks
from service.api.export import export_files as archive_files
from service.ports import Outcome
from service.records.catalogue import LIVE_METHODS
from service.records.epoch import format_epoch
from service.records.levels.attitude import NO_ANGLES, Axes

pytestmark = pytest.mark.anyio


async def lines_of(bench, path: str, **params: str) -> list[list[str]]:
    """Return the fields of each line of a file."""
    answer = await bench.client.get(bench.url + path, params=params)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    return list(csv.reader(io.StringIO(answer.text, newline="")))


async def test_attitude_columns_and_numbers(bench, make):
    first, second = bench.append([make.now_us, make.now_us + 60 * make.s])
    found = make.row(first, attitude_deg=Axes(0.1 + 0.2, -1e-7, 0.0), downlink_fade=True, downlink_fade_db=-0.3)
    lost = make.row(
        second,
        attitude_deg=NO_ANGLES,
        sigma_deg=NO_ANGLES,
        excluded=(),
        control_allowed=False,
        common_db=make.nan,
        downlink_fade_db=make.nan,
    )
    bench.consume([Outcome((found,), None), Outcome((lost,), None)])
    answer = await bench.client.get(f"{bench.url}/archive/attitude:export", params={"format": "csv"})
    assert answer.headers["content-disposition"] == 'attachment; filename="yamal-202_attitude_paper_live_begin_end.csv"'
    # columns that are added come last
    first_columns = [",".join(line.split(",")[:15]) for line in answer.text.split("\r\n")]
    assert "\r\n".join(first_columns) == (
        "epoch,method,yaw_deg,roll_deg,pitch_deg,yaw_sigma_deg,roll_sigma_deg,pitch_sigma_deg,control_allowed,"
        "downlink_fade,downlink_fade_db,common_db,carriers_used,excluded,status\r\n"
        "2026-11-21T03:00:00.000000Z,paper,0.30000000000000004,-1e-07,0.0,0.2,0.01,0.02,true,"
        "true,-0.3,0.02,14,c03:uplink_fade;c05:absent,ACQUIRED\r\n"
        "2026-11-21T03:01:00.000000Z,paper,,,,,,,false,false,,,14,,ACQUIRED\r\n"
    )


async def test_measurement_columns_are_the_union_of_the_plans_of_the_span(bench, make):
    bench.append([make.now_us], [-42.1, math.nan, -43.3, -44.0, -45.0, -46.0])
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(9), make.carrier(0)], "second")
    bench.storage.catalogue.put_plan(make.sc, [make.carrier(7)], "never used")
    bench.append([make.now_us + make.s], [-50.5, -51.25], source="sa-2", plan_id=plan.id)
    header, first, second = await lines_of(bench, "/archive/measurements:export")
    assert header == ["epoch", "source", *(f"c{k:02d}_dbm" for k in range(6)), "c09_dbm"]
    assert first == ["2026-11-21T03:00:00.000000Z", "sa-1", "-42.1", "", "-43.3", "-44", "-45", "-46", ""]
    assert second == ["2026-11-21T03:00:01.000000Z", "sa-2", "-51.25", "", "", "", "", "", "-50.5"]
    header, row = await lines_of(bench, "/archive/measurements:export", start=format_epoch(make.now_us + 1))
    assert (header, row) == (["epoch", "source", "c09_dbm", "c00_dbm"], [*second[:2], "-50.5", "-51.25"])


async def test_powers_read_back_to_the_stored_float32(bench, make):
    seed = 5
    print("seed", seed)
    sent = np.random.default_rng(seed).uniform(-250.0, 50.0, (50, 6)).astype(np.float32)
    bench.append([make.now_us + k for k in range(50)], sent)
    _, *rows = await lines_of(bench, "/archive/measurements:export")
    # exact: the fewest digits that name a float32 read back to it
    assert np.array_equal(np.array([row[2:] for row in rows], dtype=np.float32), sent)


@pytest.mark.parametrize("rows", [0, 1, 2, 3, 6, 7])
async def test_pages_make_the_same_file_as_one(bench, make, monkeypatch, rows):
    if rows:
        stored = bench.append([make.now_us + k for k in range(rows)])
        bench.consume([Outcome((make.row(row),), None) for row in stored])
    for series in ("measurements", "attitude"):
        whole = await lines_of(bench, f"/archive/{series}:export")
        assert len(whole) == rows + 1
        with monkeypatch.context() as patch:
            patch.setattr(archive_chunks, "PAGE_ROWS", 3)
            patch.setattr(archive_files, "PAGE_ROWS", 3)
            assert await lines_of(bench, f"/archive/{series}:export") == whole


async def test_version_of_a_replay(bench, make):
    (row,) = bench.append([make.now_us])
    version = bench.replay()
    bench.storage.results.save_outcomes(make.sc, version, [Outcome((make.row(row),), None)], 0, None)
    _, line = await lines_of(bench, "/archive/attitude:export", version=version)
    assert line[:5] == ["2026-11-21T03:00:00.000000Z", "paper", "0.1", "-0.02", "0.03"]
    bench.consume()
    _, live = await lines_of(bench, "/archive/attitude:export")
    assert live[2:5] == ["", "", ""]


async def test_files_of_other_spans_methods_and_formats_have_other_names(bench, make):
    rows = bench.append([make.now_us, make.now_us + 86_400 * make.s])
    bench.consume([Outcome(tuple(make.row(row, method=each) for each in LIVE_METHODS), None) for row in rows])
    parts = []
    for choice in ({"format": "csv", "method": "robust"}, {"format": "aem", "method": "paper"}):
        for span in ({}, {"start": format_epoch(make.now_us), "stop": format_epoch(make.now_us + 90_000 * make.s)}):
            found = await bench.get("/archive/attitude:manifest", **choice, **span)
            parts += found["parts"]
    names = [(await bench.client.get(part["href"])).headers["content-disposition"] for part in parts]
    assert 'attachment; filename="yamal-202_attitude_robust_live_20261121T030000Z_20261122T000000Z.csv"' in names
    assert 'attachment; filename="yamal-202_attitude_paper_live_2026-11-21.aem"' in names
    assert len(set(names)) == len(names) == 8
