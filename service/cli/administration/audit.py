"""``soo audit``: the audit log of a database, looked at without the service.

Exit codes of ``verify``: 0 the chain is whole, 1 it is not, 2 there is nothing to look at.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import JsonOption
from service.errors import StorageError
from service.records.operations.access import ChainFinding, findings

app = new_app(help="The audit log: who did what, chained by hashes.", no_args_is_help=True)
EXIT_BROKEN = 1
_LOGGED = re.compile(r"audit head (\d+) ([0-9a-f]{64})")
_NOTED = re.compile(r"(\d+):([0-9a-f]{64})")


@app.callback()
def audit() -> None:
    """Look at the audit log of a database, without the service."""


@app.command()
def verify(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; default that of the settings.")] = None,
    head: Annotated[
        list[str] | None, typer.Option(help="NUMBER:HASH noted elsewhere; may be given many times.")
    ] = None,
    log: Annotated[list[Path] | None, typer.Option(help="Log of the service; the heads in it must hold.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Tell whether entries were changed, removed, put in or cut off."""
    # imported here so that other commands start without the database
    from service.composition.bootstrap import open_storage
    from service.composition.settings import Settings

    announced = _noted(head or []) | _logged(log or [])
    try:
        storage = open_storage(Settings.model_validate({"database_url": database} if database else {}))
    except (StorageError, ValueError) as error:
        end(f"cannot use the database: {error}")
    try:
        newest = storage.audit.head()
        found = list(findings(storage.audit.chain(), newest, announced, storage.audit.head))
    except StorageError as error:
        end(error.detail)
    finally:
        storage.close()
    if as_json:
        reported = [asdict(each) for each in found]
        typer.echo(
            json.dumps({"number": newest.number, "hash": newest.hash, "heads": len(announced), "findings": reported})
        )
    else:
        _report(f"{newest.number} entries, newest hash {newest.hash}, {len(announced)} heads noted elsewhere", found)
    if found:
        raise typer.Exit(EXIT_BROKEN)


def _report(summary: str, found: Sequence[ChainFinding]) -> None:
    """Print what was found."""
    for each in found:
        typer.echo(f"entry {each.number}: {each.kind}: {each.detail}")
    typer.echo(f"{'BROKEN' if found else 'whole'}: {summary}")


def _noted(heads: Sequence[str]) -> dict[int, str]:
    """Return hashes by number of heads given on the command line."""
    found = {}
    for text in heads:
        match = _NOTED.fullmatch(text)
        if match is None:
            end(f"a head reads NUMBER:HASH with 64 hexadecimal digits, not {text!r}")
        found[int(match[1])] = match[2]
    return found


def _logged(logs: Sequence[Path]) -> dict[int, str]:
    """Return hashes by number of heads that the service announced in its log."""
    # number 0 is the empty log
    return {int(number): text for number, text in logged(_LOGGED, logs) if number != "0"}


def logged(pattern: re.Pattern[str], logs: Sequence[Path]) -> Iterator[tuple[str, ...]]:
    """Yield the groups of every match of a pattern in logs; ends the command where one cannot be read."""
    for path in logs:
        try:
            with path.open(encoding="utf-8", errors="replace") as lines:
                for line in lines:
                    yield from (match.groups() for match in pattern.finditer(line))
        except OSError as error:
            end(f"cannot read {path}: {error.strerror}")
