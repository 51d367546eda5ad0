"""Limits: bytes of bodies, open connections, rates, and the names of the server's protocol that they rest on."""

import gzip
import inspect
import logging
import tomllib
from pathlib import Path
from random import Random

import pytest
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from service.api.limits.http_protocol import SPARE_PLACES, Connections
from service.api.limits.rate_limits import MAX_ADDRESSES, BodyLimit, RateClass, RateLimitConfig, RateLimits, network_of
from service.api.problems.problems import RequestProblemError

pytestmark = pytest.mark.anyio


async def passed(body: bytes, chunk: int, limit: int, *headers: tuple[bytes, bytes]) -> tuple[bytes, int, list]:
    """Send a body in pieces through the layer; return what the inside read, the pieces taken, and its headers."""
    chunks = [body[k : k + chunk] for k in range(0, len(body), chunk)] or [b""]
    taken = 0
    seen: list = []

    async def receive():
        nonlocal taken
        taken += 1
        return {"type": "http.request", "body": chunks[taken - 1], "more_body": taken < len(chunks)}

    async def inside(scope, receive, send):
        seen.extend(scope["headers"])
        read, more = b"", True
        while more:
            message = await receive()
            read, more = read + message["body"], message["more_body"]
        scope["read"] = read

    async def send(message):
        raise AssertionError("the layer itself must not answer here")

    scope = {"type": "http", "headers": list(headers), "method": "POST", "path": "/"}
    try:
        await BodyLimit(inside, limit)(scope, receive, send)
    except RequestProblemError as problem:
        return problem.code.encode(), taken, seen
    return scope["read"], taken, seen


async def test_a_body_of_exactly_the_limit_passes():
    assert (await passed(b"x" * 100, 7, 100))[0] == b"x" * 100


async def test_one_byte_more_is_refused_as_soon_as_it_comes():
    code, taken, _ = await passed(b"x" * 1000, 10, 100)
    assert (code, taken) == (b"body.too_large", 11)


@pytest.mark.parametrize("chunk", [1, 3, 1000])
async def test_packed_bodies_reach_the_inside_plain_without_their_headers(chunk):
    body = bytes(range(256)) * 3
    packed = gzip.compress(body[:300]) + gzip.compress(body[300:])
    headers = [(b"content-encoding", b"gzip"), (b"content-length", str(len(packed)).encode()), (b"x", b"y")]
    read, _, seen = await passed(packed, chunk, len(packed) + len(body), *headers)
    assert read == body
    assert seen == [(b"x", b"y")]


async def test_a_bomb_is_stopped_within_one_piece_of_the_limit():
    packed = gzip.compress(b"\0" * 10_000_000)
    code, taken, _ = await passed(packed, 100, 10_000, (b"content-encoding", b"gzip"))
    # a piece of 100 bytes unpacks to at most a hundred thousand: the limit falls in the first
    assert (code, taken) == (b"body.too_large", 1)


@pytest.mark.parametrize("chunk", [7, 1000, 10_000_000])
async def test_what_unpacks_too_far_is_stopped_long_before_the_limit(chunk):
    packed = gzip.compress(b"0," * 4_000_000)
    assert len(packed) < 9000
    code, taken, _ = await passed(packed, chunk, 8_000_000, (b"content-encoding", b"gzip"))
    assert code == b"body.gzip_ratio"
    # each byte unpacks to a thousand: 256 KiB are reached within 300 of them
    assert (taken - 1) * chunk < 500


@pytest.mark.parametrize("chunk", [1, 13, 997, 100_000])
async def test_bodies_of_any_size_come_whole(chunk):
    random = Random(chunk)
    for size in (65_535, 65_536, 65_537, 131_072, 131_073, *(random.randrange(200_000) for _ in range(5))):
        body = b"".join(random.choice((b"-85.1,", b" " * 300, b"0")) for _ in range(size))[:size]
        packed = gzip.compress(body)
        assert (await passed(packed, chunk, 1_000_000, (b"content-encoding", b"gzip")))[0] == body


async def test_small_bodies_pack_as_far_as_they_like():
    body = b" " * 256 * 1024
    assert (await passed(gzip.compress(body), 100, 1_000_000, (b"content-encoding", b"gzip")))[0] == body


async def test_unpacked_size_is_exact():
    packed = gzip.compress(b"x" * 5000)
    assert (await passed(packed, 9, 5000, (b"content-encoding", b"gzip")))[0] == b"x" * 5000
    assert (await passed(packed, 9, 4999, (b"content-encoding", b"gzip")))[0] == b"body.too_large"


async def test_what_is_not_http_passes_untouched():
    async def inside(scope, receive, send):
        scope["seen"] = receive

    scope = {"type": "lifespan"}
    await BodyLimit(inside, 1)(scope, "channel", None)
    assert scope["seen"] == "channel"


@pytest.fixture
def clock():
    """A clock that a test sets."""
    return [0.0]


def test_an_address_has_so_many_and_gets_room_back(clock):
    connections = Connections(20, 2, "", lambda: clock[0])
    places = [(connections.admit("192.0.2.1") is None, connections.is_spare("192.0.2.1")) for _ in range(11)]
    assert places == [(True, False)] * 2 + [(True, True)] * SPARE_PLACES + [(False, True)]
    assert connections.admit("192.0.2.2") is None
    assert not connections.is_spare("192.0.2.2")
    for _ in range(SPARE_PLACES + 1):
        connections.leave("192.0.2.1")
    assert connections.admit("192.0.2.1") is None
    assert not connections.is_spare("192.0.2.1")
    assert (connections.count, connections.refused) == (3, {"address": 1})


