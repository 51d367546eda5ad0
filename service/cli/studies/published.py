"""Rows of a reproduced paper as a table on the screen, a section of a page, or JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from service.study.published import Row


def report(rows: "Sequence[Row]", title: str, *, as_json: bool, as_markdown: bool) -> None:
    """Print the rows of a study."""
    from rich.console import Console
    from rich.table import Table

    from service.study.published import COLUMNS, markdown

    if as_json:
        typer.echo(json.dumps({"rows": [{**asdict(row), "ratio": row.ratio} for row in rows]}, allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(rows), nl=False)
    else:
        console = Console()
        table = Table(*COLUMNS, title=title, title_justify="left")
        for row in rows:
            table.add_row(*row.cells)
        (console if console.is_terminal else Console(width=160)).print(table)
