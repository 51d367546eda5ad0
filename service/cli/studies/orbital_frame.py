"""``soo study orbital-frame``: the orbital-frame control of Meteor-M No. 2 beside its published figures.

Exit codes: 0 every figure but those that are known not to reproduce does, 1 another one does not.
"""

import time
from typing import Annotated

import typer

from service.cli.studies.published import report
from service.cli.studies.screen import EXIT_MISSED, AsJson, AsMarkdown, Figures, draw, named_steps


def orbital_frame(
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
    plain: Annotated[bool, typer.Option("--plain", help="Compute without the compiler.")] = False,
) -> None:
    """Fly the orbital-frame model and print its figures beside the published ones."""
    from service.core.dynamics.orbital_frame_kernel import fly
    from service.pipeline.kernels import flight_kernel
    from service.study.orbital_frame.reproduction import reproduce

    kernel = fly if plain else flight_kernel()
    began_s = time.monotonic()
    with named_steps() as show:
        rows = reproduce(kernel, show)
    taken_s = time.monotonic() - began_s
    draw(figures, "orbital_frame", lambda study, folder: study.draw_reproduction(kernel, folder))
    report(rows, "Orbital-frame control of Meteor-M No. 2", as_json=as_json, as_markdown=as_markdown)
    typer.echo(f"{len(rows)} figures in {taken_s:.1f} s", err=True)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(EXIT_MISSED)
