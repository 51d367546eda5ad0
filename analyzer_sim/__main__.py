"""Command line of the simulator: ``serve`` (the default), ``export``, ``plant`` and ``scenarios``.

``serve`` prints one line of JSON when all ports are open, then serves until SIGTERM or SIGINT and ends with 0; a port
that is taken is told and ends it with 1. HiSLIP is served when its port is given; nothing is announced by mDNS::

    {"scpi_port": 5025, "alias_ports": [], "hislip_port": null, "ground_port": 5026, "uplink_port": null,
     "dialect": "rs", "scenario": "demo", "seed": 1}

With ``--uplink-port`` the spacecraft is flown: schedules come in on that port (``serving.py``).
"""

import argparse
import io
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# numpy, scipy and the world cost twenty times the parser: each command imports what it runs
from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.instrument.sweep_progress import Pace
from analyzer_sim.world.spacecraft.hub_tones import HubTone, parse_tone

if TYPE_CHECKING:
    from analyzer_sim.plant.plant import PlantOptions
    from analyzer_sim.world.scenario.story import Scenario

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


def _tone(text: str) -> HubTone:
    try:
        return parse_tone(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _one_of(load: Callable[[], Iterable[str]]) -> Callable[[str], str]:
    """Return the type of an option that takes a name of a table, which is imported when the option is read."""

    def read(text: str) -> str:
        names = sorted(load())
        if text not in names:
            raise argparse.ArgumentTypeError(f"invalid choice: {text!r} (choose from {', '.join(names)})")
        return text

    return read


def _scenarios() -> Iterable[str]:
    from analyzer_sim.world.scenario.scenario import SCENARIOS

    return SCENARIOS


def _closed_scenarios() -> Iterable[str]:
    from analyzer_sim.world.scenario.scenario import CLOSED_SCENARIOS

    return CLOSED_SCENARIOS


def _dialects() -> Iterable[str]:
    from analyzer_sim.dialects.dialects import DIALECTS

    return DIALECTS


def _fault(text: str) -> tuple[str, int]:
    from analyzer_sim.serving import parse_fault

    return parse_fault(text)


def _response(text: str) -> tuple[str, float]:
    from analyzer_sim.world.spacecraft.body import AXES

    axis, _, value = text.partition("=")
    if axis not in AXES or not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not AXIS=FACTOR with an axis of {', '.join(AXES)}")
    factor = float(value)
    if not -2.0 <= factor <= 2.0:
        raise argparse.ArgumentTypeError("the factor lies outside -2..2")
    return axis, factor


def _add_story(parser: argparse.ArgumentParser, load: Callable[[], Iterable[str]] = _scenarios) -> None:
    """Add the options that choose the world."""
    parser.add_argument(
        "--scenario", default="demo", type=_one_of(load), metavar="NAME", help="one of `scenarios` (default: demo)"
    )
    parser.add_argument("--seed", type=_seed, default=1, help="seed of every random quantity (default: 1)")
    parser.add_argument("--start", type=_epoch_us, help="first epoch, RFC 3339 with zone")
    parser.add_argument("--operation-days", type=_positive, help="length of the operation phase, days")
    parser.add_argument("--quiet-days", type=_positive, help="length of the quiet phase, days")
    parser.add_argument("--row-period", type=_positive, help="time between rows, seconds")


def _add_serve(parser: argparse.ArgumentParser) -> None:
    """Add the options of the served instrument."""
    _add_story(parser, _closed_scenarios)
    parser.add_argument(
        "--dialect", default="rs", type=_one_of(_dialects), help="rs, keysight, siglent or anritsu (default: rs)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1)")
    parser.add_argument("--port", type=_port, default=5025, help="SCPI port, 0 = a free one (default: 5025)")
    parser.add_argument("--alias-port", type=_port, action="append", default=[], help="further SCPI port; may repeat")
    parser.add_argument("--hislip-port", type=_port, help="HiSLIP port, usually 4880, 0 = a free one (default: none)")
    parser.add_argument("--ground-port", type=_port, default=5026, help="ground port, 0 = a free one (default: 5026)")
    parser.add_argument("--uplink-port", type=_port, help="fly the spacecraft by schedules, 0 = a free port")
    parser.add_argument("--change-port", type=_port, help="change the flown world for a time, 0 = a free port")
    parser.add_argument("--await-ground", action="store_true", help="sweep no row before a ground client allows it")
    parser.add_argument(
        "--detail",
        default="fast",
        choices=["fast", "envelope"],
        help="fast: drawn per point; envelope: drawn in time (default: fast)",
    )
    parser.add_argument("--ideal", action="store_true", help="an analyzer without errors and noise of its own")
    parser.add_argument(
        "--pace",
        default=Pace.VIRTUAL.value,
        choices=[pace.value for pace in Pace],
        help="virtual: a sweep takes no time; real: it lasts its sweep time (default: virtual)",
    )
    parser.add_argument("--truth-log", type=Path, help="file for the truth of every sweep, JSON lines; is overwritten")
    parser.add_argument(
        "--fault",
        type=_fault,
        action="append",
        default=[],
        metavar="NAME[:TIMES]",
        help="fault of the next answers or traces, for tests of clients; may repeat",
    )
    _add_spacecraft(parser)


def _add_spacecraft(parser: argparse.ArgumentParser) -> None:
    """Add the options of a spacecraft that is flown."""
    parser.add_argument(
        "--uplink",
        default="ideal",
        choices=["ideal", "link"],
        help="ideal: a schedule arrives at once; link: after 30-120 s, 2%% lost, 1%% twice (default: ideal)",
    )
    parser.add_argument(
        "--onboard",
        default="wheels",
        choices=["wheels", "perfect"],
        help="wheels: the loop on board is flown; perfect: taken as perfect, torques of any size act (default: wheels)",
    )
    parser.add_argument(
        "--response",
        type=_response,
        action="append",
        default=[],
        metavar="AXIS=FACTOR",
        help="what a commanded torque does about an axis, -1 = the opposite; may repeat",
    )
    parser.add_argument(
        "--tone",
        type=_tone,
        action="append",
        default=[],
        metavar="AXIS:OMEGA:DAMPING:COUPLING",
        help="flexible mode that moves the hub, rad/s; may repeat",
    )


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="soo-analyzer", description="Simulated spectrum analyzer and its world.")
    commands = parser.add_subparsers(dest="command", required=True)
    _add_serve(commands.add_parser("serve", help="serve SCPI and the ground port (the default command)"))
    export = commands.add_parser("export", help="write a whole scenario as arrays, without SCPI")
    _add_story(export)
    export.add_argument("--out", type=Path, required=True, help="file to write, .npz")
    plant = commands.add_parser("plant", help="close a loop: powers to standard output, torque schedules from input")
    _add_story(plant, _closed_scenarios)
    _add_spacecraft(plant)
    plant.add_argument(
        "--age-limit",
        type=float,
        metavar="S",
        help="the loop on board takes angles in place of torques, and acts on none older than this",
    )
    for command in (export, plant):
        command.add_argument(
            "--sweep-noise", type=float, default=1.0, help="scale of the sweep's own noise (default: 1)"
        )
    scenarios = commands.add_parser("scenarios", help="list the stories that can be told")
    scenarios.add_argument("--markdown", action="store_true", help="as the tables of docs/evidence/scenarios.md")
    return parser


