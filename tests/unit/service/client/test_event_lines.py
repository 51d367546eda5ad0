"""Events from chunks of bytes: cut anywhere, whatever stands in texts; ids, silence and patience."""

import httpx
import pytest

from service.client.event_lines import SILENCE_S, Follower, StreamEvent
from service.client.problem import ServiceUnavailableError

BODY = (
    'retry: 2000\n\nid: a:1.0.0\nevent: status\ndata: {"name":"line\u2028separator \u0085"}\n\n: heartbeat\n\n'
    'id: a:2.0.0\r\nevent: measurement\r\ndata: {"n":\r\ndata: 2}\r\n\r\n'
).encode()
EVENTS = [
    StreamEvent("a:1.0.0", "status", {"name": "line\u2028separator \u0085"}),
    StreamEvent("a:2.0.0", "measurement", {"n": 2}),
]


@pytest.mark.parametrize("size", [1, 2, 3, 7, 50, 1000])
def test_chunks_may_be_cut_anywhere(size):
    follower = Follower()
    chunks = [BODY[position : position + size] for position in range(0, len(BODY), size)]
    assert [event for chunk in chunks for event in follower.consume(chunk)] == EVENTS
    assert follower.last_event_id == "a:2.0.0"


def test_what_was_cut_off_is_forgotten_with_its_connection():
    follower = Follower()
    assert list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\nid: a:9.9.9\nda")) != []
    assert follower.headers()["Last-Event-ID"] == "a:1.0.0"
    assert [event.id for event in follower.consume(b"id: a:2.0.0\nevent: status\ndata: {}\n\n")] == ["a:2.0.0"]


def test_an_id_alone_says_how_far_the_stream_has_got():
    follower = Follower()
    assert list(follower.consume(b"id: a:1.0.0\n\n: heartbeat\n\nid: a:5.0.0\n\n")) == []
    assert follower.headers()["Last-Event-ID"] == "a:5.0.0"


def test_without_an_id_none_is_sent():
    assert "Last-Event-ID" not in Follower().headers()
    assert Follower("a:1.0.0").headers()["Last-Event-ID"] == "a:1.0.0"
    assert Follower().timeout(httpx.Timeout(3.0)).read == SILENCE_S


def test_waits_grow_until_an_event_comes_and_follow_the_service():
    follower = Follower()
    fault = ServiceUnavailableError("gone")
    waits = [follower.wait_after(fault) for _ in range(12)]
    assert waits[0] <= 0.2
    assert waits[-1] <= 15.0
    assert waits[-1] > 5.0
    assert follower.wait_after(ServiceUnavailableError("busy", 503, 7.0)) == 7.0
    assert follower.wait_after(ServiceUnavailableError("busy", 503, 1e9)) == 60.0
    list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\n"))
    assert follower.wait_after(fault) <= 0.2


def test_patience_ends():
    now = [0.0]
    follower = Follower(patience_s=30.0, clock=lambda: now[0])
    fault = ServiceUnavailableError("gone")
    follower.wait_after(fault)
    now[0] = 29.0
    follower.wait_after(fault)
    list(follower.consume(b"id: a:1.0.0\nevent: status\ndata: {}\n\n"))
    now[0] = 100.0
    follower.wait_after(fault)
    now[0] = 131.0
    with pytest.raises(ServiceUnavailableError, match="gone"):
        follower.wait_after(fault)
