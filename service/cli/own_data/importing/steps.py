"""Steps of an import after the catalogue: readings, powers, calibration, alignment; each may be repeated.

Catalogue of a folder beside that of the service: equal, missing, or different.

Proposal of a manifest: role and layout of each file, guesses marked, windows where the readings show turns.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.cli.command_group import end
from service.cli.own_data.archive_progress import send_with_progress
from service.cli.own_data.carriers import read_plan
from service.cli.own_data.document_file import refuse_findings
from service.cli.own_data.ephemeris import check_orbit, read_orbit
from service.cli.own_data.foreign_file import carrier_names, impossibility, is_own, laid_out
from service.cli.own_data.importing.entries import Statements, complete_layout, powers_entry, references_entry
from service.cli.own_data.importing.manifest import (
    FolderManifest,
    Guess,
    PowersSection,
    ReferencesSection,
    WindowSection,
    plain_value,
)
from service.cli.own_data.importing.roles import Content, FileRole, content_of, files_of
from service.cli.own_data.importing.windows import proposed_windows, readings_of
from service.cli.own_data.readings import check_readings, send_readings, survey_of
from service.cli.own_data.spacecraft import differences_of, flat, known_spacecraft, read_spacecraft
from service.cli.own_data.tdm_archive import open_any_archive
from service.frontend.backfill.backfill import ArchiveOrder, check_archive
from service.frontend.backfill.columns import ArchiveError
from service.pipeline.inputs.catalogue_checks import contradiction_of
from service.records.epoch import format_epoch
from service.runtime.clock import system_now_us

if TYPE_CHECKING:
    from service.api.schemas.catalogue import CarrierPlanDocument, SpacecraftDocument
    from service.client.service_client import ServiceClient
    from service.formats.foreign.messages import OrbitFile
    from service.records.catalogue import Ephemeris


#: roles whose files have fields of their own
_TABLES = (FileRole.POWERS, FileRole.REFERENCES)


class FolderProposal(NamedTuple):
    """Sections of a manifest, and what they leave open."""

    sections: dict[str, Any]
    #: windows that were not found
    shortcomings: tuple[str, ...]


def propose_folder(folder: Path, stated: FolderManifest, statements: Statements) -> FolderProposal:
    """Return the manifest of a folder; what was stated before is kept."""
    files, left_out = files_of(folder)
    contents = {path: content_of(path, None) for path in files}
    plan_file = _chosen(_named(contents, FileRole.CARRIERS), stated.carriers)
    carriers: dict[str, str] = {}
    if plan_file is not None:
        plan = read_plan(folder / plain_value(plan_file))
        carriers = carrier_names([each.model_dump() for each in plan.carriers])
    contents = {path: one if one.role or one.reason else content_of(path, carriers) for path, one in contents.items()}
    unknown = set(statements) - {path.name for path, one in contents.items() if one.role in _TABLES}
    if unknown:
        end(f"--state: no powers or readings in {', '.join(sorted(unknown))}")
    left_out |= {path.name: one.reason for path, one in contents.items() if one.role is None}
    spacecraft_file = _chosen(_named(contents, FileRole.SPACECRAFT), stated.spacecraft.file)
    spacecraft = None if spacecraft_file is None else read_spacecraft(folder / plain_value(spacecraft_file))
    orbits, others = _orbits(folder, _named(contents, FileRole.EPHEMERIS), spacecraft)
    references = [references_entry(folder / name, stated, statements) for name in _named(contents, FileRole.REFERENCES)]
    own = (
        {"file": spacecraft_file}
        if spacecraft_file
        else {"id": stated.spacecraft.id or Guess(None, "no file of a spacecraft")}
    )
    windows, shortcomings = proposed_windows(folder, references, stated)
    sections = {
        "spacecraft": own,
        "carriers": plan_file,
        "ephemeris": _chosen(orbits, stated.ephemeris),
        "powers": [
            powers_entry(folder / name, stated, statements, carriers) for name in _named(contents, FileRole.POWERS)
        ],
        "references": references,
        "windows": windows,
        "left_out": left_out | others,
    }
    return FolderProposal({name: value for name, value in sections.items() if value}, shortcomings)


def _named(contents: Mapping[Path, Content], role: FileRole) -> list[str]:
    """Return the names of the files of a role."""
    return [path.name for path, content in contents.items() if content.role is role]


def _chosen(names: list[str], stated: str | None) -> Any:
    """Return the file of a role that one file has; the first of several is a guess."""
    if stated in names or not names:
        return stated if stated in names else None
    return names[0] if len(names) == 1 else Guess(names[0], f"one of {', '.join(names)}")


def _orbits(
    folder: Path, names: list[str], spacecraft: "SpacecraftDocument | None"
) -> tuple[list[str], dict[str, str]]:
    """Return the files with an orbit of this spacecraft, and why others are left out."""
    own, others = [], {}
    for name in names:
        orbit, ephemeris = read_orbit(folder / name)
        foreign = None if spacecraft is None else contradiction_of(ephemeris, spacecraft.longitude_deg)
        if spacecraft is not None and spacecraft.cospar_id and orbit.cospar_id not in (None, spacecraft.cospar_id):
            foreign = f"it is of {orbit.cospar_id}"
        if foreign is None:
            own.append(name)
        else:
            others[name] = f"orbit of another satellite: {foreign}"
    return own, others


def require_files(manifest: FolderManifest, folder: Path) -> None:
    """End where a manifest names a file that is not in its folder, or states no source of one."""
    single = [manifest.spacecraft.file, manifest.carriers, manifest.ephemeris]
    tables = (*manifest.powers, *manifest.references)
    nameless = [each.file for each in tables if not each.source]
    if nameless:
        end(f"the manifest states no source of {', '.join(nameless)}")
    names = [*filter(None, single), *(each.file for each in tables)]
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        end(f"{folder} has no {', '.join(missing)}, which the manifest names")


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


_NO_WINDOWS = "the manifest states no window {names}: soo import FOLDER --propose finds them, or write start and stop"


def import_references(
    client: "ServiceClient", folder: Path, section: ReferencesSection, spacecraft: dict[str, Any]
) -> dict[str, int]:
    """Send the readings of a file and return what became of them."""
    path = folder / section.file
    readings = readings_of(path, section)
    survey = survey_of(path, readings)
    check_readings(path, survey, is_simulated=spacecraft.get("simulated", False))
    sigma_deg = {str(axis): value for axis, value in section.sigma_deg.items()}
    counts = send_readings(client, spacecraft["id"], section.source, readings, sigma_deg)
    return counts | {"unreadable": survey.faults.rows}


def import_powers(
    client: "ServiceClient",
    folder: Path,
    section: PowersSection,
    spacecraft: dict[str, Any],
    patience_s: float,
    *,
    is_quiet: bool,
) -> dict[str, Any]:
    """Send the powers of a file, or the rest of them, and return what became of the rows."""
    path = folder / section.file
    order = ArchiveOrder(path, spacecraft["id"], section.source, patience_s=patience_s, open_file=open_any_archive)
    try:
        if not is_own(path, section.layout()):
            carriers = carrier_names(client.carriers(order.spacecraft_id)["carriers"])
            order = laid_out(order, complete_layout(path, section, carriers))
            now_us = system_now_us()
            survey = check_archive(client, order, now_us)
            reason = impossibility(survey, None if spacecraft.get("simulated", False) else now_us)
            if reason:
                end(f"{path}: {reason.replace('--tz', 'its tz').replace('--unit', 'its unit')}")
        return send_with_progress(client, order, is_quiet=is_quiet)
    except (ArchiveError, OSError) as error:
        end(str(error), cause=error)


def calibrate(
    client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest, reason: str | None
) -> dict[str, Any]:
    """Make a calibration of the manifest's windows the active one, unless it is, and return it.

    One with warnings stays a draft unless a reason to accept them is given; then the newest such draft is activated.
    Made again with the same figures, the former draft stays and the new one is deleted.
    """
    from service.cli.operation.operate import wait_for_job

    quiet, turns = manifest.windows.quiet, manifest.windows.turns
    if quiet is None or turns is None:
        end(_NO_WINDOWS.format(names="quiet or turns"))
    body = {"quiet": _document(quiet), "turns": _document(turns), "method": "geometry"}
    asked = body | {"sources": dict.fromkeys(("yaw", "roll", "pitch"), _sensor(manifest))}
    former = [one for one in _calibrations(client, spacecraft_id) if asked.items() <= one.items()]
    drafts = [one for one in former if one["state"] == "draft" and one["observability"] is not None]
    active = next((one for one in former if one["state"] == "active"), None)
    if active is not None:
        return active
    if reason and drafts:
        return client.activate_calibration(spacecraft_id, drafts[0]["id"], reason)
    started = client.start_calibration(spacecraft_id, body | {"source": _sensor(manifest)})
    wait_for_job(client, started["job"], "calibration")
    made = client.calibration(spacecraft_id, started["id"])
    if not made["quality"].get("warnings") or reason:
        return client.activate_calibration(spacecraft_id, started["id"], reason)
    for one in drafts:
        if all(one[name] == made[name] for name in ("plan_id", "ephemeris_id", "quality", "carriers")):
            client.request("DELETE", f"/spacecraft/{spacecraft_id}/calibrations/{made['id']}")
            return one
    return made


def _calibrations(client: "ServiceClient", spacecraft_id: str) -> list[dict[str, Any]]:
    """Return the calibrations that the service has."""
    found: list[dict[str, Any]] = client.request("GET", f"/spacecraft/{spacecraft_id}/calibrations")["rows"]
    return found


def align(client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest) -> dict[str, Any]:
    """Align in the window of the manifest, unless that is done, and return the alignment."""
    window = manifest.windows.align
    if window is None:
        end(_NO_WINDOWS.format(names="align"))
    document = _document(window)
    active = [each["id"] for each in _calibrations(client, spacecraft_id) if each["state"] == "active"]
    for each in client.request("GET", f"/spacecraft/{spacecraft_id}/alignments")["rows"]:
        if each["window"] == document and each["calibration_id"] in active:
            return dict(each)
    return client.align(spacecraft_id, document | {"source": _sensor(manifest)})


def _document(window: WindowSection) -> dict[str, str]:
    """Return a window as the interface has it."""
    return {"start": format_epoch(window.start), "stop": format_epoch(window.stop)}


def _sensor(manifest: FolderManifest) -> str:
    """Return the sensor of calibration and alignment: that of the first file of readings."""
    return manifest.references[0].source if manifest.references else "star_tracker"
