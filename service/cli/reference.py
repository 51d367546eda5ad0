"""``soo openapi`` and ``soo settings``: references that the code itself writes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from service.composition.settings import Settings


def settings_markdown() -> str:
    """Return the page of settings: defaults, whatever the environment says."""
    # validation costs more than the command line itself
    from service.composition.settings import Settings, setting_entries
    from service.records.setting import ORIGINS

    origins = "\n".join(f"* *{word}*: {meaning}" for word, meaning in ORIGINS.items())
    rows = "\n".join(
        f"| `{entry.name}` | {entry.default} | {entry.meaning} | {entry.origin} |"
        for entry in setting_entries(Settings.model_construct())
    )
    return f"{_HEAD}\n{origins}\n\n| variable | default | meaning | origin |\n|---|---|---|---|\n{rows}\n"


def settings_text(settings: "Settings") -> str:
    """Return the values in force, one line a setting; what differs from its default is marked."""
    from service.composition.settings import setting_entries

    entries = list(setting_entries(settings))
    width = max(len(entry.name) for entry in entries)
    return "\n".join(
        f"{'*' if entry.value != entry.default else ' '} {entry.name:{width}} {entry.value}" for entry in entries
    )


_HEAD = """# Settings

Made by `soo settings --markdown`; `tests/docs/test_reference.py` holds page and code together. Settings are read once,
from the environment, or from the folder that `SOO_SECRETS_DIR` names, which has a file for each, called as the variable
(`soo_bootstrap_key`). A double underscore leads into the configuration of a stage:
`SOO_INTERLOCK__VALIDITY_LIMIT_DEG=0.35`. `soo settings` prints the values in force and marks what was changed; the
database, address, port, clock and the files of TLS can be given to `soo serve` as options, which win.

The column *origin* says where a default comes from:
"""


Output = Annotated[Path | None, typer.Option(help="File to write; without it the document is printed.")]


def openapi(output: Output = None) -> None:
    """Write the OpenAPI document of this version."""
    # the web framework costs a quarter of a second that other commands need not pay
    from service.api.app import render_openapi

    _deliver(render_openapi(), output)


def settings(
    markdown: Annotated[bool, typer.Option("--markdown", help="The reference page instead of values.")] = False,
    output: Output = None,
) -> None:
    """Print the settings in force, or the reference of all settings."""
    from service.composition.settings import Settings

    _deliver(settings_markdown() if markdown else settings_text(Settings.model_validate({})) + "\n", output)


def _deliver(text: str, output: Path | None) -> None:
    """Write a document to a file, or print it."""
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
