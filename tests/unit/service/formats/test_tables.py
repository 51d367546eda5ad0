"""Tables: every bit of every level comes back, in every format; bytes do not tell how rows came."""

import csv
import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from block_rows import row_sources
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from pyarrow import parquet

from service.formats import table_file
from service.formats.series_tables import (
    ATTITUDE,
    EVENTS,
    REFERENCES,
    TORQUES,
    JoinedRow,
    joined_table,
    plain_value,
)
from service.formats.table_file import (
    Column,
    MeasurementColumns,
    SeriesTable,
    TableFormat,
    measurement_bytes,
    table_bytes,
)
from service.records.catalogue import Method, Site, Spacecraft
from service.records.csv_guard import unguarded
from service.records.epoch import format_epoch, parse_epoch
from service.records.inputs import AttitudeReference, Operation
from service.records.levels.attitude import CARRIER_STATES, NO_ANGLES, Axes, CarrierResults, Pulse, row_without_attitude
from service.records.levels.measurement import Measurement, MeasurementBlock

PLANS = {1: ("c00", "c01"), 2: ("c09", "c00")}
TABLE = joined_table(MeasurementColumns(list(PLANS.values()), PLANS.__getitem__))


def measurement(plan_id: int) -> Measurement:
    levels = np.array([np.float32(-42.1), np.nan], dtype=np.float64)
    return Measurement(1_000_000, 2_000_000, 7, "sa-1", plan_id, levels, None)


def cells(row: JoinedRow) -> dict[str, object]:
    return dict(zip((column.name for column in TABLE.columns), TABLE.values(row), strict=True))


def test_names_are_unique_and_begin_with_the_measurement() -> None:
    names = [column.name for column in TABLE.columns]
    assert len(set(names)) == len(names)
    assert names[:6] == ["epoch", "source", "c00_dbm", "c01_dbm", "c09_dbm", "c00_state"]


def test_a_measurement_alone_fills_no_other_cell() -> None:
    found = cells(JoinedRow(measurement(1), None, None, None))
    assert {name for name, value in found.items() if value is not None} == {"epoch", "source", "c00_dbm"}
    assert found["c00_dbm"] == -42.1


def test_results_stand_at_the_carriers_of_their_own_plan() -> None:
    results = CarrierResults(
        2, np.array([0.012, math.nan]), np.array([-0.004, 0.3]), np.array([0, 1]), np.zeros(2, int)
    )
    attitude = row_without_attitude(1_000_000, 2_000_000, 7, Method.PAPER, ("not_aligned",))
    found = cells(JoinedRow(measurement(2), attitude, results, None))
    assert [found[f"{carrier}_dbm"] for carrier in ("c00", "c01", "c09")] == [None, None, -42.1]
    assert [found[f"{carrier}_state"] for carrier in ("c00", "c01", "c09")] == [CARRIER_STATES[1], None, "used"]
    assert (found["c09_deviation_db"], found["c09_residual_db"], found["c00_residual_db"]) == (0.012, -0.004, 0.3)
    assert (found["method"], found["inhibitions"], found["command_epoch"]) == ("paper", "not_aligned", None)


START_US = parse_epoch("2026-11-21T00:00:00Z")
MEASUREMENT_PLANS = {1: ("c00", "c01", "c02"), 2: ("c01", "c03", "c00"), 3: ("c00", "c01", "c02", "c03")}


def _columns(*plans: int) -> MeasurementColumns:
    return MeasurementColumns([MEASUREMENT_PLANS[plan] for plan in plans], lambda plan: MEASUREMENT_PLANS[plan])


def _block(plan: int, rows: int, source: str = "sa-1", start: int = 0) -> MeasurementBlock:
    rng = np.random.default_rng(plan + rows)
    levels = rng.uniform(-120.0, 10.0, (rows, len(MEASUREMENT_PLANS[plan]))).astype(np.float32)
    levels[rng.random(levels.shape) < 0.2] = np.nan
    epochs_us = START_US + 1_500_000 * np.arange(start, start + rows)
    return MeasurementBlock((source,), plan, epochs_us, levels)


def _written(columns: MeasurementColumns, file_format: TableFormat, blocks: Sequence[MeasurementBlock]) -> bytes:
    return b"".join(measurement_bytes(columns, file_format, blocks))


