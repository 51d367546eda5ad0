"""``soo send``: an archive that a station already has, sent to the service.

Exit codes: 0 every row is accepted or was known, 1 the service refused the request or did not answer (the same command
continues where it stopped), 2 the file or an option is wrong, 3 rows were refused or could not be read.
"""

import json
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from service.cli.command_group import end
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.frontend.backfill import backfill

EXIT_STOPPED, EXIT_REFUSED = 1, 3


def send(
    file: Annotated[Path, typer.Argument(help="CSV, NDJSON, Parquet or TDM file.", dir_okay=False, exists=True)],
    *,
    spacecraft: SpacecraftOption,
    source: Annotated[str, typer.Option(help="Source under which the rows are stored.")],
    from_source: Annotated[
        str | None, typer.Option(help="Send rows that the file gives to this source; default: those of --source.")
    ] = None,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and check the file, send nothing.")] = False,
    refuse_unknown: Annotated[
        bool, typer.Option("--refuse-unknown", help="Refuse a file with columns that are no carrier of the plan.")
    ] = False,
    batch_rows: Annotated[int, typer.Option(min=1, max=10_000, help="Rows of one request at most.")] = 1000,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for a service that is away.")] = 600.0,
    state: Annotated[
        Path | None,
        typer.Option(help="Folder for progress and refused rows; default: beside the file.", file_okay=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Send an archive of carrier powers to the service; continues where it was interrupted."""
    # httpx and numpy cost more than the command line itself
    from service.cli.station.tdm_archive import open_any_archive
    from service.frontend.backfill.backfill import ArchiveOrder, check_archive
    from service.frontend.backfill.columns import ArchiveError

    order = ArchiveOrder(
        file, spacecraft, source, from_source, refuse_unknown, batch_rows, patience, state, open_any_archive
    )
    signal.signal(signal.SIGTERM, _stop)
    with connected(service, key_env, retries=0, timeout_s=60.0) as client:
        try:
            report = check_archive(client, order) if dry_run else _send(client, order, is_quiet=as_json)
        except (ArchiveError, OSError) as error:
            end(str(error), cause=error)
        except KeyboardInterrupt as stop:
            end("stopped; the same command continues where this one stopped", EXIT_STOPPED, stop)
    typer.echo(json.dumps(report)) if as_json else _show(report)
    _end(report, source)


def _send(client: "ServiceClient", order: "backfill.ArchiveOrder", *, is_quiet: bool) -> dict[str, Any]:
    """Send behind a progress bar; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from service.frontend.backfill.backfill import send_archive

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    bar = Progress(*columns, TextColumn("{task.fields[rate]}"), console=console)
    bar.disable = is_quiet or not console.is_terminal
    with bar:
        task = bar.add_task(order.path.name, total=None, rate="")
        begun_at = bar.get_time()
        first: list[int] = []

        def show(progress: "backfill.Progress") -> None:
            first.append(progress.rows) if not first else None
            rate = (progress.rows - first[0]) / max(bar.get_time() - begun_at, 1e-3)
            bar.update(task, completed=progress.done, total=progress.total, rate=f"{rate:,.0f} rows/s")

        return send_archive(client, order, show)


def _stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does."""
    raise KeyboardInterrupt


def _show(report: dict[str, Any]) -> None:
    """Print a report as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table("", "", show_header=False)
    for name, value in report.items():
        if name not in {"columns", "faults"} and value not in ({}, None):
            table.add_row(name, str(value))
    for name, columns in report["columns"].items():
        if columns:
            table.add_row(f"columns {name}", ", ".join(columns))
    for fault in report.get("faults", ()):
        table.add_row(f"line {fault['line']}", fault["detail"])
    Console().print(table)


def _end(report: dict[str, Any], source: str) -> None:
    """End with the code that tells what became of the rows."""
    foreign = report["other_sources"]
    sent = report["rows"] if "faults" in report else report["rows"] - sum(foreign.values())
    if foreign and not sent:
        end(f"no row of {source}; the file's are of {', '.join(foreign)}: see --from-source")
    if report["unreadable"] or report.get("refused"):
        raise typer.Exit(EXIT_REFUSED)
