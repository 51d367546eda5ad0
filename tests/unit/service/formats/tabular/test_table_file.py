"""Tables of records: what each format makes of each kind of value, and bytes that do not tell how rows came."""

import csv
import io
import json
import math
from collections.abc import Sequence
from typing import Any

import pytest
from pyarrow import parquet

from service.formats.tabular import parquet_stream
from service.formats.tabular.series_tables import ATTITUDE, EVENTS, REFERENCES, TORQUES, plain_value
from service.formats.tabular.table_file import Column, SeriesTable, TableFormat, table_bytes
from service.records.catalogue import Site, Spacecraft
from service.records.csv_guard import unguarded
from service.records.inputs import AttitudeReference, Operation
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.levels.command import Pulse

KINDS = SeriesTable(
    (
        Column("epoch", "epoch"),
        Column("word", "text"),
        Column("angle_deg", "figure"),
        Column("is_so", "truth"),
        Column("n", "count"),
        Column("rest", "document"),
    ),
    lambda row: row,
)
ROWS: list[Sequence[Any]] = [
    (1_500_000, 'a "b", c', -1e-7, True, 3, {"x": [1, None]}),
    (2_000_000, "", math.nan, False, -1, []),
    (None, None, None, None, None, None),
]


def written(file_format: TableFormat, pages: Sequence[Sequence[Any]], table: SeriesTable[Any] = KINDS) -> bytes:
    return b"".join(table_bytes(table, file_format, pages))


def test_csv() -> None:
    assert written("csv", [ROWS]).decode() == (
        "epoch,word,angle_deg,is_so,n,rest\r\n"
        '1970-01-01T00:00:01.500000Z,"a ""b"", c",-1e-07,true,3,"{""x"":[1,null]}"\r\n'
        "1970-01-01T00:00:02.000000Z,,,false,-1,[]\r\n"
        ",,,,,\r\n"
    )


def test_ndjson() -> None:
    names = [column.name for column in KINDS.columns]
    lines = [json.loads(line) for line in written("ndjson", [ROWS]).splitlines()]
    assert [list(line) for line in lines] == [names] * 3
    assert [list(line.values()) for line in lines] == [
        ["1970-01-01T00:00:01.500000Z", 'a "b", c', -1e-7, True, 3, {"x": [1, None]}],
        ["1970-01-01T00:00:02.000000Z", "", None, False, -1, []],
        [None] * 6,
    ]


def test_parquet() -> None:
    table = parquet.read_table(io.BytesIO(written("parquet", [ROWS])))
    assert table.column("epoch").cast("int64").to_pylist() == [1_500_000, 2_000_000, None]
    rest = [list(row.values())[1:] for row in table.to_pylist()]
    assert rest == [
        ['a "b", c', -1e-7, True, 3, '{"x":[1,null]}'],
        ["", None, False, -1, "[]"],
        [None] * 5,
    ]


@pytest.mark.parametrize("file_format", ["csv", "ndjson", "parquet"])
def test_bytes_do_not_tell_in_which_pages_rows_came(file_format: TableFormat, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet_stream, "GROUP_ROWS", 7)
    rows = [(k, f"word {k % 3}", k / 3, k % 2 == 0, k, [k]) for k in range(50)]
    whole = written(file_format, [rows])
    for size in (1, 3, 7, 20):
        assert written(file_format, [rows[first : first + size] for first in range(0, 50, size)]) == whole
    if file_format == "parquet":
        assert parquet.ParquetFile(io.BytesIO(whole)).num_row_groups == 8


@pytest.mark.parametrize("table", [ATTITUDE, REFERENCES, TORQUES, EVENTS])
def test_files_without_a_row_are_files(table: SeriesTable[Any]) -> None:
    names = [column.name for column in table.columns]
    assert written("csv", [], table).decode() == ",".join(names) + "\r\n"
    assert written("ndjson", [], table) == b""
    assert parquet.read_table(io.BytesIO(written("parquet", [], table))).column_names == names


def test_columns_of_attitude_are_those_of_the_contract() -> None:
    assert " ".join(column.name for column in ATTITUDE.columns) == (
        "epoch method yaw_deg roll_deg pitch_deg yaw_sigma_deg roll_sigma_deg pitch_sigma_deg control_allowed "
        "downlink_fade downlink_fade_db common_db carriers_used excluded status "
        "yaw_protection_deg roll_protection_deg pitch_protection_deg lag_s"
    )


def test_references_keep_what_a_sensor_does_not_see_absent() -> None:
    row = AttitudeReference("earth_sensor", 0, Axes(math.nan, 0.1, -0.0), NO_ANGLES)
    assert written("csv", [[row]], REFERENCES).decode().splitlines()[1] == (
        "1970-01-01T00:00:00.000000Z,earth_sensor,,0.1,-0.0,,,"
    )


def test_records_become_json() -> None:
    operation = Operation(3, "eclipse", 0, None, attitude_uncertainty_deg=Axes(math.nan, 0.1, 0.2))
    assert plain_value(operation) | {"comment": ""} == {
        "id": 3,
        "kind": "eclipse",
        "start": "1970-01-01T00:00:00.000000Z",
        "stop": None,
        "carriers": None,
        "transponders": None,
        "inhibit_control": False,
        "attitude_uncertainty_deg": {"yaw": None, "roll": 0.1, "pitch": 0.2},
        "comment": "",
        "revision": 1,
    }
    assert plain_value((Pulse(0, 1.0, NO_ANGLES),))[0]["start"] == "1970-01-01T00:00:00.000000Z"
    inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
    spacecraft = plain_value(Spacecraft("sc", "Craft", 90.0, Site(55.0, 38.0), inertia, 0.05))
    assert json.loads(json.dumps(spacecraft, allow_nan=False))["control"]["method"] == "robust"


@pytest.mark.parametrize("word", ["=1+1", "+1", "-1", "@x", "\t=1", "\r", "'=1"])
def test_words_that_a_spreadsheet_would_compute_are_guarded(word: str) -> None:
    rows = [(0, word, -0.5, True, -3, None)]
    lines = b"".join(table_bytes(KINDS, "csv", [rows])).decode()
    (cells,) = list(csv.reader(io.StringIO(lines, newline="")))[1:]
    assert cells[1:5] == [f"'{word}", "-0.5", "true", "-3"]
    assert unguarded(cells[1]) == word
    assert json.loads(b"".join(table_bytes(KINDS, "ndjson", [rows])))["word"] == word
