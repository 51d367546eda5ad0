"""Columns of sealed days come back bit for bit, take few bytes, and a blob that is damaged is refused."""

import math
import struct
from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyarrow import parquet

from db.columns import checksum_of
from db.encoding.column_blob import ColumnBlob, decimals, levels_of, pack_columns
from db.encoding.segments import PLAIN_COLUMNS, MeasurementSegment, SegmentCache, SegmentHead
from db.encoding.segments import measured_arrays as arrays_of_columns
from db.sealing import HOUR_S, MINUTE_S, bins_from, bins_of, differences
from db.tables import segment
from service.core.rows import Summaries

INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
#: texts as JSON writes numbers, and what only looks so
NUMBERS = st.one_of(
    st.floats().map(repr),
    st.floats(1e-7, 1e-3).map(repr),
    INT64.map(str),
    st.sampled_from(
        ["-0", "05", "1e5", "1E5", "1.50", "0.1", "-0.0", "9" * 30, "9" * 5000, "1.5.2", "--3", "٣", "1e400"]
    ),
    st.sampled_from(["0.00005", "5e-5", "5e-05", "1e-6", "1e16", "1e+16", "10000000000000000.0"]),
)
TEXTS = st.one_of(
    st.text(max_size=5),
    st.lists(st.one_of(NUMBERS, st.sampled_from(["[", ", ", '{"a": ', "%s", "%", "c"])), max_size=6).map("".join),
    st.lists(NUMBERS, min_size=2, max_size=2).map(lambda two: f"[{two[0]},{two[1]}]"),
)
COLUMN_KINDS = {
    "integer": st.none() | INT64,
    "truth": st.none() | st.booleans(),
    "double": st.floats().map(lambda value: math.nan if math.isnan(value) else value),
    "text": st.none() | TEXTS,
    "record": st.none()
    | st.lists(st.floats(-2, 2), min_size=2, max_size=2).map(lambda two: f"[{two[0]!r},{two[1]!r}]"),
    "string": st.none() | st.binary(max_size=4),
    "absent": st.none(),
}


@st.composite
def tables(draw):
    count = draw(st.integers(1, 12))
    return count, {name: draw(st.lists(kind, min_size=count, max_size=count)) for name, kind in COLUMN_KINDS.items()}


def bits(values):
    """Return values as text that tells every bit; NaN is one object."""
    return [
        (struct.pack("<d", value), value is math.nan) if isinstance(value, float) else (type(value), value)
        for value in values
    ]


def arrays(columns):
    return {name: np.array(values) if name.startswith("double") else values for name, values in columns.items()}


@settings(derandomize=True, deadline=None)
@given(table=tables(), data=st.data())
def test_every_bit_comes_back(table, data):
    count, columns = table
    columns["double again"] = columns["double"]
    packed = ColumnBlob(pack_columns(arrays(columns)), count)
    start, stop = sorted(data.draw(st.tuples(st.integers(0, count), st.integers(0, count))))
    positions = data.draw(st.lists(st.integers(0, count - 1), max_size=4))
    for name, values in columns.items():
        assert bits(packed.values(name, slice(None))) == bits(values), name
        assert bits(packed.values(name, slice(start, stop))) == bits(values[start:stop]), name
        chosen = np.array(positions, dtype=np.int64)
        assert bits(packed.values(name, chosen)) == bits([values[position] for position in positions]), name


def test_what_repeats_another_column_costs_next_to_nothing():
    figures = np.random.default_rng(3).normal(size=2000)
    one = pack_columns({"a": figures})
    texts = [f'[{{"torque": {value!r}, "names": ["x"]}}]' for value in figures.tolist()]
    texts = [text.replace("e-0", "e-") for text in texts]
    assert len(pack_columns({"a": figures, "b": figures})) < 1.02 * len(one)
    # but for a number that documents write otherwise
    assert len(pack_columns({"c": texts})) < 1.1 * len(one)
    assert len(one) < 8 * 2000


def test_a_blob_is_parquet_that_others_read():
    blob = pack_columns({"epoch_us": np.arange(5), "power_dbm_0": decimals(np.full(5, -50.25, np.float32), 2)})
    table = parquet.read_table(pa.BufferReader(blob))
    assert table.column("epoch_us").to_pylist() == [0, 1, 2, 3, 4]
    assert {str(level) for level in table.column("power_dbm_0").to_pylist()} == {"-50.25"}


@pytest.mark.parametrize("count", [2, 4])
def test_another_number_of_rows_is_a_value_error(count):
    with pytest.raises(ValueError, match="3 rows where"):
        ColumnBlob(pack_columns({"a": [1, 2, 3]}), count)


