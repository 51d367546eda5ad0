"""``soo study orbital-frame``: the orbital-frame control of Meteor-M No. 2 beside its published figures.

Exit codes: 0 every figure but the one that is known not to reproduce does, 1 another one does not.
"""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.study.orbital_frame.reproduction import Row

#: the quantum's peaks without noise; why stands in docs/explanations/orbital-frame-control.md
KNOWN_MISSES = frozenset({("peak of yaw", "no noise"), ("peak of roll", "no noise")})
_COLUMNS = ("figure", "parameters", "paper", "reproduced", "ratio", "verdict")


def orbital_frame(
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON only.")] = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="Print the table as a section of a page.")] = False,
    figures: Annotated[
        Path | None, typer.Option(help="Draw figures 2, 3 and 4 into this folder.", file_okay=False)
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Compute without the compiler.")] = False,
) -> None:
    """Fly the orbital-frame model and print its figures beside the published ones."""
    from service.core.dynamics.orbital_frame_kernel import fly
    from service.pipeline.dynamics_kernels import flight_kernel
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
    if as_json:
        typer.echo(json.dumps({"rows": [{**asdict(row), "ratio": row.ratio} for row in rows]}, allow_nan=False))
    elif as_markdown:
        typer.echo(_markdown(rows), nl=False)
    else:
        _print(rows)
        console.print(f"{len(rows)} figures in {taken_s:.1f} s", highlight=False)
    if any(_is_surprising(row) for row in rows):
        raise typer.Exit(1)


def _is_surprising(row: "Row") -> bool:
    """Return whether a figure does not reproduce that should."""
    known = any(row.what == what and part in row.parameters for what, part in KNOWN_MISSES)
    return row.verdict == "not reproduced" and not known


def _cells(row: "Row") -> tuple[str, ...]:
    bound = "<= " if row.is_bound else ""
    unit = f" {row.unit}" if row.unit else ""
    return (
        row.what,
        row.parameters,
        f"{bound}{row.published:.4g}{unit}",
        f"{row.reproduced:.4g}{unit}",
        f"{row.ratio:.2f}",
        row.verdict.value,
    )


def _print(rows: "Sequence[Row]") -> None:
    console = Console()
    table = Table(*_COLUMNS, title="Orbital-frame control of Meteor-M No. 2", title_justify="left")
    for row in rows:
        table.add_row(*_cells(row))
    (console if console.is_terminal else Console(width=160)).print(table)


def _markdown(rows: "Sequence[Row]") -> str:
    lines = [f"| {' | '.join(_COLUMNS)} |", f"|{'---|' * len(_COLUMNS)}"]
    return "\n".join([*lines, *(f"| {' | '.join(_cells(row))} |" for row in rows)]) + "\n"
