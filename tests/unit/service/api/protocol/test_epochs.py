"""Epochs at the border: the fast way and the careful way say the same."""

import random

import numpy as np
import pytest

from service.api.protocol.epochs import EpochTextError, parse_epochs
from service.records.epoch import format_epoch, parse_epoch


def test_exact_forms_read_as_one_by_one():
    seed = 20261121
    print("seed", seed)
    rng = random.Random(seed)
    # year 1 to year 9999
    texts = [format_epoch(rng.randrange(-62_135_596_800_000_000, 253_402_300_800_000_000)) for _ in range(2000)]
    assert parse_epochs(texts).epochs_us.tolist() == [parse_epoch(text) for text in texts]
    assert parse_epochs(texts).epochs_us.dtype == np.int64


def test_an_empty_sequence_has_no_epochs():
    assert parse_epochs([]).epochs_us.tolist() == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-11-21T03:02:32Z", "2026-11-21T03:02:32.000000Z"),
        ("2026-11-21t03:02:32.5z", "2026-11-21T03:02:32.500000Z"),
        ("2026-11-21T06:02:32.123456+03:00", "2026-11-21T03:02:32.123456Z"),
        ("2016-12-31T23:59:60.500000Z", "2017-01-01T00:00:00.500000Z"),
        ("2026-11-21T03:02:32.123456789Z", "2026-11-21T03:02:32.123457Z"),
    ],
)
def test_other_forms_among_exact_ones_are_understood(text, expected):
    exact = ["2026-11-21T03:02:32.011250Z"] * 20
    assert parse_epochs([*exact, text]).epochs_us.tolist() == [parse_epoch(exact[0])] * 20 + [parse_epoch(expected)]
    assert parse_epochs([text]).epochs_us.tolist() == [parse_epoch(expected)]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2026-11-21T03:02:32.011250",
        "2026-11-21 03:02:32.011250Z",
        "2026-11-21T03:02:32,011250Z",
        "2026-W47-6T03:02:32.011250Z",
        "2026-13-21T03:02:32.011250Z",
        "2026-02-29T03:02:32.011250Z",
        "2026-11-21T24:02:32.011250Z",
        "2026-11-21T03:60:32.011250Z",
        "2026-11-21T03:02:61.011250Z",
        "0000-11-21T03:02:32.011250Z",
        "-026-11-21T03:02:32.011250Z",
        "2026-11-21T03:02:32.01125\u0660Z",
        "2026-11-21T03:02:32.01125 Z",
        "2026-11-21T03:02:32.011250Z\x00",
        "2026-11-21T03:02:32.011250\x00",
        "NaT                        ",
    ],
)
@pytest.mark.parametrize("before", [2, 20])
def test_what_is_no_instant_is_named_by_its_place(text, before):
    with pytest.raises(EpochTextError) as caught:
        parse_epochs(["2026-11-21T03:02:32.011250Z"] * before + [text])
    assert caught.value.index == before
    assert caught.value.detail


def test_instants_of_a_leap_second_are_named_by_their_places():
    texts = ["2016-12-31T23:59:59.500000Z", "2016-12-31T23:59:60.500000Z", "2017-01-01T05:29:60+05:30"]
    assert parse_epochs(texts).leap_positions == (1, 2)
    assert parse_epochs(texts * 10).leap_positions[-1] == 29
    assert parse_epochs(texts[:1] * 30).leap_positions == ()
