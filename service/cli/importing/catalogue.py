"""Catalogue of an operator's files: spacecraft, carriers and orbit read, checked, compared with the service.

A file at fault raises `ForeignTableError` with every reason and the next step.
"""

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from service.formats.foreign.messages import OrbitFile, read_orbit_file
from service.formats.foreign.table import ForeignTableError, decoded_text, is_workbook, unpacked, workbook_text
from service.records.catalogue import Ephemeris
from service.records.epoch import format_epoch

if TYPE_CHECKING:
    from pydantic import BaseModel, TypeAdapter

    from service.api.schemas.catalogue import CarrierPlanDocument, SpacecraftDocument
    from service.client.service_client import ServiceClient
    from service.pipeline.inputs.catalogue_checks import CatalogueFindings

M = TypeVar("M", bound="BaseModel")
#: no document of the catalogue is larger, bytes
_MOST_BYTES = 64 << 20
#: an orbit beyond it is stated, deg
INCLINED_DEG = 1.0


def file_text(path: Path) -> str:
    """Return the text of a document, decoded and unpacked; ForeignTableError where it is none."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ForeignTableError(f"larger than {_MOST_BYTES >> 20} MiB; this is no document of the catalogue")
        _, content = unpacked(path.name, path.read_bytes())
    except OSError as error:
        raise ForeignTableError(f"cannot be read: {error.strerror or error}") from None
    if is_workbook(content):
        return re.sub(r"(?m)^,*\n", "", workbook_text(content, None))
    return decoded_text(content, None)[0]


def decoded(adapter: "TypeAdapter[M]", raw: bytes) -> M:
    """Return a validated document; ForeignTableError with every field at fault."""
    # web framework and validation cost a quarter of a second that other commands need not pay
    from service.api.problems.problems import RequestProblemError
    from service.api.protocol.requests import decode

    try:
        return decode(adapter, raw)
    except RequestProblemError as error:
        faults = [f"{field.pointer or '/'}: {field.detail}" for field in error.fields] or [error.detail]
        if any(field.pointer.endswith("/latitude_deg") and field.code == "value.range" for field in error.fields):
            faults.append("latitude and longitude look exchanged: no latitude is beyond 90 deg")
        raise _refusal(faults, [error.code]) from None


def _judge(findings: "CatalogueFindings", warn: Callable[[str], None]) -> None:
    """Refuse what contradicts physics or the catalogue, and warn of what is unusual."""
    if findings.faults:
        faults = [f"{fault.pointer}: {fault.detail}" for fault in findings.faults]
        raise _refusal(faults, [fault.code for fault in findings.faults])
    for warning in findings.warnings:
        warn(f"{warning.pointer}: {warning.detail}")


def _refusal(faults: Sequence[str], codes: Sequence[str]) -> ForeignTableError:
    """Return the refusal of a document: what is wrong, and what to do next, a line each."""
    from service.api.problems.next_steps import NEXT_STEPS

    steps = [f"Next: {NEXT_STEPS[code]}" for code in dict.fromkeys(codes) if code in NEXT_STEPS]
    return ForeignTableError("\n  ".join(("refused:", *faults, *steps)))


def read_spacecraft(path: Path, warn: Callable[[str], None]) -> "SpacecraftDocument":
    """Return the spacecraft of JSON, or of a table with the columns field and value."""
    from service.api.schemas.catalogue import SPACECRAFT_ADAPTER
    from service.pipeline.inputs.catalogue_checks import Position, check_positions

    text = file_text(path)
    raw = text if text.lstrip().startswith("{") else json.dumps(_of_fields(text))
    document = decoded(SPACECRAFT_ADAPTER, raw.encode())
    site = document.receiving_site
    position = Position("/receiving_site", site.latitude_deg, site.longitude_deg, site.height_m)
    _judge(check_positions([position], document.longitude_deg), warn)
    return document


def _of_fields(text: str) -> dict[str, Any]:
    """Return a document of lines with a dotted name and a value."""
    separator = max(",;\t", key=text.partition("\n")[0].count)
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=separator) if any(cell.strip() for cell in row)]
    if not rows or [cell.strip() for cell in rows[0]] != ["field", "value"]:
        raise ForeignTableError("neither JSON nor CSV with the columns field and value")
    document: dict[str, Any] = {}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != 2:
            raise ForeignTableError(f"line {number}: {len(row)} cells; write field and value, in quotes")
        *path, last = row[0].strip().split(".")
        member = document
        for name in path:
            member = member.setdefault(name, {})
            if not isinstance(member, dict):
                raise ForeignTableError(f"line {number}: {row[0].strip()} lies within a field that has a value")
        if last in member:
            raise ForeignTableError(f"line {number}: {row[0].strip()} occurs twice")
        member[last] = _value(row[1].strip())
    return document


def _value(cell: str) -> Any:
    """Return a number, truth value or array that a cell holds, else its text."""
    try:
        return json.loads(cell)
    except (ValueError, RecursionError):
        return cell


def read_plan(path: Path) -> "CarrierPlanDocument":
    """Return the plan of a file; what begins with neither brace nor bracket is a table."""
    from service.api.schemas.catalogue import CARRIER_PLAN_ADAPTER
    from service.errors import InvalidInputError
    from service.formats.carrier_plan_csv import read_carrier_plan

    text = file_text(path)
    start = text.lstrip()[:1]
    try:
        if start == "[":
            text = f'{{"carriers":{text}}}'
        elif start != "{":
            text = json.dumps({"carriers": read_carrier_plan(text.encode())})
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None
    return decoded(CARRIER_PLAN_ADAPTER, text.encode())


def unlikely(
    spacecraft: "SpacecraftDocument | None", plan: "CarrierPlanDocument | None", longitude_deg: float
) -> list[str]:
    """Return what a person must confirm: figures that no satellite has, columns that look exchanged."""
    from service.pipeline.inputs.catalogue_checks import unlikely_body, unlikely_carriers

    found = [] if spacecraft is None else unlikely_body(spacecraft.to_record())
    return found + ([] if plan is None else unlikely_carriers(plan.to_records(), longitude_deg))


def check_likely(
    spacecraft: "SpacecraftDocument | None", plan: "CarrierPlanDocument | None", longitude_deg: float
) -> None:
    """Refuse `unlikely` figures, which were not confirmed."""
    odd = unlikely(spacecraft, plan, longitude_deg)
    if odd:
        text = "this must be confirmed with --state confirmed=true:"
        raise ForeignTableError("\n  ".join((text, *odd)))


def check_plan(plan: "CarrierPlanDocument", longitude_deg: float, warn: Callable[[str], None]) -> None:
    """Refuse carriers whose stations cannot see the satellite, and frequencies outside of their band."""
    from service.pipeline.inputs.catalogue_checks import check_carriers

    _judge(check_carriers(plan.to_records(), longitude_deg), warn)


def carrier_names(plan: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the ids of a plan's carriers by id and by name; a name that several have has none."""
    known: dict[str, str] = {}
    for each in plan:
        name = str(each.get("name") or "")
        if name:
            known[name] = "" if name in known and known[name] != str(each["id"]) else str(each["id"])
    return known | {str(each["id"]): str(each["id"]) for each in plan}


