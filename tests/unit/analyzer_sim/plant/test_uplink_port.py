"""Uplink port over real sockets: schedules in, reports out, and nothing that a client does can break it."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant import uplink_port
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.plant import PlantOptions
from analyzer_sim.plant.plant_lines import fed_forward_line
from analyzer_sim.plant.schedule_lines import MAX_LINE_CHARACTERS
from analyzer_sim.plant.uplink_port import UplinkPort
from analyzer_sim.world.ground.ground_port import Gate, serve_ground
from analyzer_sim.world.scenario.scenario import scenario_named

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

    async def send(self, data: bytes) -> None:
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
async def served(*, rows: int = 1) -> AsyncIterator[tuple[int, FlownWorld]]:
    """Serve the port of a spacecraft that has flown some rows; give its number and the spacecraft."""
    subject = FlownWorld(STORY, SEED, PlantOptions())
    while rows and subject.epoch_us is None:
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


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe\x00",
        b"[" * 5000,
        b'{"schedule":[{"start":1}]}',
        b'{"schedule":[],"counter":-1}',
        b'{"schedule":[],"counter":1e999}',
        b'{"kind":"proceed"}',
    ],
)
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


async def test_before_operation_nothing_is_taken() -> None:
    async with served(rows=0) as (port, _spacecraft), connected(port) as client:
        await client.line()
        assert "under its sensors" in (await client.ask(b'{"schedule":[]}'))["detail"]


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
    monkeypatch.setattr(uplink_port, "MAX_WAITING_BYTES", 0)

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
                await client.send(PROCEED)
                held = await client.until("hold")
            assert {line["kind"] for line in held} == {"phase", "hold"}, "nobody knows what will be flown"
            while subject.world.next_epoch_us < STORY.operation_start_us:
                subject.advance()
            await client.send(PROCEED)
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
                    await client.send(PROCEED)
                await client.send(PROCEED)
                await gate.wait(STORY.operation_start_us)
            await noticed(turns=250)  # it looks after its client five times a second
            while subject.epoch_us is None:
                subject.advance()
            async with connected(port) as client:
                lines = await client.until("hold")
                assert [line["kind"] for line in lines][-3:] == ["telemetry", "truth", "hold"]
                assert "error" not in {line["kind"] for line in lines}

    asyncio.run(reported())
