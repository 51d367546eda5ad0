"""Records: natural keys, epochs, names of keys, sentences on what pydantic refused."""

import re
from dataclasses import FrozenInstanceError, replace
from typing import Annotated, Literal, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core.core_schema import ErrorType

from service.records.catalogue import Carrier, Method
from service.records.epoch import EARLIEST_EPOCH_US, format_epoch, parse_epoch
from service.records.field_faults import fault_sentence, faults_text
from service.records.inputs import (
    KIND_OF,
    KINDS,
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SourceSelection,
    SpacecraftChange,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import AppliedCommand, Axes, Status, TorqueCommand, row_without_attitude
from service.records.levels.measurement import QualityFlag, Sweep, SweepSettings
from service.records.operations.access import plain_name
from service.records.operations.work import Replay

ZERO = Axes(0.0, 0.0, 0.0)


def command(number):
    return TorqueCommand(
        1,
        number,
        1,
        "ground",
        ZERO,
        (),
        False,
        60.0,
        2,
        (),
        ZERO,
        ZERO,
        ZERO,
        (),
        True,
        (),
    )


@pytest.mark.parametrize(
    ("record", "key"),
    [
        (AttitudeReference("earth_sensor", 17, ZERO, ZERO), "earth_sensor/17"),
        (Correction(3, 9, ZERO), "3/9"),
        (TelemetryRecord(5), "5"),
        (WeatherReport("radar", "Kyiv", 5, 1.0), "radar/Kyiv/5"),
        (PolarizationRecord("p", 5, -15.0), "p/5"),
        (Operation(4, "other", 1, None, revision=2), "4/2"),
        (PlanChange(6), "6"),
        (EphemerisChange(7), "7"),
        (CalibrationActivation(1, 3), "3"),
        (AlignmentSet(8), "8"),
        (SourceSelection("sa-2", 2), "2"),
        (AppliedCommand(command(31)), "31"),
    ],
)
def test_inputs_know_their_natural_key(record, key):
    assert record.key == key
    assert KINDS[KIND_OF[type(record)]] is type(record)


def test_a_change_of_the_spacecraft_is_known_by_its_count(payload):
    assert SpacecraftChange(payload.spacecraft(), 12).key == "12"


@pytest.mark.parametrize(
    ("changes", "is_usable"),
    [
        ({}, True),
        ({"enabled": False}, False),
        ({"kind": "beacon"}, False),
        ({"kind": "pilot"}, True),
        ({"uplink_power_control": "auto"}, False),
    ],
)
def test_which_carriers_may_tell_the_attitude(changes, is_usable):
    assert replace(Carrier("c", "Ku", "t", 1.0, 1.0), **changes).is_usable_for_attitude == is_usable


def test_a_replay_is_a_version_of_its_own():
    assert Replay(12, 0, 1, None, None, 1, "journal", "job", 0).version == "replay-12"


def test_a_row_without_attitude_knows_nothing_and_allows_nothing():
    row = row_without_attitude(5, 6, 7, Method.PAPER, ("not_aligned",))
    assert np.isnan([*row.attitude_deg, *row.sigma_deg, row.common_db, row.residual_rms_db]).all()
    assert (row.status, row.control_allowed, row.control_allowed_axes) == (Status.INVALID, False, (False,) * 3)
    assert (row.rates_deg_s, row.calibration_id, row.alignment_id) == (None, None, None)


def test_every_quality_flag_is_a_bit_of_its_own():
    bits = [flag.value for flag in QualityFlag]
    assert len(set(bits)) == len(QualityFlag.__members__)
    assert all(bit & (bit - 1) == 0 for bit in bits)


@pytest.mark.parametrize(("points", "step_hz"), [(1001, 1000.0), (1, 1e6)])
def test_the_step_of_a_sweep(points, step_hz):
    settings = SweepSettings(1e9, 1.001e9, points, 1e3, 1.06e3, 100.0, 0.5, "RMS")
    assert settings.step_hz == step_hz
    assert Sweep("a", 1, settings, np.zeros(points)).settings.count == 1


def test_records_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        Correction(3, 9, ZERO).start_us = 4


NOVEMBER_US = 1_795_230_152_011_250


@pytest.mark.parametrize(
    ("text", "epoch_us"),
    [
        ("1970-01-01T00:00:00.000000Z", 0),
        ("2000-01-01T00:00:00.000000Z", EARLIEST_EPOCH_US),
        ("2026-11-21T03:02:32.011250Z", NOVEMBER_US),
        ("0999-01-01T00:00:00.000000Z", -30_641_760_000_000_000),
        ("9999-12-31T23:59:59.999999Z", 253_402_300_799_999_999),
    ],
)
def test_six_decimals_and_z_both_ways(text, epoch_us):
    assert parse_epoch(text) == epoch_us
    assert format_epoch(epoch_us) == text
    assert format_epoch(np.int64(epoch_us)) == text


@pytest.mark.parametrize(
    ("text", "same_as"),
    [
        ("2026-11-21t06:02:32.01125+03:00", "2026-11-21T03:02:32.011250Z"),
        ("2026-11-20T21:32:32.01125-05:30", "2026-11-21T03:02:32.011250Z"),
        ("2026-11-21T03:02:32z", "2026-11-21T03:02:32.000000Z"),
        ("2026-11-21T03:02:32.0112504Z", "2026-11-21T03:02:32.011250Z"),
        ("2026-11-21T03:02:32.999999500Z", "2026-11-21T03:02:33.000000Z"),
        ("2016-12-31T23:59:60.5Z", "2017-01-01T00:00:00.500000Z"),
        ("2017-01-01T05:29:60.25+05:30", "2017-01-01T00:00:00.250000Z"),
        ("2026-11-21T03:02:32.0123456789Z", "2026-11-21T03:02:32.012346Z"),
        ("2026-11-21T03:02:59.99999999999999999999Z", "2026-11-21T03:03:00.000000Z"),
        ("2026-11-21T03:02:32.01125050000000000001Z", "2026-11-21T03:02:32.011251Z"),
    ],
)
def test_other_spellings_of_an_instant(text, same_as):
    assert format_epoch(parse_epoch(text)) == same_as


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2026-11-21",
        "2026-11-21T03:02:32",
        "2026-11-21 03:02:32Z",
        "2026-11-21T03:02:32.Z",
        "2026-11-21T12:34:60Z",
        "2016-12-31T23:59:60+00:01",
        "2026-02-30T00:00:00Z",
        "2026-11-21T24:00:00Z",
        "2026-11-21T03:02:61Z",
        "2026-11-21T03:02:32+24:00",
        "2026-11-21T03:02:32-01:60",
        "٢٠٢٦-11-21T03:02:32Z",
        "0000-01-01T00:00:00Z",
        " 2026-11-21T03:02:32Z",
    ],
)
def test_what_is_no_instant_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        parse_epoch(text)