def plan_rows(plan: "CarrierPlanDocument", longitude_deg: float) -> list[dict[str, Any]]:
    """Return a row of a table for each carrier; elevation is that of the spacecraft at its station."""
    from service.core.geometry.frames import satellite_elevation_deg

    rows = []
    for carrier in plan.carriers:
        station = carrier.station
        row = {"id": carrier.id, "transponder": carrier.transponder, "band": carrier.band}
        row |= dict.fromkeys(("station", "latitude_deg", "longitude_deg", "elevation_deg"), "")
        if station is not None:
            elevation_deg = satellite_elevation_deg(station.longitude_deg, station.latitude_deg, 0.0, longitude_deg)
            row |= {"station": station.name, "elevation_deg": f"{float(elevation_deg):.1f}"}
            row |= {"latitude_deg": f"{station.latitude_deg:g}", "longitude_deg": f"{station.longitude_deg:g}"}
        row["uplink_ghz"] = "" if carrier.uplink_hz is None else f"{carrier.uplink_hz / 1e9:.6f}"
        row["downlink_ghz"] = f"{carrier.downlink_hz / 1e9:.6f}"
        rows.append(row | {"bandwidth_khz": f"{carrier.bandwidth_hz / 1e3:g}"})
    return rows


def read_orbit(path: Path) -> tuple[OrbitFile, Ephemeris]:
    """Return a file's orbit, as it came and as the service will have it."""
    from pydantic import TypeAdapter

    from service.api.schemas.catalogue import EphemerisDocument
    from service.errors import InvalidInputError

    orbit = read_orbit_file(file_text(path))
    body = decoded(TypeAdapter(EphemerisDocument), json.dumps(orbit.body).encode())
    try:
        return orbit, orbit.ephemeris or body.to_record()
    except InvalidInputError as error:
        raise ForeignTableError(error.detail) from None


