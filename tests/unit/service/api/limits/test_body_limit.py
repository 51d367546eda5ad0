"""The body limit as a layer of its own: bytes counted as they come."""

import gzip
from random import Random

import pytest

from service.api.limits.body_limit import BodyLimit
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
