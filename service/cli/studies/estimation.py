"""``soo study estimation``: campaigns of both methods on simulated truth.

Exit codes: 0 every bound kept, 1 one missed or a world refused, 2 the study could not be run.
"""

import json
import shlex
from typing import Annotated

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

#: columns of a table that is written to a file
_FILE_WIDTH = 150


def estimation(
    scenario: Annotated[list[str] | None, typer.Option(help="Scenario to run; may be given many times.")] = None,
    group: Annotated[str | None, typer.Option(help="Scenarios of a group; default `all` where none is named.")] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Seeds 1 to this number for each scenario.")] = 10,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    scheduler: Scheduler = None,
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Run both methods over simulated worlds and hold their figures against the bounds."""
    # these cost half a second that no other command needs
    from concurrent.futures import BrokenExecutor

    from service.study.estimation.campaign import CampaignPlan, run_campaign
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.estimation.report import as_document, markdown, tables, verdict_lines
    from service.study.executors import ClusterError, WorkerChoice

    plan = CampaignPlan(_scenarios(scenario, group), seeds, WorkerChoice(workers, scheduler), operation_days)
    with failures_shown(ExportFailedError, BrokenExecutor, ClusterError, OSError), counted("worlds") as show:
        campaign = run_campaign(plan, show)
    draw(figures, "estimation", lambda study, folder: study.draw_campaign(campaign, folder))
    command = _command(scenario, group, seeds, operation_days)
    if as_json:
        typer.echo(json.dumps(as_document(campaign, command), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign, command), nl=False)
    else:
        lines = [*verdict_lines(campaign), f"made by: {command}"]
        print_tables(console_of(_FILE_WIDTH), tables(campaign), lines)
    if campaign.missed or campaign.idle or campaign.refusals:
        raise typer.Exit(EXIT_MISSED)


def _scenarios(named: list[str] | None, group: str | None) -> tuple[str, ...]:
    """Return the scenarios to run: those named, a group, or both; all where neither is given."""
    from service.study.estimation.campaign import GROUPS

    if group is not None and group not in GROUPS:
        end(f"no group {group!r}; there are {', '.join(GROUPS)}")
    grouped = GROUPS[group or "all"] if group or not named else ()
    return tuple(dict.fromkeys([*grouped, *(named or ())]))


def _command(scenario: list[str] | None, group: str | None, seeds: int, operation_days: float | None) -> str:
    """Return the command that makes the same figures again."""
    words = ["soo", "study", "estimation"]
    words += [word for name in scenario or () for word in ("--scenario", name)]
    words += ["--group", group] if group else []
    words += ["--seeds", str(seeds)]
    words += ["--operation-days", f"{operation_days:g}"] if operation_days else []
    return shlex.join(words)
