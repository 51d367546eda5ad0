"""``soo control``: orders to the interlock. Exit codes: 0 the service confirmed the order, 1 it did not."""

import os
import sys
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
    on_service,
)
from service.cli.shift.tables import clean, command_facts, meaning, reasons_table, screen, show, utc, words
from service.client.documents import Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType

    from service.client.service_client import ServiceClient


control_app = new_app(help="Control: arm, stop, reset.", no_args_is_help=True)
Comment = Annotated[str, typer.Option(help="Comment for the shift log.")]


@control_app.command()
@on_service
def arm(
    client: "ServiceClient", spacecraft: SpacecraftOption, comment: Comment = "", as_json: JsonOption = False
) -> None:
    """Arm: commands may be prepared and confirmed."""
    _show(Json(client.order_control(spacecraft, "arm", comment)), spacecraft, as_json=as_json)


@control_app.command()
@on_service
def stop(
    client: "ServiceClient", spacecraft: SpacecraftOption, comment: Comment = "", as_json: JsonOption = False
) -> None:
    """Stop: no torque goes out until somebody resets."""
    # httpx costs more than the command line itself
    from service.client.problem import ClientError

    try:
        found = Json(client.order_control(spacecraft, "stop", comment))
    except ClientError as error:
        end(f"{words('app.stop.failed', spacecraft=spacecraft)}\n{clean(error)}", 1, error)
    if found["state"] != "TRIPPED":
        end(f"{words('app.stop.failed', spacecraft=spacecraft)}\nthe service says {clean(found['state'])}", 1)
    _show(found, spacecraft, as_json=as_json)


@control_app.command()
@on_service
def reset(
    client: "ServiceClient", spacecraft: SpacecraftOption, comment: Comment = "", as_json: JsonOption = False
) -> None:
    """Reset a trip whose cause is over; ten good minutes and an arming follow."""
    _show(Json(client.order_control(spacecraft, "reset", comment)), spacecraft, as_json=as_json)


def _show(control: Json, spacecraft: str, *, as_json: bool) -> None:
    """Print the state of the interlock after an order."""

    def parts() -> "Iterator[RenderableType]":
        yield f"{spacecraft}: {meaning('states', control['state'])}; since {utc(control['since'])} UTC"
        if control["control"]["reasons"]:
            yield reasons_table(control["control"]["reasons"])

    show(control, parts, as_json=as_json)


torque_app = new_app(help="Release of torques by two persons: prepare, confirm, report.", no_args_is_help=True)
EXIT_CHECK_FAILED = 3
#: characters of a digest that show that a person has read it
LEAST_DIGEST = 8
CommandId = Annotated[int, typer.Argument(help="Id of the command.", min=1)]


@torque_app.command()
@on_service
def prepare(
    client: "ServiceClient",
    reason: Annotated[str, typer.Argument(help="Reason of the command, kept with it.")],
    spacecraft: SpacecraftOption,
    start: Annotated[str | None, typer.Option(help="RFC 3339 start; default: as soon as can be.")] = None,
    duration_s: Annotated[float | None, typer.Option(help="Length of the schedule, s.")] = None,
    max_torque_n_m: Annotated[float | None, typer.Option(help="Greatest torque of a pulse, N m.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the command and its checks, store nothing.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Prepare a command that waits for another person."""
    prepared = client.prepare_torques(
        spacecraft, reason, start=start, duration_s=duration_s, max_torque_n_m=max_torque_n_m, dry_run=dry_run
    )
    show(prepared, lambda: command_facts(Json(prepared)), as_json=as_json)
    if not all(check["ok"] for check in prepared["checks"]):
        raise typer.Exit(EXIT_CHECK_FAILED)


@torque_app.command()
def confirm(
    command: CommandId,
    spacecraft: SpacecraftOption,
    digest: Annotated[
        str | None, typer.Option(help="Digest of the command, 8 characters at least; asked for on a terminal.")
    ] = None,
    second_key_env: Annotated[
        str, typer.Option(help="Environment variable with the second person's key; asked for on a terminal.")
    ] = "SOO_SECOND_KEY",
    comment: Annotated[str, typer.Option(help="Comment, kept with the command.")] = "",
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Show a prepared command, then release it by the key of the second person and the digest."""
    is_asking = sys.stdin.isatty()
    if digest is None and not is_asking:
        end("state --digest: the command is confirmed by the digest that the second person has read")
    with connected(service, key_env) as client:
        shown = client.command(spacecraft, command)
    console = screen(is_error=as_json)
    for part in command_facts(Json(shown)):
        console.print(part)
    if shown["state"] != "PREPARED":
        end(f"command {command} is {shown['state']}; only a prepared command can be confirmed", 1)
    stated = digest if digest is not None else typer.prompt("Digest of the command (8 characters at least)", err=True)
    stated = stated.strip().lower()
    if len(stated) < LEAST_DIGEST or not shown["digest"].startswith(stated):
        end(f"the digest of command {command} is another one, or less than {LEAST_DIGEST} characters; nothing was sent")
    if is_asking and not (os.environ.get(second_key_env) or os.environ.get(f"{second_key_env}_FILE")):
        os.environ[second_key_env] = typer.prompt("Key of the second person", hide_input=True, err=True).strip()
    with connected(service, second_key_env) as client:
        # the digest that was shown: the service refuses it when the command is another one by now
        confirmed = client.confirm_torques(spacecraft, command, shown["digest"], comment)
    show(confirmed, lambda: [f"command {command}: {confirmed['state']}"], as_json=as_json)


@torque_app.command()
@on_service
def report(
    client: "ServiceClient",
    command: CommandId,
    outcome: Annotated[Literal["sent", "executed", "failed"], typer.Argument(help="sent, executed or failed.")],
    spacecraft: SpacecraftOption,
    executed_from: Annotated[str | None, typer.Option(help="RFC 3339 start of the executed part.")] = None,
    executed_until: Annotated[str | None, typer.Option(help="RFC 3339 end of the executed part.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Report what became of a released command; the same report again changes nothing."""
    found = client.report_torques(
        spacecraft, command, outcome, executed_from=executed_from, executed_until=executed_until
    )
    show(found, lambda: [f"command {command}: {found['state']}"], as_json=as_json)
