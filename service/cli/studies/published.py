"""Rows of a reproduced paper as a table on the screen, a section of a page, or JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from service.cli.studies.screen import console_of, print_tables

if TYPE_CHECKING:
    from service.study.published import Row


#: columns of a table that is written to a file
_FILE_WIDTH = 160


def report(rows: "Sequence[Row]", title: str, *, as_json: bool, as_markdown: bool) -> None:
    """Print the rows of a study."""
    from service.study.published import COLUMNS, markdown

    if as_json:
        typer.echo(json.dumps({"rows": [{**asdict(row), "ratio": row.ratio} for row in rows]}, allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(rows), nl=False)
    else:
        print_tables(console_of(_FILE_WIDTH), [(title, COLUMNS, [row.cells for row in rows])])
