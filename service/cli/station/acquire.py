"""``soo acquire``: measure carrier powers on spectrum analyzers and send them to the service.

Exit codes: 0 ended by a signal (rows that the service has not taken stay in the spool, and are counted), 1 a thread
died, 2 the task or an option is wrong, or another process uses the spool. The key comes from the environment, never
from the command line.
"""

import json
import logging
import signal
import socket
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from service.cli.operation.connection import key_of
from service.cli.station.check_task import PlannedAnalyzer, faults_of, plan_analyzer, show
from service.cli.station.state_folder import state_folder
from service.client.service_client import ServiceClient
from service.frontend.acquisition.settings import AcquisitionSettings
from service.frontend.acquisition.states import reference_page
from service.frontend.link_report import LinkReporter
from service.frontend.measurement_task import TaskError
from service.frontend.spool.file import Bounds, Owner
from service.frontend.spool.row import SpooledTask
from service.frontend.spool.schema import SpoolError
from service.frontend.spool.spool import Spool, spool_path
from service.frontend.station import MeasuringStation, StationError, StationSummary, run_stations
from service.frontend.tasks.station_file import StationEntry, load_station
from service.frontend.upload.uploader import UploadSettings
from service.records.epoch import US_PER_S, format_epoch
from service.runtime.clock import system_now_us

logger = logging.getLogger("service.cli.station.acquire")

#: wrong task or option
EXIT_USAGE = 2
#: bound on a report of links, s: it is repeated anyway
_REPORT_TIMEOUT_S = 5.0


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


@dataclass(frozen=True, slots=True)
class _Delivery:
    """Where rows go, and where they wait."""

    service: str
    key: str
    batch_rows: int
    batch_s: float
    spool_folder: Path
    bounds: Bounds
    trace_period_s: float


def acquire(
    *,
    task_file: Annotated[
        Path | None, typer.Option("--task", help="Measurement task (JSON) of one analyzer.", dir_okay=False)
    ] = None,
    station_file: Annotated[
        Path | None, typer.Option("--station", help="Station file (JSON): several analyzers.", dir_okay=False)
    ] = None,
    spacecraft: Annotated[str | None, typer.Option(help="Spacecraft whose carriers are measured.")] = None,
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
    spool: Annotated[
        Path | None,
        typer.Option(help="Folder where rows wait for the service; default: the state folder.", file_okay=False),
    ] = None,
    spool_days: Annotated[float, typer.Option(min=0.01, help="Days that a row waits at most.")] = 30.0,
    spool_mib: Annotated[float, typer.Option(min=0.1, help="Size of the rows that wait at most, MiB.")] = 1024.0,
    trace_period: Annotated[
        float, typer.Option(min=0.0, help="Seconds between two kept evidence traces of a sweep; inf = none.")
    ] = 10.0,
    evidence_traces: Annotated[int, typer.Option(min=0, help="Evidence traces that wait at most.")] = 1000,
    report_s: Annotated[
        float, typer.Option(min=0.0, help="Seconds between reports of the links; 0 = no reports.")
    ] = 5.0,
    check: Annotated[bool, typer.Option("--check", help="Show the plan and end.")] = False,
    states: Annotated[bool, typer.Option("--states", help="Print the page of states (Markdown) and end.")] = False,
    json_log: Annotated[bool, typer.Option("--json-log", help="Log one JSON object a line.")] = False,
) -> None:
    """Measure carrier powers on spectrum analyzers and send them to the service."""
    if states:
        typer.echo(reference_page(), nl=False)
        return
    _start_log(json_log=json_log)
    if station_file is not None:
        entries = _entries(station_file, task_file)
    elif task_file is not None and spacecraft is not None:
        entries = (
            StationEntry(
                task=task_file,
                spacecraft=spacecraft,
                source=source,
                resource=resource,
                period_s=period,
                epoch=epoch.value,
                hold_s=hold_s,
            ),
        )
    else:
        _refuse("nothing to measure: give --task and --spacecraft, or --station")
    planned = _plan(entries, is_quiet=json_log)
    if check:
        return
    key = key_of(key_env)
    bounds = Bounds(rows_bytes=round(spool_mib * 2**20), age_s=spool_days * 86_400.0, traces=evidence_traces)
    folder = spool or state_folder("spool")
    delivery = _Delivery(service, key, batch_rows, batch_s, folder, bounds, trace_period)
    for each, summary in zip(planned, _measure(planned, delivery, report_s), strict=True):
        _finish(each.entry, summary)


