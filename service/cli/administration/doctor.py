"""``soo doctor``: looks at an archive and says in plain words what is wrong and what to do.

Exit codes: 0 sound, 1 something is damaged or does not work, 2 the option is wrong, 3 it works, with warnings.
"""

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from service.cli.administration.audit import logged
from service.cli.command_group import end
from service.cli.operation.connection import JsonOption
from service.records.storage import Diagnosis, State, worst

EXIT_OF: dict[State, int] = {"ok": 0, "fault": 1, "warning": 3}
_LOGGED = re.compile(r"journal head ([a-z0-9-]+) (\d+) ([0-9a-f]{16})")
_COLOURS: dict[State, str] = {"ok": "green", "warning": "yellow", "fault": "red"}


def doctor(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    log: Annotated[
        list[Path] | None, typer.Option(help="Log of the service; the journals must hold the entries that it names.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Look at an archive, also of a running service, and say what is wrong and what to do."""
    from rich.console import Console

    # the database costs time that other commands need not pay
    from service.composition.bootstrap import open_archive_tools
    from service.records.inputs import JournalHead

    announced = [JournalHead(name, int(number), digest) for name, number, digest in logged(_LOGGED, log or [])]
    if log and not announced:
        end("the log names no head of a journal: lines `journal head SPACECRAFT NUMBER DIGEST`")
    try:
        with Console(stderr=True).status("opening") as status:
            found = open_archive_tools(database).diagnose(status.update, announced)
    except ValueError as error:
        end(str(error), cause=error)
    show(found, as_json=as_json)
    raise typer.Exit(EXIT_OF[worst(found)])


def show(found: list[Diagnosis], *, as_json: bool) -> None:
    """Print diagnoses."""
    from rich.console import Console
    from rich.table import Table

    if as_json:
        typer.echo(json.dumps({"state": worst(found), "checks": [asdict(diagnosis) for diagnosis in found]}))
        return
    table = Table("check", "state", "what is there, and what to do")
    for diagnosis in found:
        words = diagnosis.detail + (f"\n[bold]{diagnosis.advice}[/bold]" if diagnosis.advice else "")
        colour = _COLOURS[diagnosis.state]
        table.add_row(diagnosis.check, f"[{colour}]{diagnosis.state}[/{colour}]", words)
    Console().print(table)
