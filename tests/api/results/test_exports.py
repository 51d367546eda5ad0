"""Exports: columns, numbers and pages; each joined row holds what the answers hold of its measurement."""

import asyncio
import csv
import io
import json
import math
import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from pyarrow import parquet
from starlette.requests import ClientDisconnect, Request

from service.api.export import export_chunks
from service.api.export import export_chunks as joined_rows
from service.api.export.export_responses import bounded_answer
from service.ports.archive import Outcome
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS
from service.records.epoch import format_epoch
from service.records.levels.attitude import CARRIER_STATES, NO_ANGLES, Axes, CarrierResults

pytestmark = pytest.mark.anyio


class Client:
    """A client that stays until it goes, as an application hears it."""

    def __init__(self):
        self.gone = asyncio.Event()
        self.request = Request({"type": "http"}, self._receive)
        self._is_asked = False

    async def _receive(self):
        if not self._is_asked:
            self._is_asked = True
            return {"type": "http.request", "body": b"", "more_body": False}
        await self.gone.wait()
        return {"type": "http.disconnect"}


async def test_two_bounded_answers_are_made_at_once():
    lock, running, most = threading.Lock(), set(), []
    pair = threading.Barrier(2, timeout=120)

    def parts(name):
        with lock:
            running.add(name)
            most.append(len(running))
        pair.wait()
        yield b"a" * 400_000
        yield b"b"
        with lock:
            running.discard(name)

    places = asyncio.Semaphore(2)
    made = [bounded_answer(Client().request, places, partial(parts, k), "text/plain") for k in range(12)]
    for answer in await asyncio.gather(*made):
        body = b"".join([part async for part in answer.body_iterator])
        assert body == b"a" * 400_000 + b"b"
        assert answer.headers["content-length"] == "400001"
    assert (max(most), len(most)) == (2, 12)


async def test_a_client_that_goes_ends_its_answer_and_gives_its_place_back():
    places, leaver, waiting = asyncio.Semaphore(1), Client(), Client()
    loop, asked, made = asyncio.get_running_loop(), [], []

    def parts(name):
        asked.append(name)
        for k in range(1000):
            made.append(k)
            loop.call_soon_threadsafe(leaver.gone.set)
            if k == 1:
                # the loop has heard of it before the next part
                asyncio.run_coroutine_threadsafe(asyncio.sleep(0.05), loop).result(120)
            yield b"x"

    first = asyncio.ensure_future(bounded_answer(leaver.request, places, partial(parts, "first"), "text/plain"))
    waiting.gone.set()
    second = asyncio.ensure_future(bounded_answer(waiting.request, places, partial(parts, "second"), "text/plain"))
    for each in (first, second):
        with pytest.raises(ClientDisconnect):
            await each
    assert (asked, len(made) < 10, places.locked()) == (["first"], True, False)


#: rows that the chain consumed, and all
CONSUMED, ROWS = 6, 9


def results_of(row, rng) -> CarrierResults:
    """Return carrier results of a row, unlike those of any other."""
    count = len(row.power_dbm)
    deviation, residual = (rng.integers(-500, 500, count) * 0.004 for _ in range(2))
    deviation[0] = np.nan
    states = rng.integers(0, len(CARRIER_STATES), count)
    return CarrierResults(row.plan_id, deviation, residual, states, np.zeros(count, dtype=np.int64))


