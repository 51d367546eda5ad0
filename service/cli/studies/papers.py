"""``soo study limit-cycles``, ``orbital-frame`` and ``rf-attitude``: reproductions of papers beside their figures."""

import json
import time
from typing import Annotated

import typer

from service.cli.studies.screen import (
    EXIT_MISSED,
    AsJson,
    AsMarkdown,
    Figures,
    console_of,
    draw,
    failures_shown,
    named_steps,
    print_tables,
    report,
)

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


def orbital_frame(
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
    plain: Annotated[bool, typer.Option("--plain", help="Compute without the compiler.")] = False,
) -> None:
    """Fly the orbital-frame model and print its figures beside the published ones."""
    from service.core.dynamics.orbital_frame_kernel import compiled_fly, fly
    from service.study.orbital_frame.reproduction import reproduce

    kernel = fly if plain else compiled_fly()
    began_s = time.monotonic()
    with named_steps() as show:
        rows = reproduce(kernel, show)
    taken_s = time.monotonic() - began_s
    draw(figures, "orbital_frame", lambda study, folder: study.draw_reproduction(kernel, folder))
    report(rows, "Orbital-frame control of Meteor-M No. 2", as_json=as_json, as_markdown=as_markdown)
    typer.echo(f"{len(rows)} figures in {taken_s:.1f} s", err=True)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(EXIT_MISSED)


def rf_attitude(
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Simulated worlds 1 to this number.")] = 2,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Fit the published daily curve and compare sessions with other sensors, beside the published figures."""
    from service.study.estimation.flight.drive import UndrivenError
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.rf_attitude.reproduction import reproduce

    with failures_shown(ExportFailedError, UndrivenError, OSError), named_steps() as show:
        rows, sessions = reproduce(seeds, show)
    draw(figures, "rf_attitude", lambda study, at: study.draw_reproduction(sessions[0], at))
    report(rows, "Attitude from retransmitted carriers, Yamal-200", as_json=as_json, as_markdown=as_markdown)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(EXIT_MISSED)
