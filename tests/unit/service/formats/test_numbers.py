"""Numbers as text: the fewest digits that give the stored value back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.formats.numbers import shortest_float32, text_of_float, text_of_float32

FLOAT32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(st.lists(FLOAT32, max_size=8))
def test_float32_reads_back_exactly(values):
    stored = np.array(values, dtype=np.float64)
    # exact: the promise is the stored bits, not something near them
    assert np.array_equal(np.array(shortest_float32(stored), dtype=np.float32), stored.astype(np.float32))
    assert [float(text) for text in text_of_float32(stored)] == shortest_float32(stored)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_float64_reads_back_exactly(value):
    assert float(text_of_float(value)) == value


CASES = {-42.1: "-42.1", 0.0: "0.0", -250.0: "-250.0", 1e-20: "1e-20", 16777216.0: "1.6777216e+07", math.nan: ""}


@pytest.mark.parametrize(("value", "text"), CASES.items(), ids=str)
def test_few_digits(value, text):
    stored = np.array([np.float32(value)], dtype=np.float64)
    assert text_of_float32(stored) == [text]
    assert shortest_float32(stored) == [float(text) if text else None]


def test_absent_is_empty():
    assert text_of_float(math.nan) == ""
    assert text_of_float(np.float64(0.1)) == "0.1", "a number of numpy is written as a number"
    assert text_of_float32(np.zeros(0)) == []