@pytest.fixture
def filled(bench, make):
    """Rows under two plans with the results of both methods; commands begin some seconds after their rows.

    At one epoch another source measured too; it feeds no estimator. The newest rows are not consumed yet.
    """
    seed = 11
    print("seed", seed)
    rng = np.random.default_rng(seed)
    epochs = [make.now_us + k * make.s for k in range(CONSUMED + 2)]
    first = bench.append(epochs[:3], rng.normal(-50, 5, (3, 6)))
    bench.append(epochs[2:3], rng.normal(-50, 5, (1, 6)), source="sa-2")
    plan = bench.storage.catalogue.put_plan(make.sc, [make.carrier(9), make.carrier(0)], "second")
    second = bench.append(epochs[3:CONSUMED], [[-44.0, np.nan]] * (CONSUMED - 3), plan_id=plan.id)
    outcomes = []
    for k, row in enumerate([*first, *second]):
        rows = tuple(
            make.row(
                row,
                method=each,
                attitude_deg=Axes(*rng.normal(0, 0.1, 3)),
                protection_deg=Axes(0.5, 0.1, np.nan),
                inhibitions=("one", "other"),
            )
            for each in LIVE_METHODS
        )
        begin_us = max(row.epoch_us, row.received_at_us)
        command = replace(make.command(row), epoch_us=begin_us, torque_n_m=Axes(*rng.normal(0, 0.01, 3)))
        known = tuple(results_of(row, rng) for _ in LIVE_METHODS)
        outcomes.append(Outcome(rows, None if k == 1 else command, carriers=known))
    bench.consume(outcomes)
    bench.append(epochs[CONSUMED:], [[-44.5, -45.25]] * 2, plan_id=plan.id)


def estimated(rows):
    """Return the rows with an estimate."""
    return [row for row in rows if row["method"]]


async def text_of(bench, series, **params):
    """Return a file as text."""
    answer = await bench.client.get(f"{bench.url}/archive/{series}:export", params=params)
    assert answer.status_code == 200, answer.text
    return answer.text


def table_of(text):
    """Return the rows of a CSV file by name."""
    return list(csv.DictReader(io.StringIO(text, newline="")))


@pytest.mark.parametrize("method", LIVE_METHODS)
async def test_each_row_is_that_of_the_separate_files_and_answers(bench, filled, method):
    joined = table_of(await text_of(bench, "joined", method=method))
    measured = table_of(await text_of(bench, "measurements"))
    assert [{name: row[name] for name in measured[0]} for row in joined] == measured
    assert len(joined) == ROWS

    seen = estimated(joined)
    assert len(seen) == CONSUMED
    attitude = table_of(await text_of(bench, "attitude", method=method))
    assert [{name: row[name] for name in attitude[0]} for row in seen] == attitude
    answered = (await bench.get("/attitude/history", method=method))["rows"]
    assert [row["inhibitions"].split(";") for row in seen] == [row["inhibitions"] for row in answered]

    torques = table_of(await text_of(bench, "torques"))
    commanded = [row for row in joined if row["command_epoch"]]
    assert [{name: row[f"command_{name}"] for name in torques[0]} for row in commanded] == torques
    assert [row["command_attitude_epoch"] for row in commanded] == [row["epoch"] for row in commanded]
    assert len(commanded) == CONSUMED - 1

    for carrier in ("c00", "c03", "c09"):
        answers = (await bench.get(f"/carriers/{carrier}/results", method=method))["rows"]
        for row, answer in zip(seen, answers, strict=True):
            for name in ("state", "deviation_db", "residual_db"):
                cell, value = row[f"{carrier}_{name}"], answer[name]
                assert cell == ("" if value is None else str(value)), (carrier, name)


async def test_rows_without_an_estimate_keep_their_powers(bench, filled):
    joined = table_of(await text_of(bench, "joined"))
    of_measurements = [name for name in joined[0] if name in {"epoch", "source"} or name.endswith("_dbm")]
    without = [row for row in joined if not row["method"]]
    assert [row["source"] for row in without] == ["sa-2", "sa-1", "sa-1"]
    for row in without:
        assert any(row[name] for name in of_measurements[2:])
        assert not any(value for name, value in row.items() if name not in of_measurements)


