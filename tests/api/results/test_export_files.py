"""Files of every series in every format, days with their manifest, and byte ranges of a file."""

import csv
import gzip
import hashlib
import io
import json
import math
from dataclasses import replace

import httpx
import numpy as np
import pytest
from aem_reader import read_aem
from pyarrow import parquet
from stored_records import ALARM

from service.api.export.export_files import OFFERED
from service.formats.tdm import read_tdm
from service.ports.archive import Outcome
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference, Correction, Operation, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.measurement import CarrierDetails
from service.records.operations.alarms import AlarmChange, ChangeKind

pytestmark = pytest.mark.anyio


DAY = 86_400_000_000
#: every format of one series and every series in one format at each run
CASES = [
    pytest.param(
        series,
        file_format,
        marks=() if series == "measurements" or file_format == "csv" else pytest.mark.slow,
    )
    for series, formats in OFFERED.items()
    for file_format in formats
]


async def file_of(bench, series: str, **params: object) -> httpx.Response:
    """Return the answer that carries a file."""
    answer = await bench.client.get(f"{bench.url}/archive/{series}:export", params=params)
    assert answer.status_code == 200, answer.text
    return answer


def table_of(text: str) -> list[dict[str, str]]:
    """Return the rows of a CSV file by name."""
    return list(csv.DictReader(io.StringIO(text, newline="")))


def fill(bench, make, *, days: int = 3) -> None:
    """Store four rows on each of some days with all that may be computed and declared beside them."""
    start = make.now_us - days * DAY
    epochs = [start + day * DAY + k * 3_600_000_000 for day in range(days) for k in range(4)]
    rows = bench.append(epochs, np.linspace(-60, -40, len(epochs) * 6).reshape(-1, 6).round(2))
    bench.consume([Outcome((make.row(row, attitude_deg=Axes(0.1, -0.2, 0.3)),), make.command(row)) for row in rows])
    archive = bench.storage.archive
    references = [AttitudeReference("star_tracker", epoch, Axes(0.1, math.nan, -0.0), NO_ANGLES) for epoch in epochs]
    archive.append_inputs(make.sc, references)
    archive.append_inputs(make.sc, [Correction(epochs[0], epochs[1], Axes(0.0, 0.1, 0.0))])
    rates = [None, Axes(1e-4, math.nan, -0.0)]
    telemetry = [
        TelemetryRecord(epoch, "wheels", (0.25, -1.5, 0.0), body_rate_deg_s=rates[k % 2])
        for k, epoch in enumerate(epochs[1:])
    ]
    archive.append_inputs(make.sc, [TelemetryRecord(epochs[0], "forecast"), *telemetry])
    polarized = [
        PolarizationRecord("pol-1", epoch, ratio_db=-15.25, co_power_dbm=-48.5, tec_tecu=20.0) for epoch in epochs
    ]
    archive.append_inputs(make.sc, polarized)
    archive.add_operation(make.sc, Operation(0, "eclipse", epochs[3], None, comment='of "Moon", perhaps'))


@pytest.mark.parametrize(("series", "file_format"), CASES)
async def test_every_file_is_the_files_of_its_days(bench, make, series, file_format):
    fill(bench, make)
    span = {"start": format_epoch(make.now_us - 4 * DAY), "stop": format_epoch(make.now_us + DAY)}
    wanted = {**span, "format": file_format}
    whole = await file_of(bench, series, **wanted)
    assert whole.headers["accept-ranges"] == "none"
    assert f".{file_format}" in whole.headers["content-disposition"]
    parts, params = [], {**wanted, "limit": 2}
    while True:
        answer = await bench.client.get(f"{bench.url}/archive/{series}:manifest", params=params)
        page = answer.json()
        assert (page["range"], page["format"]) == (
            {"start": span["start"], "stop": span["stop"]},
            file_format,
        )
        parts += page["parts"]
        if page["next"] is None:
            break
        assert len(page["parts"]) == 2
        assert answer.headers["link"].endswith('rel="next"')
        params["cursor"] = page["next"]
    contents = []
    for part in parts:
        one = await bench.client.get(part["href"])
        assert one.status_code == 200
        assert (len(one.content), hashlib.sha256(one.content).hexdigest()) == (part["bytes"], part["sha256"])
        contents.append(one.content)
    days = [part["start"][:10] for part in parts]
    assert days == sorted(set(days))
    assert all(part["closed"] == (part["stop"] <= format_epoch(make.now_us)) for part in parts)
    rows = sum(part["rows"] for part in parts)
    assert rows == (3 if series == "events" else 12)
    assert rows_of(file_format, contents) == rows_of(file_format, [whole.content])


