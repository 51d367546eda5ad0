"""Documents, powers, carriers and details come back bit for bit, and take no more bytes than they need."""

import dataclasses

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from db.encoding.measurement_runs import details_of, pack_carriers, prepare_details, unpack_carriers
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
from db.encoding.record_codec import decode, decode_all, decode_input, encode, encode_all, kind_of
from service.core.estimation.filtering.anchor import HYPOTHESES
from service.errors import StorageError
from service.records.inputs import KINDS, AttitudeReference, Operation, PlanChange
from service.records.levels.attitude import CARRIER_HYPOTHESES, CARRIER_STATES, STEP_DB, Axes, CarrierResults
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails


@settings(derandomize=True, deadline=None)
@given(st.lists(st.floats()))
def test_floats_survive_as_bits(values):
    stored = decode_all(float, encode_all(float, tuple(values)))
    # repr of a float is exact, tells -0.0 from 0.0 and lets NaN equal NaN
    assert repr(stored) == repr(tuple(values))


def test_a_document_is_plain_json_with_field_names():
    record = AttitudeReference("other", 5, Axes(float("nan"), 1.0, -0.0), Axes(1e-3, float("inf"), 3.0))
    text = encode(record)
    assert text == '{"source":"other","epoch_us":5,"attitude_deg":[NaN,1.0,-0.0],"sigma_deg":[0.001,Infinity,3.0]}'
    assert repr(decode(AttitudeReference, text)) == repr(record)


def test_quotes_and_letters_of_any_script_survive():
    record = Operation(1, "other", 5, None, comment='"Ямал" \\ \u2028 \U0001f6f0')
    assert decode_input("operation", encode(record)) == record


@pytest.mark.parametrize(("kind", "record_type"), KINDS.items())
def test_every_kind_of_input_has_a_name_and_a_key(kind, record_type):
    assert dataclasses.is_dataclass(record_type)
    assert isinstance(record_type.key, property)
    assert kind_of(object.__new__(record_type)) == kind


def test_documents_are_checked_when_read():
    with pytest.raises(StorageError, match=r"storage\.corrupt: A stored PlanChange cannot be read: plan_id: Field"):
        decode(PlanChange, "{}")


LEVELS = st.floats(-131.0, 131.0) | st.just(float("nan"))


@settings(derandomize=True, deadline=None)
@given(data=st.data(), count=st.integers(1, 40))
def test_what_is_stored_comes_back(data, count):
    def column(values):
        return np.array(data.draw(st.lists(values, min_size=count, max_size=count)))

    state, hypothesis = (column(st.integers(0, len(names) - 1)) for names in (CARRIER_STATES, CARRIER_HYPOTHESES))
    stored = CarrierResults(data.draw(st.integers(1, 2**31 - 1)), column(LEVELS), column(LEVELS), state, hypothesis)
    found = unpack_carriers(pack_carriers(stored))
    assert found.plan_id == stored.plan_id
    for name in ("deviation_db", "residual_db"):
        np.testing.assert_allclose(getattr(found, name), getattr(stored, name), rtol=0, atol=0.5001 * STEP_DB)
    np.testing.assert_array_equal(found.state, stored.state)
    np.testing.assert_array_equal(found.hypothesis, stored.hypothesis)
    # stored again it is the same
    assert pack_carriers(found) == pack_carriers(stored)


def test_a_level_beyond_all_is_the_greatest_one():
    nothing = np.zeros(3, dtype=np.int64)
    levels = np.array([1e9, -1e9, np.inf])
    found = unpack_carriers(pack_carriers(CarrierResults(1, levels, levels, nothing, nothing)))
    assert found.deviation_db.tolist() == [131.068, -131.068, 131.068]


def test_hypotheses_are_those_of_the_filter():
    assert (None, *HYPOTHESES) == CARRIER_HYPOTHESES


NAN = float("nan")


def details(*kinds: int, rows: int = 3, carriers: int = 5) -> CarrierDetails:
    """Return details that state some kinds of figures in every row but the second."""
    figures = np.full((len(DETAIL_NAMES), rows, carriers), NAN, dtype=np.float32)
    for kind in kinds:
        figures[kind] = kind + np.arange(rows * carriers, dtype=np.float32).reshape(rows, carriers) / 7
    figures[:, 1] = NAN
    return CarrierDetails(*figures)


@pytest.mark.parametrize("kinds", [(0,), (3,), (0, 2), (1, 3), (0, 1, 2, 3)])
def test_figures_come_back_and_only_what_is_stated_takes_bytes(kinds):
    sent = details(*kinds)
    prepared = prepare_details(sent)
    assert prepared.width == 1 + 4 * 5 * len(kinds)
    assert prepared.is_stated.tolist() == [True, False, True]
    for row in range(3):
        reported = details_of(prepared.figures[row * prepared.width : (row + 1) * prepared.width], 5)
        for name in DETAIL_NAMES:
            # float32 widened: no tolerance
            np.testing.assert_array_equal(getattr(reported, name), getattr(sent, name)[row].astype(np.float64))


def test_what_states_nothing_is_nothing():
    assert prepare_details(None) is None
    assert prepare_details(details()) is None


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 40))
#: any bits but infinities, which are refused long before
ANY = arrays("<u4", SHAPES).map(lambda bits: np.where(np.isinf(bits.view("<f4")), np.float32(-0.0), bits.view("<f4")))
POWER_LEVELS = np.linspace(-70, -50, 32)


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
    power_dbm = POWER_LEVELS + rng.normal(0.0, 0.1, (50, 32))
    power_dbm = (power_dbm if decimals is None else np.round(power_dbm, decimals)).astype(np.float32)
    power_dbm.reshape(-1)[:missing] = np.nan
    assert assert_comes_back(power_dbm) <= most_bytes


def test_a_row_without_powers_is_a_row():
    assert assert_comes_back(np.full((3, 32), np.nan, dtype=np.float32)) < 32


def test_a_sign_of_zero_or_a_value_off_every_grid_costs_the_plain_form():
    for odd in (-0.0, 1e-44):
        power_dbm = np.round(POWER_LEVELS, 2).astype(np.float32)[None].copy()
        power_dbm[0, 3] = odd
        assert assert_comes_back(power_dbm) == 128


def test_rows_of_any_form_and_plan_are_read_together():
    wide, narrow = np.round(POWER_LEVELS, 2).astype(np.float32)[None], np.full((1, 3), -50.5, dtype=np.float32)
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
    row = np.round(POWER_LEVELS, 2).astype(np.float32)[None, :]
    assert _one_row(row) == _many_rows(row)
    for odd in (np.nan, np.inf, -0.0):
        assert _one_row(np.append(row, np.float32(odd))[None, :]) is None