async def test_formats_tell_the_same(bench, filled):
    lines = table_of(await text_of(bench, "joined"))
    objects = [json.loads(line) for line in (await text_of(bench, "joined", format="ndjson")).splitlines()]
    answer = await bench.client.get(f"{bench.url}/archive/joined:export", params={"format": "parquet"})
    table = parquet.read_table(io.BytesIO(answer.content))
    assert table.column_names == list(lines[0]) == list(objects[0])
    assert str(table.schema.field("c00_dbm").type) == "float"
    for line, each, row in zip(lines, objects, table.to_pylist(), strict=True):
        for name, cell in line.items():
            value = each[name]
            assert (value is None) == (row[name] is None)
            if name.endswith("_dbm") and value is not None:
                assert np.float32(value) == np.float32(cell) == np.float32(row[name])
            elif isinstance(value, float):
                assert float(cell) == value == row[name]
            elif isinstance(value, str):
                assert cell == value


@pytest.mark.parametrize("powers", [1, 20])
async def test_pages_make_the_same_file_as_one(bench, filled, monkeypatch, powers):
    whole = await text_of(bench, "joined")
    monkeypatch.setattr(export_chunks, "PAGE_ROWS", 3)
    monkeypatch.setattr(joined_rows, "PAGE_ROWS", 3)
    monkeypatch.setattr(joined_rows, "PAGE_POWERS", powers)
    assert await text_of(bench, "joined") == whole


async def test_commands_of_rows_that_came_late_are_looked_for_when_those_were_received(bench, make):
    year_us, second_us = 365 * 86_400 * make.s, make.s
    (row,) = bench.append([make.now_us])
    at = [replace(row, epoch_us=row.epoch_us + k * second_us) for k in range(3)]
    measured = Window(row.epoch_us, row.epoch_us + 2 * second_us + 1)
    assert joined_rows._command_spans(at) == [Window(measured.start_us, row.received_at_us + 1)]
    received_us = row.epoch_us + year_us
    late = [replace(each, received_at_us=received_us) for each in at]
    assert joined_rows._command_spans(late) == [measured, Window(received_us, received_us + 1)]
    # an epoch ahead of the clock of the service
    early = [replace(each, received_at_us=row.epoch_us - second_us) for each in at]
    assert joined_rows._command_spans(early) == [measured]


async def test_version_of_a_replay(bench, make):
    (row,) = bench.append([make.now_us])
    version = bench.replay()
    outcome = Outcome((make.row(row),), make.command(row))
    bench.storage.results.save_outcomes(make.sc, version, [outcome], 0, None)
    bench.consume()
    (replayed,) = table_of(await text_of(bench, "joined", version=version))
    (live,) = table_of(await text_of(bench, "joined"))
    names = ("c00_dbm", "yaw_deg", "command_roll_n_m")
    assert [replayed[name] for name in names] == ["-42.1", "0.1", "-0.002"]
    assert [live[name] for name in names] == ["-42.1", "", ""]


async def test_the_name_of_the_file_and_the_addresses_of_its_days(bench, make, filled):
    page = await bench.get("/archive/joined:manifest", start=format_epoch(make.now_us - 1), method="robust")
    assert (page["method"], page["version"], page["parts"][0]["rows"]) == ("robust", "live", ROWS)
    answer = await bench.client.get(page["parts"][0]["href"])
    assert "yamal-202_joined_robust_live_" in answer.headers["content-disposition"]
    assert len(answer.content) == page["parts"][0]["bytes"]


async def test_a_span_without_rows_is_a_header(bench):
    assert table_of(await text_of(bench, "joined")) == []


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
async def test_pages_of_attitude_make_the_same_file_as_one(bench, make, monkeypatch, rows):
    if rows:
        stored = bench.append([make.now_us + k for k in range(rows)])
        bench.consume([Outcome((make.row(row),), None) for row in stored])
    for series in ("measurements", "attitude"):
        whole = await lines_of(bench, f"/archive/{series}:export")
        assert len(whole) == rows + 1
        with monkeypatch.context() as patch:
            patch.setattr(export_chunks, "PAGE_ROWS", 3)
            assert await lines_of(bench, f"/archive/{series}:export") == whole


async def test_attitude_of_the_version_of_a_replay(bench, make):
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
