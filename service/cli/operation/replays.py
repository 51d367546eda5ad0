"""Versions of results that replays wrote: list them, delete one."""

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.operation.connection import JsonOption, SpacecraftOption, on_service

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


@on_service
def replays(
    client: "ServiceClient",
    spacecraft: SpacecraftOption,
    delete: Annotated[int | None, typer.Option(help="Delete the replay of this number first.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the versions that replays wrote, or delete one."""
    if delete is not None:
        client.delete_replay(spacecraft, delete)
    listed = list(client.replays(spacecraft))
    for each in listed:
        typer.echo(json.dumps(each) if as_json else _line(each))


def _line(each: dict[str, Any]) -> str:
    """Return one replay as a line."""
    state = each["state"] if each["state"] in {"done", "failed"} else f"{each['state']} {each['progress']:.0%}"
    figures = f"{each['attitude_rows']} rows, {each['torque_rows']} torques, {each['size_bytes'] / 1e6:.1f} MB"
    return f"{each['version']}  {each['start']} to {each['stop']}  {state}  {figures}"
