"""``serve``: a world, an instrument on it and their ports in one process, until a signal asks to stop."""

import argparse
import asyncio
import json
import signal
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import NamedTuple

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress
from analyzer_sim.instrument.trace_faults import TraceFault, TraceFaults
from analyzer_sim.instrument.truth_log import TruthLog
from analyzer_sim.lines.line_faults import LineFault, LineFaults
from analyzer_sim.lines.server import SimulatedAnalyzer, port_error
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.plant import PlantOptions
from analyzer_sim.plant.uplink_port import UplinkPort, serve_changes
from analyzer_sim.world.ground.ground_port import Gate, serve_ground
from analyzer_sim.world.scenario.scenario import Scenario
from analyzer_sim.world.world import World

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
