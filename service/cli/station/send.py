"""``soo send``: an archive that a station already has, sent to the service.

Exit codes: 0 every row is accepted or was known, 1 the service refused the request or did not answer (the same command
continues where it stopped), 2 the file or an option is wrong, 3 rows were refused or could not be read.
"""

import json
import signal
import sys
from collections.abc import Iterator
from enum import StrEnum
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
    from service.formats.foreign.layout import StatedLayout
    from service.frontend.backfill import backfill

EXIT_STOPPED, EXIT_REFUSED = 1, 3


class DecimalSign(StrEnum):
    """Decimal sign of a foreign file."""

    POINT = "point"
    COMMA = "comma"


class LevelUnit(StrEnum):
    """Unit of the levels of a foreign file."""

    DBM = "dBm"
    DBW = "dBW"


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
    time_column: Annotated[
        list[str] | None, typer.Option(help="Foreign file: column of the epochs; date and time: state both.")
    ] = None,
    time_format: Annotated[
        str | None, typer.Option(help="`iso`, `unix_s`, `unix_ms`, `unix_us`, or a pattern: %d.%m.%Y %H:%M:%S.")
    ] = None,
    tz: Annotated[
        str | None, typer.Option(help="Zone of epochs without an offset: UTC, +03:00, Europe/Moscow.")
    ] = None,
    decimal: Annotated[DecimalSign | None, typer.Option(help="Decimal sign of the levels.")] = None,
    unit: Annotated[LevelUnit | None, typer.Option(help="Unit of levels whose columns name none.")] = None,
    carrier_column: Annotated[
        str | None, typer.Option(help="One level a line: column with the name of the carrier.")
    ] = None,
    level_column: Annotated[str | None, typer.Option(help="One level a line: column of the levels.")] = None,
    map_: Annotated[
        list[str] | None, typer.Option("--map", help="NAME=CARRIER: column or name, and the carrier of the plan.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Send an archive of carrier powers to the service; continues where it was interrupted."""
    # httpx and numpy cost more than the command line itself
    from service.cli.own_data.foreign_file import stated_pairs
    from service.cli.own_data.tdm_archive import open_any_archive
    from service.formats.foreign.layout import StatedLayout
    from service.frontend.backfill.backfill import ArchiveOrder
    from service.frontend.backfill.columns import ArchiveError

    stated = StatedLayout(
        tuple(time_column or ()),
        time_format,
        tz,
        None if decimal is None else decimal.value,
        None if unit is None else unit.value,
        carrier_column,
        level_column,
        stated_pairs(map_ or [], "--map", "NAME=CARRIER"),
    )
    order = ArchiveOrder(
        file, spacecraft, source, from_source, refuse_unknown, batch_rows, patience, state, open_any_archive
    )
    signal.signal(signal.SIGTERM, _stop)
    with connected(service, key_env, retries=0, timeout_s=60.0) as client:
        try:
            report = _run(client, order, stated, is_dry=dry_run, is_quiet=as_json)
        except (ArchiveError, OSError) as error:
            end(str(error), cause=error)
        except KeyboardInterrupt as stop:
            end("stopped; the same command continues where this one stopped", EXIT_STOPPED, stop)
    typer.echo(json.dumps(report)) if as_json else _show(report, spacecraft)
    _end(report, source)


def _run(
    client: "ServiceClient", order: "backfill.ArchiveOrder", stated: "StatedLayout", *, is_dry: bool, is_quiet: bool
) -> dict[str, Any]:
    """Survey a file, and send it unless the survey was all that was asked for."""
    from service.cli.own_data.angles import wait_for_angles
    from service.cli.own_data.archive_progress import send_with_progress
    from service.cli.own_data.foreign_file import impossibility, with_layout
    from service.frontend.backfill.backfill import check_archive
    from service.runtime.clock import system_now_us

    order = with_layout(client, order, stated, can_ask=not is_quiet and _is_terminal())
    if is_dry or order.layout:
        now_us = system_now_us()
        report = check_archive(client, order, now_us)
        is_simulated = bool(order.layout) and client.spacecraft(order.spacecraft_id).get("simulated", False)
        reason = impossibility(report, None if is_simulated else now_us) if order.layout else None
        if order.layout:
            report["layout"] = json.loads(order.layout)
        if is_dry:
            return report | ({"impossible": reason} if reason else {})
        if reason:
            end(f"{order.path}: {reason}")
    report = send_with_progress(client, order, is_quiet=is_quiet)
    return report | {"angles": wait_for_angles(client, order.spacecraft_id, order.patience_s, is_quiet=is_quiet)}


def _is_terminal() -> bool:
    """Return whether a person can be asked."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does."""
    raise KeyboardInterrupt


#: labels of the table, where the name of the field is not the word for people
_LABELS = {
    "late": "of them historical",
    "start": "first epoch",
    "stop": "newest epoch",
    "age_s": "age of the newest, s",
}
#: shown in tables of their own
_APART = frozenset({"columns", "faults", "levels", "longest_gaps", "layout", "angles", "impossible"})


def _show(report: dict[str, Any], spacecraft: str) -> None:
    """Print a report as tables."""
    from rich.console import Console
    from rich.table import Table

    from service.cli.own_data.angles import angles_line

    table = Table("", "", show_header=False)
    for row in (*_summary_lines(report), *_survey_lines(report)):
        table.add_row(*row)
    Console().print(table)
    if "angles" in report:
        typer.echo(angles_line(report["angles"], spacecraft))


def _summary_lines(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what a report counts, and the columns."""
    for name, value in report.items():
        if name not in _APART and value not in ({}, None):
            yield _LABELS.get(name, name), f"{value:.3f}" if isinstance(value, float) else str(value)
    for name, value in report.get("layout", {}).items():
        yield f"read as: {name}", str(value)
    for name, columns in report["columns"].items():
        if columns:
            yield f"columns {name}", ", ".join(columns)


def _survey_lines(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield gaps, levels and faults."""
    for gap in report.get("longest_gaps", ()):
        yield "gap", f"{gap['start']} to {gap['stop']}, {gap['duration_s']:.0f} s"
    for carrier, span in report.get("levels", {}).items():
        levels = "no level" if span["least_dbm"] is None else f"{span['least_dbm']:g} to {span['greatest_dbm']:g} dBm"
        yield carrier, f"{levels}, {span['empty']} empty"
    for fault in report["faults"]:
        yield f"{fault['rows']} rows: {fault['kind']}", f"first: line {fault['line']}, {fault['detail']}"


def _end(report: dict[str, Any], source: str) -> None:
    """End with the code that tells what became of the rows."""
    if "impossible" in report:
        end(report["impossible"])
    foreign = report["other_sources"]
    sent = report["rows"] if "accepted" not in report else report["rows"] - sum(foreign.values())
    if foreign and not sent:
        end(f"no row of {source}; the file's are of {', '.join(foreign)}: see --from-source")
    if report["unreadable"] or report.get("refused"):
        raise typer.Exit(EXIT_REFUSED)
