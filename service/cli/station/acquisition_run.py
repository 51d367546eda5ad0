"""The run of ``soo acquire``: tasks planned, analyzers measured until a signal, rows spooled and sent."""

import logging
import signal
import socket
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import typer

from service.cli.station.check_task import PlannedAnalyzer, faults_of, planned_analyzer, show
from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import AcquisitionSettings
from service.frontend.link_report import LinkReporter
from service.frontend.measurement_task import TaskError
from service.frontend.spool.file import Bounds, Owner
from service.frontend.spool.row import SpooledTask, SpoolError
from service.frontend.spool.spool import Spool, spool_path
from service.frontend.station import MeasuringStation, StationError, StationSummary, run_stations
from service.frontend.tasks.station_file import StationEntry, load_station
from service.frontend.upload.uploader import UploadSettings
from service.runtime.clock import system_now_us

logger = logging.getLogger("service.cli.station.acquire")

#: wrong task or option
EXIT_USAGE = 2
#: bound on a report of links, s: it is repeated anyway
_REPORT_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class Delivery:
    """Destination of the rows: service, key and spool."""

    service: str
    key: str
    batch_rows: int
    batch_s: float
    spool_folder: Path
    bounds: Bounds
    trace_period_s: float


def entries_of(station_file: Path, task_file: Path | None) -> tuple[StationEntry, ...]:
    """Return the analyzers of a station file, or end with its faults."""
    if task_file is not None:
        refuse("--task and --station exclude one another")
    try:
        return load_station(station_file)
    except TaskError as error:
        refuse(str(error))


def planned_of(entries: tuple[StationEntry, ...], *, is_quiet: bool) -> list[PlannedAnalyzer]:
    """Load, plan and show all tasks, or end with their faults."""
    try:
        planned = [planned_analyzer(entry) for entry in entries]
    except TaskError as error:
        refuse(str(error))
    for each in planned:
        show(each, is_quiet=is_quiet)
    faults = [fault for each in planned for fault in faults_of(each)]
    if faults:
        refuse("; ".join(faults))
    return planned


def measure(planned: list[PlannedAnalyzer], delivery: Delivery, report_s: float) -> list[StationSummary]:
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


def _station(stack: ExitStack, planned: PlannedAnalyzer, delivery: Delivery) -> MeasuringStation:
    """Return one analyzer with its own client and its own spool."""
    entry, task = planned.entry, planned.task
    measured = SpooledTask(planned.sha256, tuple(carrier.id for carrier in task.carriers))
    rows = stack.enter_context(_open(delivery, Owner(entry.spacecraft, entry.source), measured))
    return MeasuringStation(
        task,
        AcquisitionSettings(
            planned.resource or "",
            planned.period_s,
            entry.epoch == "analyzer",
            task.task.analyzer.io_timeout_s,
            entry.hold_s,
        ),
        UploadSettings(entry.spacecraft, entry.source, delivery.batch_rows, delivery.batch_s),
        stack.enter_context(ServiceClient(delivery.service, delivery.key, retries=0)),
        rows,
        system_now_us,
    )


def _open(delivery: Delivery, owner: Owner, task: SpooledTask) -> Spool:
    """Return the spool of a source, or end with the reason why it cannot be used."""
    path = spool_path(delivery.spool_folder, *owner)
    try:
        spool = Spool(path, owner, task, system_now_us, delivery.bounds, trace_period_s=delivery.trace_period_s)
    except SpoolError as error:
        refuse(str(error))
    state = spool.state
    logger.info("spool %s opened: %d rows wait to be sent, newest row number %d", path, state.waiting, state.last_seq)
    return spool


def _front_end_name() -> str:
    """Return the name of this front end among links."""
    return f"front-end.{socket.gethostname()}"[:64]


def log_summary(entry: StationEntry, summary: StationSummary) -> None:
    """Log the summary of a run."""
    upload, measured = summary.upload, summary.acquisition
    logger.info(
        "%s.%s ended: %d rows measured, %d accepted, %d duplicates, %d refused, %d left in the spool; "
        "%d analyzer faults",
        entry.spacecraft,
        entry.source,
        measured.rows,
        upload.accepted,
        upload.duplicates,
        upload.refused,
        summary.undelivered,
        measured.faults,
    )


def refuse(message: str) -> NoReturn:
    """End with a message on standard error."""
    logger.error("%s", message)
    raise typer.Exit(EXIT_USAGE)