def understood_orbit(orbit: OrbitFile, ephemeris: Ephemeris, now: str | None) -> dict[str, Any]:
    """Return what was understood of an orbit."""
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


def foreign_orbit(
    orbit: OrbitFile, ephemeris: Ephemeris, known: Mapping[str, Any], *, is_relocating: bool = False
) -> str | None:
    """Return why an orbit is that of another satellite than a known one; None: it is not."""
    from service.pipeline.inputs.catalogue_checks import contradiction_of

    own = known.get("cospar_id")
    if own and orbit.cospar_id and orbit.cospar_id[:8] + orbit.cospar_id[8:].strip() != own:
        return f"it is of {orbit.name or 'an object'} {orbit.cospar_id}; spacecraft {known['id']} is {own}"
    contradiction = contradiction_of(ephemeris, known["longitude_deg"])
    return (
        None
        if contradiction is None or is_relocating
        else f"{contradiction}; state relocating when it moves on purpose"
    )


def check_orbit(
    orbit: OrbitFile, ephemeris: Ephemeris, known: Mapping[str, Any], *, is_relocating: bool, is_inclined: bool
) -> None:
    """Refuse the orbit of another satellite, and one whose inclination must be stated."""
    foreign = foreign_orbit(orbit, ephemeris, known, is_relocating=is_relocating)
    if foreign is not None:
        raise ForeignTableError(f"the orbit of another satellite: {foreign}")
    greatest_deg = inclination_deg(ephemeris)
    if greatest_deg > INCLINED_DEG and not is_inclined:
        limit = f"above {INCLINED_DEG:g} deg: state inclined if that is so"
        raise ForeignTableError(f"the orbit is inclined by {greatest_deg:.2f} deg, {limit}")


def inclination_deg(ephemeris: Ephemeris) -> float:
    """Return the greatest latitude of an orbit's track, 0 without one."""
    return 0.0 if ephemeris.track is None else float(np.max(np.abs(ephemeris.track.latitude_deg)))


