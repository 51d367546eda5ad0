"""Stored powers come back bit for bit, whatever they are, and take no more bytes than as float32."""

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from db.encoding.power_codec import (
    NO_FLAGS,
    _many_rows,
    _one_row,
    canonical_powers,
    pack_flags,
    pack_powers,
    unpack_flags,
    unpack_parts,
    unpack_powers,
)

SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 40))
#: any bits but infinities, which are refused long before
ANY = arrays("<u4", SHAPES).map(lambda bits: np.where(np.isinf(bits.view("<f4")), np.float32(-0.0), bits.view("<f4")))
LEVELS = np.linspace(-70, -50, 32)


def rows_of(stored, count):
    return [stored.part(position, position + 1).rows for position in range(count)]


def assert_comes_back(power_dbm):
    """Pack and unpack, compare bits, return the bytes of a row."""
    stored = pack_powers(power_dbm)
    assert len(stored.rows) == stored.width * len(power_dbm)
    assert stored.width <= 4 * power_dbm.shape[1]
    rows = rows_of(stored, len(power_dbm))
    expected = canonical_powers(power_dbm).view("<u4")
    np.testing.assert_array_equal(unpack_powers(rows).view("<u4"), expected)
    np.testing.assert_array_equal(unpack_powers(rows[-1:]).view("<u4"), expected[-1:])
    return stored.width


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=ANY)
def test_any_bits_come_back(power_dbm):
    assert_comes_back(power_dbm.astype(np.float32))


@st.composite
def gridded(draw):
    """Levels on a grid, with some values of any kind among them."""
    shape = draw(SHAPES)
    steps = draw(arrays(np.int32, shape, elements=st.integers(-(10**7), 10**6)))
    scale = draw(st.sampled_from([1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 2.0**17, 2.0**23, 3.0]))
    power_dbm = (steps / scale).astype(np.float32)
    odd = draw(arrays(np.bool_, shape, elements=st.sampled_from([False] * 9 + [True]), fill=st.just(False)))
    power_dbm[odd] = draw(st.sampled_from([np.nan, -0.0, 0.0, 1e-45, -1e-40, 1.1754944e-38, 3.4e38, 1e-5, -59.08]))
    return power_dbm


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=gridded())
def test_levels_on_a_grid_come_back(power_dbm):
    assert_comes_back(power_dbm)


@pytest.mark.parametrize(
    ("decimals", "most_bytes"),
    [(2, 50), (3, 66), (5, 90), (None, 98)],
    ids=["0.01", "0.001", "0.00001", "full mantissa"],
)
@pytest.mark.parametrize("missing", [0, 1, 40])
def test_levels_of_carriers_take_the_bits_of_their_span(decimals, most_bytes, missing):
    rng = np.random.default_rng(5)
    power_dbm = LEVELS + rng.normal(0.0, 0.1, (50, 32))
    power_dbm = (power_dbm if decimals is None else np.round(power_dbm, decimals)).astype(np.float32)
    power_dbm.reshape(-1)[:missing] = np.nan
    assert assert_comes_back(power_dbm) <= most_bytes


def test_a_row_without_powers_is_a_row():
    assert assert_comes_back(np.full((3, 32), np.nan, dtype=np.float32)) < 32


def test_a_sign_of_zero_or_a_value_off_every_grid_costs_the_plain_form():
    for odd in (-0.0, 1e-44):
        power_dbm = np.round(LEVELS, 2).astype(np.float32)[None].copy()
        power_dbm[0, 3] = odd
        assert assert_comes_back(power_dbm) == 128


def test_rows_of_any_form_and_plan_are_read_together():
    wide, narrow = np.round(LEVELS, 2).astype(np.float32)[None], np.full((1, 3), -50.5, dtype=np.float32)
    many = np.round(np.linspace(-60, -50, 7), 5).astype(np.float32)[None]
    plain = many + np.float32(np.pi) * np.float32(1e-30)
    of_rows = [wide, narrow, wide + np.float32(1), many, plain, wide.astype(np.float16).astype(np.float32)]
    found = {}
    for positions, part in unpack_parts([pack_powers(row).rows for row in of_rows]):
        found.update(zip(positions, part, strict=True))
    for position, row in enumerate(of_rows):
        np.testing.assert_array_equal(found[position], row[0])
    same_plan = [of_rows[position] for position in (0, 2, 5, 0)]
    np.testing.assert_array_equal(unpack_powers([pack_powers(row).rows for row in same_plan]), np.vstack(same_plan))


def test_plain_rows_of_older_versions_are_read():
    plain = np.array([-50.25, np.nan, -0.0], dtype="<f4")
    np.testing.assert_array_equal(unpack_powers([plain.tobytes()])[0].view("<u4"), plain.view("<u4"))
    masks = np.array([0, 1 << 22, -1], dtype="<i4")
    assert unpack_flags(masks.tobytes(), 3).tolist() == masks.tolist()


@settings(max_examples=examples(200), deadline=None)
@given(masks=arrays(np.int32, SHAPES, elements=st.one_of(st.just(0), st.integers(-(1 << 31), (1 << 31) - 1))))
def test_flags_come_back(masks):
    stored = pack_flags(masks)
    assert stored.width <= 4 * masks.shape[1]
    for row, mask in zip(rows_of(stored, len(masks)), masks, strict=True):
        assert unpack_flags(row, masks.shape[1]).tolist() == mask.tolist()


def test_flags_take_no_bytes_where_none_is_set_and_few_where_they_are_small():
    masks = np.zeros((2, 32), dtype=np.int32)
    assert pack_flags(masks) == NO_FLAGS
    masks[1, 4] = 16
    assert pack_flags(masks).width <= 6 + 20 + 1


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=gridded())
def test_a_row_alone_is_packed_as_one_of_many(power_dbm):
    for row in canonical_powers(power_dbm):
        assert pack_powers(row[None, :]) == _many_rows(canonical_powers(row[None, :]))


def test_a_row_alone_is_packed_value_by_value_where_levels_have_few_decimals():
    row = np.round(LEVELS, 2).astype(np.float32)[None, :]
    assert _one_row(row) == _many_rows(row)
    for odd in (np.nan, np.inf, -0.0):
        assert _one_row(np.append(row, np.float32(odd))[None, :]) is None
