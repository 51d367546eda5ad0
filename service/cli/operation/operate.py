"""Operators' commands over the REST interface: calibrate, align, replay."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import Scheduler, end
from service.cli.operation import connection
from service.records.epoch import parse_epoch

if TYPE_CHECKING:
    from service.client.archive_download import DownloadOrder, DownloadProgress
    from service.client.service_client import ServiceClient


Start = Annotated[str, typer.Option(help="RFC 3339 start, inclusive.")]
Stop = Annotated[str, typer.Option(help="RFC 3339 stop, exclusive.")]


@connection.on_service
def calibrate(
    client: "ServiceClient",
    spacecraft: connection.SpacecraftOption,
    quiet: Annotated[tuple[str, str], typer.Option(help="Start and stop of the quiet window.")],
    turns: Annotated[tuple[str, str], typer.Option(help="Start and stop of the calibration turns.")],
    method: Annotated[str, typer.Option(help="`geometry` serves both methods, `paper` only itself.")] = "geometry",
    source: Annotated[str, typer.Option(help="Sensor of the attitude references.")] = "star_tracker",
    activate: Annotated[bool, typer.Option("--activate", help="Make it the active one when it is done.")] = False,
    override_reason: Annotated[str | None, typer.Option(help="Why it is activated with inconsistent turns.")] = None,
    as_json: connection.JsonOption = False,
) -> None:
    """Fit daily changes and sensitivities from quiet days and calibration turns."""
    body = {
        "quiet": {"start": quiet[0], "stop": quiet[1]},
        "turns": {"start": turns[0], "stop": turns[1]},
        "method": method,
        "source": source,
    }
    started = client.start_calibration(spacecraft, body)
    wait_for_job(client, started["job"], "calibration")
    if activate:
        client.activate_calibration(spacecraft, started["id"], override_reason)
    calibration = client.calibration(spacecraft, started["id"])
    if as_json:
        typer.echo(json.dumps(calibration))
        return
    selected = [carrier["id"] for carrier in calibration["carriers"] if carrier["selected"]]
    typer.echo(f"calibration {calibration['id']} is {calibration['state']}; selected: {', '.join(selected)}")
    for warning in calibration["quality"].get("warnings", []):
        typer.echo(f"warning: {warning}")


@connection.on_service
def align(
    client: "ServiceClient",
    spacecraft: connection.SpacecraftOption,
    start: Start,
    stop: Stop,
    source: Annotated[str, typer.Option(help="Sensor of the attitude references.")] = "star_tracker",
    override_reason: Annotated[str | None, typer.Option(help="Why angles hold that the powers contradict.")] = None,
    as_json: connection.JsonOption = False,
) -> None:
    """Take angles and reference powers from a window; from then on no sensor is used."""
    body = {"start": start, "stop": stop, "source": source}
    if override_reason:
        body["override_reason"] = override_reason
    alignment = client.align(spacecraft, body)
    if as_json:
        typer.echo(json.dumps(alignment))
        return
    angles = ", ".join(f"{name} {alignment[f'{name}_deg']:+.3f}" for name in ("yaw", "roll", "pitch"))
    typer.echo(f"alignment {alignment['id']} at {alignment['epoch']}: {angles} deg")
    typer.echo(f"stored rows after it: {alignment['rows_recomputed']} computed, {alignment['rows_kept']} kept")
    if alignment["rows_kept"]:
        span = f"--start {alignment['epoch']} --stop {alignment['created_at']}"
        typer.echo(
            "kept rows have the angles of an earlier alignment; compute them again beside these with: "
            f"soo replay --spacecraft {spacecraft} {span} --alignment {alignment['id']} --order epoch"
        )
    for warning in alignment.get("warnings", []):
        typer.echo(f"warning: {warning}")


def replay(
    spacecraft: connection.SpacecraftOption,
    start: Start,
    stop: Stop,
    method: Annotated[str | None, typer.Option(help="Only this method.")] = None,
    calibration: Annotated[int | None, typer.Option(help="Use this calibration.")] = None,
    alignment: Annotated[int | None, typer.Option(help="Start from this alignment.")] = None,
    order: Annotated[str, typer.Option(help="`journal` as it was, or `epoch` as it would have been.")] = "journal",
    commands: Annotated[bool, typer.Option(help="Compute torques too: they cost as much as the filter.")] = True,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Add rows of method robust_smoothed: after the rows that came later.")
    ] = False,
    compare: Annotated[bool, typer.Option("--compare", help="Compare with the live rows; exit 1 on a change.")] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Compute beside the service, in so many processes.")
    ] = None,
    scheduler: Scheduler = None,
    database: Annotated[
        str | None, typer.Option(help="SQLAlchemy URL of the archive, for --workers and --scheduler.")
    ] = None,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Run the chain again over the archive, as a new version."""
    body = {
        "start": start,
        "stop": stop,
        "method": method,
        "calibration_id": calibration,
        "alignment_id": alignment,
        "order": order,
        "commands": commands,
        "smooth": smooth,
    }
    if workers is None and scheduler is None:
        with connection.connected(service, key_env) as client:
            wanted = {name: value for name, value in body.items() if value is not None}
            started = client.request("POST", f"/spacecraft/{spacecraft}/replays", wanted)
            wait_for_job(client, started["job"], "replay")
            report: dict[str, Any] = {"id": started["id"], "version": started["version"]}
    else:
        report = _replayed_in_parts(spacecraft, body, workers, scheduler, database)
    if compare:
        from service.study.demonstration.judgement import METHODS, compare_with_live

        methods = (method,) if method else METHODS
        with connection.connected(service, key_env) as client:
            report |= compare_with_live(client, spacecraft, start, stop, methods, report["version"])
    typer.echo(json.dumps(report) if as_json else ", ".join(f"{name} {value}" for name, value in report.items()))
    if compare and report["rows_different"]:
        raise typer.Exit(1)


