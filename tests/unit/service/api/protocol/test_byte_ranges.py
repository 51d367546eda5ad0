"""Byte ranges of RFC 9110."""

import pytest

from service.api.protocol.byte_ranges import UnsatisfiableRangeError, wanted_range


@pytest.mark.parametrize(
    ("header", "wanted"),
    [
        (None, None),
        ("", None),
        ("bytes=0-0", (0, 0)),
        ("bytes=0-999", (0, 99)),
        ("Bytes = 5-", (5, 99)),
        ("bytes=-200", (0, 99)),
        ("bytes=99-99", (99, 99)),
        ("bytes=-", None),
        ("bytes=5-4", None),
        ("bytes=1-2,4-5", None),
        ("bytes=a-b", None),
        ("rows=1-2", None),
        ("bytes=\u0661-", None),
        ("bytes=" + "9" * 30 + "-", None),
    ],
)
def test_readable_ranges_are_given_and_others_mean_the_whole(header, wanted):
    assert wanted_range(header, 100) == wanted


@pytest.mark.parametrize(("header", "size"), [("bytes=100-", 100), ("bytes=-0", 100), ("bytes=0-", 0), ("bytes=-5", 0)])
def test_ranges_without_a_byte_are_refused(header, size):
    with pytest.raises(UnsatisfiableRangeError):
        wanted_range(header, size)
