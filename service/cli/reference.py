"""``soo openapi`` and ``soo settings``: references that the code itself writes."""

import json
from pathlib import Path
from typing import Annotated

import typer

Output = Annotated[Path | None, typer.Option(help="File to write; without it the document is printed.")]


def openapi(
    types: Annotated[bool, typer.Option("--types", help="Types of the Python client instead of the document.")] = False,
    output: Output = None,
) -> None:
    """Write the OpenAPI document of this version."""
    # the web framework costs a quarter of a second that other commands need not pay
    from service.api.app import render_openapi

    document = render_openapi()
    if types:
        from service.cli.client_types import client_types

        document = client_types(json.loads(document))
    _deliver(document, output)


def settings(
    markdown: Annotated[bool, typer.Option("--markdown", help="The reference page instead of values.")] = False,
    output: Output = None,
) -> None:
    """Print the settings in force, or the reference of all settings."""
    from service.cli.settings_reference import settings_markdown, settings_text
    from service.composition.settings import Settings

    _deliver(settings_markdown() if markdown else settings_text(Settings.model_validate({})) + "\n", output)


def _deliver(text: str, output: Path | None) -> None:
    """Write a document to a file, or print it."""
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