def flat(document: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the members of a document by dotted name."""
    found: dict[str, Any] = {}
    for name, value in document.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def known_document(client: "ServiceClient", path: str, missing_code: str) -> dict[str, Any] | None:
    """Return a document of the service; None: it has none."""
    from service.client.problem import ProblemError

    try:
        found: dict[str, Any] = client.request("GET", path)
    except ProblemError as error:
        if error.code != missing_code:
            raise
        return None
    return found


Differences = dict[str, tuple[Any, Any]]


class OwnCatalogue(NamedTuple):
    """Spacecraft, carriers and orbit of an operator's files; None: there is none."""

    spacecraft_id: str
    spacecraft: "SpacecraftDocument | None"
    plan: "CarrierPlanDocument | None"
    orbit: tuple[OrbitFile, Ephemeris] | None


class CatalogueComparison(NamedTuple):
    """Members of the spacecraft, creations by their names, and differences to the service by their fields."""

    members: dict[str, Any]
    creations: dict[str, Callable[[], Any]]
    differences: Differences


def compared(client: "ServiceClient", own: OwnCatalogue) -> CatalogueComparison:
    """Return how a catalogue and the service compare; ForeignTableError where there is no such spacecraft."""
    path = f"/spacecraft/{own.spacecraft_id}"
    known = known_document(client, path, "spacecraft.unknown")
    if known is None and own.spacecraft is None:
        raise ForeignTableError(f"the service has no spacecraft {own.spacecraft_id}, and there is no file of one")
    stated = {} if own.spacecraft is None else own.spacecraft.model_dump(mode="json", exclude_unset=True)
    creations: dict[str, Callable[[], Any]] = {}
    differences: Differences = {}
    if own.spacecraft is not None and known is None:
        creations["spacecraft"] = lambda: client.create_spacecraft(stated)
    elif own.spacecraft is not None:
        pairs = spacecraft_differences(own.spacecraft, known or {})
        differences |= {f"spacecraft.{name}": pair for name, pair in pairs.items()}
    if own.plan is not None:
        carriers = own.plan.model_dump(mode="json", exclude_unset=True)["carriers"]
        there = known and known_document(client, f"{path}/carriers", "plan.unknown")
        if there:
            differences |= _plan_differences(own.plan.model_dump(mode="json")["carriers"], there["carriers"])
        else:
            creations["carriers"] = lambda: client.put_carriers(own.spacecraft_id, carriers)
    if own.orbit is not None:
        orbit, ephemeris = own.orbit
        there = known and known_document(client, f"{path}/ephemeris", "ephemeris.none")
        if there:
            differences |= _orbit_differences(ephemeris, there)
        else:
            creations["ephemeris"] = lambda: client.put_ephemeris(own.spacecraft_id, orbit.body)
    return CatalogueComparison(known or stated, creations, differences)


def spacecraft_differences(document: "SpacecraftDocument", known: Mapping[str, Any]) -> Differences:
    """Return the stated fields that the service has otherwise, with both values."""
    stated = flat(document.model_dump(mode="json", exclude_unset=True))
    # members of arrays have their defaults here, as the service has them
    here, there = flat(document.model_dump(mode="json")), flat(known)
    return {name: (here[name], there.get(name)) for name in stated if there.get(name) != here[name]}


def _plan_differences(here: list[dict[str, Any]], there: list[dict[str, Any]]) -> Differences:
    """Return the fields of carriers that differ, with both values; their order counts too."""
    own, known = ({each["id"]: each for each in plan} for plan in (here, there))
    stated, stored = (
        flat({name: each for name, each in own.items() if name in known}, "carriers."),
        flat(known, "carriers."),
    )
    found = {name: (value, stored.get(name)) for name, value in stated.items() if stored.get(name) != value}
    return found if list(own) == list(known) else found | {"carriers": (", ".join(own), ", ".join(known))}


def _orbit_differences(ephemeris: Ephemeris, there: Mapping[str, Any]) -> Differences:
    """Return the figures of an orbit that differ, with both values."""
    from service.api.schemas.catalogue import EphemerisReceiptAnswer

    here = json.loads(EphemerisReceiptAnswer.of(ephemeris).model_dump_json())
    names = ("valid", "nodal_period_s", "ascending_nodes")
    differing = [name for name in names if here[name] != there[name]]
    return {f"ephemeris.{name}": (_ends(here[name]), _ends(there[name])) for name in differing}


def _ends(value: Any) -> Any:
    """Return a value for a message, of a list its ends."""
    return f"{value[0]} to {value[-1]}, {len(value)}" if isinstance(value, list) and value else value
