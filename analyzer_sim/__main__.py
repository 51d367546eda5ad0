"""Command line of the simulator: ``serve`` (the default), ``export``, ``plant`` and ``scenarios``.

``serve`` prints one line of JSON when both ports are open, then serves until SIGTERM or SIGINT and ends with 0::

    {"scpi_port": 5025, "ground_port": 5026, "scenario": "demo", "seed": 1}
"""

import argparse
import asyncio
import io
import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from analyzer_sim.dialect import Dialect
from analyzer_sim.dialects import DIALECTS
from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.export import run_export
from analyzer_sim.ground_port import Gate, serve_ground
from analyzer_sim.imperfections import IDEAL
from analyzer_sim.instrument import Instrument
from analyzer_sim.painter import Detail, TracePainter
from analyzer_sim.plant import run_plant
from analyzer_sim.scenario import SCENARIOS, Scenario, scenario_named
from analyzer_sim.scenario_table import markdown_page, plain_table
from analyzer_sim.server import SimulatedAnalyzer
from analyzer_sim.world import World

_SUBCOMMANDS = ("serve", "export", "plant", "scenarios")


def _epoch_us(text: str) -> int:
    try:
        return epoch_us_from_text(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError("must be a positive number")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError("must be a port number")
    return value


def _add_story(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose the world."""
    parser.add_argument("--scenario", default="demo", choices=sorted(SCENARIOS), help="the story (default: demo)")
    parser.add_argument("--seed", type=_seed, default=1, help="seed of every random quantity (default: 1)")
    parser.add_argument("--start", type=_epoch_us, help="first epoch, RFC 3339 with zone")
    parser.add_argument("--operation-days", type=_positive, help="length of the operation phase, days")
    parser.add_argument("--row-period", type=_positive, help="time between rows, seconds")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="soo-analyzer", description="Simulated spectrum analyzer and its world.")
    commands = parser.add_subparsers(dest="command", required=True)
    serve = commands.add_parser("serve", help="serve SCPI and the ground port (the default command)")
    _add_story(serve)
    serve.add_argument("--dialect", default="rs", choices=sorted(DIALECTS), help="language (default: rs)")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1)")
    serve.add_argument("--port", type=_port, default=5025, help="SCPI port, 0 = a free one (default: 5025)")
    serve.add_argument("--ground-port", type=_port, default=5026, help="ground port, 0 = a free one (default: 5026)")
    serve.add_argument("--await-ground", action="store_true", help="sweep no row before a ground client allows it")
    serve.add_argument(
        "--detail",
        default=Detail.FAST.value,
        choices=[detail.value for detail in Detail],
        help="fast: drawn per point; envelope: drawn in time (default: fast)",
    )
    serve.add_argument("--ideal", action="store_true", help="an analyzer without errors and noise of its own")
    export = commands.add_parser("export", help="write a whole scenario as arrays, without SCPI")
    _add_story(export)
    export.add_argument("--out", type=Path, required=True, help="file to write, .npz")
    plant = commands.add_parser("plant", help="close a loop: powers to standard output, torque schedules from input")
    _add_story(plant)
    for command in (export, plant):
        command.add_argument(
            "--sweep-noise", type=float, default=1.0, help="scale of the sweep's own noise (default: 1)"
        )
    scenarios = commands.add_parser("scenarios", help="list the stories that can be told")
    scenarios.add_argument("--markdown", action="store_true", help="as the page of the reference")
    return parser


def _scenario(options: argparse.Namespace) -> Scenario:
    return scenario_named(
        options.scenario,
        operation_days=options.operation_days,
        row_period_s=options.row_period,
        start_us=options.start,
    )


async def _serve(options: argparse.Namespace) -> None:
    """Serve until a signal asks to stop."""
    world = World(_scenario(options), options.seed)
    gate = Gate()
    dialect = DIALECTS[options.dialect]
    instrument = Instrument(
        world, _painter(options, dialect), may_advance=lambda: _may_advance(world, gate), model=dialect.model
    )
    ground = await serve_ground(
        world, gate, host=options.host, port=options.ground_port, await_ground=options.await_ground
    )
    analyzer = SimulatedAnalyzer(
        instrument,
        dialect,
        permission=lambda: _permission(world, gate),
        host=options.host,
        port=options.port,
    )
    stop_wanted = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop_wanted.set)
    try:
        async with analyzer:
            _announce(options, analyzer.port, ground.sockets[0].getsockname()[1])
            await stop_wanted.wait()
    finally:
        ground.close()  # not waited for: a connected ground client must not keep the process alive


def _painter(options: argparse.Namespace, dialect: Dialect) -> TracePainter:
    imperfections = IDEAL if options.ideal else dialect.imperfections
    return TracePainter(options.seed, imperfections, Detail(options.detail))


def _may_advance(world: World, gate: Gate) -> bool:
    """Tell whether the next row may be swept; past the last row there is nothing to hold back."""
    return world.next_epoch_us is None or gate.is_granted(world.next_epoch_us)


async def _permission(world: World, gate: Gate) -> None:
    if world.next_epoch_us is not None:
        await gate.wait(world.next_epoch_us)


def _run_plant(options: argparse.Namespace) -> int:
    """Close a loop over the standard streams; a reader that leaves ends it without a complaint."""
    # bytes that are no text must reach the parser of lines, which answers them
    source = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8", errors="replace")
    try:
        return run_plant(_scenario(options), options.seed, options.sweep_noise, source, sys.stdout)
    except BrokenPipeError:
        # the interpreter flushes once more at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _announce(options: argparse.Namespace, scpi_port: int, ground_port: int) -> None:
    """Tell the parent process where to connect."""
    line = {"scpi_port": scpi_port, "ground_port": ground_port, "scenario": options.scenario, "seed": options.seed}
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or (given[0] not in _SUBCOMMANDS and given[0] not in {"-h", "--help"}):
        given.insert(0, "serve")
    options = build_parser().parse_args(given)
    if options.command == "scenarios":
        sys.stdout.write(markdown_page() if options.markdown else plain_table())
        return 0
    if options.command == "export":
        return run_export(_scenario(options), options.seed, options.out, options.sweep_noise)
    if options.command == "plant":
        return _run_plant(options)
    try:
        asyncio.run(_serve(options))
    except OSError as error:
        sys.stderr.write(f"soo-analyzer: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
