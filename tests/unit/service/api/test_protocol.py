"""Bodies, byte ranges, epochs, merge patches and cursors as the interface reads them; faults in our words."""

import asyncio
import base64
import random
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import BaseModel, TypeAdapter

from service.api.problems.problems import MAX_FAULTS, RequestProblemError, faults_of, pointer_of
from service.api.protocol import requests
from service.api.protocol.paging import (
    EVERYTHING,
    EpochTextError,
    decode_cursor,
    encode_cursor,
    parse_epochs,
    window_of,
)
from service.api.protocol.requests import MOST_VALUES, UnsatisfiableRangeError, decode, merge, read_body, wanted_range
from service.api.schemas.inputs import ReferenceBatchDocument
from service.api.schemas.measurements import MeasurementBatchDocument
from service.records.calibration import Window
from service.records.epoch import format_epoch, parse_epoch

pytestmark = pytest.mark.anyio


ROW = b'{"epoch":"2026-11-21T03:00:00Z","power_dbm":[%b]}'
REFERENCES = b'{"source":"star_tracker","references":[%b{}]}'
BATCH = b'{"plan_id":1,"measurements":[%b]}'


class Anything(BaseModel):
    """A document that takes what comes."""

    x: list[int]


@pytest.mark.parametrize("chunk", [b"0,", b"[],", b'"",', b"{},"], ids=["numbers", "lists", "texts", "objects"])
def test_more_values_than_are_decoded_are_refused_unseen(chunk):
    raw = b'{"x":[' + chunk * (MOST_VALUES + 1) + b"0]}"
    with pytest.raises(RequestProblemError) as caught:
        decode(None, raw)
    assert (caught.value.status, caught.value.code) == (413, "body.too_many_values")


def test_as_many_values_as_are_decoded_pass():
    raw = b'{"x":[' + b"0," * (MOST_VALUES - 3) + b"0]}"
    assert len(decode(TypeAdapter(Anything), raw).x) == MOST_VALUES - 2


@pytest.mark.parametrize(
    ("model", "raw"),
    [
        (MeasurementBatchDocument, BATCH % (ROW % (b"0," * 4096 + b"0"))),
        (MeasurementBatchDocument, BATCH % (b",".join([ROW % b"0"] * 100_001))),
        (
            ReferenceBatchDocument,
            b'{"source":"star_tracker","references":[' + b'{"epoch":"2026-11-21T03:00:00Z"},' * 100_001 + b"{}]}",
        ),
    ],
    ids=["a row", "rows", "references"],
)
def test_lists_beyond_their_length_end_the_decoding(model, raw):
    with pytest.raises(RequestProblemError) as caught:
        decode(TypeAdapter(model), raw)
    assert (caught.value.status, caught.value.code) == (422, "value.length")
    assert len(caught.value.fields) == 1


async def test_large_bodies_are_decoded_one_at_a_time_and_beside_the_loop(monkeypatch):
    running, most, threads = 0, 0, set()

    def slow_decode(_adapter, raw):
        nonlocal running, most
        running += 1
        most = max(most, running)
        threads.add(threading.current_thread())
        time.sleep(0.05)
        running -= 1
        return len(raw)

    monkeypatch.setattr(requests, "decode", slow_decode)
    app = SimpleNamespace(state=SimpleNamespace(large_body=asyncio.Lock()))

    def request_of(raw):
        async def body():
            return raw

        return SimpleNamespace(headers={}, body=body, app=app, scope={"state": {}})

    large = [read_body(request_of(b" " * 300_000), None) for _ in range(5)]
    assert await asyncio.gather(*large) == [300_000] * 5
    assert (most, threading.main_thread() in threads) == (1, False)
    assert await read_body(request_of(b"{}"), None) == 2
    assert threading.main_thread() in threads


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


@pytest.mark.parametrize(
    ("target", "patch", "result"),
    [
        ({"a": "b"}, {"a": "c"}, {"a": "c"}),
        ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
        ({"a": "b"}, {"a": None}, {}),
        ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
        ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
        ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
        ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
        ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
        (["a", "b"], ["c", "d"], ["c", "d"]),
        ({"a": "b"}, ["c"], ["c"]),
        ({"a": "foo"}, None, None),
        ({"a": "foo"}, "bar", "bar"),
        ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
        ([1, 2], {"a": "b", "c": None}, {"a": "b"}),
        ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
    ],
)
def test_examples_of_the_standard(target, patch, result):
    before = repr(target)
    assert merge(target, patch) == result
    assert repr(target) == before, "the target must stay as it is"


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


def fault(kind: str, *loc: str | int) -> dict:
    return {"type": kind, "loc": loc, "msg": "so"}


def test_pointers_escape_what_rfc_6901_asks_for():
    assert pointer_of(("a/b", "m~n", 0, "")) == "/a~1b/m~0n/0/"
    assert pointer_of(()) == ""


def test_codes_fold_into_stable_ones_and_ours_pass():
    kinds = ["missing", "extra_forbidden", "finite_number", "string_type", "less_than", "wheels.quantum"]
    assert [f.code for f in faults_of([fault(kind, "x") for kind in kinds])] == [
        "field.missing",
        "field.unknown",
        "value.not_finite",
        "value.type",
        "value.range",
        "wheels.quantum",
    ]


def test_a_sequence_is_not_called_short_because_its_elements_failed():
    assert [f.pointer for f in faults_of([fault("string_type", "rows", 0), fault("too_short", "rows")])] == ["/rows/0"]
    assert [f.pointer for f in faults_of([fault("too_short", "rows"), fault("missing", "row")])] == ["/rows", "/row"]


def test_an_answer_names_a_bounded_number_of_faults():
    assert len(faults_of([fault("missing", k) for k in range(1000)])) == MAX_FAULTS
