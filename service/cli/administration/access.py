"""Access from outside: keys of a service, and the audit log of a database, looked at without the service.

Exit codes of ``audit verify``: 0 the chain is whole, 1 it is not, 2 there is nothing to look at.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import JsonOption, on_service
from service.errors import StorageError
from service.records.operations.access import ChainFinding, findings

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


keys_app = new_app(help="Access keys of a service: make, list, revoke.", no_args_is_help=True)


@keys_app.command()
@on_service
def create(
    client: "ServiceClient",
    name: Annotated[str, typer.Option(help="Who will hold it; it stands in the audit log.")],
    role: Annotated[str, typer.Option(help="viewer, station, operator, approver or admin.")],
    expires: Annotated[str | None, typer.Option(help="RFC 3339 instant from which it is no longer valid.")] = None,
    station: Annotated[str | None, typer.Option(help="Station of a key of role station; by default its name.")] = None,
    spacecraft: Annotated[list[str] | None, typer.Option(help="Only for this spacecraft; repeatable.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only this kind, such as powers; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a key and print it; nobody can read it again."""
    bound = {"station": station, "spacecraft": spacecraft or None, "kinds": kind or None}
    made = client.request("POST", "/keys", {"name": name, "role": role, "expires_at": expires, **bound})
    if as_json:
        typer.echo(json.dumps(made))
        return
    # the key alone on standard output: it goes straight into a file or a variable
    typer.echo(f"key {made['id']} ({made['role']}) of {made['name']}, shown this once:", err=True)
    typer.echo(made["key"])


@keys_app.command(name="list")
@on_service
def list_keys(
    client: "ServiceClient",
    revoked: Annotated[bool, typer.Option("--revoked", help="List revoked keys too.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List keys without their secrets."""
    rows = client.request("GET", "/keys", params={"revoked": str(revoked).lower()})["rows"]
    if as_json:
        typer.echo(json.dumps(rows))
        return
    for row in rows:
        expires, used = row["expires_at"] or "never", row["last_used_at"] or "never"
        typer.echo(f"{row['id']}  {row['state']:7}  {row['role']:8}  expires {expires}  used {used}  {row['name']}")


@keys_app.command()
@on_service
def revoke(client: "ServiceClient", key_id: Annotated[str, typer.Argument(help="Id of the key, not the key.")]) -> None:
    """Make a key worthless, at once."""
    client.request("DELETE", f"/keys/{key_id}")
    typer.echo(f"key {key_id} is revoked")


audit_app = new_app(help="The audit log: who did what, chained by hashes.", no_args_is_help=True)
EXIT_BROKEN = 1
_LOGGED = re.compile(r"audit head (\d+) ([0-9a-f]{64})")
_NOTED = re.compile(r"(\d+):([0-9a-f]{64})")


@audit_app.callback()
def audit() -> None:
    """Look at the audit log of a database, without the service."""


@audit_app.command()
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
