"""``soo study closed-loop``: the service's torques against a spacecraft that answers them.

Exit codes: 0 every group does what it shall, 1 one does not, 2 the study could not be run.
"""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end
from service.cli.extras import Scheduler
from service.cli.studies.screen import (
    EXIT_MISSED,
    AsJson,
    AsMarkdown,
    Figures,
    console_of,
    counted,
    draw,
    failures_shown,
    print_tables,
)

if TYPE_CHECKING:
    from service.study.closed_loop.campaign import LoopPlan

SCENARIOS = (
    "nominal",
    "steps",
    "downlink_rain",
    "slew_fade",
    "unknown_residual_constant",
    "unknown_residual_daily",
    "plant_varied",
)
_UPLINKS = ("ideal", "link")
#: columns of a table that is written to a file
_FILE_WIDTH = 200


def closed_loop(
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Seeds 1 to this number of each scenario.")] = 3,
    scenario: Annotated[
        list[str] | None, typer.Option(help=f"Scenario; may be given many times. Default: {', '.join(SCENARIOS)}.")
    ] = None,
    uplink: Annotated[
        str, typer.Option(help="Way to the spacecraft: link (delay, loss, repetition) or ideal.")
    ] = "link",
    sensing: Annotated[
        list[str] | None, typer.Option(help="automatic, truth or off; may be given many times. Default: all.")
    ] = None,
    workers: Annotated[int, typer.Option("--jobs", min=1, max=256, help="Processes.")] = 2,
    scheduler: Scheduler = None,
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    residual_torque_n_m: Annotated[
        float | None,
        typer.Option(help="Size of the unknown torque that the catalogue states; default: the scenario's."),
    ] = None,
    mode: Annotated[
        str, typer.Option(help="ground: torques go up; onboard: angles do, for a loop on board.")
    ] = "ground",
    method: Annotated[str, typer.Option(help="Method that drives control: robust or paper.")] = "robust",
    silence_h: Annotated[tuple[float, float], typer.Option(help="Begin and length of a time without uplink, h.")] = (
        0.0,
        0.0,
    ),
    flights: Annotated[
        Path | None,
        typer.Option(help="Keep each flight in this folder; what it has kept is not flown again.", file_okay=False),
    ] = None,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Close the loop with the chain, beside perfect sensing and beside no control, which must fail."""
    from concurrent.futures import BrokenExecutor

    from service.records.catalogue import Method
    from service.study.closed_loop.campaign import COLUMNS, LoopPlan, as_document, cells, markdown, run_loops
    from service.study.closed_loop.controllers import Sensing
    from service.study.closed_loop.plant_process import PlantFailedError
    from service.study.closed_loop.run import LoopUnit
    from service.study.executors import ClusterError, WorkerChoice

    _require("uplink", [uplink], _UPLINKS)
    _require("sensing", sensing or [], [one.value for one in Sensing])
    scenarios = tuple(dict.fromkeys(scenario or SCENARIOS))
    sensings = tuple(one for one in Sensing if not sensing or one.value in sensing)
    _require("mode", [mode], ("ground", "onboard"))
    _require("method", [method], [one.value for one in Method])
    settings = (uplink, operation_days, residual_torque_n_m, mode, silence_h, Method(method))
    unit = LoopUnit("", 0, Sensing.AUTOMATIC, *settings)
    plan = LoopPlan(scenarios, runs, WorkerChoice(workers, scheduler), sensings, unit)
    with failures_shown(PlantFailedError, BrokenExecutor, ClusterError, OSError), counted("loops") as show:
        campaign = run_loops(plan, show, flights)
    draw(figures, "closed_loop", lambda study, folder: study.draw_campaign(campaign, folder))
    if as_json:
        typer.echo(json.dumps(as_document(campaign, _command(plan)), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign), nl=False)
    else:
        last = f"{len(campaign.results)} runs in {campaign.seconds:.0f} s: {_command(campaign.plan)}"
        rows = [cells(group) for group in campaign.groups]
        print_tables(console_of(_FILE_WIDTH), [("Closed loops", COLUMNS, rows)], [last])
    if campaign.missed:
        raise typer.Exit(EXIT_MISSED)


def _require(kind: str, reported: list[str], known: Sequence[str]) -> None:
    """Refuse a word that is not known."""
    for word in reported:
        if word not in known:
            end(f"no {kind} {word!r}; there are {', '.join(known)}")


def _command(plan: "LoopPlan") -> str:
    """Return the command that makes the same figures again."""
    unit = plan.unit
    words = ["soo", "study", "closed-loop", "--runs", str(plan.runs), "--uplink", unit.uplink]
    words += [word for name in plan.scenarios for word in ("--scenario", name)]
    words += ["--operation-days", f"{unit.operation_days:g}"] if unit.operation_days else []
    stated_n_m = unit.residual_torque_n_m
    words += [] if stated_n_m is None else ["--residual-torque-n-m", f"{stated_n_m:g}"]
    words += ["--mode", unit.mode, "--method", unit.method.value]
    words += ["--silence-h", *(f"{hours:g}" for hours in unit.silence_h)] if unit.silence_h[1] else []
    words += [word for sensing in plan.sensings for word in ("--sensing", sensing.value)]
    return shlex.join(words)
