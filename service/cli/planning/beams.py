"""Beams of the antennas: boresight by the hour, its daily change, beams at the stations, a figure."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end
from service.cli.extras import require
from service.cli.operation.connection import JsonOption, SpacecraftOption, on_service

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


_FOUND_SIGMAS = 3.0
_CAUSES = {
    "none": "no daily change was found",
    "antenna": "daily change of this antenna: the others do not show it",
    "antenna_or_sensor": "daily change of the antenna or of the sensor: there is no other antenna to compare with",
    "body_or_sensor": "daily change of the body or of the sensor: the other antennas show the same",
}


@on_service
def beams(
    client: "ServiceClient",
    spacecraft: SpacecraftOption,
    start: Annotated[str | None, typer.Option(help="From here, RFC 3339; default: seven days before the end.")] = None,
    stop: Annotated[str | None, typer.Option(help="To here, exclusive; default: the newest row.")] = None,
    group: Annotated[str, typer.Option(help="Carriers of one antenna: `band` or `transponder`.")] = "band",
    figure: Annotated[Path | None, typer.Option(help="Draw boresights and beams into this PNG or SVG file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Tell where the antennas point against the body, by powers and a working sensor."""
    if figure is not None:
        require("matplotlib")
    document: dict[str, Any] = dict(client.beams(spacecraft, start, stop, group=group))
    if figure is not None:
        # matplotlib costs half a second that a report without a figure need not pay
        from service.cli.planning.figures import draw_beams

        try:
            draw_beams(document, spacecraft, figure)
        except (OSError, ValueError) as error:
            end(f"the figure cannot be written: {error}", cause=error)
    typer.echo(json.dumps(document, allow_nan=False) if as_json else "\n".join(_lines(document)))


def _lines(document: dict[str, Any]) -> list[str]:
    """Return the report as lines."""
    hours, turned = len(document["epochs"]), sum(document["turned"])
    lines = [
        f"calibration {document['calibration_id']}, sensors {', '.join(document['sensors'])}: {hours} hours, "
        f"{turned} of them left out because the body turned"
    ]
    for antenna in document["antennas"]:
        lines.append(f"{antenna['antenna']}, {len(antenna['carriers'])} carriers: {_CAUSES[antenna['cause']]}")
        lines += [f"  {axis:<5} {_axis(antenna[axis])}" for axis in ("east", "north")]
    changed = [each for each in document["stations"] if (each["change_sigmas"] or 0.0) > _FOUND_SIGMAS]
    if document["compared_calibration_id"] is not None:
        names = ", ".join(f"{each['carrier']} ({each['change_sigmas']:.1f} sigma)" for each in changed) or "none"
        lines.append(f"beams changed since calibration {document['compared_calibration_id']}: {names}")
    return lines + [f"note: {note}" for note in document["notes"]]


def _axis(axis: dict[str, Any]) -> str:
    """Return the change along one axis as text."""
    if axis["mean_deg"] is None:
        return "not told"
    text = f"{axis['mean_deg']:+.4f} deg, constant part known to {axis['constant_sigma_deg']:.4f}"
    daily = axis["daily"]
    if daily["amplitude_deg"] is None:
        return f"{text}; too short for a daily change"
    return (
        f"{text}; each day +-{daily['amplitude_deg']:.4f} (sigma {daily['sigma_deg']:.4f}), "
        f"greatest at {_clock(daily['peak_h'])} UTC"
    )


def _clock(hours: float) -> str:
    """Return an hour of the day as text."""
    minutes = round(60.0 * hours) % 1440
    return f"{minutes // 60:02d}:{minutes % 60:02d}"
