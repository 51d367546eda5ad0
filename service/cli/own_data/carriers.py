"""``soo carriers``: who is used and why not the others; ``soo carriers put``: a carrier plan from JSON or CSV.

Exit codes of ``put``: 0 stored, or understood with ``--dry-run``, 1 the service refused it or did not answer, 2 the
file is no plan, or one that contradicts itself or the spacecraft.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)
from service.cli.own_data.document_file import decoded, read_bytes, refuse_findings, report, show
from service.cli.shift.reading import carriers

if TYPE_CHECKING:
    from service.api.schemas.catalogue import CarrierPlanDocument

_HELP = "Say which carriers the newest attitude uses and why not the others; store a carrier plan."


class _ShownAlone(TyperGroup):
    """Group that shows the carriers where no command of it is named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return what is left of the arguments."""
        is_alone = not args or (args[0].startswith("-") and args[0] != "--help")
        return super().parse_args(ctx, ["show", *args] if is_alone else args)


app = new_app(help=_HELP, cls=_ShownAlone)
app.command("show")(carriers)


@app.command()
def put(
    file: Annotated[Path, typer.Argument(help="JSON or CSV file.", dir_okay=False, exists=True)],
    *,
    spacecraft: SpacecraftOption,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what is understood, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store a carrier plan of a JSON or CSV file."""
    from service.pipeline.inputs.catalogue_checks import check_carriers

    plan = read_plan(file)
    with connected(service, key_env) as client:
        longitude_deg = float(client.spacecraft(spacecraft)["longitude_deg"])
        rows = _rows(plan, longitude_deg)
        if not as_json:
            show(str(file), (tuple(map(str, row.values())) for row in rows), columns=list(rows[0]))
        findings = check_carriers(plan.to_records(), longitude_deg)
        refuse_findings(file, findings.faults)
        warnings = [f"{warning.pointer}: {warning.detail}" for warning in findings.warnings]
        for warning in warnings:
            typer.echo(f"warning: {warning}", err=True)
        if dry_run:
            understood = {"carriers": rows, "warnings": warnings}
            report(understood, as_json=as_json, sentence=f"{len(rows)} carriers; nothing was stored")
            return
        stored = client.put_carriers(spacecraft, plan.model_dump(mode="json", exclude_unset=True)["carriers"])
    sentence = f"plan {stored['plan_id']} holds {stored['carriers']} carriers"
    report({"carriers": rows, "stored": stored}, as_json=as_json, sentence=sentence)


def read_plan(file: Path) -> "CarrierPlanDocument":
    """Return the plan of a file, or end; what begins with neither brace nor bracket is CSV."""
    from service.api.schemas.catalogue import CARRIER_PLAN_ADAPTER
    from service.errors import InvalidInputError
    from service.formats.carrier_plan_csv import read_carrier_plan

    raw = read_bytes(file).removeprefix(b"\xef\xbb\xbf")
    start = raw.lstrip()[:1]
    try:
        if start == b"[":
            raw = b'{"carriers":' + raw + b"}"
        elif start != b"{":
            raw = json.dumps({"carriers": read_carrier_plan(raw)}).encode()
    except InvalidInputError as error:
        end(f"{file}: {error.detail}", cause=error)
    return decoded(file, CARRIER_PLAN_ADAPTER, raw)


def _rows(plan: "CarrierPlanDocument", longitude_deg: float) -> list[dict[str, Any]]:
    """Return a row for each carrier; elevation is that of the spacecraft at its station."""
    from service.core.geometry.frames import satellite_elevation_deg

    rows = []
    for carrier in plan.carriers:
        station = carrier.station
        position = ("", "", "")
        if station is not None:
            elevation_deg = satellite_elevation_deg(station.longitude_deg, station.latitude_deg, 0.0, longitude_deg)
            position = (f"{station.latitude_deg:g}", f"{station.longitude_deg:g}", f"{float(elevation_deg):.1f}")
        rows.append(
            {
                "id": carrier.id,
                "transponder": carrier.transponder,
                "band": carrier.band,
                "station": "" if station is None else station.name,
                "latitude_deg": position[0],
                "longitude_deg": position[1],
                "elevation_deg": position[2],
                "uplink_ghz": "" if carrier.uplink_hz is None else f"{carrier.uplink_hz / 1e9:.6f}",
                "downlink_ghz": f"{carrier.downlink_hz / 1e9:.6f}",
                "bandwidth_khz": f"{carrier.bandwidth_hz / 1e3:g}",
            }
        )
    return rows
