"""Cursors and intervals."""

import base64

import pytest

from service.api.problems.problems import RequestProblemError
from service.api.protocol.paging import EVERYTHING, decode_cursor, encode_cursor, window_of
from service.records.calibration import Window


@pytest.mark.parametrize("position", [(0, 0), (1, 2), (-(2**63), 2**63 - 1), (4_102_444_800_000_000, 10**12)])
def test_a_cursor_gives_its_place_back_and_fits_into_a_url(position):
    cursor = encode_cursor(position, 7)
    assert decode_cursor(cursor, 7) == position
    assert cursor.replace("-", "").replace("_", "").isalnum()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "A",
        "====",
        "abc",
        encode_cursor((1, 2)) + "=",
        encode_cursor((1, 2))[:-1],
        encode_cursor((1, 2)) + "AAAA",
        base64.urlsafe_b64encode(b"\x01" + bytes(20)).decode().rstrip("="),
        "\u0661" * 28,
        " " + encode_cursor((1, 2)),
        encode_cursor((1, 2))[:-1] + ("B" if encode_cursor((1, 2))[-1] != "B" else "C"),
    ],
)
def test_any_other_text_is_no_cursor(text):
    with pytest.raises(RequestProblemError) as caught:
        decode_cursor(text)
    assert (caught.value.status, caught.value.code) == (422, "cursor.invalid")


def test_a_cursor_of_another_query_is_refused():
    with pytest.raises(RequestProblemError) as caught:
        decode_cursor(encode_cursor((1, 2), 7), 8)
    assert (caught.value.status, caught.value.code) == (422, "cursor.invalid")
    assert "another query" in caught.value.detail


def test_defaults_hold_where_nothing_is_stated():
    assert window_of(None, None, EVERYTHING) == EVERYTHING
    assert window_of("1970-01-01T00:00:01Z", None, Window(0, 5_000_000)) == Window(1_000_000, 5_000_000)
    assert window_of(None, "1970-01-01T00:00:01Z", Window(0, 5_000_000)) == Window(0, 1_000_000)


@pytest.mark.parametrize(("start", "stop"), [("1970-01-01T00:00:05Z", None), (None, "1970-01-01T00:00:00Z")])
def test_an_interval_of_nothing_is_refused(start, stop):
    with pytest.raises(RequestProblemError) as caught:
        window_of(start, stop, Window(0, 5_000_000))
    assert caught.value.code == "range.invalid"
