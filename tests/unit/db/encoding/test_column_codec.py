"""Columns come back as they were packed, every bit of them, all or some."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from db.encoding.column_codec import PackedColumns, pack_columns

INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
#: texts as JSON writes numbers, and what only looks so
NUMBERS = st.one_of(
    st.floats().map(repr),
    INT64.map(str),
    st.sampled_from(
        ["-0", "05", "1e5", "1E5", "1.50", "0.1", "-0.0", "9" * 30, "9" * 5000, "1.5.2", "--3", "٣", "1e400"]
    ),
)
TEXTS = st.one_of(
    st.text(max_size=5),
    st.lists(st.one_of(NUMBERS, st.sampled_from(["[", ", ", '{"a": ', "%s", "%", "c"])), max_size=6).map("".join),
)
KINDS = {
    "integer": st.none() | INT64,
    "truth": st.none() | st.booleans(),
    "double": st.floats().map(lambda value: math.nan if math.isnan(value) else value),
    "text": st.none() | TEXTS,
    "string": st.none() | st.binary(max_size=4),
    "narrow": st.binary(min_size=3, max_size=3),
    "absent": st.none(),
}


@st.composite
def tables(draw):
    count = draw(st.integers(1, 12))
    return count, {name: draw(st.lists(kind, min_size=count, max_size=count)) for name, kind in KINDS.items()}


def bits(values):
    """Return values as text that tells every bit; NaN is one object."""
    return [
        (struct.pack("<d", value), value is math.nan) if isinstance(value, float) else (type(value), value)
        for value in values
    ]


@settings(derandomize=True, deadline=None)
@given(table=tables(), data=st.data())
def test_every_bit_comes_back(table, data):
    count, columns = table
    packed = PackedColumns(pack_columns(columns), count)
    start, stop = sorted(data.draw(st.tuples(st.integers(0, count), st.integers(0, count))))
    positions = data.draw(st.lists(st.integers(0, count - 1), max_size=4))
    for name, values in columns.items():
        assert bits(packed.values(name, slice(None))) == bits(values), name
        assert bits(packed.values(name, slice(start, stop))) == bits(values[start:stop]), name
        chosen = np.array(positions, dtype=np.int64)
        assert bits(packed.values(name, chosen)) == bits([values[position] for position in positions]), name


def test_what_repeats_another_column_costs_next_to_nothing():
    random = np.random.default_rng(3)
    figures = random.normal(size=2000).tolist()
    one = pack_columns({"a": figures})
    texts = [f'[{{"torque": {value!r}, "names": ["x"]}}]' for value in figures]
    assert len(pack_columns({"a": figures, "b": figures, "c": texts})) < 1.02 * len(one)
    assert len(one) < 8 * 2000


@pytest.mark.parametrize("count", [2, 4])
def test_another_number_of_rows_is_a_value_error(count):
    with pytest.raises(ValueError, match="bytes where"):
        PackedColumns(pack_columns({"a": [1, 2, 3]}), count)


def test_what_is_no_zstd_is_a_value_error():
    with pytest.raises(ValueError, match=r"decompress|frame"):
        PackedColumns(b"nothing", 3)
