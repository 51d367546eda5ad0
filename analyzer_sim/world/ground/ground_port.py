"""Ground port: what the ground knows, as JSON lines over TCP, in step with the sweeps.

On connection the simulator sends the catalogue lines; then, chunk of rows by chunk of rows, all lines that belong to
these rows and `{"kind":"hold","until":<epoch of the last row>,"phase":<name>}`. The client answers `{"kind":"proceed"}`
once it has forwarded them; only then may the world be swept up to that epoch. After the last row: `{"kind":"end"}`.
A client that comes back receives the catalogue and resumes at the first chunk it has not confirmed. A line that is not
understood is answered with `{"kind":"error",...}` and changes nothing. One client holds the port at a time.

Where a spacecraft is flown nobody knows its attitude beforehand: a chunk of operation ends with its only row that is
measured, and telemetry and truth of its rows follow once it has been swept.
"""

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

from analyzer_sim.epochs import rfc3339
from analyzer_sim.world.ground.ground import catalogue_lines, chunk_lines, chunks_of, flown_chunks_of, flown_lines
from analyzer_sim.world.world import World

#: longest line a client may send, bytes
MAX_LINE_BYTES = 65_536
#: larger than any epoch: nothing is held back
NO_LIMIT_US = 2**63 - 1
#: how often a client that waits for a row to be swept is looked after, s
_POLL_S = 0.2


class Flight(Protocol):
    """A spacecraft that is flown."""

    def listen(self, listener: Callable[[int, list[dict[str, Any]]], None]) -> None:
        """Let somebody hear the epoch of each row to which the spacecraft has flown."""

    def reported_after(self, first: int, last: int) -> Iterator[dict[str, Any]]:
        """Yield what the ground is told once the rows first..last have been flown."""


class Gate:
    """Permission to sweep rows up to an epoch.

    An open gate lets everything pass. A closed one lets pass what has been granted; a grant never shrinks.

    Parameters
    ----------
    is_open : bool
        Whether rows pass while nobody steers the gate.
    """

    def __init__(self, *, is_open: bool = True) -> None:
        self._is_open = is_open
        self._granted_until_us = -NO_LIMIT_US
        self._waiting: list[tuple[int, asyncio.Future[None]]] = []

    @property
    def granted_until_us(self) -> int:
        """Newest epoch that may be swept, microseconds."""
        return NO_LIMIT_US if self._is_open else self._granted_until_us

    def is_granted(self, epoch_us: int) -> bool:
        """Tell whether a row of this epoch may be swept now."""
        return epoch_us <= self.granted_until_us

    def open(self) -> None:
        """Let every row pass."""
        self._is_open = True
        self._wake()

    def close(self) -> None:
        """Hold back rows beyond the grants given so far."""
        self._is_open = False

    def grant_until(self, epoch_us: int) -> None:
        """Let rows up to and including this epoch pass."""
        self._granted_until_us = max(self._granted_until_us, epoch_us)
        self._wake()

    async def wait(self, epoch_us: int) -> None:
        """Return once a row of this epoch may be swept."""
        while not self.is_granted(epoch_us):
            future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append((epoch_us, future))
            try:
                await future
            finally:
                self._waiting = [entry for entry in self._waiting if entry[1] is not future]

    def _wake(self) -> None:
        for epoch_us, future in self._waiting:
            if self.is_granted(epoch_us) and not future.done():
                future.set_result(None)


@dataclass(slots=True)
class _Session:
    """State of the port that outlives a connection."""

    world: World
    gate: Gate
    #: whether the gate stays closed while nobody is connected
    await_ground: bool
    chunks: list[tuple[int, int, str]]
    flight: Flight | None = None
    #: first chunk that no client has confirmed
    next_chunk: int = 0
    #: first chunk whose rows' truth is still to be told, where it follows them
    next_reported: int = 0
    is_taken: bool = False
    #: lets pass what has been flown
    flown: Gate = field(default_factory=lambda: Gate(is_open=False))

    def is_flown(self, chunk: int) -> bool:
        """Tell whether the truth of a chunk follows its rows."""
        return self.flight is not None and self.chunks[chunk][2] == "operation"


