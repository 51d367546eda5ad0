"""Claims about states as bytes: what comes back is the same bit for bit, and nothing else can come back."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as some

from service.core.estimation.filtering.filter_state import CARRIER, WATCH, initial_watch
from service.pipeline.checkpoints import _LAYOUT, RECORDS, ChainState, Layout


class Colour(StrEnum):
    RED = "red"


class Inner(NamedTuple):
    colour: Colour
    swing: complex


@dataclass(frozen=True)
class Outer:
    values: np.ndarray
    inner: Inner | None
    parts: tuple[Inner, ...] = ()
    number: float = 0.0
    name: str | None = None


@dataclass(frozen=True)
class Stranger:
    number: int


LAYOUT = Layout(Outer)


def back(value):
    return LAYOUT.unpack(LAYOUT.pack(value), Outer)


@given(
    some.arrays(st.sampled_from([np.float64, np.int64, np.bool_]), some.array_shapes(max_dims=3, min_side=0)),
    st.floats(),
    st.none() | st.text(),
)
def test_a_state_comes_back_bit_for_bit(values, number, name):
    whole = Outer(values, Inner(Colour.RED, complex(0.1, -0.0)), (Inner(Colour.RED, 1j),) * 2, number, name)
    found = back(whole)
    assert found.values.tobytes() == values.tobytes()
    assert (found.values.dtype, found.values.shape) == (values.dtype, values.shape)
    assert repr(found.inner) == repr(whole.inner)
    assert (found.parts, found.name) == (whole.parts, name)
    assert found.number == number or (math.isnan(found.number) and math.isnan(number))
    assert math.copysign(1.0, found.number) == math.copysign(1.0, number) or math.isnan(number)


def test_the_order_of_arrays_and_the_kind_of_scalars_are_kept():
    columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    assert back(Outer(columns, None)).values.flags.f_contiguous
    assert type(back(Outer(columns, None, number=np.float64(0.1))).number) is np.float64
    assert type(back(Outer(columns, None, number=0.1)).number) is float
    assert back(Outer(columns, None)).values.flags.writeable


@pytest.mark.parametrize("value", [Stranger(1), [1.0], {"a": 1}, object(), lambda: None, np.array([{}], dtype=object)])
def test_what_is_no_part_of_the_state_is_refused_when_it_is_packed(value):
    with pytest.raises(TypeError, match=r"no part|not among"):
        LAYOUT.pack(Outer(np.zeros(1), value))


def test_a_stored_name_makes_nothing_but_records_of_the_layout():
    content = Layout(Stranger).pack(Stranger(1))
    with pytest.raises(KeyError, match="Stranger"):
        LAYOUT.unpack(content, Outer)
    with pytest.raises(TypeError, match="Inner"):
        LAYOUT.unpack(LAYOUT.pack(Inner(Colour.RED, 0j)), Outer)


def test_the_digest_changes_with_a_field():
    class Other(NamedTuple):
        colour: Colour
        swing: float

    Other.__name__ = "Inner"
    assert Layout(Inner).digest != Layout(Other).digest
    assert Layout(ChainState).digest == Layout(ChainState).digest


@pytest.mark.parametrize("of_state", [CARRIER, WATCH])
def test_the_digest_changes_with_a_field_of_an_array_of_records(of_state):
    fields = [(name, of_state[name]) for name in of_state.names]
    swapped = [fields[1], fields[0], *fields[2:]]
    renamed = [("other", fields[0][1]), *fields[1:]]
    retyped = [(fields[0][0], np.dtype("f4")), *fields[1:]]
    others = [np.dtype(each, align=True) for each in (fields[1:], swapped, renamed, retyped)]
    digests = {Layout(ChainState, (each,)).digest for each in (of_state, *others)}
    assert len(digests) == 5
    assert Layout(ChainState, RECORDS).digest == _LAYOUT.digest


def test_arrays_of_records_come_back_as_the_compiled_filter_takes_them():
    layout, values = Layout(Outer, (CARRIER, WATCH)), initial_watch(7)
    content = layout.pack(Outer(values, None))
    found = layout.unpack(content, Outer).values
    for name in WATCH.names:
        np.testing.assert_array_equal(found[name], values[name])
    assert numba.typeof(found) == numba.typeof(values)
    # padding of records holds whatever lay there in memory
    values.view(np.uint8)[WATCH.fields["is_steady"][1] + 1] = 99
    assert layout.pack(Outer(values, None)) == content
    with pytest.raises(TypeError, match="no part of a state"):
        LAYOUT.pack(Outer(values, None))
    with pytest.raises(TypeError, match="records of another type"):
        Layout(Outer, (CARRIER,)).unpack(content, Outer)


def test_two_classes_of_one_name_are_refused():
    @dataclass(frozen=True)
    class Both:
        one: Inner
        other: "Twin"

    class Twin(NamedTuple):
        number: int

    Twin.__name__ = "Inner"
    Both.__annotations__["other"] = Twin
    with pytest.raises(TypeError, match="two classes"):
        Layout(Both)
