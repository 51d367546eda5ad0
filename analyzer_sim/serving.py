"""``serve``: a world, an instrument on it and their ports in one process, until a signal asks to stop.

Ports of the plant: schedules to the spacecraft, changes of its world.

The instrument on its ports: raw TCP and HiSLIP, several sessions of each, one event loop. No SCPI is known here.

On the raw socket bytes go to a framer, messages to a session, responses back to the stream, in order, one message at a
time; what has been written stays in the stream, whatever the client does next. There is no device clear on it, and no
announcement by mDNS: a client is given the address.
"""

import argparse
import asyncio
import json
import signal
import sys
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from types import TracebackType
from typing import Any, NamedTuple

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.dialects.rs import RS
from analyzer_sim.epochs import rfc3339
from analyzer_sim.instrument.imperfections import IDEAL, TraceFault, TraceFaults
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress
from analyzer_sim.instrument.truth_log import TruthLog
from analyzer_sim.lines.dispatcher import Dispatcher, poll_permission
from analyzer_sim.lines.hislip_server import HislipServer
from analyzer_sim.lines.line_faults import FaultyLine, LineEndedError, LineFault, LineFaults
from analyzer_sim.plant.flown_world import MAX_LINE_BYTES, ChangeError, FlownWorld
from analyzer_sim.plant.plant import MAX_LINE_CHARACTERS, PlantOptions, ScheduleError, fed_forward_line
from analyzer_sim.scpi.framing import MessageFramer
from analyzer_sim.world.ground.ground_port import Gate, serve_ground
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.world import World

_READ_BYTES = 1 << 16
#: what a stream buffers before it stops reading from the network; asyncio's own 64 KiB cut long blocks in pieces, bytes
_STREAM_LIMIT_BYTES = 1 << 20

_Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def port_error(name: str, port: int, host: str, error: OSError) -> OSError:
    """Return what to raise in place of an error of a listening socket: its text names the port."""
    # asyncio puts the address before the reason, since Python 3.13 also the number of the error in brackets
    reason = str(error.strerror or error).rpartition(": ")[2].rpartition("] ")[2].lower()
    return OSError(f"{name} port {port} of {host}: {reason}")