def _wanted(blocks: Sequence[MeasurementBlock]) -> tuple[list[str], list[str], dict[str, NDArray[np.float32]]]:
    names = sorted({name for block in blocks for name in MEASUREMENT_PLANS[block.plan_id]})
    epochs = [format_epoch(epoch) for block in blocks for epoch in block.epochs_us.tolist()]
    sources = [source for block in blocks for source in row_sources(block)]
    parts: dict[str, list[NDArray[np.float32]]] = {name: [] for name in names}
    for block in blocks:
        for name in names:
            absent = np.full(len(block.epochs_us), np.nan, dtype=np.float32)
            held = MEASUREMENT_PLANS[block.plan_id]
            parts[name].append(block.power_dbm[:, held.index(name)] if name in held else absent)
    return epochs, sources, {name: np.concatenate(each) for name, each in parts.items()}


def _same(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    return bool(np.all((one.view(np.uint32) == other.view(np.uint32)) | (np.isnan(one) & np.isnan(other))))


BLOCKS = [
    [_block(1, 40)],
    [_block(1, 7), _block(2, 5, start=7)],
    [_block(2, 3), _block(1, 1, 'a "b", c', 3), _block(2, 2, start=4)],
    [],
]
PARTS = ["one plan", "two plans", "two sources", "nothing"]


def _csv_rows(content: bytes) -> list[dict[str, Any]]:
    rows = csv.DictReader(io.StringIO(content.decode(), newline=""))
    return [
        {name: float(cell) if name.endswith("_dbm") and cell else cell or None for name, cell in row.items()}
        for row in rows
    ]


def _parquet_rows(content: bytes) -> list[dict[str, Any]]:
    table = parquet.read_table(io.BytesIO(content))
    epochs_us = table.column("epoch").cast("int64").to_pylist()
    return [row | {"epoch": format_epoch(epoch)} for row, epoch in zip(table.to_pylist(), epochs_us, strict=True)]


@pytest.mark.parametrize("blocks", BLOCKS, ids=PARTS)
@pytest.mark.parametrize(
    ("file_format", "rows_of"),
    [
        ("csv", _csv_rows),
        ("ndjson", lambda content: list(map(json.loads, content.splitlines()))),
        ("parquet", _parquet_rows),
    ],
    ids=["csv", "ndjson", "parquet"],
)
def test_every_bit_reads_back(blocks: list[MeasurementBlock], file_format: TableFormat, rows_of: Any) -> None:
    rows = rows_of(_written(_columns(*(block.plan_id for block in blocks)), file_format, blocks))
    epochs, sources, levels = _wanted(blocks)
    assert [(row["epoch"], row["source"]) for row in rows] == list(zip(epochs, sources, strict=True))
    for name, wanted in levels.items():
        cells = [row[f"{name}_dbm"] for row in rows]
        assert [cell is None for cell in cells] == np.isnan(wanted).tolist()
        assert _same(np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float32), wanted)


def test_parquet_gives_its_bytes_group_by_group() -> None:
    taken = []

    def blocks() -> Iterator[MeasurementBlock]:
        for k in range(6):
            taken.append(k)
            yield _block(1, 50_000, start=50_000 * k)

    chunks = measurement_bytes(_columns(1), "parquet", blocks())
    assert next(chunks) == b"PAR1"
    # the blocks that complete a group, and the end
    assert [len(taken) for chunk in chunks if chunk] == [2, 3, 4, 6, 6]


@pytest.mark.parametrize("file_format", ["csv", "ndjson", "parquet"])
def test_two_sources_that_take_turns_make_the_same_file_however_rows_come(
    file_format: Literal["csv", "ndjson", "parquet"],
) -> None:
    whole = _block(1, 1500)
    rows = [replace(whole.part(k, k + 1), sources=(f"sa-{k % 2}",)) for k in range(1500)]
    written = _written(_columns(1), file_format, rows)
    together = replace(whole, sources=("sa-1", "sa-0"), source_positions=1 - np.arange(1500) % 2)
    assert _written(_columns(1), file_format, [together.part(0, 700), together.part(700, 1500)]) == (written)
    if file_format == "parquet":
        table = parquet.read_table(io.BytesIO(written))
        assert table.column("source").to_pylist() == [f"sa-{k % 2}" for k in range(1500)]
        assert _same(table.column("c01_dbm").to_numpy().astype(np.float32), whole.power_dbm[:, 1])
    else:
        assert written.count(b"sa-1") == 750
        one = [replace(row, sources=("sa-0",)) for row in rows]
        assert _written(_columns(1), file_format, one) == _written(
            _columns(1), file_format, [replace(whole, sources=("sa-0",))]
        )


