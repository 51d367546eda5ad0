"""Ports of the plant: schedules to the spacecraft, changes of its world."""

import asyncio
import json
from collections import deque
from contextlib import suppress
from typing import Any

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.flown_world import MAX_LINE_BYTES, ChangeError, FlownWorld
from analyzer_sim.plant.plant import MAX_LINE_CHARACTERS, ScheduleError
from analyzer_sim.plant.plant_lines import fed_forward_line


async def serve_changes(flown: FlownWorld, host: str, port: int) -> asyncio.Server:
    """Open the port; 0 takes a free one.

    Raises
    ------
    OSError
        It is taken.
    """

    async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # the loop cancels connections when the simulator stops; asyncio's own callback would report that as an error
        with suppress(asyncio.CancelledError, ConnectionError):
            try:
                while line := await reader.readline():
                    await _send(writer, _answer(flown, line))
            except ValueError:
                await _send(writer, {"type": "error", "detail": f"a line holds at most {MAX_LINE_BYTES} bytes"})
            writer.close()

    return await asyncio.start_server(on_connection, host, port, limit=MAX_LINE_BYTES)


def _answer(flown: FlownWorld, line: bytes) -> dict[str, Any]:
    """Change the world and return the answer."""
    try:
        change = flown.change(line.decode("utf-8", errors="replace"))
    except ChangeError as error:
        return {"type": "error", "detail": str(error)}
    span = {"from": rfc3339(change.start_us), "until": rfc3339(change.stop_us)}
    return {"type": "changed", "change": change.kind.value, "carrier": change.carrier or None, **span}


async def _send(writer: asyncio.StreamWriter, message: dict[str, Any]) -> None:
    writer.write(json.dumps(message).encode() + b"\n")
    await writer.drain()


Line = dict[str, Any]

#: what waits for a client that does not read, bytes; reports kept for a client that is to come
MAX_WAITING_BYTES = 1_000_000
MAX_WAITING_REPORTS = 10_000


class UplinkPort:
    """The port and its one client.

    Parameters
    ----------
    flown : FlownWorld
        Spacecraft behind the port.
    """

    def __init__(self, flown: FlownWorld) -> None:
        self._spacecraft = flown
        self._client: asyncio.StreamWriter | None = None
        self._unheard: deque[Line] = deque(maxlen=MAX_WAITING_REPORTS)
        flown.listen(self._on_flown)

    async def serve(self, host: str, port: int) -> asyncio.Server:
        """Open the port; 0 takes a free one.

        Raises
        ------
        OSError
            It is taken.
        """
        return await asyncio.start_server(self._on_connection, host, port, limit=MAX_LINE_CHARACTERS)

    async def _on_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # the loop cancels connections when the simulator stops; asyncio's own callback would report that as an error
        with suppress(asyncio.CancelledError, ConnectionError):
            if self._client is None:
                await self._converse(reader, writer)
            else:
                writer.write(_text({"type": "error", "detail": "another client holds the uplink"}))
                writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve the client that holds the port."""
        self._client = writer
        try:
            self._report(self._opening())
            while self._unheard:
                self._report(self._unheard.popleft())
            while (line := await _read_line(reader)) is not None:
                self._report(self._answer(line))
                await writer.drain()
        finally:
            self._client = None
            writer.close()

    def _opening(self) -> Line:
        options, scenario = self._spacecraft.options, self._spacecraft.world.scenario
        return {
            "type": "start",
            "scenario": scenario.name,
            "seed": self._spacecraft.world.seed,
            "uplink": options.uplink,
            "onboard": options.onboard,
            "operation_start": rfc3339(scenario.operation_start_us),
            "fed_forward_torque": fed_forward_line(self._spacecraft.world),
        }

    def _answer(self, line: bytes) -> Line:
        """Hand a line to the spacecraft and return the answer."""
        try:
            # bytes that are no text must reach the parser of lines, which answers them
            counter = self._spacecraft.send(line.decode("utf-8", errors="replace"))
        except ScheduleError as error:
            return {"type": "error", "detail": str(error)}
        epoch_us = self._spacecraft.epoch_us
        return {"type": "taken", "counter": counter, "sent": None if epoch_us is None else rfc3339(epoch_us)}

    def _on_flown(self, epoch_us: int, reports: list[Line]) -> None:
        """Tell what the spacecraft has told on the way to a row."""
        if self._client is None:
            self._unheard.extend(reports)
            return
        for line in (*reports, {"type": "flown", "epoch": rfc3339(epoch_us)}):
            self._report(line)

    def _report(self, line: Line) -> None:
        if self._client is None:
            return
        self._client.write(_text(line))
        if self._client.transport.get_write_buffer_size() > MAX_WAITING_BYTES:
            self._client.transport.abort()


def _text(line: Line) -> bytes:
    return json.dumps(line, allow_nan=False, separators=(",", ":")).encode() + b"\n"


async def _read_line(reader: asyncio.StreamReader) -> bytes | None:
    """Return the next line, the beginning of one that is too long, None at the end."""
    try:
        return await reader.readuntil(b"\n")
    except asyncio.IncompleteReadError:
        return None
    except asyncio.LimitOverrunError:
        await _skip_line(reader)
        return b"x" * (MAX_LINE_CHARACTERS + 1)


async def _skip_line(reader: asyncio.StreamReader) -> None:
    """Read the rest of a line that is too long."""
    while True:
        try:
            await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return
        except asyncio.LimitOverrunError as overrun:
            await reader.readexactly(overrun.consumed)
        else:
            return
