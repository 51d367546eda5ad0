"""Bodies: what holds too much is refused before it is decoded, and large ones are decoded one at a time."""

import asyncio
import threading
import time
from types import SimpleNamespace

import pytest
from pydantic import BaseModel, TypeAdapter

from service.api.problems.problems import RequestProblemError
from service.api.protocol import bodies
from service.api.protocol.bodies import MOST_VALUES, decode, read_body
from service.api.schemas.inputs import ReferenceBatchDocument
from service.api.schemas.measurements import MeasurementBatchDocument

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

    monkeypatch.setattr(bodies, "decode", slow_decode)
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
