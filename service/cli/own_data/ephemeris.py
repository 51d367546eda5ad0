"""``soo ephemeris``: an orbit from two-line elements, OMM, OEM or JSON.

Exit codes: 0 stored, or understood with ``--dry-run``, 1 the service refused it or did not answer, 2 the file is no
orbit, or one of another satellite.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
)
from service.cli.own_data.document_file import decoded, read_text, report, show
from service.records.epoch import format_epoch

if TYPE_CHECKING:
    from service.formats.foreign.messages import OrbitFile
    from service.records.catalogue import Ephemeris

app = new_app(help="Orbit of a spacecraft.", no_args_is_help=True)


@app.callback()
def group() -> None:
    """Orbit of a spacecraft."""


@app.command()
def put(
    file: Annotated[Path, typer.Argument(help="TLE, OMM, OEM or JSON file.", dir_okay=False, exists=True)],
    *,
    spacecraft: SpacecraftOption,
    relocating: Annotated[
        bool, typer.Option("--relocating", help="The spacecraft leaves its longitude; stands in the audit log.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what is understood, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store an orbit of a TLE, OMM, OEM or JSON file."""
    orbit, ephemeris = read_orbit(file)
    with connected(service, key_env) as client:
        known = client.spacecraft(spacecraft)
        understood = _understood(orbit, ephemeris, client.status(spacecraft)["now"])
        if not as_json:
            show(str(file), ((name, str(value)) for name, value in understood.items() if value is not None))
        check_orbit(file, orbit, ephemeris, known, is_relocating=relocating)
        if dry_run:
            report({"understood": understood}, as_json=as_json, sentence="nothing was stored")
            return
        stored = client.put_ephemeris(spacecraft, orbit.body | ({"relocating": True} if relocating else {}))
    sentence = f"ephemeris {stored['ephemeris_id']} is in force until {understood['valid_stop']}"
    report({"understood": understood, "stored": stored}, as_json=as_json, sentence=sentence)


def read_orbit(file: Path) -> "tuple[OrbitFile, Ephemeris]":
    """Return a file's orbit, as it came and as the service will have it, or end."""
    from pydantic import TypeAdapter

    from service.api.schemas.catalogue import EphemerisDocument
    from service.errors import InvalidInputError
    from service.formats.foreign.layout import ForeignTableError
    from service.formats.foreign.messages import read_orbit_file

    try:
        orbit = read_orbit_file(read_text(file))
        body = decoded(file, TypeAdapter(EphemerisDocument), json.dumps(orbit.body).encode())
        return orbit, orbit.ephemeris or body.to_record()
    except (ForeignTableError, InvalidInputError) as error:
        end(f"{file}: {getattr(error, 'detail', error)}", cause=error)


def _understood(orbit: "OrbitFile", ephemeris: "Ephemeris", now: str | None) -> dict[str, Any]:
    """Return what was understood of an orbit."""
    import numpy as np

    track = ephemeris.track
    stop = format_epoch(ephemeris.valid_stop_us)
    found: dict[str, Any] = {
        "form": orbit.form,
        "object": orbit.name,
        "cospar_id": orbit.cospar_id,
        "valid_start": format_epoch(ephemeris.valid_start_us),
        "valid_stop": stop,
        "is_over": now is not None and stop < now,
        "nodal_period_s": round(ephemeris.nodal_period_s, 3),
        "ascending_nodes": len(ephemeris.ascending_nodes_us),
    }
    if track is not None:
        longitude_deg = np.unwrap(np.array(track.longitude_deg), period=360.0)
        found |= {
            "mean_longitude_deg_east": round(float(np.mean(longitude_deg)) % 360.0, 3),
            "longitude_span_deg": round(float(np.ptp(longitude_deg)), 3),
            "greatest_latitude_deg": round(float(np.max(np.abs(track.latitude_deg))), 3),
        }
    return found


def check_orbit(
    file: Path, orbit: "OrbitFile", ephemeris: "Ephemeris", known: dict[str, Any], *, is_relocating: bool
) -> None:
    """End when the orbit is that of another satellite."""
    from service.pipeline.inputs.catalogue_checks import contradiction_of

    own = known.get("cospar_id")
    if own and orbit.cospar_id and orbit.cospar_id[:8] + orbit.cospar_id[8:].strip() != own:
        name = orbit.name or "an object"
        end(f"{file} is of {name} {orbit.cospar_id}; spacecraft {known['id']} is {own}: choose its own file")
    contradiction = contradiction_of(ephemeris, known["longitude_deg"])
    if contradiction is not None and not is_relocating:
        end(
            f"{file} is the orbit of another satellite: {contradiction}; or state --relocating when it moves on purpose"
        )
