"""Orders that a person gives: ``soo ack``, ``soo shelve``, ``soo note``."""

from typing import Annotated

import typer

from service.cli.command_group import end
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)
from service.cli.shift.tables import alarm_line, show
from service.cli.shift.words import clean, utc
from service.records.epoch import US_PER_S, format_epoch, parse_epoch

Comment = Annotated[str, typer.Option(help="Comment for the shift log.")]
AlarmId = Annotated[int, typer.Argument(help="Id of the alarm, as `soo alarms` lists it.", min=1)]


def ack(
    alarm: AlarmId,
    comment: Comment = "",
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Acknowledge an alarm; no further notice unless it becomes worse or comes back."""
    with connected(service, key_env) as client:
        found = client.request("POST", f"/alarms/{alarm}:acknowledge", {"comment": comment})
    show(found, lambda: [alarm_line(found)], as_json=as_json)


def shelve(
    alarm: AlarmId,
    spacecraft: SpacecraftOption,
    hours: Annotated[float, typer.Option(help="For how long, h.", min=0.01, max=24.0)] = 1.0,
    comment: Comment = "",
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Keep an alarm quiet for some hours of the spacecraft's clock."""
    with connected(service, key_env) as client:
        now = client.status(spacecraft)["now"]
        if now is None:
            end(f"{spacecraft} has no present before its first row, so nothing can be shelved until an instant", 1)
        until = format_epoch(parse_epoch(now) + round(hours * 3600 * US_PER_S))
        found = client.request("POST", f"/alarms/{alarm}:shelve", {"until": until, "comment": comment})
    show(found, lambda: [f"shelved until {utc(until)} UTC", alarm_line(found)], as_json=as_json)


def note(
    text: Annotated[str, typer.Argument(help="Text of the note.")],
    spacecraft: SpacecraftOption,
    corrects: Annotated[int | None, typer.Option(help="Id of the note that this one corrects.", min=1)] = None,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Write a note into the shift log."""
    body = {"text": text, "spacecraft_id": spacecraft, "corrects": corrects}
    with connected(service, key_env) as client:
        found = client.request("POST", "/notes", body)
    show(found, lambda: [f"note {found['id']} of {utc(found['epoch'])} UTC: {clean(found['text'])}"], as_json=as_json)
