"""``soo import``: an operator's own files, proposed as a manifest, asked about, and sent by it.

Exit codes: 0 all is there, or the manifest was written, 1 the service refused a request or did not answer (the same
command continues), 2 the manifest holds guesses (standard error names the option that states each), or a file or option
is wrong, 3 the service has other values, which were not changed, rows were refused or could not be read, or a
calibration with warnings stayed a draft.
"""

import json
import shlex
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end, new_app
from service.cli.importing.dialogue import EXIT_DIFFERENT, EXIT_STOPPED, answer, is_terminal, printable, shown, stop
from service.cli.operation import connection

if TYPE_CHECKING:
    from service.cli.importing.folder import ImportFiles
    from service.cli.importing.manifest import FolderManifest, Guess
    from service.client.service_client import ServiceClient


_DRAFT_NEXT = (
    ", its warnings stand and nothing was aligned: correct what they name and run the command again, or accept them "
    'with --accept "REASON", which is stored with the calibration'
)
import_app = new_app()


@import_app.command("import")
def import_files(
    files: Annotated[list[Path], typer.Argument(help="Folder with the files, or files of one folder.", exists=True)],
    *,
    propose: Annotated[bool, typer.Option("--propose", help="Write soo.yaml beside the files, send nothing.")] = False,
    state: Annotated[list[str] | None, typer.Option(help="FILE.FIELD=VALUE in place of a guess; repeat it.")] = None,
    calibrate: Annotated[bool, typer.Option("--calibrate", help="Calibrate, and activate the calibration.")] = False,
    accept: Annotated[
        str | None, typer.Option(help="With --calibrate: why the calibration is activated with its warnings.")
    ] = None,
    align: Annotated[bool, typer.Option("--align", help="Align, so that angles begin.")] = False,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for powers and angles.")] = 600.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Compare with the service, send nothing.")] = False,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Send files: spacecraft, carriers, orbit, readings and powers; creates what is missing, changes nothing."""
    if propose and (calibrate or align or dry_run):
        end("--propose sends nothing; run the command again without it")
    # validation and numpy cost more than the command line itself
    from service.cli.importing.folder import require_files
    from service.cli.importing.manifest import NAME, read_manifest
    from service.formats.foreign.table import ForeignTableError

    folder, named = _folder_of(files)
    try:
        if propose or state or not (folder / NAME).exists():
            _propose(folder, named, _statements(state or []), files, is_only=propose, as_json=as_json)
            if propose:
                return
        manifest = read_manifest(folder)
        require_files(manifest, folder)
        signal.signal(signal.SIGTERM, stop)
        with connection.connected(service, key_env, retries=0, timeout_s=60.0) as client:
            done = _import(client, folder, manifest, patience, is_dry=dry_run, is_quiet=as_json)
            if not dry_run:
                done |= _operate(client, done, manifest, (calibrate, align, accept, patience), is_quiet=as_json)
    except ForeignTableError as error:
        end(str(error), cause=error)
    except KeyboardInterrupt as error:
        end("stopped; the same command continues where this one stopped", EXIT_STOPPED, error)
    typer.echo(json.dumps(done)) if as_json else _show(done)
    is_draft = done.get("calibration", {}).get("state") == "draft"
    if is_draft or any(each.get("refused") or each.get("unreadable") for each in done.get("files", {}).values()):
        raise typer.Exit(EXIT_DIFFERENT)


def _folder_of(files: list[Path]) -> tuple[Path, list[Path] | None]:
    """Return the folder of files, and the files themselves where they are named one by one."""
    if len(files) == 1 and files[0].is_dir():
        return files[0], None
    folders = {path.resolve().parent for path in files}
    if any(path.is_dir() for path in files) or len(folders) > 1:
        end("name one folder, or files of one folder")
    return files[0].parent, [files[0].parent / path.name for path in files]


def _statements(stated: list[str]) -> dict[str, dict[str, Any]]:
    """Return fields of entries by the name of their file, of the whole manifest by no name, or end."""
    from service.cli.importing.manifest import TOP_FIELDS, read_statement

    found: dict[str, dict[str, Any]] = {}
    for text in stated:
        where, _, value = text.partition("=")
        file, _, field = where.rpartition(".")
        if not field or not value or (not file and field not in TOP_FIELDS):
            end(f"--state {text!r}: write FILE.FIELD=VALUE, as --state levels.csv.tz=Europe/Moscow")
        found.setdefault(file, {})[field] = read_statement(value)
    return found


def _propose(
    folder: Path,
    named: list[Path] | None,
    statements: dict[str, dict[str, Any]],
    files: list[Path],
    *,
    is_only: bool,
    as_json: bool,
) -> None:
    """Write the manifest of files; what it leaves open is asked on a terminal, or ends the command with its options."""
    from service.cli.importing.folder import ImportFiles, files_of, propose
    from service.cli.importing.manifest import guesses_in, read_stated, with_top_fields, write_manifest
    from service.runtime.clock import system_now_us

    while True:
        paths, left_out = files_of(folder) if named is None else (sorted(named), {})
        stated = with_top_fields(read_stated(folder), statements.get("", {}))
        importing = ImportFiles(folder, paths, stated, statements, system_now_us(), left_out)
        sections = propose(importing)
        guesses = list(guesses_in(sections))
        asked = [(*_place_of(name), guess) for name, guess in guesses if not name.startswith("windows")]
        if not asked or is_only or as_json or not is_terminal():
            break
        for file, field, guess in asked:
            name = f"{file}.{field}".lstrip(".")
            statements.setdefault(file, {})[field] = answer(f"{name}: {guess.reason}", guess.value)
    path = write_manifest(folder, sections)
    options = [(f"{file}.{field}".lstrip("."), guess, _value(guess)) for file, field, guess in asked]
    words = [word for name, _, value in options for word in ("--state", f"{name}={value}")]
    document = {
        "manifest": str(path),
        "guesses": {name: guess.reason for name, guess in guesses},
        "shortcomings": list(importing.shortcomings),
        "left_out": importing.left_out,
        "notes": {name: list(notes) for name, notes in importing.notes.items()},
        "next": shlex.join(["soo", "import", *map(str, files), *words]),
    }
    if not as_json:
        _show_proposal(path, sections, importing)
    absent = {role for role in ("carriers", "ephemeris") if role not in sections}
    absent |= set() if sections["spacecraft"].get("file") else {"spacecraft"}
    broken = [name for name, role in importing.faulty.items() if role in absent]
    if is_only:
        next_step = "correct what is marked !guess, or state it: " if asked else ""
        typer.echo(json.dumps(document) if as_json else f"{path} is written; next: {next_step}{document['next']}")
    elif asked:
        lines = [f"{path} is written, nothing was sent; this must be stated, it is not guessed:"]
        lines += [f"  {name} = {value}: {guess.reason}" for name, guess, value in options]
        end(printable("\n".join((*lines, f"State it: {document['next']}"))))
    elif broken:
        reasons = [f"  {name}: {importing.left_out[name]}" for name in broken]
        end(printable("\n".join(("nothing was sent: a file that the others need is left out", *reasons))))


def _place_of(name: str) -> tuple[str, str]:
    """Return file and field of a guess; no file for one of the whole manifest."""
    entry, _, where = name.partition(" ")
    file, _, field = where.rpartition(".")
    return (file, field) if where else ("", entry.partition(".")[0])


def _value(guess: "Guess") -> str:
    """Return the value of a guess as --state writes it."""
    return "VALUE" if guess.value is None else shown(guess.value)


def _show_proposal(path: Path, sections: dict[str, Any], importing: "ImportFiles") -> None:
    """Print the manifest and how each file is read, in lines that any terminal can hold."""
    from service.cli.importing.manifest import manifest_text

    roles = {name: section for name, section in sections.items() if name != "left_out"}
    lines = [f"{path}:", *manifest_text(roles).splitlines()]
    lines += [f"{name}: {note}" for name, notes in importing.notes.items() for note in notes]
    reasons: dict[str, list[str]] = {}
    for name, reason in importing.left_out.items():
        reasons.setdefault(reason, []).append(name)
    lines += [f"left out: {', '.join(names)}: {reason}" for reason, names in reasons.items()]
    lines += [f"warning: {text}" for text in dict.fromkeys(importing.warnings)]
    lines += [f"windows: {text}" for text in importing.shortcomings]
    for line in lines:
        typer.echo(printable(line))


def _import(
    client: "ServiceClient",
    folder: Path,
    manifest: "FolderManifest",
    patience_s: float,
    *,
    is_dry: bool,
    is_quiet: bool,
) -> dict[str, Any]:
    """Read everything, then create what is missing and send the files; end where the service has something else."""
    from service.cli.importing.catalogue import compared
    from service.cli.importing.folder import read_catalogue, read_tables
    from service.cli.importing.sending import SendOrder, SendState, send_powers, send_readings

    own = read_catalogue(folder, manifest)
    comparison = compared(client, own)
    if comparison.differences:
        pairs = comparison.differences.items()
        lines = [f"  {name}: the folder has {here}, the service {there}" for name, (here, there) in pairs]
        lines.append("nothing was sent; correct the file, change the service (soo put ...), or leave the file out")
        end("\n".join((f"the service has {own.spacecraft_id} otherwise:", *lines)), EXIT_DIFFERENT)
    tables = read_tables(client, folder, manifest, own, is_simulated=bool(comparison.members.get("simulated")))
    done: dict[str, Any] = {"spacecraft": own.spacecraft_id, "created": [] if is_dry else list(comparison.creations)}
    if is_dry:
        return done | {"missing": list(comparison.creations), "rows": {n: len(r.lines) for n, r in tables.items()}}
    for create in comparison.creations.values():
        create()
    files = {}
    for readings in manifest.references:
        files[readings.file] = send_readings(client, own.spacecraft_id, readings, tables[readings.file])
    for powers in manifest.powers:
        statement = powers.model_dump_json(exclude_defaults=True)
        path = folder / powers.file
        order = SendOrder(path, own.spacecraft_id, powers.source, statement, patience_s=patience_s)
        state = SendState(order, client.service_url)
        files[powers.file] = send_powers(client, order, tables[powers.file], state, is_quiet=is_quiet)
    return done | {"files": files}


def _operate(
    client: "ServiceClient",
    done: dict[str, Any],
    manifest: "FolderManifest",
    options: tuple[bool, bool, str | None, float],
    *,
    is_quiet: bool,
) -> dict[str, Any]:
    """Calibrate and align as far as that was asked for; nothing is aligned with a calibration that stays a draft."""
    from service.cli.importing.folder import align, calibrate
    from service.cli.importing.sending import wait_for_angles

    is_calibrated, is_aligned, reason, patience_s = options
    spacecraft_id, found = done["spacecraft"], dict[str, Any]()
    if is_calibrated:
        made = calibrate(client, spacecraft_id, manifest, reason)
        warnings = made["quality"].get("warnings", [])
        found["calibration"] = {"id": made["id"], "state": made["state"], "warnings": warnings}
        is_aligned = is_aligned and made["state"] == "active"
    if is_aligned:
        aligned = align(client, spacecraft_id, manifest)
        angles = wait_for_angles(client, spacecraft_id, patience_s, is_quiet=is_quiet)
        newest: dict[str, Any] = dict(client.attitude(spacecraft_id)) if angles["newest_attitude"] else {}
        attitude = {name: newest.get(name) for name in ("epoch", "yaw_deg", "roll_deg", "pitch_deg")}
        found |= {"alignment": {name: aligned[name] for name in ("id", "epoch")}}
        found |= {"angles": angles, "attitude": attitude}
    return found


def _show(done: dict[str, Any]) -> None:
    if "missing" in done:
        typer.echo(f"missing in the service: {', '.join(done['missing']) or 'nothing'}; nothing was sent")
        return
    lines = [f"{done['spacecraft']}: created {', '.join(done['created']) or 'nothing, all was there'}"]
    for name, counts in done["files"].items():
        outcomes = ("accepted", "duplicates", "refused", "unreadable")
        lines.append(f"{name}: " + ", ".join(f"{counts[each]} {each}" for each in outcomes))
        lines += [f"  {fault}" for fault in counts["faults"]]
    if "calibration" in done:
        number, state, warnings = done["calibration"].values()
        lines += [f"warning: {warning}" for warning in warnings]
        lines.append(f"calibration {number} is {state}{_DRAFT_NEXT if state == 'draft' else ''}")
    if "alignment" in done:
        epoch, *angles_deg = done["attitude"].values()
        lines.append(f"alignment {done['alignment']['id']} at {done['alignment']['epoch']}")
        if angles_deg[0] is None:
            lines.append("no angles yet: no row lies after the alignment; they begin with the next row")
        else:
            yaw_deg, roll_deg, pitch_deg = angles_deg
            lines.append(f"angles at {epoch}: yaw {yaw_deg:+.3f}, roll {roll_deg:+.3f}, pitch {pitch_deg:+.3f} deg")
    for line in lines:
        typer.echo(printable(line))