def test_blocks_are_taken_one_at_a_time() -> None:
    taken = 0

    def blocks() -> Iterator[MeasurementBlock]:
        nonlocal taken
        for k in range(5):
            taken += 1
            yield _block(1, 10, start=10 * k)

    chunks = measurement_bytes(_columns(1), "csv", blocks())
    next(chunks)
    next(chunks)
    assert taken == 1


def _numbered(width: int) -> MeasurementColumns:
    """Columns of one plan of so many carriers."""
    names = tuple(f"c{k}" for k in range(width))
    return MeasurementColumns([names], lambda plan: names)


def _csv(epochs_us: NDArray[np.int64], values: NDArray[np.float32]) -> bytes:
    block = MeasurementBlock(("sa-1",), 1, epochs_us, values)
    return _written(_numbered(values.shape[1]), "csv", [block]).partition(b"\r\n")[2]


def _read_csv(text: bytes) -> tuple[list[str], NDArray[np.float32]]:
    rows = list(csv.reader(io.StringIO(text.decode(), newline="")))
    values = [[float(cell) if cell else np.nan for cell in row[2:]] for row in rows]
    return [row[0] for row in rows], np.array(values).astype(np.float32)


@settings(max_examples=examples(200))
@given(
    hnp.arrays(
        np.float32,
        st.tuples(st.integers(1, 4), st.integers(1, 5)),
        elements=st.floats(-250, 50, width=32) | st.just(np.nan) | st.floats(width=32, allow_infinity=False),
    ),
    st.integers(0, 253_402_300_799_999_999),
)
def test_every_float32_reads_back(values: NDArray[np.float32], epoch_us: int) -> None:
    epochs, again = _read_csv(_csv(np.full(len(values), epoch_us), values))
    assert epochs == [format_epoch(epoch_us)] * len(values)
    assert _same(again, values)


@pytest.mark.parametrize("decimals", [0, 1, 2, 3, 4, 5])
def test_rounded_levels_are_written_with_their_own_decimals(decimals: int) -> None:
    rng = np.random.default_rng(decimals)
    wanted = rng.uniform(-127.0, 50.0, 4000).round(decimals)
    text = _csv(np.arange(4000), wanted.astype(np.float32)[:, np.newaxis]).decode()
    cells = [line.split(",")[2] for line in text.splitlines()]
    assert max(len(cell.partition(".")[2]) for cell in cells) <= max(decimals, 5)
    assert [float(cell) for cell in cells] == wanted.tolist()


def test_lines_of_json_hold_null_for_what_is_absent() -> None:
    values = np.array([[-42.1, np.nan], [np.nan, np.nan]], dtype=np.float32)
    sources, epochs_us = ('sa "1"', "sa-2"), np.array([0, 1_500_000])
    block = MeasurementBlock(sources, 1, epochs_us, values, source_positions=np.array([1, 0]))
    lines = _written(_numbered(2), "ndjson", [block]).splitlines()
    assert [json.loads(line) for line in lines] == [
        {"epoch": "1970-01-01T00:00:00.000000Z", "source": "sa-2", "c0_dbm": -42.1, "c1_dbm": None},
        {"epoch": "1970-01-01T00:00:01.500000Z", "source": 'sa "1"', "c0_dbm": None, "c1_dbm": None},
    ]


def test_nothing_gives_nothing() -> None:
    assert _csv(np.empty(0, dtype=np.int64), np.empty((0, 3), dtype=np.float32)) == b""


def test_calendar_of_every_month_and_leap_day() -> None:
    days = np.arange("2023-12-31", "2028-03-02", dtype="datetime64[D]").astype("datetime64[us]").astype(np.int64)
    text = _csv(days + 86_399_999_999, np.zeros((len(days), 1), dtype=np.float32)).decode()
    assert [line[:27] for line in text.splitlines()] == [format_epoch(int(day) + 86_399_999_999) for day in days]


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
    monkeypatch.setattr(table_file, "GROUP_ROWS", 7)
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
        "downlink_fade downlink_fade_db common_db carriers_used excluded status inhibitions "
        "yaw_protection_deg roll_protection_deg pitch_protection_deg lag_s "
        "yaw_nominal_protection_deg roll_nominal_protection_deg pitch_nominal_protection_deg "
        "yaw_waiting_loss_deg roll_waiting_loss_deg pitch_waiting_loss_deg "
        "yaw_steering_deg roll_steering_deg pitch_steering_deg "
        "yaw_steering_sigma_deg roll_steering_sigma_deg pitch_steering_sigma_deg"
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
