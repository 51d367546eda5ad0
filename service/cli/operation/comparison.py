"""``soo compare``: two versions of the attitude history row by row.

Rows belong together that have the same epoch, the first of one epoch with the first, and so on.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end, require
from service.cli.operation import connection

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.client.service_client import ServiceClient


_LIVE = "live"


@connection.on_service
def compare(
    client: "ServiceClient",
    first: Annotated[str, typer.Argument(help="Version: `live`, or `replay-1` and so on.")],
    second: Annotated[str, typer.Argument(help="The other version; differences are this one minus the first.")],
    spacecraft: connection.SpacecraftOption,
    start: Annotated[str | None, typer.Option(help="From here, RFC 3339; default: where both spans begin.")] = None,
    stop: Annotated[str | None, typer.Option(help="To here, exclusive; default: where the first span ends.")] = None,
    method: Annotated[str, typer.Option(help="`robust` or `paper`.")] = "robust",
    figure: Annotated[Path | None, typer.Option(help="Draw the differences into this PNG or SVG file.")] = None,
    as_json: connection.JsonOption = False,
) -> None:
    """Compare the attitude of two versions row by row."""
    if first == second:
        end(f"{first} is compared with itself; name two versions")
    if figure is not None:
        require("matplotlib")
    # numpy costs more than the command line itself
    from service.cli.operation.version_comparison import compared, document_of, draw_comparison, rows_of

    span = _span(client, spacecraft, (first, second), start, stop)
    files = (_attitude_file(client, spacecraft, span, method, version) for version in (first, second))
    found = compared(*map(rows_of, (first, second), files))
    named = f"{spacecraft}, {method}: {second} minus {first}, {span[0]} to {span[1]}"
    if not len(found.in_first):
        counts = [len(side.epochs_us) for side in (found.first, found.second)]
        end(f"{named}: no row in both, {first} has {counts[0]} and {second} has {counts[1]}; look at `soo replays`", 1)
    document = {"spacecraft": spacecraft, "method": method, "start": span[0], "stop": span[1], **document_of(found)}
    if figure is not None:
        try:
            draw_comparison(found, named, figure)
        except (OSError, ValueError) as error:
            end(f"the figure cannot be written: {error}", cause=error)
    typer.echo(json.dumps(document, allow_nan=False) if as_json else f"{named}\n{_table(document)}")


def _attitude_file(
    client: "ServiceClient", spacecraft: str, span: tuple[str, str], method: str, version: str
) -> "Iterator[bytes]":
    """Return the Parquet file of a version, whose columns cost a third of its rows as JSON."""
    start, stop = span
    chosen = {"format": "parquet", "start": start, "stop": stop, "method": method, "version": version}
    return client.download(f"/spacecraft/{spacecraft}/archive/attitude:export", chosen)


def _span(
    client: "ServiceClient", spacecraft: str, versions: tuple[str, ...], start: str | None, stop: str | None
) -> tuple[str, str]:
    """Return the span that is compared: that of the options, else what the replays have in common."""
    replays = []
    for version in versions:
        number = version.removeprefix("replay-")
        if version == _LIVE:
            continue
        if version == number or not (number.isascii() and number.isdecimal()):
            end(f"{version} is no version; name `live` or `replay-` with a number, see `soo replays`")
        replays.append(client.replay(spacecraft, int(number)))
    # texts of one form: the service writes every epoch alike
    start = start or max((each["start"] for each in replays), default=None)
    stop = stop or min((each["stop"] for each in replays), default=None)
    if start is None or stop is None:
        end("nothing says which span is compared; state --start and --stop")
    return start, stop


def _table(document: dict[str, Any]) -> str:
    rows, (first, second) = document["rows"], document["versions"]
    lines = [
        f"rows: {rows['both']} in both ({rows['both_with_angles']} with angles), {rows['first_alone']} in {first} "
        f"alone, {rows['second_alone']} in {second} alone"
    ]
    for axis, each in document["difference_deg"].items():
        sigma, level = document["rms_sigma_deg"][axis], document["median_protection_deg"][axis]
        lines.append(
            f"{axis:<6} rms {_number(each['rms'])}, greatest {_number(each['greatest'])} deg at "
            f"{each['greatest_at'] or '-'}; sigma {_pair(sigma)}; protection level {_pair(level)} deg"
        )
    lines.append(f"control allowed: {_pair(document['control_allowed'])} of the rows")
    lines += [f"{code}: {counts[0]} -> {counts[1]} rows" for code, counts in document["inhibitions"].items()]
    return "\n".join(lines)


def _pair(values: list[float | None]) -> str:
    return " -> ".join(map(_number, values))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
