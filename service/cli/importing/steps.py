"""Steps of an import by its manifest: everything is read first, then created and sent; each may be repeated."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.cli.importing.catalogue import (
    OwnCatalogue,
    carrier_names,
    check_likely,
    check_orbit,
    check_plan,
    read_orbit,
    read_plan,
    read_spacecraft,
)
from service.cli.importing.folder import interpretation_of
from service.cli.importing.manifest import FolderManifest
from service.formats.foreign.columns import TableRows
from service.formats.foreign.table import ForeignTableError
from service.runtime.clock import system_now_us

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


def require_files(manifest: FolderManifest, folder: Path) -> None:
    """Refuse a manifest that names a file that is not in its folder, or states no source of one."""
    single = [manifest.spacecraft.file, manifest.carriers, manifest.ephemeris]
    tables = (*manifest.powers, *manifest.references)
    nameless = [each.file for each in tables if not each.source]
    if nameless:
        raise ForeignTableError(f"the manifest states no source of {', '.join(nameless)}")
    names = [*filter(None, single), *(each.file for each in tables)]
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ForeignTableError(f"{folder} has no {', '.join(missing)}, which the manifest names")


def read_catalogue(folder: Path, manifest: FolderManifest) -> OwnCatalogue:
    """Return the catalogue of a manifest; a file at fault is named."""
    warnings: list[str] = []
    spacecraft_file = manifest.spacecraft.file
    with _of_file(folder, spacecraft_file):
        spacecraft = None if spacecraft_file is None else read_spacecraft(folder / spacecraft_file, warnings.append)
    spacecraft_id = manifest.spacecraft.id if spacecraft is None else spacecraft.id
    if spacecraft_id is None:
        text = "the manifest names no spacecraft: state spacecraft.file, or spacecraft.id of one that the service has"
        raise ForeignTableError(text)
    with _of_file(folder, manifest.ephemeris):
        orbit = None if manifest.ephemeris is None else read_orbit(folder / manifest.ephemeris)
        if orbit is not None and spacecraft is not None:
            members = spacecraft.model_dump(mode="json")
            check_orbit(*orbit, members, is_relocating=False, is_inclined=manifest.inclined)
    with _of_file(folder, manifest.carriers):
        plan = None if manifest.carriers is None else read_plan(folder / manifest.carriers)
        if plan is not None and spacecraft is not None:
            check_plan(plan, spacecraft.longitude_deg, warnings.append)
    if spacecraft is not None and not manifest.confirmed:
        check_likely(spacecraft, plan, spacecraft.longitude_deg)
    return OwnCatalogue(spacecraft_id, spacecraft, plan, orbit)


@contextmanager
def _of_file(folder: Path, name: str | None) -> Iterator[None]:
    """Name the file in what is raised within."""
    try:
        yield
    except ForeignTableError as error:
        raise ForeignTableError(f"{folder / str(name)}: {error}") from error


def read_tables(
    client: "ServiceClient", folder: Path, manifest: FolderManifest, own: OwnCatalogue, *, is_simulated: bool
) -> dict[str, TableRows]:
    """Return the rows of all tables of a manifest by file, each read to its end."""
    plan = [] if own.plan is None else [each.model_dump() for each in own.plan.carriers]
    if own.plan is None and manifest.powers:
        plan = client.carriers(own.spacecraft_id)["carriers"]
    found, carriers, now_us = {}, carrier_names(plan), system_now_us()
    for stated in (*manifest.references, *manifest.powers):
        with _of_file(folder, stated.file):
            path = folder / stated.file
            interpretation = interpretation_of(path, stated, carriers, now_us, is_simulated=is_simulated)
            if interpretation.questions or interpretation.rows is None:
                asked = "; ".join(f"{each.field}: {each.text}" for each in interpretation.questions)
                raise ForeignTableError(f"the manifest must state {asked}")
            found[stated.file] = interpretation.rows
    return found


def calibrate(
    client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest, reason: str | None
) -> dict[str, Any]:
    """Make a calibration of the manifest's windows the active one, unless it is, and return it.

    One with warnings stays a draft unless a reason to accept them is given; then the newest such draft is activated.
    Made again with the same figures, the former draft stays and the new one is deleted.
    """
    from service.cli.operation.operate import wait_for_job

    body = {**_windows(manifest, "quiet", "turns"), "method": "geometry"}
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
    window = _windows(manifest, "align")["align"]
    active = [each["id"] for each in _calibrations(client, spacecraft_id) if each["state"] == "active"]
    for each in client.request("GET", f"/spacecraft/{spacecraft_id}/alignments")["rows"]:
        if each["window"] == window and each["calibration_id"] in active:
            return dict(each)
    return client.align(spacecraft_id, window | {"source": _sensor(manifest)})


def _windows(manifest: FolderManifest, *names: str) -> dict[str, Any]:
    """Return windows as the interface has them; ForeignTableError where the manifest does not state them."""
    stated = manifest.windows.model_dump(mode="json", include=set(names), exclude_none=True)
    if len(stated) < len(names):
        where = "soo import FOLDER --propose finds them, or write start and stop"
        raise ForeignTableError(f"the manifest states no window {' or '.join(names)}: {where}")
    return stated


def _sensor(manifest: FolderManifest) -> str:
    """Return the sensor of calibration and alignment: that of the first file of readings."""
    return manifest.references[0].source if manifest.references else "star_tracker"