def _entries(station_file: Path, task_file: Path | None) -> tuple[StationEntry, ...]:
    """Return the analyzers of a station file, or end with its faults."""
    if task_file is not None:
        _refuse("--task and --station exclude one another")
    try:
        return load_station(station_file)
    except TaskError as error:
        _refuse(str(error))


def _plan(entries: tuple[StationEntry, ...], *, is_quiet: bool) -> list[PlannedAnalyzer]:
    """Load, plan and show all tasks, or end with their faults."""
    try:
        planned = [plan_analyzer(entry) for entry in entries]
    except TaskError as error:
        _refuse(str(error))
    for each in planned:
        show(each, is_quiet=is_quiet)
    faults = [fault for each in planned for fault in faults_of(each)]
    if faults:
        _refuse("; ".join(faults))
    return planned


def _measure(planned: list[PlannedAnalyzer], delivery: _Delivery, report_s: float) -> list[StationSummary]:
    """Run all analyzers until a signal asks for the end."""
    with ExitStack() as stack:
        stations = [_station(stack, each, delivery) for each in planned]
        _stop_on_signals(stations)
        if report_s > 0.0:
            client = ServiceClient(delivery.service, delivery.key, retries=0, timeout_s=_REPORT_TIMEOUT_S)
            reporter = LinkReporter(stack.enter_context(client), _front_end_name(), stations, report_s)
            reporter.start()
            stack.callback(reporter.stop)
        try:
            return run_stations(stations)
        except StationError as error:
            logger.critical("%s", error)
            raise typer.Exit(1) from error


def _stop_on_signals(stations: list[MeasuringStation]) -> None:
    """End all analyzers when a signal asks for it."""

    def stop(*_: object) -> None:
        for station in stations:
            station.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)


def _station(stack: ExitStack, planned: PlannedAnalyzer, delivery: _Delivery) -> MeasuringStation:
    """Return one analyzer with its own client and its own spool."""
    entry, task = planned.entry, planned.task
    measured = SpooledTask(planned.sha256, tuple(carrier.id for carrier in task.carriers))
    rows = stack.enter_context(_open(delivery, Owner(entry.spacecraft, entry.source), measured))
    return MeasuringStation(
        task,
        AcquisitionSettings(
            planned.resource or "",
            planned.period_s,
            EpochClock(entry.epoch) is EpochClock.ANALYZER,
            task.task.analyzer.io_timeout_s,
            entry.hold_s,
        ),
        UploadSettings(entry.spacecraft, entry.source, delivery.batch_rows, delivery.batch_s),
        stack.enter_context(ServiceClient(delivery.service, delivery.key, retries=0)),
        rows,
        system_now_us,
    )


def _open(delivery: _Delivery, owner: Owner, task: SpooledTask) -> Spool:
    """Return the spool of a source, or end with the reason why it cannot be used."""
    path = spool_path(delivery.spool_folder, *owner)
    try:
        spool = Spool(path, owner, task, system_now_us, delivery.bounds, trace_period_s=delivery.trace_period_s)
    except SpoolError as error:
        _refuse(str(error))
    state = spool.state
    logger.info("spool %s: %d rows wait, newest number %d", path, state.waiting, state.last_seq)
    return spool


def _front_end_name() -> str:
    """Return the name of this front end among links."""
    return f"front-end.{socket.gethostname()}"[:64]


def _finish(entry: StationEntry, summary: StationSummary) -> None:
    """Say what the run came to."""
    upload, measured = summary.upload, summary.acquisition
    logger.info(
        "%s.%s: %d rows measured, %d accepted, %d known already, %d refused, %d left in the spool; "
        "%d faults of the analyzer",
        entry.spacecraft,
        entry.source,
        measured.rows,
        upload.accepted,
        upload.duplicates,
        upload.refused,
        summary.undelivered,
        measured.faults,
    )


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
