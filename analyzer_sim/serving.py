"""``serve``: a world, an instrument on it and their ports in one process, until a signal asks to stop."""

import argparse
import asyncio
import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import Detail, TracePainter
from analyzer_sim.instrument.sweep_life import Pace, SweepLife
from analyzer_sim.instrument.trace_faults import TraceFault, TraceFaults
from analyzer_sim.instrument.truth_log import TruthLog
from analyzer_sim.lines.line_faults import LineFault, LineFaults
from analyzer_sim.lines.server import SimulatedAnalyzer, port_error
from analyzer_sim.world.ground_port import Gate, serve_ground
from analyzer_sim.world.scenario import Scenario
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


async def serve(options: argparse.Namespace, scenario: Scenario) -> None:
    """Serve until SIGTERM or SIGINT.

    Raises
    ------
    OSError
        A port is taken, or the truth log cannot be written; the text says which.
    """
    world = World(scenario, options.seed)
    gate = Gate()
    dialect = DIALECTS[options.dialect]
    with _truth_log(options, world) as truth:
        instrument = Instrument(
            world,
            _painter(options, dialect),
            may_advance=lambda: _may_advance(world, gate),
            model=dialect.model,
            life=SweepLife(Pace(options.pace)),
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
        await _serve_both(options, world, gate, analyzer)


async def _serve_both(options: argparse.Namespace, world: World, gate: Gate, analyzer: SimulatedAnalyzer) -> None:
    """Open all ports, tell them, wait for a signal, close them."""
    stop_wanted = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop_wanted.set)
    try:
        ground = await serve_ground(
            world, gate, host=options.host, port=options.ground_port, await_ground=options.await_ground
        )
    except OSError as error:
        raise port_error("ground", options.ground_port, options.host, error) from error
    try:
        async with analyzer:
            _announce(options, analyzer, ground.sockets[0].getsockname()[1])
            await stop_wanted.wait()
    finally:
        ground.close()  # not waited for: a connected ground client must not keep the process alive


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


def _announce(options: argparse.Namespace, analyzer: SimulatedAnalyzer, ground_port: int) -> None:
    """Tell the parent process where to connect."""
    line = {
        "scpi_port": analyzer.port,
        "alias_ports": list(analyzer.alias_ports),
        "hislip_port": analyzer.hislip_port,
        "ground_port": ground_port,
        "dialect": options.dialect,
        "scenario": options.scenario,
        "seed": options.seed,
    }
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()
