"""``soo study limit-cycles``: tables and figures of the flexible spacecraft under relay-pulse control."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.study.limit_cycles.report import Reproduction

#: columns of a table that is written to a file
_FILE_WIDTH = 150
_EXIT_MISSED = 1


def limit_cycles(
    as_json: Annotated[bool, typer.Option("--json", help="Print the tables as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the tables as sections of a page.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Draw the figures into this folder.", file_okay=False)] = None,
    svg: Annotated[bool, typer.Option("--svg", help="Draw SVG in place of PNG.")] = False,
) -> None:
    """Reproduce limit cycles, capture and torque schedules of a flexible spacecraft."""
    # numba and the study cost half a second that no other command needs
    from service.study.limit_cycles.report import as_document, markdown, reproduce

    done = reproduce()
    if figures is not None:
        _draw(figures, "svg" if svg else "png")
    if as_json:
        typer.echo(json.dumps(as_document(done), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(done), nl=False)
    else:
        _print(done)
    if done.missed:
        raise typer.Exit(_EXIT_MISSED)


def _draw(folder: Path, suffix: str) -> None:
    """Draw the figures."""
    # matplotlib costs a second that only figures need
    from service.study.limit_cycles.figures import draw_figures

    folder.mkdir(parents=True, exist_ok=True)
    for path in draw_figures(folder, suffix=suffix):
        typer.echo(f"drawn: {path}", err=True)


def _print(done: "Reproduction") -> None:
    """Print tables, what was missed, and the time."""
    from rich.console import Console
    from rich.table import Table

    from service.study.limit_cycles.report import COLUMNS, cells, summary_lines

    console = Console()
    if not console.is_terminal:
        console = Console(width=_FILE_WIDTH)
    for compared in done.tables:
        table = Table(title=f"{compared.name} {compared.title}", title_justify="left")
        for column in COLUMNS:
            table.add_column(column, overflow="fold")
        for row in compared.rows:
            table.add_row(*cells(row))
        console.print(table)
    for line in summary_lines(done):
        console.print(line, soft_wrap=True, highlight=False)
