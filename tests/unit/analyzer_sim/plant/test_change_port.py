"""Change port: each line has one answer, and a line that changes nothing does not end the conversation."""

import asyncio
import json
from types import SimpleNamespace

from analyzer_sim.plant.change_port import serve_changes
from analyzer_sim.plant.world_changes import MAX_LINE_BYTES, parse_change

CARRIERS = ("c00", "c01")
FLOWN = SimpleNamespace(change=lambda text: parse_change(text, 0, CARRIERS))


def answers(*lines: bytes) -> list[dict]:
    """Return what the port answers to some lines of one client."""

    async def converse() -> list[dict]:
        server = await serve_changes(FLOWN, "127.0.0.1", 0)
        async with server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
            writer.write(b"".join(lines))
            writer.write_eof()
            text = await reader.read()
            writer.close()
        return [json.loads(line) for line in text.splitlines()]

    return asyncio.run(converse())


def test_a_change_is_answered_with_its_span():
    (answer,) = answers(b'{"change":"step","duration_s":60}\n')
    assert answer["type"] == "changed"
    assert (answer["change"], answer["carrier"]) == ("step", "c00")
    assert (answer["from"], answer["until"]) == ("1970-01-01T00:00:00.000000Z", "1970-01-01T00:01:00.000000Z")


def test_a_line_that_is_none_is_answered_and_the_next_one_too():
    said = answers(b"\xff\n", b'{"change":"rain","duration_s":-1}\n', b'{"change":"rain","duration_s":1}\n')
    assert [answer["type"] for answer in said] == ["error", "error", "changed"]


def test_a_line_that_is_too_long_is_refused():
    (answer,) = answers(b"x" * (2 * MAX_LINE_BYTES) + b"\n")
    assert f"{MAX_LINE_BYTES} bytes" in answer["detail"]