def _scenario(options: argparse.Namespace) -> "Scenario":
    from analyzer_sim.world.scenario.scenario import scenario_named

    return scenario_named(
        options.scenario,
        seed=options.seed,
        operation_days=options.operation_days,
        quiet_days=options.quiet_days,
        row_period_s=options.row_period,
        start_us=options.start,
    )


def _flown(options: argparse.Namespace) -> "PlantOptions":
    from analyzer_sim.plant.plant import PlantOptions
    from analyzer_sim.world.spacecraft.body import AXES

    factors = {**dict.fromkeys(AXES, 1.0), **dict(options.response)}
    response = (factors["roll"], factors["pitch"], factors["yaw"])
    return PlantOptions(
        options.uplink, options.onboard, response, tuple(options.tone), getattr(options, "age_limit", None)
    )


def _run_plant(options: argparse.Namespace) -> int:
    """Close a loop over the standard streams; a reader that leaves ends it without a complaint."""
    from analyzer_sim.plant.plant import Plant, run_plant

    # bytes that are no text must reach the parser of lines, which answers them
    source = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8", errors="replace")
    try:
        plant = Plant(_scenario(options), options.seed, options.sweep_noise, _flown(options))
        return run_plant(plant, source, sys.stdout)
    except BrokenPipeError:
        # the interpreter flushes once more at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or (given[0] not in _SUBCOMMANDS and given[0] not in {"-h", "--help"}):
        given.insert(0, "serve")
    parser = build_parser()
    options = parser.parse_args(given)
    if options.command == "scenarios":
        from analyzer_sim.world.scenario_table import markdown_tables, plain_table

        sys.stdout.write(markdown_tables() if options.markdown else plain_table())
        return 0
    if options.command == "export":
        from analyzer_sim.export import run_export

        return run_export(_scenario(options), options.seed, options.out, options.sweep_noise)
    if options.command == "plant":
        return _run_plant(options)
    if options.uplink_port is None and options.scenario not in _scenarios():
        parser.error(f"scenario {options.scenario} is for closed loops alone: give --uplink-port")
    if options.uplink_port is None and options.change_port is not None:
        parser.error("--change-port changes a spacecraft that is flown: give --uplink-port")
    return _run_server(options)


def _run_server(options: argparse.Namespace) -> int:
    """Serve until a signal; a port that is taken is told."""
    import asyncio

    from analyzer_sim.serving import serve

    try:
        asyncio.run(serve(options, _scenario(options), _flown(options)))
    except OSError as error:
        sys.stderr.write(f"soo-analyzer: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
