"""``soo keys``: access keys made, listed and revoked over the REST interface."""

import json
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import new_app
from service.cli.operation.connection import JsonOption, on_service

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


app = new_app(help="Access keys of a service: make, list, revoke.", no_args_is_help=True)


@app.command()
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


@app.command(name="list")
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


@app.command()
@on_service
def revoke(client: "ServiceClient", key_id: Annotated[str, typer.Argument(help="Id of the key, not the key.")]) -> None:
    """Make a key worthless, at once."""
    client.request("DELETE", f"/keys/{key_id}")
    typer.echo(f"key {key_id} is revoked")