def test_a_blob_that_is_cut_or_none_is_a_value_error():
    blob = pack_columns({"a": np.random.default_rng(1).normal(size=50)})
    for size in (0, 1, 8, len(blob) // 2, len(blob) - 9, len(blob) - 1):
        with pytest.raises(ValueError, match=r"[Pp]arquet|footer|bytes|thrift"):
            ColumnBlob(blob[:size]).values("a", slice(None))
    with pytest.raises(ValueError, match=r"[Pp]arquet|footer"):
        ColumnBlob(b"nothing at all, and long enough for a footer")


@settings(derandomize=True, deadline=None)
@given(st.lists(st.floats(width=32) | st.sampled_from([-0.0, 0.0, math.nan, math.inf, 1e-45]), min_size=1))
def test_levels_come_back_bit_for_bit_or_are_no_decimals(levels):
    values = np.array(levels, dtype=np.float32)
    for places in (2, 5):
        found = decimals(values, places)
        rounded = np.round(np.clip(values, -1000, 1000), places).astype(np.float32) + np.float32(0.0)
        for stored, wanted in ((found, values), (decimals(rounded, places), rounded)):
            if stored is not None:
                read = levels_of(pa.array(stored.cast(pa.decimal128(9, places))))
                np.testing.assert_array_equal(np.isnan(read), np.isnan(wanted))
                is_known = ~np.isnan(wanted)
                assert read[is_known].tobytes() == wanted[is_known].tobytes()


KINDS = 4
MeasuredColumns = namedtuple("MeasuredColumns", ["epochs_us", *PLAIN_COLUMNS[1:], "power_dbm", "flags", "details"])


def measured_arrays(rows):
    return arrays_of_columns(dict(zip(PLAIN_COLUMNS, rows, strict=False)), *rows[len(PLAIN_COLUMNS) :])


@st.composite
def measured(draw):
    count, carriers = draw(st.integers(1, 12)), draw(st.integers(1, 5))
    integers = [draw(hnp.arrays(np.int64, count, elements=INT64)) for _ in range(3)]
    claims = [draw(hnp.arrays(np.bool_, count)) for _ in range(3)]
    seqs = draw(hnp.arrays(np.int64, count, elements=st.integers(-1, 1 << 62)))
    powers = draw(hnp.arrays(np.uint32, (count, carriers))).view(np.float32)
    if draw(st.booleans()):
        steps = draw(hnp.arrays(np.int32, (count, carriers), elements=st.integers(-(10**5), 10**5)))
        powers = np.where(draw(hnp.arrays(np.bool_, (count, carriers))), np.nan, steps / 100.0).astype(np.float32)
    flags = draw(hnp.arrays(np.int32, (count, carriers)))
    details = draw(hnp.arrays(np.float32, (count, KINDS, carriers), elements=st.floats(width=32, allow_nan=True)))
    return MeasuredColumns._make((*integers, *claims, seqs, powers, flags, details))


def head_of(rows: MeasuredColumns) -> SegmentHead:
    count, first, last = len(rows.epochs_us), int(rows.epochs_us[0]), int(rows.epochs_us[-1])
    return SegmentHead(
        1, 1, "measurement", "", "", 1, 1, 20_000, count, count, first, last, 1, count, None, None, b"sum "
    )


@settings(derandomize=True, deadline=None)
@given(rows=measured())
def test_every_bit_of_a_segment_comes_back(rows):
    blob = ColumnBlob(pack_columns(measured_arrays(rows)), len(rows.epochs_us))
    found = MeasurementSegment(head_of(rows), blob, "sa-1")
    whole = MeasuredColumns(*blob.whole(*PLAIN_COLUMNS), found.power_dbm(), found.all_flags(), found.details())
    for name, column in whole._asdict().items():
        wanted = getattr(rows, name)
        # any NaN is "not measured"
        np.testing.assert_array_equal(column, wanted, name)
        if wanted.dtype.kind == "f":
            assert column[~np.isnan(column)].tobytes() == wanted[~np.isnan(wanted)].tobytes()


def steady(count: int, carriers: int) -> MeasuredColumns:
    """Return rows of a front end that measures every ten seconds, levels of two decimals."""
    random, step = np.random.default_rng(5), np.arange(count)
    yes, no = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    epochs_us = 1_795_000_000_000_000 + step * 10_000_000
    powers = np.round(random.normal(-60.0, 0.1, (count, carriers)), 2).astype(np.float32)
    flags, details = np.zeros((count, carriers), np.int32), np.full((count, KINDS, carriers), np.nan, np.float32)
    return MeasuredColumns(epochs_us, step + 5, epochs_us + 40_000, yes, no, no, step, powers, flags, details)


def test_a_day_of_two_decimals_takes_a_fifth_of_its_powers():
    rows = steady(8640, 32)
    size = len(pack_columns(measured_arrays(rows)))
    assert size <= 0.19 * rows.power_dbm.nbytes, f"{size / rows.power_dbm.nbytes:.3f}"


def test_any_wrong_bit_changes_the_checksum():
    """Every byte of a blob counts, the footer too, which no checksum of a page covers."""
    rows = steady(20, 4)
    blob = pack_columns(measured_arrays(rows))
    values = {**head_of(rows)._asdict(), "content": blob}
    right = checksum_of(segment, values)
    for position in range(8 * len(blob)):
        wrong = bytearray(blob)
        wrong[position // 8] ^= 1 << position % 8
        assert checksum_of(segment, {**values, "content": bytes(wrong)}) != right, position


def test_every_figure_of_the_head_is_under_the_checksum():
    rows = steady(20, 4)
    values = {**head_of(rows)._asdict(), "content": b""}
    right = checksum_of(segment, values)
    for name, value in values.items():
        other = {int: 1, str: "x", bytes: b"y"}.get(type(value), 1)
        is_same = checksum_of(segment, {**values, name: other if value is None else value + other}) == right
        assert is_same == (name in ("segment_id", "checksum")), name


@pytest.mark.parametrize(
    "columns", [{"a": [1, 2]}, {"epoch_us": [1, None]}, {"epoch_us": ["a", "b"], "number": [1, 2]}]
)
def test_a_blob_of_another_schema_is_a_value_error(columns):
    rows = steady(2, 1)
    whole = {**measured_arrays(rows), **columns} if len(columns) > 1 else columns
    with pytest.raises(ValueError, match=r"columns|lack"):
        MeasurementSegment(head_of(rows), ColumnBlob(pack_columns(whole), 2), "sa-1")


S = 1_000_000
RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("step_us", "lengths"), [(60 * S, {HOUR_S}), (20 * S, {HOUR_S}), (19 * S, {HOUR_S, MINUTE_S})])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_bins_come_back(step_us, lengths, dtype):
    epochs_us = 5 * 86_400 * S + np.arange(0, 86_400 * S, step_us)
    values = RNG.normal(size=(len(epochs_us), 3)).astype(dtype)
    values[RNG.random(values.shape) < 0.1] = np.nan
    values[: len(values) // 2, 1] = np.nan
    made = bins_of("x", epochs_us, values)
    assert {bin_s for _, bin_s in made} == lengths
    for (_, bin_s), blob in made.items():
        found = bins_from(blob, bin_s)
        wanted = Summaries.of_rows(epochs_us, values).gathered(epochs_us // (bin_s * S))
        for name in Summaries._fields[2:]:
            np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-12, err_msg=name)
        assert (found.first_us % (bin_s * S) == 0).all()
        assert list(differences(blob, blob)) == []
        other = values.copy()
        other[5, 0] = 77.0
        assert {"sum", "greatest"} <= set(differences(blob, bins_of("x", epochs_us, other)["x", bin_s]))


def test_bins_of_no_value_take_no_byte():
    assert set(bins_of("x", np.arange(3), np.full((3, 2), np.nan)).values()) == {b""}
    assert set(bins_of("x", np.empty(0, np.int64), np.empty((0, 2))).values()) == {b""}


CARRIERS, ROWS = 16, 100


def head(number: int, checksum: bytes = b"sum ") -> SegmentHead:
    return head_of(steady(ROWS, 1))._replace(segment_id=number, checksum=checksum)


def chunk(number):
    return SimpleNamespace(position=number, blob_bytes=0)


def held(cache: SegmentCache) -> list[int]:
    return [number for number in range(1, 10) if cache.get(head(number)) is not None]


def filled(cache, *numbers):
    for number in numbers:
        cache.put(head(number), chunk(number), CARRIERS)
    return cache


def test_what_was_not_read_for_longest_goes():
    cache = filled(SegmentCache(3 * ROWS * (4 * CARRIERS + 48)), 1, 2, 3)
    cache.get(head(1))
    filled(cache, 4)
    assert held(cache) == [1, 3, 4]
    assert cache.get(head(1, b"else")) is None, "an id that came again after a roll-back"
    cache.put(head(10), chunk(10), 4000)
    assert cache.get(head(10)) is not None, "one is held whatever it takes"
    assert held(filled(SegmentCache(0), 3, 4)) == [4]