def rows_of(file_format: str, contents: list[bytes]) -> list[object]:
    """Return the rows of files one after the other."""
    rows: list[object] = []
    for content in contents:
        if file_format == "csv":
            rows += [tuple(row.items()) for row in table_of(content.decode())]
        elif file_format == "ndjson":
            rows += [tuple(json.loads(line).items()) for line in content.splitlines()]
        elif file_format == "parquet":
            table = parquet.read_table(io.BytesIO(content))
            rows += [tuple(row.items()) for row in table.to_pylist()]
        elif file_format == "aem":
            rows += [
                (epoch, *angles)
                for track in read_aem(content.decode())
                for epoch, angles in zip(track.epochs_us.tolist(), track.attitude_deg.tolist(), strict=True)
            ]
        else:
            tracks = read_tdm(content.decode())
            rows += [
                (track.track_id, *each)
                for track in tracks
                for each in zip(track.epochs_us.tolist(), track.power_dbm.tolist(), strict=True)
            ]
    return sorted(rows) if file_format == "tdm" else rows


async def test_formats_of_a_table_tell_the_same(bench, make):
    fill(bench, make, days=1)
    for series in ("attitude", "torques", "references", "telemetry", "polarization", "events"):
        lines = table_of((await file_of(bench, series)).text)
        objects = [json.loads(line) for line in (await file_of(bench, series, format="ndjson")).text.splitlines()]
        table = parquet.read_table(io.BytesIO((await file_of(bench, series, format="parquet")).content))
        assert [list(line) for line in lines] == [list(each) for each in objects]
        assert table.column_names == list(lines[0])
        for line, each, row in zip(lines, objects, table.to_pylist(), strict=True):
            for name, cell in line.items():
                assert cell == as_cell(each[name]), name
                reported = row[name]
                if isinstance(each[name], list | dict):
                    assert json.loads(reported) == each[name]
                elif hasattr(reported, "isoformat"):
                    assert reported.strftime("%Y-%m-%dT%H:%M:%S.%fZ") == each[name]
                else:
                    assert reported == each[name]


def as_cell(value: object) -> str:
    """Return the CSV cell of a JSON value."""
    if value is None:
        return ""
    if isinstance(value, bool | list | dict):
        return json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    return repr(value) if isinstance(value, float) else str(value)


async def test_telemetry_and_polarisation_are_as_they_were_sent(bench, make):
    fill(bench, make, days=1)
    first, second, third, _ = table_of((await file_of(bench, "telemetry")).text)
    assert (first["onboard_mode"], first["wheel_momentum_n_m_s"], first["yaw_body_rate_deg_s"]) == ("forecast", "", "")
    assert (second["wheel_momentum_n_m_s"], second["yaw_body_rate_deg_s"]) == ("[0.25,-1.5,0.0]", "")
    assert [third[f"{axis}_body_rate_deg_s"] for axis in ("yaw", "roll", "pitch")] == ["0.0001", "", "-0.0"]
    rows = table_of((await file_of(bench, "polarization")).text)
    listed = (await bench.get("/polarization"))["rows"]
    assert [row["epoch"] for row in rows] == [row["epoch"] for row in listed]
    for row, known in zip(rows, listed, strict=True):
        assert (row["source"], row["ratio_db"], row["angle_deg"]) == ("pol-1", "-15.25", "")
        assert {name: as_cell(known[name]) for name in row} == row


async def test_events_tell_what_was_declared_and_decided(bench, make):
    fill(bench, make, days=1)
    bench.calibrate([])
    bench.align(make.now_us - DAY)
    rows = table_of((await file_of(bench, "events")).text)
    assert [row["kind"] for row in rows] == ["ephemeris", "correction", "alignment", "operation", "activation"]
    assert [(row["epoch"], int(row["number"])) for row in rows] == sorted((r["epoch"], int(r["number"])) for r in rows)
    (operation,) = [json.loads(row["document"]) for row in rows if row["kind"] == "operation"]
    assert operation["comment"] == 'of "Moon", perhaps'
    assert (operation["kind"], operation["stop"]) == ("eclipse", None)
    (correction,) = [row for row in rows if row["kind"] == "correction"]
    assert correction["stop"] == format_epoch(make.now_us - DAY + 3_600_000_000)