async def serve_ground(
    world: World,
    gate: Gate,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    rows_per_chunk: int = 60,
    await_ground: bool = False,
    flight: Flight | None = None,
) -> asyncio.Server:
    """Start the ground port and return the listening server; port 0 takes a free one.

    With `await_ground` the gate is closed at once and whenever no client is connected; without it the gate is open
    until a client connects and again after it has left.
    """
    chunks = flown_chunks_of if flight else chunks_of
    session = _Session(world, gate, await_ground, chunks(world, rows_per_chunk), flight)
    if flight is not None:
        flight.listen(lambda epoch_us, _lines: session.flown.grant_until(epoch_us))
    if await_ground:
        gate.close()

    async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # the loop cancels connections when the simulator stops; asyncio's own callback would report that as an error
        with suppress(asyncio.CancelledError):
            await _converse(session, reader, writer)

    return await asyncio.start_server(on_connection, host, port, limit=MAX_LINE_BYTES)


async def _converse(session: _Session, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Serve one connection from its first line to its last."""
    is_holder = not session.is_taken
    try:
        if is_holder:
            session.is_taken = True
            session.gate.close()
            await _steer(session, reader, writer)
        else:
            await _send(writer, [_error("ground.taken", "another ground client holds the port")])
    except (ConnectionError, asyncio.IncompleteReadError):
        pass  # the client left; it resumes at the first chunk it has not confirmed
    finally:
        if is_holder:
            session.is_taken = False
            if not session.await_ground:
                session.gate.open()
        writer.close()


async def _steer(session: _Session, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Send catalogue and chunks; move on with each confirmation."""
    await _send(writer, catalogue_lines(session.world, is_flown=session.flight is not None))
    await _report_flown(session, reader, writer)
    while session.next_chunk < len(session.chunks):
        first, last, phase = session.chunks[session.next_chunk]
        until_us = int(session.world.rows.epochs_us[last])
        lines = flown_lines if session.is_flown(session.next_chunk) else chunk_lines
        await _send(writer, lines(session.world, first, last))
        await _send(writer, [{"kind": "hold", "until": rfc3339(until_us), "phase": phase}])
        await _await_proceed(reader, writer)
        session.gate.grant_until(until_us)
        session.next_chunk += 1
        await _report_flown(session, reader, writer)
    await _send(writer, [{"kind": "end"}])
    while await reader.read(MAX_LINE_BYTES):
        pass  # nothing is left to say; the client closes


async def _report_flown(session: _Session, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Tell what follows the rows of a chunk that was confirmed, once they have been swept."""
    while session.flight is not None and session.next_reported < session.next_chunk:
        first, last, _phase = session.chunks[session.next_reported]
        if session.is_flown(session.next_reported):
            await _await_flown(session, int(session.world.rows.epochs_us[last]), reader)
            await _send(writer, session.flight.reported_after(first, last))
        session.next_reported += 1


async def _await_flown(session: _Session, epoch_us: int, reader: asyncio.StreamReader) -> None:
    """Return once a row has been swept; a client that leaves meanwhile lets go of the port."""
    while not session.flown.is_granted(epoch_us):
        with suppress(TimeoutError):
            async with asyncio.timeout(_POLL_S):
                await session.flown.wait(epoch_us)
        if reader.at_eof():
            raise ConnectionResetError


async def _await_proceed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Read lines until the client confirms; answer every other line with its error."""
    while True:
        try:
            line = await reader.readuntil(b"\n")
        except asyncio.LimitOverrunError as overrun:
            await reader.readexactly(overrun.consumed)
            await _send(writer, [_error("line.too_long", f"a line holds at most {MAX_LINE_BYTES} bytes")])
            continue
        problem = _problem_of(line)
        if problem is None:
            return
        await _send(writer, [problem])


def _problem_of(line: bytes) -> dict[str, Any] | None:
    """Return None for a confirmation, else the error line that answers it."""
    try:
        message = json.loads(line)
    except ValueError:
        return _error("line.not_json", "a line is one JSON object")
    if not isinstance(message, dict):
        return _error("line.not_object", "a line is one JSON object")
    if message.get("kind") != "proceed":
        return _error("kind.unknown", 'the only kind a client sends is "proceed"')
    return None


def _error(code: str, detail: str) -> dict[str, Any]:
    return {"kind": "error", "code": code, "detail": detail}


async def _send(writer: asyncio.StreamWriter, lines: Iterator[dict[str, Any]] | list[dict[str, Any]]) -> None:
    for line in lines:
        writer.write(json.dumps(line, allow_nan=False, separators=(",", ":")).encode() + b"\n")
        await writer.drain()
