"""Steps of an import by its manifest: everything is read first, then created and sent; each may be repeated."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.cli.importing.catalogue import (
    OwnCatalogue,
    carrier_names,
    check_orbit,
    check_plan,
    read_orbit,
    read_plan,
    read_spacecraft,
    unlikely,
)
from service.cli.importing.folder import read_readings, table_of
from service.cli.importing.manifest import FolderManifest, WindowSection
from service.cli.importing.sending import SendOrder, SendState, send_readings, send_with_progress
from service.formats.foreign.columns import (
    Interpretation,
    PowersStatement,
    ReadingsStatement,
    TableRows,
    grouped,
    interpret_powers,
)
from service.formats.foreign.table import ForeignTableError
from service.records.epoch import format_epoch
from service.runtime.clock import system_now_us

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

_NO_WINDOWS = "the manifest states no window {names}: soo import FOLDER --propose finds them, or write start and stop"


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
    odd = [] if spacecraft is None or manifest.confirmed else unlikely(spacecraft, plan, spacecraft.longitude_deg)
    if odd:
        raise ForeignTableError("\n  ".join(("this must be confirmed (confirmed: true in the manifest):", *odd)))
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
    now_us = system_now_us()
    plan = own.plan
    if plan is None and manifest.powers:
        carriers = carrier_names(client.carriers(own.spacecraft_id)["carriers"])
    else:
        carriers = {} if plan is None else carrier_names([each.model_dump() for each in plan.carriers])
    found = {}
    for readings in manifest.references:
        with _of_file(folder, readings.file):
            read = read_readings(folder / readings.file, readings, now_us, is_simulated=is_simulated)
            found[readings.file] = rows_of(read)
    for powers in manifest.powers:
        with _of_file(folder, powers.file):
            found[powers.file] = powers_of(folder / powers.file, powers, carriers, now_us, is_simulated=is_simulated)
    return found


def powers_of(
    path: Path, stated: PowersStatement, carriers: Mapping[str, str], now_us: int, *, is_simulated: bool
) -> TableRows:
    """Return the powers of a file under its statement; ForeignTableError where that leaves something open."""
    table = table_of(path, stated.container)
    return rows_of(interpret_powers(table, stated, carriers, now_us, is_simulated=is_simulated))


def rows_of(read: Interpretation) -> TableRows:
    """Return the rows of a reading that leaves nothing open."""
    if read.questions or read.rows is None:
        asked = "; ".join(f"{each.field}: {each.text}" for each in read.questions)
        raise ForeignTableError(f"the manifest must state {asked}")
    return read.rows


def import_readings(
    client: "ServiceClient", spacecraft_id: str, stated: ReadingsStatement, rows: TableRows
) -> dict[str, Any]:
    """Send the readings of a file and return what became of them."""
    sigma_deg = {str(axis): value for axis, value in stated.sigma_deg.items()}
    counts = send_readings(client, spacecraft_id, stated.source, rows, sigma_deg)
    return {**counts, "unreadable": len(rows.faults), "faults": grouped(rows.faults)}


def import_powers(
    client: "ServiceClient", order: tuple[Path, str, float], stated: PowersStatement, rows: TableRows, *, is_quiet: bool
) -> dict[str, Any]:
    """Send the powers of a file, or the rest of them, and return what became of the rows."""
    path, spacecraft_id, patience_s = order
    statement = stated.model_dump_json(exclude_defaults=True)
    sending = SendOrder(path, spacecraft_id, stated.source, statement, patience_s=patience_s)
    state = SendState(sending, client.service_url)
    state.plan_id = int(client.carriers(spacecraft_id)["plan_id"]) if state.plan_id is None else state.plan_id
    return send_with_progress(client, sending, rows, state, is_quiet=is_quiet)


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
        raise ForeignTableError(_NO_WINDOWS.format(names="quiet or turns"))
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
        raise ForeignTableError(_NO_WINDOWS.format(names="align"))
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
