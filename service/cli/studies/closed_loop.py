"""``soo study closed-loop``: the service's torques against a spacecraft that answers them.

Exit codes: 0 every group does what it shall, 1 one does not, 2 the study could not be run.
"""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.studies.exit_code import ended_by_signals

if TYPE_CHECKING:
    from service.study.closed_loop.campaign import LoopCampaign, LoopPlan

SCENARIOS = (
    "nominal",
    "steps",
    "downlink_rain",
    "slew_fade",
    "unknown_residual_constant",
    "unknown_residual_daily",
)
_UPLINKS = ("ideal", "link")
#: columns of a table that is written to a file
_FILE_WIDTH = 200
_EXIT_MISSED = 1
_EXIT_FAILED = 2


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
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    drift_deg_h: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Drift that the filter believes in: yaw, roll, pitch; default: the product's."),
    ] = None,
    yaw_sigma_deg: Annotated[float, typer.Option(min=0.0, help="Sigma of yaw up to which it is controlled.")] = 0.5,
    mode: Annotated[
        str, typer.Option(help="ground: torques go up; onboard: angles do, for a loop on board.")
    ] = "ground",
    silence_h: Annotated[
        tuple[float, float], typer.Option(help="Begin and length of a time without uplink; mode onboard.")
    ] = (0.0, 0.0),
    flights: Annotated[
        Path | None,
        typer.Option(help="Keep each flight in this folder; what it has kept is not flown again.", file_okay=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures and runs as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the table as a section of a page.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Draw PNG figures into this folder.", file_okay=False)] = None,
) -> None:
    """Close the loop with the chain, beside perfect sensing and beside no control, which must fail."""
    from concurrent.futures import BrokenExecutor

    from service.study.closed_loop.campaign import LoopPlan
    from service.study.closed_loop.controllers import Sensing
    from service.study.closed_loop.plant_process import PlantFailedError
    from service.study.closed_loop.report import as_document, markdown

    _require("uplink", [uplink], _UPLINKS)
    _require("sensing", sensing or [], [one.value for one in Sensing])
    scenarios = tuple(dict.fromkeys(scenario or SCENARIOS))
    sensings = tuple(one for one in Sensing if not sensing or one.value in sensing)
    _require("mode", [mode], ("ground", "onboard"))
    if silence_h[1] and mode != "onboard":
        typer.echo("--silence-h is for --mode onboard; over a link commands are lost as it is", err=True)
        raise typer.Exit(_EXIT_FAILED)
    settings = (uplink, operation_days, drift_deg_h, yaw_sigma_deg, mode, silence_h)
    plan = LoopPlan(scenarios, runs, workers, sensings, *settings)
    try:
        with ended_by_signals():
            campaign = _run(plan, flights)
    except KeyboardInterrupt:
        typer.echo("stopped", err=True)
        raise typer.Exit(_EXIT_FAILED) from None
    except (PlantFailedError, BrokenExecutor, OSError) as error:
        typer.echo(f"the study failed: {error}", err=True)
        raise typer.Exit(_EXIT_FAILED) from error
    if figures is not None:
        _draw(campaign, figures)
    if as_json:
        typer.echo(json.dumps(as_document(campaign, _command(plan)), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign), nl=False)
    else:
        _print(campaign)
    if campaign.missed:
        raise typer.Exit(_EXIT_MISSED)


def _require(kind: str, reported: list[str], known: Sequence[str]) -> None:
    """Refuse a word that is not known."""
    for word in reported:
        if word not in known:
            typer.echo(f"no {kind} {word!r}; there are {', '.join(known)}", err=True)
            raise typer.Exit(_EXIT_FAILED)


def _run(plan: "LoopPlan", flights: Path | None) -> "LoopCampaign":
    """Run the campaign behind a progress bar; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from service.study.closed_loop.campaign import run_loops

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("loops", total=None)
        return run_loops(plan, lambda done, total: progress.update(task, completed=done, total=total), flights)


def _draw(campaign: "LoopCampaign", folder: Path) -> None:
    """Draw the figures."""
    # matplotlib costs a second that only figures need
    from service.study.closed_loop.figures import draw_campaign

    folder.mkdir(parents=True, exist_ok=True)
    for path in draw_campaign(campaign, folder):
        typer.echo(f"drawn: {path}", err=True)


def _command(plan: "LoopPlan") -> str:
    """Return the command that makes the same figures again."""
    words = ["soo", "study", "closed-loop", "--runs", str(plan.runs), "--uplink", plan.uplink]
    words += [word for name in plan.scenarios for word in ("--scenario", name)]
    words += ["--operation-days", f"{plan.operation_days:g}"] if plan.operation_days else []
    words += ["--drift-deg-h", *(f"{drift:g}" for drift in plan.drift_deg_h)] if plan.drift_deg_h else []
    words += ["--yaw-sigma-deg", f"{plan.yaw_sigma_deg:g}", "--mode", plan.mode]
    words += ["--silence-h", *(f"{hours:g}" for hours in plan.silence_h)] if plan.silence_h[1] else []
    words += [word for sensing in plan.sensings for word in ("--sensing", sensing.value)]
    return shlex.join(words)


def _print(campaign: "LoopCampaign") -> None:
    """Print the table and the command that makes it again."""
    from rich.console import Console
    from rich.table import Table

    from service.study.closed_loop.report import COLUMNS, cells

    console = Console()
    if not console.is_terminal:
        console = Console(width=_FILE_WIDTH)
    table = Table(title="Closed loops", title_justify="left")
    for column in COLUMNS:
        table.add_column(column, overflow="fold")
    for group in campaign.groups:
        table.add_row(*cells(group))
    console.print(table)
    console.print(
        f"{len(campaign.results)} runs in {campaign.seconds:.0f} s: {_command(campaign.plan)}", highlight=False
    )
