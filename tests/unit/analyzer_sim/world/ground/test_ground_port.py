"""Gate and ground port over real sockets on a free port."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from ground_story import ground_lines

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.world.ground.ground import chunks_of
from analyzer_sim.world.ground.ground_port import MAX_LINE_BYTES, Gate, serve_ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

pytestmark = pytest.mark.anyio
PROCEED = b'{"kind":"proceed"}\n'


@cache
def world() -> World:
    return World(replace(scenario_named("nominal"), quiet_h=2.5, operation_h=1.5), 1)


class Client:
    """A ground client that reads line by line."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def line(self) -> dict[str, Any]:
        return json.loads(await asyncio.wait_for(self.reader.readline(), 120.0))

    async def until(self, *kinds: str) -> list[dict[str, Any]]:
        """Read up to and including the first line of these kinds."""
        lines = [await self.line()]
        while lines[-1]["kind"] not in kinds:
            lines.append(await self.line())
        return lines

    async def send(self, data: bytes = PROCEED) -> None:
        self.writer.write(data)
        await self.writer.drain()

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


@asynccontextmanager
async def connected(port: int) -> AsyncIterator[Client]:
    client = Client(*await asyncio.open_connection("127.0.0.1", port, limit=1 << 22))
    try:
        yield client
    finally:
        await client.close()


@asynccontextmanager
async def served(*, await_ground: bool = True) -> AsyncIterator[tuple[int, Gate]]:
    """Serve the port; give its number and its gate."""
    gate = Gate()
    server = await serve_ground(world(), gate, port=0, await_ground=await_ground)
    async with server:
        yield server.sockets[0].getsockname()[1], gate
        await noticed()


async def noticed() -> None:
    """Let the handlers notice that their clients left: so many turns of the loop, however long they take."""
    for _ in range(20):
        await asyncio.sleep(0.002)


async def settled(condition: Callable[[], bool]) -> None:
    """Wait until the server has done what it was asked to."""
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.001)


def test_an_open_gate_holds_nothing_back() -> None:
    asyncio.run(asyncio.wait_for(Gate().wait(10**18), 120.0))


async def test_a_closed_gate_opens_up_to_what_was_granted() -> None:
    gate = Gate(is_open=False)
    early, late = asyncio.create_task(gate.wait(100)), asyncio.create_task(gate.wait(101))
    await asyncio.sleep(0)
    assert not early.done()
    gate.grant_until(100)
    await asyncio.wait_for(early, 120.0)
    gate.grant_until(50)  # a grant never shrinks
    assert gate.is_granted(100)
    assert not late.done()
    gate.open()
    await asyncio.wait_for(late, 120.0)


async def test_a_cancelled_wait_leaves_nothing_behind() -> None:
    gate = Gate(is_open=False)
    waiting = asyncio.create_task(gate.wait(1))
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert not gate._waiting


async def test_the_port_says_all_the_ground_knows_and_ends() -> None:
    async with served() as (port, gate):
        heard: list[dict[str, Any]] = []
        async with connected(port) as client:
            for first, last, phase in chunks_of(world()):
                lines = await client.until("hold")
                assert lines[-1]["phase"] == phase
                until_us = epoch_us_from_text(lines[-1]["until"])
                assert until_us == world().rows.epochs_us[last]
                assert not gate.is_granted(int(world().rows.epochs_us[first]))  # not before the answer
                heard += lines[:-1]
                await client.send()
            assert (await client.line()) == {"kind": "end"}
        assert gate.is_granted(int(world().rows.epochs_us[-1]))
        assert heard == json.loads(json.dumps(list(ground_lines(world()))))


async def test_a_grant_reaches_exactly_to_the_last_row_of_the_chunk() -> None:
    async with served() as (port, gate), connected(port) as client:
        hold = (await client.until("hold"))[-1]
        await client.send()
        await client.until("hold")
        assert gate.granted_until_us == epoch_us_from_text(hold["until"])


async def test_a_client_that_returns_resumes_at_the_first_unconfirmed_chunk() -> None:
    async with served() as (port, _gate):
        async with connected(port) as client:
            await client.until("hold")
            await client.send()
            second = (await client.until("hold"))[-1]
        await noticed()
        async with connected(port) as client:
            lines = await client.until("hold")
            assert [line["kind"] for line in lines[:4]] == ["spacecraft", "carriers", "task", "ephemeris"]
            assert lines[-1] == second


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"proceed\n", "line.not_json"),
        (b"\xff\xfe\n", "line.not_json"),
        (b"[1]\n", "line.not_object"),
        (b'{"kind":"go"}\n', "kind.unknown"),
        (b" " * (2 * MAX_LINE_BYTES) + b"\n", "line.too_long"),
    ],
)
async def test_a_bad_line_is_answered_and_changes_nothing(data: bytes, code: str) -> None:
    async with served() as (port, gate), connected(port) as client:
        hold = (await client.until("hold"))[-1]
        await client.send(data)
        error = (await client.until("error"))[-1]
        assert error["code"] == code
        assert not gate.is_granted(epoch_us_from_text(hold["until"]))
        await client.send()
        await client.until("hold")
        assert gate.is_granted(epoch_us_from_text(hold["until"]))


async def test_a_second_client_is_turned_away() -> None:
    async with served() as (port, _gate), connected(port) as holder:
        await holder.until("hold")
        async with connected(port) as other:
            assert (await other.line())["code"] == "ground.taken"
        await holder.send()
        await holder.until("hold")


async def test_without_await_ground_the_gate_is_open_until_a_client_comes_and_after_it_left() -> None:
    async with served(await_ground=False) as (port, gate):
        assert gate.is_granted(10**18)
        async with connected(port) as client:
            await client.until("hold")
            assert not gate.is_granted(10**18)
        await settled(lambda: gate.is_granted(10**18))


async def test_with_await_ground_the_gate_stays_closed_when_the_client_leaves() -> None:
    async with served() as (port, gate):
        async with connected(port) as client:
            await client.until("hold")
        await noticed()
        assert not gate.is_granted(int(world().rows.epochs_us[0]))


def test_stopping_the_simulator_with_a_client_connected_is_silent(caplog: pytest.LogCaptureFixture) -> None:
    with socket.socket() as raw:

        async def reported() -> None:
            gate = Gate()
            server = await serve_ground(world(), gate, port=0)
            raw.connect(server.sockets[0].getsockname())
            await settled(lambda: not gate.is_granted(10**18))
            # as the simulator does: since Python 3.12 the server's own end would wait for the client
            server.close()

        asyncio.run(reported())
    assert not caplog.records
