"""``soo study estimation``: campaigns of both methods on simulated truth.

Exit codes: 0 every bound kept, 1 one missed or a world refused, 2 the study could not be run.
"""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.studies.exit_code import ended_by_signals

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from service.study.estimation import report
    from service.study.estimation.campaign import Campaign, CampaignPlan, Show

#: columns of a table that is written to a file
_FILE_WIDTH = 150
_EXIT_MISSED = 1
_EXIT_FAILED = 2


def estimation(
    scenario: Annotated[list[str] | None, typer.Option(help="Scenario to run; may be given many times.")] = None,
    group: Annotated[str | None, typer.Option(help="Scenarios of a group; default `all` where none is named.")] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Seeds 1 to this number for each scenario.")] = 10,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures, bounds and marks as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the tables as a section of a page.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Draw PNG figures into this folder.", file_okay=False)] = None,
) -> None:
    """Run both methods over simulated worlds and hold their figures against the bounds."""
    # these cost half a second that no other command needs
    from concurrent.futures import BrokenExecutor

    from service.study.estimation.campaign import CampaignPlan, run_campaign
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.estimation.report import as_document, markdown, tables, verdict_lines

    console = _console(is_report_elsewhere=as_json or as_markdown)
    plan = CampaignPlan(_scenarios(scenario, group), seeds, workers, operation_days)
    try:
        with ended_by_signals():
            campaign = _run(plan, run_campaign, console)
    except KeyboardInterrupt:
        console.print("stopped")
        raise typer.Exit(_EXIT_FAILED) from None
    except (ExportFailedError, BrokenExecutor, OSError) as error:
        typer.echo(f"the study failed: {error}", err=True)
        raise typer.Exit(_EXIT_FAILED) from error
    if figures is not None:
        _draw(campaign, figures)
    command = _command(scenario, group, seeds, operation_days)
    if as_json:
        typer.echo(json.dumps(as_document(campaign, command), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign, command), nl=False)
    else:
        _print(tables(campaign), [*verdict_lines(campaign), f"made by: {command}"], console)
    if campaign.missed or campaign.idle or campaign.refusals:
        raise typer.Exit(_EXIT_MISSED)


def _console(*, is_report_elsewhere: bool) -> "Console":
    """Return the console of progress and tables; a file or a pipe is as wide as the tables."""
    from rich.console import Console

    console = Console(stderr=is_report_elsewhere)
    return console if console.is_terminal else Console(stderr=is_report_elsewhere, width=_FILE_WIDTH)


def _print(reported: "Sequence[report.ReportTable]", lines: list[str], console: "Console") -> None:
    """Print tables and what was missed."""
    from rich.table import Table

    for one in reported:
        table = Table(title=one.title, title_justify="left")
        for column in one.columns:
            table.add_column(column, overflow="fold")
        for row in one.rows:
            table.add_row(*row)
        console.print(table)
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False)


def _scenarios(named: list[str] | None, group: str | None) -> tuple[str, ...]:
    """Return what to run: what is named, a group, or both; everything where neither is."""
    from service.study.estimation.scenarios import GROUPS

    if group is not None and group not in GROUPS:
        typer.echo(f"no group {group!r}; there are {', '.join(GROUPS)}", err=True)
        raise typer.Exit(_EXIT_FAILED)
    grouped = GROUPS[group or "all"] if group or not named else ()
    return tuple(dict.fromkeys([*grouped, *(named or ())]))


def _run(
    plan: "CampaignPlan", run_campaign: "Callable[[CampaignPlan, Show], Campaign]", console: "Console"
) -> "Campaign":
    """Run the campaign behind a progress bar; away from a terminal it would be noise."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("worlds", total=None)
        return run_campaign(plan, lambda done, total: progress.update(task, completed=done, total=total))


def _draw(campaign: "Campaign", folder: Path) -> None:
    """Draw the figures of a campaign."""
    # matplotlib costs a second that only figures need
    from service.study.estimation.figures import draw_campaign

    folder.mkdir(parents=True, exist_ok=True)
    for path in draw_campaign(campaign, folder):
        typer.echo(f"drawn: {path}", err=True)


def _command(scenario: list[str] | None, group: str | None, seeds: int, operation_days: float | None) -> str:
    """Return the command that makes the same figures again."""
    words = ["soo", "study", "estimation"]
    words += [word for name in scenario or () for word in ("--scenario", name)]
    words += ["--group", group] if group else []
    words += ["--seeds", str(seeds)]
    words += ["--operation-days", f"{operation_days:g}"] if operation_days else []
    return shlex.join(words)
