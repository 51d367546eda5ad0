"""``soo control``: orders to the interlock. Exit codes: 0 the service confirmed the order, 1 it did not."""

from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import JsonOption, SpacecraftOption, on_service
from service.cli.shift.tables import clean, meaning, reasons_table, show, utc, words
from service.client.documents import Json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType

    from service.client.service_client import ServiceClient

app = new_app(help="Control: arm, stop, reset.", no_args_is_help=True)
Comment = Annotated[str, typer.Option(help="Comment for the shift log.")]


@app.command()
@on_service
def arm(
    client: "ServiceClient", spacecraft: SpacecraftOption, comment: Comment = "", as_json: JsonOption = False
) -> None:
    """Arm: commands may be prepared and confirmed."""
    _show(Json(client.order_control(spacecraft, "arm", comment)), spacecraft, as_json=as_json)


@app.command()
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


@app.command()
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
