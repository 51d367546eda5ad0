"""``soo study rf-attitude``: attitude from retransmitted carriers on Yamal-200 beside its published figures.

Exit codes: 0 every figure but those that are known not to reproduce does, 1 another one does not, 2 nothing was run.
"""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.studies.published import report


def rf_attitude(
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Simulated worlds 1 to this number.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the table as a section of a page.")] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Draw figures 1, 2 and 3 into this folder.", file_okay=False)
    ] = None,
) -> None:
    """Fit the published daily curve and compare sessions with other sensors, beside the published figures."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from service.study.estimation.flight.drive import UndrivenError
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.rf_attitude.reproduction import reproduce

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    try:
        with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
            task = progress.add_task("", total=None)
            rows, sessions = reproduce(seeds, lambda what: progress.update(task, description=what))
    except (ExportFailedError, UndrivenError, OSError) as error:
        typer.echo(f"the study failed: {error}", err=True)
        raise typer.Exit(2) from error
    if figures is not None:
        # matplotlib costs a second that only figures need
        from service.study.rf_attitude.figures import draw_reproduction

        figures.mkdir(parents=True, exist_ok=True)
        for path in draw_reproduction(sessions[0], figures):
            console.print(f"drawn: {path}", highlight=False)
    report(rows, "Attitude from retransmitted carriers, Yamal-200", as_json=as_json, as_markdown=as_markdown)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(1)
