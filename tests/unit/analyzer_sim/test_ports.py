"""Uplink and ground ports over real sockets: schedules and news, and nothing that a client does can break them."""

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

from analyzer_sim import serving
from analyzer_sim.epochs import epoch_us_from_text, rfc3339
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.plant import MAX_LINE_CHARACTERS, PlantOptions, fed_forward_line
from analyzer_sim.serving import UplinkPort
from analyzer_sim.world.ground.ground import chunks_of
from analyzer_sim.world.ground.ground_port import MAX_LINE_BYTES, Gate, serve_ground
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

pytestmark = pytest.mark.anyio


STORY = replace(scenario_named("nominal"), quiet_h=0.5, operation_h=0.2)
SEED = 1
PROCEED = b'{"kind":"proceed"}\n'


class Client:
    """A client that reads line by line."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def line(self) -> dict[str, Any]:
        return json.loads(await asyncio.wait_for(self.reader.readline(), 120.0))

    async def ask(self, data: bytes) -> dict[str, Any]:
        await self.send(data + b"\n")
        return await self.line()

    async def send(self, data: bytes = PROCEED) -> None:
        self.writer.write(data)
        await self.writer.drain()

    async def until(self, kind: str) -> list[dict[str, Any]]:
        """Read up to and including the first line of a kind."""
        lines = [await self.line()]
        while lines[-1]["kind"] != kind:
            lines.append(await self.line())
        return lines


@asynccontextmanager
async def connected(port: int) -> AsyncIterator[Client]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 22)
    try:
        yield Client(reader, writer)
    finally:
        writer.close()


@asynccontextmanager
async def served() -> AsyncIterator[tuple[int, FlownWorld]]:
    """Serve the port of a spacecraft that has flown a row; give its number and the spacecraft."""
    subject = FlownWorld(STORY, SEED, PlantOptions())
    while subject.epoch_us is None:
        subject.advance()
    server = await UplinkPort(subject).serve("127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1], subject
        await noticed()


async def noticed(turns: int = 20) -> None:
    """Let the handlers notice that their clients left: so many turns of the loop, however long they take."""
    for _ in range(turns):
        await asyncio.sleep(0.002)


def schedule(subject: FlownWorld, counter: int) -> bytes:
    assert subject.epoch_us is not None
    element = {
        "start": rfc3339(subject.epoch_us),
        "duration_s": 10.0,
        "roll_n_m": 0.0,
        "pitch_n_m": 0.01,
        "yaw_n_m": 0.0,
    }
    return json.dumps({"schedule": [element], "counter": counter}).encode()


async def test_a_schedule_is_taken_and_its_report_comes_before_the_row_that_was_flown() -> None:
    async with served() as (port, subject), connected(port) as client:
        opening = await client.line()
        assert opening == {
            "type": "start",
            "scenario": "nominal",
            "seed": SEED,
            "uplink": "ideal",
            "onboard": "wheels",
            "operation_start": rfc3339(STORY.operation_start_us),
            "fed_forward_torque": fed_forward_line(subject.world),
        }
        sent = rfc3339(subject.epoch_us)
        assert await client.ask(schedule(subject, 4)) == {"type": "taken", "counter": 4, "sent": sent}
        assert await client.ask(b'{"schedule":[]}') == {"type": "taken", "counter": None, "sent": sent}
        subject.advance()
        report, flown = await client.line(), await client.line()
        assert (report["type"], report["counter"], report["state"]) == ("report", 4, "executed")
        assert flown == {"type": "flown", "epoch": rfc3339(subject.epoch_us)}


@pytest.mark.parametrize("data", [b"", b"\xff\xfe\x00", b'{"schedule":[],"counter":-1}'])
async def test_garbage_is_answered_and_changes_nothing(data: bytes) -> None:
    async with served() as (port, subject), connected(port) as client:
        await client.line()
        answer = await client.ask(data)
        assert answer["type"] == "error"
        assert (await client.ask(schedule(subject, 1)))["type"] == "taken"


async def test_a_line_that_is_too_long_is_skipped_to_its_end() -> None:
    async with served() as (port, subject), connected(port) as client:
        await client.line()
        answer = await client.ask(b"x" * (2 * MAX_LINE_CHARACTERS + 7))
        assert "at most 1000000 characters" in answer["detail"]
        assert (await client.ask(schedule(subject, 1)))["type"] == "taken"


async def test_a_second_client_is_turned_away_and_the_first_goes_on() -> None:
    async with served() as (port, subject), connected(port) as first:
        await first.line()
        async with connected(port) as second:
            assert await second.line() == {"type": "error", "detail": "another client holds the uplink"}
            assert await second.reader.read() == b""
        assert (await first.ask(schedule(subject, 1)))["type"] == "taken"
        subject.advance()
        assert [(await first.line())["type"] for _ in range(2)] == ["report", "flown"]


async def test_what_was_told_while_nobody_was_there_is_told_to_the_next() -> None:
    async with served() as (port, subject):
        async with connected(port) as client:
            await client.line()
            await client.ask(schedule(subject, 9))
            await client.send(b'{"schedule":')  # half a line, then gone
        await noticed()
        subject.advance()
        async with connected(port) as client:
            opening, report = await client.line(), await client.line()
            assert (opening["type"], report["type"], report["counter"]) == ("start", "report", 9)
            subject.advance()
            assert (await client.line())["type"] == "flown"


async def test_a_client_that_does_not_read_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "MAX_WAITING_BYTES", 0)

    async with served() as (port, subject), connected(port) as deaf:
        await deaf.line()
        # more than the buffers of both systems take
        lines: list[dict[str, Any]] = [{"filler": "x" * 1_000_000} for _ in range(20)]
        subject._report(lines)
        await noticed()
        async with connected(port) as client:
            assert (await client.line())["type"] == "start"


def test_the_ground_port_tells_truth_and_telemetry_after_the_row() -> None:
    async def reported() -> None:
        subject, gate = FlownWorld(STORY, SEED, PlantOptions()), Gate()
        server = await serve_ground(subject.world, gate, await_ground=True, flight=subject)
        async with server, connected(server.sockets[0].getsockname()[1]) as client:
            held = await client.until("hold")
            while held[-1]["phase"] != "operation":
                assert "truth" in {line["kind"] for line in held}, "before operation it is known beforehand"
                await client.send()
                held = await client.until("hold")
            assert {line["kind"] for line in held} == {"phase", "hold"}, "nobody knows what will be flown"
            while subject.world.next_epoch_us < STORY.operation_start_us:
                subject.advance()
            await client.send()
            await gate.wait(STORY.operation_start_us)
            assert not gate.is_granted(STORY.operation_start_us + 1), "each row waits for the command of the one before"
            subject.advance()
            telemetry, truth, hold = await client.until("hold")
            assert telemetry["body"]["records"][0]["epoch"] == truth["rows"][0]["epoch"]
            assert hold["until"] == rfc3339(STORY.operation_start_us + 60_000_000)

    asyncio.run(reported())


def test_a_ground_client_that_leaves_while_a_row_is_due_hears_its_truth_later() -> None:
    async def reported() -> None:
        subject, gate = FlownWorld(STORY, SEED, PlantOptions()), Gate()
        server = await serve_ground(subject.world, gate, await_ground=True, flight=subject)
        port = server.sockets[0].getsockname()[1]
        async with server:
            async with connected(port) as client:
                while (await client.until("hold"))[-1]["phase"] != "operation":
                    await client.send()
                await client.send()
                await gate.wait(STORY.operation_start_us)
            await noticed(turns=250)  # it looks after its client five times a second
            while subject.epoch_us is None:
                subject.advance()
            async with connected(port) as client:
                lines = await client.until("hold")
                assert [line["kind"] for line in lines][-3:] == ["telemetry", "truth", "hold"]
                assert "error" not in {line["kind"] for line in lines}

    asyncio.run(reported())


@cache
def world() -> World:
    return World(replace(scenario_named("nominal"), quiet_h=2.5, operation_h=1.5), 1)


@asynccontextmanager
async def ground_served(*, await_ground: bool = True) -> AsyncIterator[tuple[int, Gate]]:
    """Serve the port; give its number and its gate."""
    gate = Gate()
    server = await serve_ground(world(), gate, port=0, await_ground=await_ground)
    async with server:
        yield server.sockets[0].getsockname()[1], gate
        await noticed()


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
    async with ground_served() as (port, gate):
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
    async with ground_served() as (port, gate), connected(port) as client:
        hold = (await client.until("hold"))[-1]
        await client.send()
        await client.until("hold")
        assert gate.granted_until_us == epoch_us_from_text(hold["until"])


async def test_a_client_that_returns_resumes_at_the_first_unconfirmed_chunk() -> None:
    async with ground_served() as (port, _gate):
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
    async with ground_served() as (port, gate), connected(port) as client:
        hold = (await client.until("hold"))[-1]
        await client.send(data)
        error = (await client.until("error"))[-1]
        assert error["code"] == code
        assert not gate.is_granted(epoch_us_from_text(hold["until"]))
        await client.send()
        await client.until("hold")
        assert gate.is_granted(epoch_us_from_text(hold["until"]))


async def test_a_second_client_is_turned_away() -> None:
    async with ground_served() as (port, _gate), connected(port) as holder:
        await holder.until("hold")
        async with connected(port) as other:
            assert (await other.line())["code"] == "ground.taken"
        await holder.send()
        await holder.until("hold")


async def test_without_await_ground_the_gate_is_open_until_a_client_comes_and_after_it_left() -> None:
    async with ground_served(await_ground=False) as (port, gate):
        assert gate.is_granted(10**18)
        async with connected(port) as client:
            await client.until("hold")
            assert not gate.is_granted(10**18)
        await settled(lambda: gate.is_granted(10**18))


async def test_with_await_ground_the_gate_stays_closed_when_the_client_leaves() -> None:
    async with ground_served() as (port, gate):
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
