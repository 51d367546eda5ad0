"""``soo acquire``: measure carrier powers on a spectrum analyzer and send them to the service.

Exit codes: 0 ended by a signal with everything delivered, 1 rows were left undelivered or a thread died, 2 the task or
an option is wrong. The key comes from the environment, never from the command line.
"""

import json
import logging
import os
import signal
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from service.client.service_client import ServiceClient
from service.frontend.acquisition import AcquisitionSettings
from service.frontend.measurement_task import MeasurementTask, TaskError, load_task
from service.frontend.station import Station, StationError, StationSummary
from service.frontend.task_plan import TaskPlan, plan_task
from service.frontend.uploader import UploadSettings
from service.records.epoch import US_PER_S, format_epoch
from service.runtime.clock import system_now_us

logger = logging.getLogger("service.cli.acquire")

#: wrong task or option
EXIT_USAGE = 2


class EpochClock(StrEnum):
    """Whose clock stamps the rows."""

    ANALYZER = "analyzer"
    SYSTEM = "system"


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, logger, message."""

    def format(self, record: logging.LogRecord) -> str:
        """Return one record as a line."""
        entry = {
            "time": format_epoch(round(record.created * US_PER_S)),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry)


def acquire(
    *,
    task_file: Annotated[Path, typer.Option("--task", help="Measurement task (JSON).", dir_okay=False)],
    spacecraft: Annotated[str, typer.Option(help="Spacecraft whose carriers are measured.")],
    resource: Annotated[
        str | None, typer.Option(help="VISA resource name of the analyzer; in place of the task's.")
    ] = None,
    service: Annotated[str, typer.Option(help="Address of the service.")] = "http://127.0.0.1:8000",
    key_env: Annotated[str, typer.Option(help="Environment variable that holds the key.")] = "SOO_KEY",
    source: Annotated[str, typer.Option(help="Name of this source of measurements.")] = "sa-1",
    epoch: Annotated[EpochClock, typer.Option(help="Whose clock stamps the rows.")] = EpochClock.SYSTEM,
    period: Annotated[
        float | None,
        typer.Option(min=0.0, help="Seconds from row to row, 0 = as fast as it goes; default: the task's."),
    ] = None,
    batch_rows: Annotated[int, typer.Option(min=1, max=10_000, help="Rows of one request at most.")] = 100,
    batch_s: Annotated[
        float, typer.Option(min=0.0, help="Shortest time between requests that are not full, s; 0 = send at once.")
    ] = 0.05,
    hold_s: Annotated[
        float, typer.Option(min=0.0, help="Further wait for a sweep that a trigger or a simulator holds back, s.")
    ] = 0.0,
    queue_rows: Annotated[int, typer.Option(min=1, help="Rows kept while the service is away.")] = 10_000,
    json_log: Annotated[bool, typer.Option("--json-log", help="Log one JSON object a line.")] = False,
) -> None:
    """Measure carrier powers on a spectrum analyzer and send them to the service."""
    _start_log(json_log=json_log)
    task, sha256 = _load(task_file)
    analyzer = resource or task.task.analyzer.resource
    if analyzer is None:
        _refuse("no analyzer: give --resource, or task.analyzer.resource in the task")
    period_s = task.task.period_s if period is None else period
    plan = plan_task(task, period_s)
    _show(task, plan, is_quiet=json_log)
    if plan.errors:
        _refuse("; ".join(map(str, plan.errors)))
    logger.info("task %s sha256 %s, %d carriers, period %g s", task.task.id, sha256, len(task.carriers), period_s)
    key = os.environ.get(key_env)
    if not key:
        _refuse(f"no key: the environment variable {key_env} is empty")
    with ServiceClient(service, key, retries=0) as client:
        station = Station(
            task,
            AcquisitionSettings(
                analyzer,
                period_s,
                epoch is EpochClock.ANALYZER,
                task.task.analyzer.io_timeout_s,
                hold_s,
            ),
            UploadSettings(spacecraft, source, batch_rows, batch_s, queue_rows),
            client,
            system_now_us,
        )
        summary = _run(station)
    _finish(summary)


def _run(station: Station) -> StationSummary:
    """Run until a signal asks for the end."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: station.stop())
    try:
        return station.run()
    except StationError as error:
        logger.critical("%s", error)
        raise typer.Exit(1) from error


def _finish(summary: StationSummary) -> None:
    """Say what the run came to."""
    upload, measured = summary.upload, summary.acquisition
    logger.info(
        "%d rows measured, %d accepted, %d known already, %d refused, %d undelivered; %d faults of the analyzer",
        measured.rows,
        upload.accepted,
        upload.duplicates,
        upload.refused,
        summary.undelivered,
        measured.faults,
    )
    if summary.undelivered:
        raise typer.Exit(1)


def _load(task_file: Path) -> tuple[MeasurementTask, str]:
    """Return the task and its hash, or end with its faults."""
    try:
        return load_task(task_file)
    except TaskError as error:
        _refuse(str(error))


def _show(task: MeasurementTask, plan: TaskPlan, *, is_quiet: bool) -> None:
    """Print the predicted scatter of every carrier, and what the planner warns of."""
    for finding in plan.warnings:
        logger.warning("%s", finding)
    if is_quiet:
        logger.info("predicted sigma, dB: %s", {name: round(sigma, 4) for name, sigma in plan.sigma_db.items()})
        return
    table = Table("carrier", "sweep", "centre, MHz", "bandwidth, kHz", "predicted sigma, dB", title=task.task.id)
    for carrier in task.carriers:
        sigma = plan.sigma_db.get(carrier.id)
        table.add_row(
            carrier.id,
            carrier.sweep,
            f"{carrier.fc_hz / 1e6:.4f}",
            f"{carrier.integ_bw_hz / 1e3:.1f}",
            "-" if sigma is None else f"{sigma:.3f}",
        )
    Console(stderr=True).print(table)


def _start_log(*, json_log: bool) -> None:
    """Log to standard error, one line an event."""
    handler = logging.StreamHandler()
    plain = logging.Formatter("%(asctime)s %(levelname)s %(message)s")
    handler.setFormatter(JsonLines() if json_log else plain)
    root = logging.getLogger("service")
    root.handlers = [handler]
    root.setLevel(logging.INFO)


def _refuse(message: str) -> NoReturn:
    """End with a message on standard error."""
    logger.error("%s", message)
    raise typer.Exit(EXIT_USAGE)
