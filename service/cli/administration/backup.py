"""``soo backup``: copies of an archive that are made while the service runs, proved, and put back.

Exit codes: 0 done and sound, 1 refused, damaged or failed, 2 a wrong option.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.administration.doctor import show
from service.cli.command_group import end, new_app
from service.cli.operation.connection import JsonOption
from service.records.storage import BackupError, Manifest, worst

app = new_app(help="Copies of an archive: made while the service runs, proved, put back.", no_args_is_help=True)

Database = Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")]
Folder = Annotated[Path, typer.Argument(help="Folder of the backup.")]
EXIT_REFUSED = 1


@app.command()
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


@app.command()
def verify(folder: Folder, as_json: JsonOption = False) -> None:
    """Compare a backup with its manifest and look at everything in it."""
    from service.composition.bootstrap import open_archive_tools

    with _guarded() as report:
        found = open_archive_tools(None).verify(folder, report)
    show(found, as_json=as_json)
    if worst(found) == "fault":
        raise typer.Exit(EXIT_REFUSED)


@app.command()
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
    """Print what was done."""
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
