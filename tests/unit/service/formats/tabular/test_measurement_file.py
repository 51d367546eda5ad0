"""Files of measurements read back with other people's readers: every bit of every level, whatever the plans."""

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from block_rows import row_sources
from numpy.typing import NDArray
from pyarrow import parquet

from service.formats.tabular.measurement_file import (
    CsvFile,
    Kernels,
    MeasurementColumns,
    MeasurementFile,
    NdjsonFile,
    ParquetFile,
    file_bytes,
    measurement_file,
)
from service.records.epoch import format_epoch, parse_epoch
from service.records.levels.measurement_block import MeasurementBlock

START_US = parse_epoch("2026-11-21T00:00:00Z")
PLANS = {1: ("c00", "c01", "c02"), 2: ("c01", "c03", "c00"), 3: ("c00", "c01", "c02", "c03")}


def _columns(*plans: int) -> MeasurementColumns:
    return MeasurementColumns([PLANS[plan] for plan in plans], lambda plan: PLANS[plan])


def _block(plan: int, rows: int, source: str = "sa-1", start: int = 0) -> MeasurementBlock:
    rng = np.random.default_rng(plan + rows)
    levels = rng.uniform(-120.0, 10.0, (rows, len(PLANS[plan]))).astype(np.float32)
    levels[rng.random(levels.shape) < 0.2] = np.nan
    epochs_us = START_US + 1_500_000 * np.arange(start, start + rows)
    return MeasurementBlock((source,), plan, epochs_us, levels)


def _written(file: MeasurementFile, blocks: Sequence[MeasurementBlock]) -> bytes:
    return b"".join(file_bytes(file, blocks))


def _wanted(blocks: Sequence[MeasurementBlock]) -> tuple[list[str], list[str], dict[str, NDArray[np.float32]]]:
    names = sorted({name for block in blocks for name in PLANS[block.plan_id]})
    epochs = [format_epoch(epoch) for block in blocks for epoch in block.epochs_us.tolist()]
    sources = [source for block in blocks for source in row_sources(block)]
    parts: dict[str, list[NDArray[np.float32]]] = {name: [] for name in names}
    for block in blocks:
        for name in names:
            absent = np.full(len(block.epochs_us), np.nan, dtype=np.float32)
            held = PLANS[block.plan_id]
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


@pytest.mark.parametrize("blocks", BLOCKS, ids=PARTS)
@pytest.mark.parametrize("kernels", ["numba", "numpy"])
def test_csv_reads_back(blocks: list[MeasurementBlock], kernels: Kernels) -> None:
    plans = [block.plan_id for block in blocks]
    text = _written(CsvFile(_columns(*plans), kernels), blocks).decode()
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    epochs, sources, levels = _wanted(blocks)
    assert [row["epoch"] for row in rows] == epochs
    assert [row["source"] for row in rows] == sources
    for name, wanted in levels.items():
        cells = [row[f"{name}_dbm"] for row in rows]
        assert _same(np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float32), wanted)


@pytest.mark.parametrize("blocks", BLOCKS, ids=PARTS)
@pytest.mark.parametrize("kernels", ["numba", "numpy"])
def test_ndjson_reads_back(blocks: list[MeasurementBlock], kernels: Kernels) -> None:
    plans = [block.plan_id for block in blocks]
    rows = [json.loads(line) for line in _written(NdjsonFile(_columns(*plans), kernels), blocks).splitlines()]
    epochs, sources, levels = _wanted(blocks)
    assert [(row["epoch"], row["source"]) for row in rows] == list(zip(epochs, sources, strict=True))
    for name, wanted in levels.items():
        cells = [row[f"{name}_dbm"] for row in rows]
        assert _same(np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float32), wanted)


@pytest.mark.parametrize("blocks", BLOCKS, ids=PARTS)
def test_parquet_reads_back(blocks: list[MeasurementBlock]) -> None:
    plans = [block.plan_id for block in blocks]
    table = parquet.read_table(io.BytesIO(_written(ParquetFile(_columns(*plans)), blocks)))
    epochs, sources, levels = _wanted(blocks)
    stored_us = table.column("epoch").cast("int64").to_pylist()
    assert [format_epoch(epoch) for epoch in stored_us] == epochs
    assert table.column("source").to_pylist() == sources
    for name, wanted in levels.items():
        column = table.column(f"{name}_dbm")
        assert column.null_count == int(np.isnan(wanted).sum())
        cells = [np.nan if cell is None else cell for cell in column.to_pylist()]
        assert _same(np.array(cells, dtype=np.float32), wanted)


def test_parquet_gives_its_bytes_group_by_group() -> None:
    file = ParquetFile(_columns(1))
    assert file.begin() == b"PAR1"
    chunks = [file.rows(_block(1, 50_000, start=50_000 * k)) for k in range(6)]
    assert [bool(chunk) for chunk in chunks] == [False, True, True, True, False, True]
    assert file.end().endswith(b"PAR1")


@pytest.mark.parametrize("file_format", ["csv", "ndjson", "parquet"])
def test_two_sources_that_take_turns_make_the_same_file_however_rows_come(
    file_format: Literal["csv", "ndjson", "parquet"],
) -> None:
    whole = _block(1, 1500)
    rows = [replace(whole.part(k, k + 1), sources=(f"sa-{k % 2}",)) for k in range(1500)]
    written = _written(measurement_file(_columns(1), file_format), rows)
    together = replace(whole, sources=("sa-1", "sa-0"), source_positions=1 - np.arange(1500) % 2)
    assert _written(measurement_file(_columns(1), file_format), [together.part(0, 700), together.part(700, 1500)]) == (
        written
    )
    if file_format == "parquet":
        table = parquet.read_table(io.BytesIO(written))
        assert table.column("source").to_pylist() == [f"sa-{k % 2}" for k in range(1500)]
        assert _same(table.column("c01_dbm").to_numpy().astype(np.float32), whole.power_dbm[:, 1])
    else:
        assert written.count(b"sa-1") == 750
        one = [replace(row, sources=("sa-0",)) for row in rows]
        assert _written(measurement_file(_columns(1), file_format), one) == _written(
            measurement_file(_columns(1), file_format), [replace(whole, sources=("sa-0",))]
        )


def test_blocks_are_taken_one_at_a_time() -> None:
    taken = 0

    def blocks() -> Iterator[MeasurementBlock]:
        nonlocal taken
        for k in range(5):
            taken += 1
            yield _block(1, 10, start=10 * k)

    chunks = file_bytes(CsvFile(_columns(1)), blocks())
    next(chunks)
    next(chunks)
    assert taken == 1
