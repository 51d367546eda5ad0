"""``soo study orbital-frame``: the orbital-frame control of Meteor-M No. 2 beside its published figures.

Exit codes: 0 every figure but those that are known not to reproduce does, 1 another one does not.
"""

import time
from pathlib import Path
from typing import Annotated

import typer

from service.cli.studies.published import report


def orbital_frame(
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the table as a section of a page.")] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Draw figures 2, 3 and 4 into this folder.", file_okay=False)
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Compute without the compiler.")] = False,
) -> None:
    """Fly the orbital-frame model and print its figures beside the published ones."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from service.core.dynamics.orbital_frame_kernel import fly
    from service.pipeline.kernels import flight_kernel
    from service.study.orbital_frame.reproduction import reproduce

    console = Console(stderr=True)
    kernel = fly if plain else flight_kernel()
    began_s = time.monotonic()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        rows = reproduce(kernel, lambda what: progress.update(task, description=what))
    taken_s = time.monotonic() - began_s
    if figures is not None:
        # matplotlib costs a second that only figures need
        from service.study.orbital_frame.figures import draw_reproduction

        figures.mkdir(parents=True, exist_ok=True)
        for path in draw_reproduction(kernel, figures):
            console.print(f"drawn: {path}", highlight=False)
    report(rows, "Orbital-frame control of Meteor-M No. 2", as_json=as_json, as_markdown=as_markdown)
    console.print(f"{len(rows)} figures in {taken_s:.1f} s", highlight=False)
    if any(one.is_surprising for one in rows):
        raise typer.Exit(1)