def _replayed_in_parts(
    spacecraft: str, body: dict[str, Any], workers: int | None, scheduler: str | None, database: str | None
) -> dict[str, Any]:
    """Compute a replay beside the service and return its id and version."""
    from pydantic import ValidationError

    from service.api.schemas.calibrations import ReplayDocument
    from service.cli.operation.parallel_replay import replay_in_parts
    from service.composition.settings import Settings
    from service.records.field_faults import faults_text
    from service.study.executors import WorkerChoice

    try:
        wanted = ReplayDocument.model_validate_json(json.dumps(body)).to_replay()
    except ValidationError as error:
        end(faults_text(error.errors()), cause=error)
    settings = Settings.model_validate({} if database is None else {"database_url": database})
    with _shown("replay") as show:
        replay = replay_in_parts(settings, spacecraft, wanted, WorkerChoice(workers or 2, scheduler), show)
    return {"id": replay.id, "version": replay.version}


def wait_for_job(client: "ServiceClient", job_id: str, what: str) -> None:
    """Wait for a job behind a progress bar."""
    with _shown(what) as show:
        client.wait_job(job_id, on_progress=show)


@contextmanager
def _shown(what: str) -> Iterator[Callable[[float], None]]:
    """Give what moves a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)


@connection.on_service
def replays(
    client: "ServiceClient",
    spacecraft: connection.SpacecraftOption,
    delete: Annotated[int | None, typer.Option(help="Delete the replay of this number first.")] = None,
    as_json: connection.JsonOption = False,
) -> None:
    """List the versions that replays wrote, or delete one."""
    if delete is not None:
        client.delete_replay(spacecraft, delete)
    listed = list(client.replays(spacecraft))
    for each in listed:
        typer.echo(json.dumps(each) if as_json else _line(each))


def _line(each: dict[str, Any]) -> str:
    state = each["state"] if each["state"] in {"done", "failed"} else f"{each['state']} {each['progress']:.0%}"
    figures = f"{each['attitude_rows']} rows, {each['torque_rows']} torques, {each['size_bytes'] / 1e6:.1f} MB"
    return f"{each['version']}  {each['start']} to {each['stop']}  {state}  {figures}"


EXIT_STOPPED = 1


def export(
    *,
    spacecraft: connection.SpacecraftOption,
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
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Download a stretch of the archive."""
    # httpx costs more than the command line itself
    from service.client.archive_download import DownloadOrder

    order = DownloadOrder(spacecraft, series, format_, start, stop, method, version, patience)
    if output is None and (by_day or as_json):
        end("--by-day and --json need --output")
    with connection.connected(service, key_env, retries=0, timeout_s=120.0) as client:
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