async def test_alarms_are_events(bench, make):
    bench.append([make.now_us - make.s])
    about = {"spacecraft_id": make.sc, "condition": "carrier_level", "thing": "c03", "raised_at_us": make.now_us}
    raised = replace(ALARM, value=math.inf, **about)
    bench.storage.alarms.save([AlarmChange(ChangeKind.RAISED, raised, make.now_us, is_told=True)])
    rows = table_of((await file_of(bench, "events")).text)
    (alarm,) = [row for row in rows if row["kind"] == "alarm"]
    assert (alarm["epoch"], alarm["stop"], alarm["key"]) == (format_epoch(make.now_us), "", "carrier_level/c03")
    document = json.loads(alarm["document"])
    assert (document["severity"], document["process"], document["value"]) == ("warning", "unacknowledged", None)
    assert document["raised_at"] == format_epoch(make.now_us)


async def test_a_file_of_a_day_is_taken_in_ranges(bench, make):
    fill(bench, make, days=1)
    span = {"start": format_epoch(make.now_us - DAY), "stop": format_epoch(make.now_us)}
    url = f"{bench.url}/archive/measurements:export"
    plain = {"Accept-Encoding": "identity"}
    whole = await bench.client.get(url, params=span, headers=plain)
    tag = whole.headers["etag"]
    assert tag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert (whole.headers["accept-ranges"], int(whole.headers["content-length"])) == ("bytes", len(whole.content))

    async def part(wanted: str, **headers: str) -> httpx.Response:
        return await bench.client.get(url, params=span, headers={**plain, "Range": wanted, **headers})

    first, rest = await part("bytes=0-99"), await part("bytes=100-", **{"If-Range": tag})
    assert (first.status_code, rest.status_code) == (206, 206)
    assert first.headers["content-range"] == f"bytes 0-99/{len(whole.content)}"
    assert first.content + rest.content == whole.content
    assert (await part("bytes=-7")).content == whole.content[-7:]
    # a file that has changed, several ranges and what nobody understands: the whole
    for answer in (
        await part("bytes=100-", **{"If-Range": '"other"'}),
        await part("bytes=0-1,4-5"),
        await part("lines=1-2"),
        await part("bytes=9-3"),
    ):
        assert (answer.status_code, answer.content) == (200, whole.content)
    beyond = await part(f"bytes={len(whole.content)}-")
    assert (beyond.status_code, beyond.json()["code"]) == (416, "range.unsatisfiable")
    assert beyond.headers["content-range"] == f"bytes */{len(whole.content)}"
    # a range is never packed; the whole is, under a tag that no range may name
    packed = await bench.client.get(url, params=span, headers={"Accept-Encoding": "gzip"})
    assert (packed.headers["content-encoding"], packed.headers["etag"]) == ("gzip", f"W/{tag}")
    assert packed.content == whole.content
    assert "content-encoding" not in (await part("bytes=0-", **{"Accept-Encoding": "gzip"})).headers


async def test_a_late_row_changes_the_file_and_its_tag(bench, make):
    fill(bench, make, days=1)
    span = {"start": format_epoch(make.now_us - DAY), "stop": format_epoch(make.now_us)}
    before = (await file_of(bench, "measurements", **span)).headers["etag"]
    assert (await file_of(bench, "measurements", **span)).headers["etag"] == before
    bench.append([make.now_us - DAY + 5])
    assert (await file_of(bench, "measurements", **span)).headers["etag"] != before


async def test_long_exports_are_packed_as_they_stream(bench, make):
    fill(bench, make)
    async with bench.client.stream("GET", f"{bench.url}/archive/measurements:export") as answer:
        assert answer.headers["content-encoding"] == "gzip"
        packed = b"".join([chunk async for chunk in answer.aiter_raw()])
    plain = await bench.client.get(f"{bench.url}/archive/measurements:export", headers={"Accept-Encoding": "identity"})
    assert gzip.decompress(packed) == plain.content
    table = await bench.client.get(f"{bench.url}/archive/measurements:export", params={"format": "parquet"})
    assert "content-encoding" not in table.headers


async def test_messages_name_craft_site_and_what_the_front_end_stated(bench, make):
    nothing = np.full((2, 6), np.nan)
    c_n0 = nothing.copy()
    c_n0[:, 1] = 72.1
    bench.append([make.now_us, make.now_us + make.s], details=CarrierDetails(nothing, c_n0, nothing, nothing))
    text = (await file_of(bench, "measurements", format="tdm")).text
    assert "PARTICIPANT_1 = Yamal-202" in text
    assert text.count("PC_N0 = 2026-11-21T03:00:0") == 2
    tracks = {track.track_id: track for track in read_tdm(text)}
    assert tracks["sa-1/c01"].c_n0_db_hz.astype(np.float32).tolist() == [np.float32(72.1)] * 2
    assert np.isnan(tracks["sa-1/c00"].c_n0_db_hz).all()
    attitude = (await file_of(bench, "attitude", format="aem")).text
    assert attitude.startswith("CCSDS_AEM_VERS = 2.0\n")
