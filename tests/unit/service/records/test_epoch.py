"""Epochs: microseconds inside, RFC 3339 outside, and nothing read that is not an instant."""

import numpy as np
import pytest

from service.records.epoch import EARLIEST_EPOCH_US, format_epoch, parse_epoch

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