#: beginnings and words that are pydantic's
LIBRARY = re.compile(
    r"Input should|should have|should be|Value error|Field required|not permitted|valid \w+,|unable to"
)
#: what the sentences name; the value that was sent is not among it
CONTEXT = {
    "min_length": 1,
    "max_length": 2,
    "pattern": "a+",
    "expected": "'a' or 'b'",
    "expected_tags": "'a' or 'b'",
    "discriminator": "'kind'",
    "gt": 0,
    "ge": 0,
    "lt": 1,
    "le": 1,
    "multiple_of": 2,
    "error": "expected value at line 1 column 1",
}


class Document(BaseModel):
    """Document with one field of each form."""

    model_config = ConfigDict(extra="forbid")
    count: Annotated[int, Field(gt=0)]
    pair: Annotated[tuple[float, ...], Field(max_length=2)]
    name: Annotated[str, Field(pattern="^[a-z]+$", max_length=4)]
    word: Literal["a", "b"]


@pytest.mark.parametrize("kind", get_args(ErrorType))
def test_every_kind_has_a_sentence_of_our_own(kind: str) -> None:
    sentence = fault_sentence({"type": kind, "ctx": CONTEXT, "msg": "Input should be something"})
    assert sentence
    assert "{" not in sentence
    assert not LIBRARY.search(sentence), sentence


def test_sentences_say_what_a_field_must_be_and_not_what_was_sent() -> None:
    sent = {"count": -7777, "pair": [1, 2, 3], "name": "SECRET", "word": "c", "more": 1}
    with pytest.raises(ValidationError) as raised:
        Document.model_validate(sent)
    assert faults_text(raised.value.errors()) == (
        "count: must be greater than 0; pair: must have at most 2 entries; name: must have at most 4 characters; "
        "word: must be 'a' or 'b'; more: unknown field; check its spelling or leave it out"
    )


def test_a_sentence_of_our_own_validator_stays() -> None:
    assert fault_sentence({"type": "epoch.malformed", "msg": "not RFC 3339"}) == "not RFC 3339"
    assert fault_sentence({"type": "value_error", "ctx": {"error": ValueError("start is not before stop")}}) == (
        "start is not before stop"
    )


def test_a_fault_of_the_whole_document_names_it() -> None:
    with pytest.raises(ValidationError) as raised:
        Document.model_validate_json("[")
    assert faults_text(raised.value.errors(), "task").startswith("task: is not JSON: ")


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("  Olga  B. ", "Olga B."),
        ("Olga\u00a0B.", "Olga B."),
        ("\uff2flga", "Olga"),
        ("Ольга", "Ольга"),
        ("Zoe\u0308", "Zoë"),
        ("anonymous 2", "anonymous 2"),
    ],
)
def test_names_are_kept_in_one_form(given, kept):
    assert plain_name(given) == kept


@pytest.mark.parametrize(
    "name",
    [
        *(
            f"Ol{letter}ga"
            for letter in "\u200b\u200e\u2066\u00ad\ufeff\x07\n\u2028\u2029\u1680\u3164\u2800\ufe0f\U000e0041\ue000"
        ),
        *("bootstrap", " BootStrap ", "anonymous", "ＡＮＯＮＹＭＯＵＳ", "Service"),
        *("", "   ", "x" * 65, "\ufdfa" * 4),
    ],
)
def test_names_that_nobody_sees_or_that_others_have_are_refused(name):
    with pytest.raises(ValueError, match=r"cannot be seen|calls others so|1 to 64"):
        plain_name(name)


@given(st.text(max_size=20))
def test_a_name_that_is_kept_is_kept_again(text):
    try:
        name = plain_name(text)
    except ValueError:
        return
    assert plain_name(name) == name
