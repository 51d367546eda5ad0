"""Documents, powers, carriers and details come back bit for bit."""

import dataclasses

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from db.encoding.measurement_rows import canonical, details_of, masks_of, powers_of, stored_arrays
from db.encoding.record_codec import decode, decode_all, decode_input, encode, encode_all, kind_of
from db.results.stored_rows import pack_carriers, unpack_carriers
from service.core.estimation.filtering.anchor import HYPOTHESES
from service.errors import StorageError
from service.records.inputs import KINDS, AttitudeReference, Operation, PlanChange
from service.records.levels.attitude import CARRIER_HYPOTHESES, CARRIER_STATES, STEP_DB, Axes, CarrierResults
from service.records.levels.measurement import DETAIL_NAMES


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
    found = unpack_carriers(*pack_carriers([stored]))
    assert found.plan_id == stored.plan_id
    for name in ("deviation_db", "residual_db"):
        np.testing.assert_allclose(getattr(found, name), getattr(stored, name), rtol=0, atol=0.5001 * STEP_DB)
    np.testing.assert_array_equal(found.state, stored.state)
    np.testing.assert_array_equal(found.hypothesis, stored.hypothesis)
    # stored again it is the same
    assert pack_carriers([found, None]) == [*pack_carriers([stored]), None]


def test_a_level_beyond_all_is_the_greatest_one():
    nothing = np.zeros(3, dtype=np.int64)
    levels = np.array([1e9, -1e9, np.inf])
    found = unpack_carriers(*pack_carriers([CarrierResults(1, levels, levels, nothing, nothing)]))
    assert found.deviation_db.tolist() == [131.068, -131.068, 131.068]


def test_hypotheses_are_those_of_the_filter():
    assert (None, *HYPOTHESES) == CARRIER_HYPOTHESES


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 40))
#: any bits but infinities, which are refused long before
ANY = arrays("<u4", SHAPES).map(lambda bits: np.where(np.isinf(bits.view("<f4")), np.float32(-0.0), bits.view("<f4")))


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=ANY)
def test_any_bits_come_back(power_dbm):
    rows = stored_arrays(power_dbm, [None] * len(power_dbm), None)
    powers = [powers for powers, _, _ in rows]
    assert {len(each) for each in powers} == {4 * power_dbm.shape[1]}
    np.testing.assert_array_equal(powers_of(powers).view("<u4"), canonical(power_dbm).view("<u4"))


@settings(max_examples=examples(200), deadline=None)
@given(masks=arrays(np.int32, SHAPES, elements=st.one_of(st.just(0), st.integers(-(1 << 31), (1 << 31) - 1))))
def test_flags_come_back_and_take_no_bytes_where_none_is_set(masks):
    for (_, flags, _), row in zip(stored_arrays(np.zeros(masks.shape), [*masks], None), masks, strict=True):
        assert masks_of(flags, len(row)).tolist() == row.tolist()
        assert bool(flags) == bool(row.any())


@pytest.mark.parametrize("kinds", [(), (0,), (3,), (0, 2), (1, 3), (0, 1, 2, 3)])
def test_figures_come_back_and_a_row_that_states_none_has_none(kinds):
    sent = np.full((3, len(DETAIL_NAMES), 5), np.nan, dtype=np.float32)
    for kind in kinds:
        sent[[0, 2], kind] = kind + np.arange(10, dtype=np.float32).reshape(2, 5) / 7
    figures = [figures for _, _, figures in stored_arrays(np.zeros((3, 5)), [None] * 3, sent)]
    assert [each is not None for each in figures] == [bool(kinds), False, bool(kinds)]
    np.testing.assert_array_equal(details_of(figures, 5), sent)
