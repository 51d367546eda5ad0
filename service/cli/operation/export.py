"""``soo export``: a stretch of the archive as a file, or as a stream to standard output.

Exit codes: 0 the file is whole and verified, 1 the service refused or did not answer (the same command continues where
it stopped), 2 an option or the file's place is wrong.
"""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from service.records.epoch import parse_epoch

if TYPE_CHECKING:
    from service.client.archive_download import DownloadOrder, DownloadProgress
    from service.client.service_client import ServiceClient

EXIT_STOPPED = 1


def export(
    *,
    spacecraft: SpacecraftOption,
    series: Annotated[
        str,
        typer.Option(
            help="measurements, attitude, torques, references, telemetry, polarization, events, or joined: "
            "the first three in one table."
        ),
    ],
    start: Annotated[str, typer.Option(help="RFC 3339 start, inclusive.")],
    stop: Annotated[str, typer.Option(help="RFC 3339 stop, exclusive.")],
    output: Annotated[
        Path | None, typer.Option(help="File to write, day by day and verified; default: a stream to standard output.")
    ] = None,
    by_day: Annotated[bool, typer.Option("--by-day", help="Let --output be a folder with one file a day.")] = False,
    format_: Annotated[
        str, typer.Option("--format", help="csv, ndjson, parquet; aem of attitude, tdm of measurements.")
    ] = "csv",
    method: Annotated[str | None, typer.Option(help="Estimation method of attitude and joined.")] = None,
    version: Annotated[str | None, typer.Option(help="Version: live or that of a replay.")] = None,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for a service that is away.")] = 600.0,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Download a stretch of the archive."""
    # httpx costs more than the command line itself
    from service.client.archive_download import DownloadOrder

    order = DownloadOrder(spacecraft, series, format_, start, stop, method, version, patience)
    if output is None and (by_day or as_json):
        end("--by-day and --json need --output")
    with connected(service, key_env, retries=0, timeout_s=120.0) as client:
        if output is None:
            for chunk in client.download(f"/spacecraft/{spacecraft}/archive/{series}:export", order.parameters):
                sys.stdout.buffer.write(chunk)
            return
        try:
            report = _download(client, order, output, by_day=by_day, is_quiet=as_json)
        except OSError as error:
            end(f"{output}: {error.strerror or error}", cause=error)
        except KeyboardInterrupt as interrupt:
            end("stopped; the same command continues where this one stopped", EXIT_STOPPED, interrupt)
    if as_json:
        typer.echo(json.dumps(report))
    else:
        where, size = report.get("file", report.get("folder")), report["bytes"]
        typer.echo(f"{where}: {report['rows']} rows of {report['days']} days, {size} bytes", err=True)


def _download(
    client: "ServiceClient", order: "DownloadOrder", output: Path, *, by_day: bool, is_quiet: bool
) -> dict[str, Any]:
    """Download behind a progress bar; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from service.client.archive_download import download_archive

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    bar = Progress(*columns, TextColumn("{task.fields[size]}"), console=console)
    bar.disable = is_quiet or not console.is_terminal
    with bar:
        task = bar.add_task(output.name, total=None, size="")

        def show(progress: "DownloadProgress") -> None:
            # the service has read both epochs by now
            start_us, stop_us = parse_epoch(order.start), parse_epoch(order.stop)
            done = parse_epoch(progress.until) - start_us
            bar.update(task, completed=done, total=stop_us - start_us, size=f"{progress.size / 1e6:.1f} MB")

        return download_archive(client, order, output, keeps_days=by_day, on_progress=show)
