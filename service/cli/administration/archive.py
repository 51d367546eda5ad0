"""Archive of a service: its backups, what is wrong with it, and the upkeep of its days.

Exit codes of ``doctor``: 0 sound, 1 something is damaged or does not work, 2 the option is wrong, 3 it works, with
warnings.
"""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.administration.access import logged
from service.cli.command_group import end, new_app
from service.cli.operation.connection import JsonOption
from service.errors import StorageError
from service.records.storage import BackupError, Diagnosis, Manifest, State, worst

backup_app = new_app(help="Copies of an archive: made while the service runs, proved, put back.", no_args_is_help=True)

Database = Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")]
Folder = Annotated[Path, typer.Argument(help="Folder of the backup.")]
EXIT_REFUSED = 1


@backup_app.command()
def create(
    folder: Annotated[Path | None, typer.Argument(help="Folder to make; default soo-TIME.backup here.")] = None,
    database: Database = None,
    as_json: JsonOption = False,
) -> None:
    """Copy an archive into a new folder, while the service may be running."""
    from service.composition.bootstrap import open_archive_tools

    keeping = open_archive_tools(database)
    target = folder or Path(f"soo-{keeping.stamp()}.backup")
    with _guarded() as report:
        manifest = keeping.create(target, report)
    _report({"folder": str(target), **asdict(manifest)}, as_json=as_json)
    _report_damaged(manifest)
    if manifest.damaged:
        raise typer.Exit(EXIT_REFUSED)


@backup_app.command()
def verify(folder: Folder, as_json: JsonOption = False) -> None:
    """Compare a backup with its manifest and look at everything in it."""
    from service.composition.bootstrap import open_archive_tools

    with _guarded() as report:
        found = open_archive_tools(None).verify(folder, report)
    show(found, as_json=as_json)
    if worst(found) == "fault":
        raise typer.Exit(EXIT_REFUSED)


@backup_app.command()
def restore(
    folder: Folder,
    database: Database = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Move an archive that is there aside; it is kept.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Put a backup in the place of an archive; the service must be stopped."""
    from service.composition.bootstrap import open_archive_tools

    with _guarded() as report:
        restored = open_archive_tools(database).restore(folder, report, may_replace=replace)
    _report({"kept": restored.aside, "spacecraft": asdict(restored.manifest)["spacecraft"]}, as_json=as_json)
    _report_damaged(restored.manifest)


def _report_damaged(manifest: Manifest) -> None:
    """Print the rows that were damaged when a backup was made."""
    for words in manifest.damaged:
        typer.echo(f"damaged: {words}; they were copied as they are, an older backup may have them sound", err=True)


@contextmanager
def _guarded() -> Iterator[Callable[[str, float], None]]:
    """Give a function that shows progress; a refusal ends the command with its words."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        tasks: dict[str, Any] = {}

        def report(step: str, share: float) -> None:
            if step not in tasks:
                tasks[step] = progress.add_task(step, total=1.0)
            progress.update(tasks[step], completed=share)

        try:
            yield report
        except BackupError as error:
            end(str(error), EXIT_REFUSED, error)
        except OSError as error:
            end(f"{error.filename or 'disk'}: {error.strerror}", EXIT_REFUSED, error)
        except ValueError as error:
            end(str(error), cause=error)


def _report(report: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(report))
        return
    spacecraft_reports = report.pop("spacecraft")
    for name in ("tables", "damaged"):
        report.pop(name, None)
    for name, value in report.items():
        typer.echo(f"{name}: {value}")
    for name, count in spacecraft_reports.items():
        typer.echo(f"{name}: journal up to {count['newest_number']}, {count['rows'].get('measurement', 0)} open rows")


EXIT_OF: dict[State, int] = {"ok": 0, "fault": 1, "warning": 3}
_LOGGED = re.compile(r"journal head ([a-z0-9-]+) (\d+) ([0-9a-f]{16})")
_COLOURS: dict[State, str] = {"ok": "green", "warning": "yellow", "fault": "red"}


def doctor(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    log: Annotated[
        list[Path] | None, typer.Option(help="Log of the service; the journals must hold the entries that it names.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Look at an archive, also of a running service, and say what is wrong and what to do."""
    from rich.console import Console

    # the database costs time that other commands need not pay
    from service.composition.bootstrap import open_archive_tools
    from service.records.inputs import JournalHead

    announced = [JournalHead(name, int(number), digest) for name, number, digest in logged(_LOGGED, log or [])]
    if log and not announced:
        end("the log names no head of a journal: lines `journal head SPACECRAFT NUMBER DIGEST`")
    try:
        with Console(stderr=True).status("opening") as status:
            found = open_archive_tools(database).diagnose(status.update, announced)
    except ValueError as error:
        end(str(error), cause=error)
    show(found, as_json=as_json)
    raise typer.Exit(EXIT_OF[worst(found)])


def show(found: list[Diagnosis], *, as_json: bool) -> None:
    """Print diagnoses."""
    from rich.console import Console
    from rich.table import Table

    if as_json:
        typer.echo(json.dumps({"state": worst(found), "checks": [asdict(diagnosis) for diagnosis in found]}))
        return
    table = Table("check", "state", "what is there, and what to do")
    for diagnosis in found:
        words = diagnosis.detail + (f"\n[bold]{diagnosis.advice}[/bold]" if diagnosis.advice else "")
        colour = _COLOURS[diagnosis.state]
        table.add_row(diagnosis.check, f"[{colour}]{diagnosis.state}[/{colour}]", words)
    Console().print(table)


EXIT_FAULT = 1


def maintenance(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Seal closed days and drop what retention no longer keeps, as the service does by itself."""
    # the database costs time that other commands need not pay
    from service.composition.bootstrap import build_clock, build_maintenance, open_storage
    from service.composition.settings import Settings

    settings = Settings.model_validate({} if database is None else {"database_url": database})
    try:
        storage = open_storage(settings)
    except (StorageError, ValueError) as error:
        end(f"cannot use the database: {error}", cause=error)
    try:
        work = build_maintenance(settings, storage, build_clock(settings, storage))
        failed = work.do_all()
    finally:
        storage.close()
    dropped = {series: rows for series, rows in work.dropped_rows.items() if rows}
    if as_json:
        reported = {
            "sealed_rows": work.sealed_rows,
            "sealed_results": work.sealed_results,
            "dropped_rows": dropped,
            "failed_spacecraft": failed,
        }
        typer.echo(json.dumps(reported))
    else:
        typer.echo(f"sealed {work.sealed_rows} rows, {work.sealed_results} results")
        for series, rows in dropped.items():
            typer.echo(f"dropped {rows} rows of {series}")
    if failed:
        raise typer.Exit(EXIT_FAULT)
