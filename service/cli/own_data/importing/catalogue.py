"""Catalogue of a folder beside that of the service: equal, missing, or different."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.cli.command_group import end
from service.cli.own_data.carriers import read_plan
from service.cli.own_data.document_file import refuse_findings
from service.cli.own_data.ephemeris import check_orbit, read_orbit
from service.cli.own_data.importing.manifest import FolderManifest
from service.cli.own_data.spacecraft import differences_of, flat, known_spacecraft, read_spacecraft

if TYPE_CHECKING:
    from service.api.schemas.catalogue import CarrierPlanDocument, SpacecraftDocument
    from service.client.service_client import ServiceClient
    from service.formats.foreign.orbit_file import OrbitFile
    from service.records.catalogue import Ephemeris

Differences = dict[str, tuple[Any, Any]]


class FolderCatalogue(NamedTuple):
    """Spacecraft, carriers and orbit of a folder; None: it has none."""

    spacecraft_id: str
    spacecraft: "SpacecraftDocument | None"
    plan: "CarrierPlanDocument | None"
    orbit: "tuple[Path, OrbitFile, Ephemeris] | None"


class CatalogueComparison(NamedTuple):
    """Creations by their names, and differences to the service by the names of their fields."""

    creations: dict[str, Callable[[], Any]]
    differences: Differences


def read_catalogue(folder: Path, manifest: FolderManifest) -> FolderCatalogue:
    """Return the catalogue of a folder, or end where a file is at fault."""
    spacecraft = None if manifest.spacecraft.file is None else read_spacecraft(folder / manifest.spacecraft.file)
    spacecraft_id = manifest.spacecraft.id if spacecraft is None else spacecraft.id
    if spacecraft_id is None:
        end("the manifest names no spacecraft: state spacecraft.file, or spacecraft.id of one that the service has")
    orbit = None
    if manifest.ephemeris is not None:
        path = folder / manifest.ephemeris
        orbit = (path, *read_orbit(path))
    plan = None if manifest.carriers is None else read_plan(folder / manifest.carriers)
    return FolderCatalogue(spacecraft_id, spacecraft, plan, orbit)


def compared(client: "ServiceClient", folder: Path, manifest: FolderManifest) -> tuple[str, CatalogueComparison]:
    """Return the id of the spacecraft and how folder and service compare; end where the files contradict themselves."""
    own = read_catalogue(folder, manifest)
    known = known_spacecraft(client, own.spacecraft_id)
    if known is None and own.spacecraft is None:
        end(f"the service has no spacecraft {own.spacecraft_id}, and the folder no file of one")
    members = known if own.spacecraft is None else own.spacecraft.model_dump(mode="json", exclude_unset=True)
    _check(folder, manifest, own, members or {})
    creations: dict[str, Callable[[], Any]] = {}
    differences: Differences = {}
    if own.spacecraft is not None:
        if known is None:
            creations["spacecraft"] = lambda: client.create_spacecraft(members or {})
        else:
            differences |= {f"spacecraft.{name}": pair for name, pair in differences_of(own.spacecraft, known).items()}
    if own.plan is not None:
        carriers = own.plan.model_dump(mode="json", exclude_unset=True)["carriers"]
        there = _existing(client, known, f"/spacecraft/{own.spacecraft_id}/carriers", "plan.unknown")
        if there is None:
            creations["carriers"] = lambda: client.put_carriers(own.spacecraft_id, carriers)
        else:
            differences |= _plan_differences(own.plan.model_dump(mode="json")["carriers"], there["carriers"])
    if own.orbit is not None:
        _, orbit, ephemeris = own.orbit
        there = _existing(client, known, f"/spacecraft/{own.spacecraft_id}/ephemeris", "ephemeris.none")
        if there is None:
            creations["ephemeris"] = lambda: client.put_ephemeris(own.spacecraft_id, orbit.body)
        else:
            differences |= _orbit_differences(ephemeris, there)
    return own.spacecraft_id, CatalogueComparison(creations, differences)


def _check(folder: Path, manifest: FolderManifest, own: FolderCatalogue, members: dict[str, Any]) -> None:
    """End where carriers or orbit cannot be those of the spacecraft."""
    from service.pipeline.inputs.catalogue_checks import check_carriers

    if own.plan is not None:
        findings = check_carriers(own.plan.to_records(), float(members["longitude_deg"]))
        refuse_findings(folder / str(manifest.carriers), findings.faults)
    if own.orbit is not None:
        check_orbit(*own.orbit, members, is_relocating=False)


def _existing(
    client: "ServiceClient", known: dict[str, Any] | None, path: str, missing_code: str
) -> dict[str, Any] | None:
    """Return a document of a known spacecraft; None: the service has none."""
    from service.client.problem import ProblemError

    if known is None:
        return None
    try:
        found: dict[str, Any] = client.request("GET", path)
    except ProblemError as error:
        if error.code != missing_code:
            raise
        return None
    return found


def _plan_differences(here: list[dict[str, Any]], there: list[dict[str, Any]]) -> Differences:
    """Return the fields of carriers that differ, with both values; their order counts too."""
    own, known = ({each["id"]: flat(each) for each in plan} for plan in (here, there))
    found: Differences = {
        f"carriers.{name}.{field}": (value, known[name].get(field))
        for name, fields in own.items()
        if name in known
        for field, value in fields.items()
        if known[name].get(field) != value
    }
    if list(own) != list(known):
        found["carriers"] = (", ".join(own), ", ".join(known))
    return found


def _orbit_differences(ephemeris: "Ephemeris", there: dict[str, Any]) -> Differences:
    """Return the figures of an orbit that differ, with both values."""
    from service.api.schemas.catalogue import EphemerisReceiptAnswer

    here = json.loads(EphemerisReceiptAnswer.of(ephemeris).model_dump_json())
    names = ("valid", "nodal_period_s", "ascending_nodes")
    differing = [name for name in names if here[name] != there[name]]
    return {f"ephemeris.{name}": (_short(here[name]), _short(there[name])) for name in differing}


def _short(value: Any) -> Any:
    """Return a value for a message, of a list its ends."""
    return f"{value[0]} to {value[-1]}, {len(value)}" if isinstance(value, list) and value else value
