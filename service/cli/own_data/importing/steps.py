"""Steps of an import after the catalogue: readings, powers, calibration, alignment; each may be repeated."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.cli.command_group import end
from service.cli.own_data.archive_progress import send_with_progress
from service.cli.own_data.foreign_file import carrier_names, impossibility, is_own, laid_out
from service.cli.own_data.importing.entries import complete_layout
from service.cli.own_data.importing.manifest import FolderManifest, PowersSection, ReferencesSection, WindowSection
from service.cli.own_data.importing.windows import readings_of
from service.cli.own_data.readings import check_readings, send_readings, survey_of
from service.cli.own_data.tdm_archive import open_any_archive
from service.frontend.backfill.backfill import ArchiveOrder, check_archive
from service.frontend.backfill.columns import ArchiveError
from service.records.epoch import format_epoch
from service.runtime.clock import system_now_us

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

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


def calibrate(client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest) -> dict[str, Any]:
    """Make a calibration of the manifest's windows the active one, unless it is, and return it."""
    from service.cli.operation.operate import wait_for_job

    quiet, turns = manifest.windows.quiet, manifest.windows.turns
    if quiet is None or turns is None:
        end(_NO_WINDOWS.format(names="quiet or turns"))
    body = {"quiet": _document(quiet), "turns": _document(turns), "method": "geometry", "source": _sensor(manifest)}
    for each in _calibrations(client, spacecraft_id):
        if each["state"] == "active" and each["quiet"] == body["quiet"] and each["turns"] == body["turns"]:
            return each
    started = client.start_calibration(spacecraft_id, body)
    wait_for_job(client, started["job"], "calibration")
    client.activate_calibration(spacecraft_id, started["id"])
    return client.calibration(spacecraft_id, started["id"])


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
