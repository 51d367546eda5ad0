"""Documents come back equal, whatever floats they hold and whenever they were written."""

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from db.encoding.json_documents import decode, decode_all, decode_input, encode, encode_all, kind_of
from service.records.inputs import AttitudeReference, Operation, PlanChange
from service.records.journal import KINDS
from service.records.levels.attitude import Axes


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
    with pytest.raises(ValueError, match="plan_id"):
        decode(PlanChange, "{}")