def test_addresses_of_one_ipv6_network_are_one(clock):
    connections = Connections(20, 1, "", lambda: clock[0])
    assert [connections.admit(f"2001:db8:1:2::{k}") for k in range(1 + SPARE_PLACES)] == [None] * (1 + SPARE_PLACES)
    assert "SOO_MAX_CONNECTIONS_PER_ADDRESS" in connections.admit("2001:db8:1:2::2")
    assert connections.admit("2001:db8:1:3::1") is None


def test_trusted_proxies_have_the_limit_of_all_alone(clock):
    connections = Connections(4, 1, "10.0.0.0/8, 192.0.2.9", lambda: clock[0])
    assert [connections.admit(address) for address in ("10.1.2.3", "10.1.2.3", "192.0.2.9", "192.0.2.9")] == [None] * 4
    assert "SOO_MAX_CONNECTIONS)" in connections.admit("10.1.2.3")
    assert connections.refused == {"total": 1}
    # the address of a local socket is none
    connections.leave("10.1.2.3")
    assert connections.admit("") is None


def test_refusals_are_logged_every_ten_seconds_with_their_number(clock, caplog):
    connections = Connections(20, 1, "", lambda: clock[0])
    for _ in range(1 + SPARE_PLACES):
        connections.admit("192.0.2.1")
    with caplog.at_level(logging.WARNING):
        for second in range(25):
            clock[0] = float(second)
            connections.admit("192.0.2.1")
    texts = [record.getMessage() for record in caplog.records]
    assert [text.partition(";")[0] for text in texts] == [
        "connections refused or closed: 1",
        "connections refused or closed: 10",
        "connections refused or closed: 10",
    ]
    assert all("192.0.2.1" in text for text in texts)


class Time:
    """A time that a test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def time():
    return Time()


def limits(time, **config):
    return RateLimits(RateLimitConfig(**config), time)


def test_a_burst_passes_and_then_the_rate(time):
    found = limits(time, read_per_s=2.0, read_burst=3)
    took = [found.consume("k", RateClass.READ) for _ in range(4)]
    assert [each.is_allowed for each in took] == [True, True, True, False]
    assert [each.remaining for each in took] == [2, 1, 0, 0]
    assert [each.reset_s for each in took] == [1, 1, 2, 1]
    time.now_s += 0.5
    assert found.consume("k", RateClass.READ).is_allowed
    assert not found.consume("k", RateClass.READ).is_allowed
    time.now_s += 1000.0
    assert [found.consume("k", RateClass.READ).is_allowed for _ in range(4)] == [True, True, True, False]


def test_over_a_long_time_the_rate_is_kept(time):
    found = limits(time, control_per_s=5.0, control_burst=10)
    passed = 0
    for _ in range(2000):
        passed += found.consume("k", RateClass.CONTROL).is_allowed
        time.now_s += 0.01
    assert 10 + 5.0 * 20 - 1 <= passed <= 10 + 5.0 * 20


def test_keys_and_classes_do_not_take_from_each_other(time):
    found = limits(time, read_per_s=1.0, read_burst=1)
    assert found.consume("a", RateClass.READ).is_allowed
    assert found.consume("b", RateClass.READ).is_allowed
    assert found.consume("a", RateClass.CONTROL).is_allowed
    assert not found.consume("a", RateClass.READ).is_allowed


def test_zero_is_no_limit(time):
    found = limits(time, ingest_per_s=0.0, anonymous_per_s=0.0)
    assert (found.consume("a", RateClass.INGEST), found.consume_anonymous("192.0.2.1")) == (None, None)


def test_addresses_are_counted_apart_and_forgotten_in_time(time):
    found = limits(time, anonymous_per_s=0.001, anonymous_burst=1)
    assert found.consume_anonymous("192.0.2.1").is_allowed
    assert not found.consume_anonymous("192.0.2.1").is_allowed
    assert found.consume_anonymous("192.0.2.2").is_allowed
    for k in range(MAX_ADDRESSES + 5):
        found.consume_anonymous(f"10.{k >> 16}.{k >> 8 & 255}.{k & 255}")
    assert len(found._addresses) == MAX_ADDRESSES
    assert found.consume_anonymous("192.0.2.1").is_allowed


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2"),
        ("2001:db8::1", "2001:db8:0:0"),
        ("::1", "0:0:0:0"),
        ("fe80::", "fe80:0:0:0"),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.1"),
        ("", ""),
        ("unix socket", "unix socket"),
    ],
)
def test_one_client_has_a_whole_network_of_addresses(address, network):
    assert network_of(address) == network


ROOT = Path(__file__).resolve().parents[4]
OVERRIDDEN = {
    "connection_made": ["transport"],
    "connection_lost": ["exc"],
    "data_received": ["data"],
    "on_message_begin": [],
    "on_url": ["url"],
    "on_header": ["name", "value"],
    "on_headers_complete": [],
    "on_message_complete": [],
    "send_400_response": ["msg"],
}


@pytest.mark.parametrize("name", list(OVERRIDDEN))
def test_a_method_that_is_overridden_is_there(name: str) -> None:
    assert list(inspect.signature(getattr(HttpToolsProtocol, name)).parameters)[1:] == OVERRIDDEN[name]


@pytest.mark.parametrize("name", ["client", "transport", "loop", "cycle", "server_state"])
def test_an_attribute_that_is_read_is_set(name: str) -> None:
    assert f"self.{name}" in inspect.getsource(HttpToolsProtocol.__init__)


def test_a_cycle_says_whether_its_answer_began() -> None:
    assert "self.response_started" in inspect.getsource(RequestResponseCycle.__init__)


def test_the_version_is_bounded() -> None:
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert any(each.startswith("uvicorn>=") and ",<" in each for each in wanted)
