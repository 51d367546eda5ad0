"""Uplink port: torque schedules to the spacecraft of a served instrument and its reports, as JSON lines over TCP.

Out; fields in brackets are not always there:

    {"type":"start","scenario":..,"seed":..,"uplink":..,"onboard":..,"operation_start":..,"fed_forward_torque":{..}}
    {"type":"taken","counter":..,"sent":..}      the line was handed to the channel; counter null = nothing to send
    {"type":"report","counter":..,"state":"executed|repeated|late|refused","told":..,"received":..,
     ["executed_from":..,"executed_until":..,"impulse_n_m_s":{..}]}
    {"type":"flown","epoch":..}                  the spacecraft has come to this row; its reports precede this line
    {"type":"error","detail":..}                 the line was refused and changes nothing

In, at any time once the first row of operation has been measured; it leaves at the epoch of the newest row:

    {"schedule":[{"start":..,"duration_s":..,"roll_n_m":..,"pitch_n_m":..,"yaw_n_m":..},..],["counter":..]}

Of a command that was lost there is no report. One client holds the port at a time; reports that nobody has heard are
told to the next one. A client that does not read is dropped.
"""

import asyncio
import json
from collections import deque
from contextlib import suppress
from typing import Any

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.plant_lines import fed_forward_line
from analyzer_sim.plant.schedule_lines import MAX_LINE_CHARACTERS, ScheduleError

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
