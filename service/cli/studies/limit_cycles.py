"""``soo study limit-cycles``: tables and figures of the flexible spacecraft under relay-pulse control."""

import json
from typing import Annotated

import typer

from service.cli.studies.screen import EXIT_MISSED, AsJson, AsMarkdown, Figures, console_of, draw, print_tables

#: columns of a table that is written to a file
_FILE_WIDTH = 150


def limit_cycles(
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
    svg: Annotated[bool, typer.Option("--svg", help="Draw SVG in place of PNG.")] = False,
) -> None:
    """Reproduce limit cycles, capture and torque schedules of a flexible spacecraft."""
    # numba and the study cost half a second that no other command needs
    from service.study.limit_cycles.report import COLUMNS, as_document, cells, markdown, reproduce, summary_lines

    done = reproduce()
    suffix = "svg" if svg else "png"
    draw(figures, "limit_cycles", lambda study, folder: study.draw_figures(folder, suffix=suffix))
    if as_json:
        typer.echo(json.dumps(as_document(done), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(done), nl=False)
    else:
        tables = [(f"{one.name} {one.title}", COLUMNS, [cells(row) for row in one.rows]) for one in done.tables]
        print_tables(console_of(_FILE_WIDTH), tables, summary_lines(done))
    if done.missed:
        raise typer.Exit(EXIT_MISSED)
