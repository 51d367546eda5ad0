"""``soo openapi``: the reference of the REST interface as a document."""

from pathlib import Path
from typing import Annotated

import typer


def openapi(
    output: Annotated[Path | None, typer.Option(help="File to write; without it the document is printed.")] = None,
) -> None:
    """Write the OpenAPI document of this version."""
    # the web framework costs a quarter of a second that other commands need not pay
    from service.api.app import render_openapi

    text = render_openapi()
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
