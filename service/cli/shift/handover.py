"""Pages for the next shift and for the file: ``soo handover``, ``soo report``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from service.cli.command_group import end, require
from service.cli.operation import connection
from service.cli.shift.pages import PageFormat, Section, handover_sections, page
from service.cli.shift.tables import utc
from service.client.documents import Json
from service.records.epoch import US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

Format = Annotated[PageFormat, typer.Option("--format", help="md or html.")]
Output = Annotated[Path | None, typer.Option(help="File to write; default: standard output.", dir_okay=False)]
_HOURS = {"day": 24, "shift": 8}


@connection.on_service
def handover(
    client: "ServiceClient",
    spacecraft: connection.SpacecraftOption,
    format_: Format = "md",
    output: Output = None,
    as_json: connection.JsonOption = False,
) -> None:
    """Write what the next shift must know: alarms, control, operations, links, what ends, notes."""
    found = client.request("GET", f"/spacecraft/{spacecraft}/handover")
    row, control = Json(client.attitude(spacecraft)), Json(client.control(spacecraft))
    if as_json:
        _deliver(json.dumps(found) + "\n", output)
        return
    title = f"{spacecraft}, {utc(found['at'])} UTC"
    _deliver(_written(lambda: page(title, handover_sections(found, row, control), format_)), output)


@connection.on_service
def report(
    client: "ServiceClient",
    span: Annotated[Literal["day", "shift"], typer.Argument(help="day: 24 h, shift: 8 h.")],
    spacecraft: connection.SpacecraftOption,
    format_: Format = "html",
    output: Output = None,
) -> None:
    """Write a report of the last day or shift with figures, then the hand-over."""
    require("matplotlib")
    # numpy and matplotlib cost more than the command line itself
    from service.cli.shift.day import drawn, figures, happened, samples_of

    found = client.request("GET", f"/spacecraft/{spacecraft}/handover")
    row, control = Json(client.attitude(spacecraft)), Json(client.control(spacecraft))
    stop_us = parse_epoch(found["at"]) + 1
    window = {"start": format_epoch(stop_us - _HOURS[span] * 3600 * US_PER_S), "stop": format_epoch(stop_us)}
    wanted = window | {"method": found["control"]["method"]}
    samples = samples_of(client, spacecraft, wanted)
    timeline = client.request("GET", f"/spacecraft/{spacecraft}/timeline", params=wanted)
    title = f"{spacecraft}, {utc(window['start'])} – {utc(window['stop'])} UTC"

    def made() -> str:
        sections = [Section("Figures", figures(samples)), Section("What happened", happened(timeline))]
        return page(title, sections + handover_sections(found, row, control), format_, drawn(samples))

    _deliver(_written(made), output)


def _written(make: Callable[[], str]) -> str:
    """Return a page; end the command where the service is too old to fill it."""
    try:
        return make()
    except KeyError as error:
        end(f"the answer of the service has no {error}: {connection.OLDER}", 1, error)


def _deliver(text: str, output: Path | None) -> None:
    """Write a page into a file or to standard output."""
    if output is None:
        typer.echo(text, nl=False)
        return
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        end(f"{output}: {error.strerror or error}", cause=error)
