"""Rows as text: what is written reads back bit for bit, by every writer."""

import csv
import io
import json
import threading

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from service.formats.tabular import row_text
from service.formats.tabular.row_kernel import compiled_fill_rows
from service.formats.tabular.row_text import RowFrame, RowText, plain_rows, ready_kernels
from service.records.epoch import format_epoch

COMPILED = RowText("numba")


def _csv(width: int) -> RowFrame:
    return RowFrame(b"", (b",sa-1",), (b",",) * width, b"", b"\r\n")


def _read_csv(text: bytes) -> tuple[list[str], NDArray[np.float32]]:
    rows = list(csv.reader(io.StringIO(text.decode(), newline="")))
    values = [[float(cell) if cell else np.nan for cell in row[2:]] for row in rows]
    return [row[0] for row in rows], np.array(values).astype(np.float32)


def _same(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    return bool(np.all((one.view(np.uint32) == other.view(np.uint32)) | (np.isnan(one) & np.isnan(other))))


@settings(max_examples=examples(200), deadline=None)  # the first example compiles
@given(
    hnp.arrays(
        np.float32,
        st.tuples(st.integers(1, 4), st.integers(1, 5)),
        elements=st.floats(-250, 50, width=32) | st.just(np.nan) | st.floats(width=32, allow_infinity=False),
    ),
    st.integers(0, 253_402_300_799_999_999),
)
def test_every_float32_reads_back(values: NDArray[np.float32], epoch_us: int) -> None:
    epochs_us = np.full(len(values), epoch_us)
    frame = _csv(values.shape[1])
    for text in (COMPILED.rows(epochs_us, values, frame), plain_rows(epochs_us, values, frame)):
        epochs, again = _read_csv(text)
        assert epochs == [format_epoch(epoch_us)] * len(values)
        assert _same(again, values)
    assert COMPILED.rows(epochs_us, values, frame) == plain_rows(epochs_us, values, frame)


@pytest.mark.parametrize("decimals", [0, 1, 2, 3, 4, 5])
def test_rounded_levels_are_written_with_their_own_decimals(decimals: int) -> None:
    rng = np.random.default_rng(decimals)
    wanted = rng.uniform(-127.0, 50.0, 4000).round(decimals)
    text = COMPILED.rows(np.arange(4000), wanted.astype(np.float32)[:, np.newaxis], _csv(1)).decode()
    cells = [line.split(",")[2] for line in text.splitlines()]
    assert max(len(cell.partition(".")[2]) for cell in cells) <= decimals
    assert [float(cell) for cell in cells] == wanted.tolist()


def test_lines_of_json_hold_null_for_what_is_absent() -> None:
    values = np.array([[-42.1, np.nan], [np.nan, np.nan]], dtype=np.float32)
    frame = RowFrame(b'{"epoch":"', (b'"',), (b',"c00_dbm":', b',"c1_dbm":'), b"null", b"}\n")
    lines = COMPILED.rows(np.array([0, 1_500_000]), values, frame).splitlines()
    assert [json.loads(line) for line in lines] == [
        {"epoch": "1970-01-01T00:00:00.000000Z", "c00_dbm": -42.1, "c1_dbm": None},
        {"epoch": "1970-01-01T00:00:01.500000Z", "c00_dbm": None, "c1_dbm": None},
    ]


def test_what_stands_after_the_epoch_is_chosen_row_by_row() -> None:
    values = np.array([[-42.1], [np.nan], [1e-30]], dtype=np.float32)
    frame = RowFrame(b"", (b",a", b",longer", b""), (b",",), b"", b";")
    positions = np.array([1, 0, 2])
    text = "1970-01-01T00:00:00.000000Z,longer,-42.1;1970-01-01T00:00:00.000001Z,a,;"
    assert COMPILED.rows(np.arange(2), values[:2], frame, positions[:2]).decode() == text
    assert plain_rows(np.arange(2), values[:2], frame, positions[:2]).decode() == text
    # the last value is for the way without a compiler alone
    whole = f"{text}1970-01-01T00:00:00.000002Z,1e-30;"
    assert COMPILED.rows(np.arange(3), values, frame, positions).decode() == whole


def test_nothing_gives_nothing() -> None:
    assert COMPILED.rows(np.empty(0, dtype=np.int64), np.empty((0, 3), dtype=np.float32), _csv(3)) == b""


def test_calendar_of_every_month_and_leap_day() -> None:
    days = np.arange("2023-12-31", "2028-03-02", dtype="datetime64[D]").astype("datetime64[us]").astype(np.int64)
    text = COMPILED.rows(days + 86_399_999_999, np.zeros((len(days), 1), dtype=np.float32), _csv(1)).decode()
    assert [line[:27] for line in text.splitlines()] == [format_epoch(int(day) + 86_399_999_999) for day in days]


def test_nobody_waits_for_the_compiler_and_the_loop_is_compiled_once_for_all_blocks(monkeypatch) -> None:
    may_go, compiled, calls = threading.Event(), compiled_fill_rows(), []

    def compile_late():
        calls.append(threading.current_thread().name)
        assert may_go.wait(120)
        return compiled

    monkeypatch.setattr(row_text, "compiled_fill_rows", compile_late)
    monkeypatch.setattr(row_text, "_compiled", threading.Event())
    monkeypatch.setattr(row_text, "_compiling", threading.Lock())
    assert [ready_kernels("numba") for _ in range(3)] == ["numpy"] * 3
    assert ready_kernels("numpy") == "numpy"
    may_go.set()
    assert row_text._compiled.wait(300)
    assert (ready_kernels("numba"), calls) == ("numba", ["row-kernel"])
    kinds = len(compiled.signatures)
    epochs_us, values = np.arange(6), np.zeros((6, 2), dtype=np.float32)
    for array in (epochs_us, values):
        array.flags.writeable = False
    RowText("numba").rows(epochs_us[::2], values[::2, ::-1], _csv(2))
    assert len(compiled.signatures) == kinds == 1