class SimulatedAnalyzer:
    """The instrument on its TCP ports; an asynchronous context manager.

    Parameters
    ----------
    instrument : Instrument
        Shared by all sessions.
    dialect : Dialect
        The language spoken.
    faults : LineFaults, optional
        Faults of the line, for tests of clients.
    permission : callable, optional
        Returns when it is worth asking again whether the next row may be swept; polling when left out.
    host, port
        Where to listen; port 0 takes a free one.
    alias_ports : tuple of int
        Further ports of the raw socket.
    hislip_port : int, optional
        Port of HiSLIP, 0 takes a free one; not served when left out.
    """

    def __init__(
        self,
        instrument: Instrument,
        dialect: Dialect = RS,
        *,
        faults: LineFaults | None = None,
        permission: Callable[[], Awaitable[None]] = poll_permission,
        host: str = "127.0.0.1",
        port: int = 0,
        alias_ports: tuple[int, ...] = (),
        hislip_port: int | None = None,
    ) -> None:
        self.faults = faults or LineFaults()
        self._dispatcher = Dispatcher(instrument, dialect, permission)
        self._hislip = HislipServer(self._dispatcher, self.faults)
        self._host = host
        self._raw_ports = (port, *alias_ports)
        self._wanted_hislip_port = hislip_port
        self._servers: list[asyncio.Server] = []
        self._connections: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        """The port taken by the raw socket; only while the server runs."""
        return self._port_of(0)

    @property
    def alias_ports(self) -> tuple[int, ...]:
        """The further ports taken by the raw socket."""
        return tuple(self._port_of(number) for number in range(1, len(self._raw_ports)))

    @property
    def hislip_port(self) -> int | None:
        """The port taken by HiSLIP, if it is served."""
        return None if self._wanted_hislip_port is None else self._port_of(-1)

    def _port_of(self, number: int) -> int:
        if not self._servers:
            raise RuntimeError("the server does not run")
        return int(self._servers[number].sockets[0].getsockname()[1])

    async def __aenter__(self) -> "SimulatedAnalyzer":
        try:
            for port in self._raw_ports:
                await self._listen("SCPI", port, self._converse)
            if self._wanted_hislip_port is not None:
                await self._listen("HiSLIP", self._wanted_hislip_port, self._hislip.serve)
        except OSError:
            await self._stop()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stop()

    async def _listen(self, name: str, port: int, serve: _Serve) -> None:
        """Open a port.

        Raises
        ------
        OSError
            It cannot be had; the text names it.
        """

        async def on_connection(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await self._serve(serve, reader, writer)

        try:
            server = await asyncio.start_server(on_connection, self._host, port, limit=_STREAM_LIMIT_BYTES)
        except OSError as error:
            raise port_error(name, port, self._host, error) from error
        self._servers.append(server)

    async def _stop(self) -> None:
        for server in self._servers:
            server.close()
        self._servers = []
        connections = tuple(self._connections)
        for task in connections:
            task.cancel()
        await asyncio.gather(*connections, return_exceptions=True)
        await self._dispatcher.close()

    async def _serve(self, serve: _Serve, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until either side ends it."""
        task = asyncio.current_task()
        if task is not None:
            self._connections.add(task)
            task.add_done_callback(self._connections.discard)
        try:
            await serve(reader, writer)
        except (ConnectionError, LineEndedError):
            pass  # the client left or a fault ended the line: either way this session is over
        except asyncio.CancelledError:
            writer.transport.abort()  # the server stops; asyncio wants this task to end without an exception
        finally:
            writer.close()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a connection of the raw socket."""
        framer, line = MessageFramer(), FaultyLine(writer, self.faults)
        session = self._dispatcher.new_session("socket")
        try:
            while data := await reader.read(_READ_BYTES):
                for message in framer.feed(data):
                    response = await self._dispatcher.execute(session, message)
                    if response is not None and await line.send(response, (response,)):
                        session.report_delivery(session.readings)
        finally:
            self._dispatcher.leave(session)


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


#: name on the command line of a peer that accepts and never answers
SILENT_PEER = "silent_peer"
#: names of all faults that can be armed on the command line
FAULT_NAMES = (SILENT_PEER, *(fault.value for fault in LineFault), *(fault.value for fault in TraceFault))


def parse_fault(text: str) -> tuple[str, int]:
    """Read ``NAME`` or ``NAME:TIMES``.

    Examples
    --------
    >>> parse_fault("stale"), parse_fault("nan:3")
    (('stale', 1), ('nan', 3))
    """
    name, _, times = text.partition(":")
    if name not in FAULT_NAMES:
        raise argparse.ArgumentTypeError(f"must be one of {', '.join(FAULT_NAMES)}")
    if times and not (times.isdecimal() and 0 < int(times) <= 1000):
        raise argparse.ArgumentTypeError("a fault happens 1 to 1000 times")
    return name, int(times or 1)


def arm(faults: list[tuple[str, int]], line: LineFaults, trace: TraceFaults) -> None:
    """Arm faults by their names, in order."""
    for name, times in faults:
        if name == SILENT_PEER:
            line.is_silent_peer = True
        elif name in {fault.value for fault in LineFault}:
            line.arm(LineFault(name), times)
        else:
            trace.arm(TraceFault(name), times)


async def serve(options: argparse.Namespace, scenario: Scenario, flown: PlantOptions) -> None:
    """Serve until SIGTERM or SIGINT; with a port for the uplink the spacecraft is flown.

    Raises
    ------
    OSError
        A port is taken, or the truth log cannot be written; the text says which.
    """
    subject = None if options.uplink_port is None else FlownWorld(scenario, options.seed, flown)
    world = World(scenario, options.seed) if subject is None else subject.world
    gate = Gate()
    dialect = DIALECTS[options.dialect]
    with _truth_log(options, world) as truth:
        instrument = Instrument(
            subject or world,
            _painter(options, dialect),
            may_advance=lambda: _may_advance(world, gate),
            model=dialect.model,
            progress=SweepProgress(Pace(options.pace)),
            truth=truth,
        )
        analyzer = SimulatedAnalyzer(
            instrument,
            dialect,
            permission=lambda: _permission(world, gate),
            host=options.host,
            port=options.port,
            alias_ports=tuple(options.alias_port),
            hislip_port=options.hislip_port,
        )
        arm(options.fault, analyzer.faults, instrument.trace_faults)
        await _serve_all(options, _Station(world, gate, subject, analyzer))


class _Station(NamedTuple):
    """World, analyzer and flown spacecraft behind the ports."""

    world: World
    gate: Gate
    #: None = the story is only replayed
    subject: FlownWorld | None
    analyzer: SimulatedAnalyzer


async def _serve_all(options: argparse.Namespace, station: _Station) -> None:
    """Open all ports, tell them, wait for a signal, close them."""
    stop_wanted = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop_wanted.set)
    servers = await _control_servers(options, station)
    try:
        async with station.analyzer:
            ports = {name: server.sockets[0].getsockname()[1] for name, server in servers.items()}
            _announce(options, station.analyzer, ports)
            await stop_wanted.wait()
    finally:
        for server in servers.values():
            server.close()  # not waited for: a connected client must not keep the process alive


async def _control_servers(options: argparse.Namespace, station: _Station) -> dict[str, asyncio.Server]:
    """Open the ground port and, where a spacecraft is flown, the uplink and the port of changes."""
    opening: dict[str, Callable[[], Awaitable[asyncio.Server]]] = {
        "ground": lambda: serve_ground(
            station.world,
            station.gate,
            host=options.host,
            port=options.ground_port,
            await_ground=options.await_ground,
            flight=station.subject,
        )
    }
    if station.subject is not None:
        uplink = UplinkPort(station.subject)
        opening["uplink"] = lambda: uplink.serve(options.host, options.uplink_port)
        if options.change_port is not None:
            opening["change"] = partial(serve_changes, station.subject, options.host, options.change_port)
    servers: dict[str, asyncio.Server] = {}
    for name, serve_port in opening.items():
        try:
            servers[name] = await serve_port()
        except OSError as error:
            for server in servers.values():
                server.close()
            raise port_error(name, getattr(options, f"{name}_port"), options.host, error) from error
    return servers


@contextmanager
def _truth_log(options: argparse.Namespace, world: World) -> Iterator[TruthLog | None]:
    if options.truth_log is None:
        yield None
        return
    with options.truth_log.open("w", encoding="utf-8") as stream:
        truth = TruthLog(stream, world.carrier_ids, lambda: world.row_index)
        truth.begin(options.scenario, options.seed)
        yield truth


def _painter(options: argparse.Namespace, dialect: Dialect) -> TracePainter:
    imperfections = IDEAL if options.ideal else dialect.imperfections
    return TracePainter(options.seed, imperfections, Detail(options.detail))


def _may_advance(world: World, gate: Gate) -> bool:
    """Tell whether the next row may be swept; past the last row there is nothing to hold back."""
    return world.next_epoch_us is None or gate.is_granted(world.next_epoch_us)


async def _permission(world: World, gate: Gate) -> None:
    if world.next_epoch_us is not None:
        await gate.wait(world.next_epoch_us)


def _announce(options: argparse.Namespace, analyzer: SimulatedAnalyzer, ports: Mapping[str, int]) -> None:
    """Tell the parent process where to connect."""
    line = {
        "scpi_port": analyzer.port,
        "alias_ports": list(analyzer.alias_ports),
        "hislip_port": analyzer.hislip_port,
        "ground_port": ports["ground"],
        "uplink_port": ports.get("uplink"),
        "change_port": ports.get("change"),
        "dialect": options.dialect,
        "scenario": options.scenario,
        "seed": options.seed,
    }
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()
