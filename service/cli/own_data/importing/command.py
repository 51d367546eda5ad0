"""``soo import``: a folder of an operator's own files, proposed as a manifest and sent by it.

Exit codes: 0 all is there, or the manifest was written, 1 the service refused a request or did not answer (the same
command continues), 2 the manifest holds guesses, or a file or option is wrong, 3 the service has other values, which
were not changed, rows were refused or could not be read, or a calibration with warnings stayed a draft.
"""

import json
import shlex
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    connected,
)
from service.cli.own_data.document_file import EXIT_DIFFERENT, report, show

if TYPE_CHECKING:
    from service.cli.own_data.importing.manifest import FolderManifest
    from service.client.service_client import ServiceClient

EXIT_STOPPED = 1
_DRAFT_NEXT = (
    ", its warnings stand and nothing was aligned: correct what they name and run the command again, or accept them "
    'with --accept "REASON", which is stored with the calibration'
)
app = new_app()


@app.command("import")
def import_folder(
    folder: Annotated[Path, typer.Argument(help="Folder with the files.", file_okay=False, exists=True)],
    *,
    propose: Annotated[bool, typer.Option("--propose", help="Write FOLDER/soo.yaml, send nothing.")] = False,
    state: Annotated[
        list[str] | None, typer.Option(help="With --propose: FILE.FIELD=VALUE in place of a guess; repeat it.")
    ] = None,
    calibrate: Annotated[bool, typer.Option("--calibrate", help="Calibrate, and activate the calibration.")] = False,
    accept: Annotated[
        str | None, typer.Option(help="With --calibrate: why the calibration is activated with its warnings.")
    ] = None,
    align: Annotated[bool, typer.Option("--align", help="Align, so that angles begin.")] = False,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for powers and angles.")] = 600.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Compare with the service, send nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Send a folder: spacecraft, carriers, orbit, readings and powers; creates what is missing, changes nothing."""
    if propose:
        if calibrate or align or dry_run:
            end("--propose sends nothing; run the command again without it")
        _propose(folder, _statements(state or []), as_json=as_json)
        return
    if state:
        end("--state goes with --propose; after that it stands in soo.yaml")
    # validation and numpy cost more than the command line itself
    from service.cli.own_data.importing.manifest import read_manifest
    from service.cli.own_data.importing.steps import require_files

    manifest = read_manifest(folder)
    require_files(manifest, folder)
    signal.signal(signal.SIGTERM, _stop)
    with connected(service, key_env, retries=0, timeout_s=60.0) as client:
        try:
            done = _import(client, folder, manifest, patience, is_dry=dry_run, is_quiet=as_json)
            if not dry_run:
                done |= _operate(
                    client, done["spacecraft"], manifest, is_calibrated=calibrate, is_aligned=align, reason=accept
                )
                done |= _angles(client, done["spacecraft"], patience, is_quiet=as_json) if "alignment" in done else {}
        except KeyboardInterrupt as stop:
            end("stopped; the same command continues where this one stopped", EXIT_STOPPED, stop)
    typer.echo(json.dumps(done)) if as_json else _show(done)
    is_draft = done.get("calibration", {}).get("state") == "draft"
    if is_draft or any(each.get("refused") or each.get("unreadable") for each in done.get("files", {}).values()):
        raise typer.Exit(EXIT_DIFFERENT)


def _statements(stated: list[str]) -> dict[str, dict[str, Any]]:
    """Return fields of entries by the name of their file, or end."""
    from service.cli.own_data.importing.manifest import read_statement

    found: dict[str, dict[str, Any]] = {}
    for text in stated:
        where, _, value = text.partition("=")
        file, _, field = where.rpartition(".")
        if not file or not field or not value:
            end(f"--state {text!r}: write FILE.FIELD=VALUE, as --state levels.csv.tz=Europe/Moscow")
        found.setdefault(file, {})[field] = read_statement(value)
    return found


def _propose(folder: Path, statements: dict[str, dict[str, Any]], *, as_json: bool) -> None:
    """Write the manifest of a folder and show what it leaves open."""
    from service.cli.own_data.importing.manifest import guesses_in, read_stated, write_manifest
    from service.cli.own_data.importing.steps import propose_folder
    from service.formats.foreign.layout import ForeignTableError
    from service.frontend.backfill.columns import ArchiveError

    try:
        proposal = propose_folder(folder, read_stated(folder), statements)
        path = write_manifest(folder, proposal.sections)
    except (ForeignTableError, ArchiveError, OSError) as error:
        end(str(error), cause=error)
    guesses = [(name, guess) for name, guess in guesses_in(proposal.sections)]
    if not as_json:
        _show_sections(path, proposal.sections)
        for text in proposal.shortcomings:
            typer.echo(f"windows: {text}")
        for name, guess in guesses:
            typer.echo(f"guess: {name} = {guess.value or 'nothing'}: {guess.reason}")
    fields = [name.partition(" ")[2] for name, _ in guesses if " " in name]
    stating = " ".join(f"--state {shlex.quote(name)}=VALUE" for name in fields)
    step = f"soo import {shlex.quote(str(folder))}"
    next_step = f"correct the {len(guesses)} values marked !guess and remove the marks" if guesses else step
    next_step += f", or state them: {step} --propose {stating}" if stating else ""
    document = {
        "manifest": str(path),
        "guesses": {name: guess.reason for name, guess in guesses},
        "shortcomings": list(proposal.shortcomings),
        "left_out": proposal.sections.get("left_out", {}),
    }
    report(document, as_json=as_json, sentence=f"{path} is written; next: {next_step}")


def _show_sections(path: Path, sections: dict[str, Any]) -> None:
    """Print role and reading of each file."""
    from service.cli.own_data.importing.manifest import plain_value

    rows: list[tuple[str, ...]] = []
    for role, section in sections.items():
        for entry in section if isinstance(section, list) else [section]:
            members = plain_value(entry)
            if isinstance(members, dict):
                members = "\n".join(f"{name}: {_brief(value)}" for name, value in members.items())
            rows.append((role.replace("_", " "), str(members)))
    show(str(path), rows)


def _brief(value: Any) -> str:
    """Return a field for people; a guess ends with a question mark."""
    from service.cli.own_data.importing.manifest import Guess, plain_value

    plain = plain_value(value)
    if isinstance(plain, dict):
        plain = ", ".join(f"{name} = {each}" for name, each in plain.items())
    elif isinstance(plain, list):
        plain = " + ".join(map(str, plain))
    return f"{plain} ?" if isinstance(value, Guess) else str(plain)


def _import(
    client: "ServiceClient",
    folder: Path,
    manifest: "FolderManifest",
    patience_s: float,
    *,
    is_dry: bool,
    is_quiet: bool,
) -> dict[str, Any]:
    """Create what is missing and send the files; end where the service has something else."""
    from service.cli.own_data.importing.steps import compared, import_powers, import_references

    spacecraft_id, comparison = compared(client, folder, manifest)
    if comparison.differences:
        lines = [
            f"  {name}: the folder has {here}, the service {there}"
            for name, (here, there) in comparison.differences.items()
        ]
        lines.append("nothing was sent; correct the file, change the service (soo ... put), or leave the file out")
        end("\n".join((f"the service has {spacecraft_id} otherwise:", *lines)), EXIT_DIFFERENT)
    done: dict[str, Any] = {"spacecraft": spacecraft_id, "created": [] if is_dry else list(comparison.creations)}
    if is_dry:
        return done | {"missing": list(comparison.creations)}
    for create in comparison.creations.values():
        create()
    spacecraft = client.spacecraft(spacecraft_id)
    files = {each.file: import_references(client, folder, each, spacecraft) for each in manifest.references}
    for powers in manifest.powers:
        files[powers.file] = import_powers(client, folder, powers, spacecraft, patience_s, is_quiet=is_quiet)
    return done | {"files": files}


def _operate(
    client: "ServiceClient",
    spacecraft_id: str,
    manifest: "FolderManifest",
    *,
    is_calibrated: bool,
    is_aligned: bool,
    reason: str | None,
) -> dict[str, Any]:
    """Calibrate and align as far as that was asked for; nothing is aligned with a calibration that stays a draft."""
    from service.cli.own_data.importing.steps import align, calibrate

    done: dict[str, Any] = {}
    if is_calibrated:
        made = calibrate(client, spacecraft_id, manifest, reason)
        warnings = made["quality"].get("warnings", [])
        done["calibration"] = {"id": made["id"], "state": made["state"], "warnings": warnings}
        is_aligned = is_aligned and made["state"] == "active"
    if is_aligned:
        aligned = align(client, spacecraft_id, manifest)
        done["alignment"] = {"id": aligned["id"], "epoch": aligned["epoch"]}
    return done


def _angles(client: "ServiceClient", spacecraft_id: str, patience_s: float, *, is_quiet: bool) -> dict[str, Any]:
    """Wait for the angles of the rows and return the newest."""
    from service.cli.own_data.angles import wait_for_angles

    angles = wait_for_angles(client, spacecraft_id, patience_s, is_quiet=is_quiet)
    names = ("epoch", "yaw_deg", "roll_deg", "pitch_deg")
    newest: dict[str, Any] = dict(client.attitude(spacecraft_id)) if angles["newest_attitude"] else {}
    return {"angles": angles, "attitude": {name: newest.get(name) for name in names}}


def _show(done: dict[str, Any]) -> None:
    """Print what was done, for people."""
    if "missing" in done:
        typer.echo(f"missing in the service: {', '.join(done['missing']) or 'nothing'}; nothing was sent")
        return
    typer.echo(f"{done['spacecraft']}: created {', '.join(done['created']) or 'nothing, all was there'}")
    for name, counts in done["files"].items():
        shown = ("accepted", "duplicates", "refused", "unreadable")
        typer.echo(f"{name}: " + ", ".join(f"{counts[each]} {each}" for each in shown))
    if "calibration" in done:
        next_step = _DRAFT_NEXT if done["calibration"]["state"] == "draft" else ""
        for warning in done["calibration"]["warnings"]:
            typer.echo(f"warning: {warning}")
        typer.echo(f"calibration {done['calibration']['id']} is {done['calibration']['state']}{next_step}")
    if "alignment" in done:
        typer.echo(f"alignment {done['alignment']['id']} at {done['alignment']['epoch']}")
    if "angles" in done and done["attitude"]["yaw_deg"] is None:
        typer.echo("no angles yet: no row lies after the alignment; they begin with the next row")
    elif "angles" in done:
        angles = ", ".join(f"{axis} {done['attitude'][f'{axis}_deg']:+.3f}" for axis in ("yaw", "roll", "pitch"))
        typer.echo(f"angles at {done['attitude']['epoch']}: {angles} deg")


def _stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does."""
    raise KeyboardInterrupt
