"""The run of ``soo acquire``: tasks planned, analyzers measured until a signal, rows spooled and sent.

Tasks of ``soo acquire``, loaded, planned and shown before an analyzer is touched.
"""

import logging
import signal
import socket
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import AcquisitionSettings
from service.frontend.link_report import LinkReporter
from service.frontend.measurement_task import MeasurementTask, TaskError, load_task
from service.frontend.spool.file import Bounds, Owner
from service.frontend.spool.row import SpooledTask, SpoolError
from service.frontend.spool.spool import Spool, spool_path
from service.frontend.station import MeasuringStation, StationError, StationSummary, run_stations
from service.frontend.tasks.task_plan import StationEntry, TaskPlan, cycle_s, load_station, plan_with_zoom, sweep_time_s
from service.frontend.upload.uploader import UploadSettings
from service.runtime.clock import system_now_us


class PlannedAnalyzer(NamedTuple):
    """One analyzer with its task as it will be measured."""

    entry: StationEntry
    task: MeasurementTask
    sha256: str
    plan: TaskPlan
    resource: str | None
    period_s: float


def planned_analyzer(entry: StationEntry) -> PlannedAnalyzer:
    """Return an analyzer of a station with its plan.

    Raises
    ------
    TaskError
        The task cannot be read.
    """
    task, sha256 = load_task(Path(entry.task))
    period_s = task.task.period_s if entry.period_s is None else entry.period_s
    planned, plan = plan_with_zoom(task, period_s)
    return PlannedAnalyzer(entry, planned, sha256, plan, entry.resource or task.task.analyzer.resource, period_s)


def faults_of(planned: PlannedAnalyzer) -> list[str]:
    """Return the errors that forbid to measure, in words."""
    faults = [str(finding) for finding in planned.plan.errors]
    if planned.resource is None:
        faults.append("no analyzer: give --resource, or a resource in the task or the station file")
    return [f"{planned.entry.source}: {fault}" for fault in faults]


def show(planned: PlannedAnalyzer, *, is_quiet: bool) -> None:
    """Print sweeps, carriers and their predicted scatter, and what the planner warns of."""
    task, plan = planned.task, planned.plan
    for finding in plan.warnings:
        logger.warning("%s", finding)
    if is_quiet:
        logger.info("predicted sigma, dB: %s", {name: round(sigma, 4) for name, sigma in plan.sigma_db.items()})
    else:
        console = Console(stderr=True)
        console.print(_sweeps_table(planned))
        console.print(_carriers_table(task, plan))
    logger.info(
        "%s: task %s sha256 %s, %d carriers, period %g s",
        planned.entry.source,
        task.task.id,
        planned.sha256,
        len(task.carriers),
        planned.period_s,
    )


def _sweeps_table(planned: PlannedAnalyzer) -> Table:
    title = f"{planned.task.task.id}: one row takes {cycle_s(planned.task):.2f} s"
    if planned.period_s:
        title += f" of {planned.period_s:g} s"
    table = Table("sweep", "start, MHz", "stop, MHz", "RBW, kHz", "points", "time, s", title=title)
    for sweep in planned.task.sweeps:
        span = (f"{sweep.start_hz / 1e6:.4f}", f"{sweep.stop_hz / 1e6:.4f}", f"{sweep.rbw_hz / 1e3:g}")
        table.add_row(sweep.id, *span, str(sweep.points), f"{sweep_time_s(sweep) * sweep.count:.3f}")
    return table


def _carriers_table(task: MeasurementTask, plan: TaskPlan) -> Table:
    """Return the carriers with their predicted scatter."""
    table = Table("carrier", "sweep", "centre, MHz", "bandwidth, kHz", "predicted sigma, dB")
    for carrier in task.carriers:
        sigma = plan.sigma_db.get(carrier.id)
        table.add_row(
            carrier.id,
            carrier.sweep,
            f"{carrier.fc_hz / 1e6:.4f}",
            f"{carrier.integ_bw_hz / 1e3:.1f}",
            "-" if sigma is None else f"{sigma:.3f}",
        )
    return table


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
    #: key as it is stored now
    stored_key: Callable[[], str | None]
    batch_rows: int
    batch_s: float
    spool_folder: Path
    bounds: Bounds
    trace_period_s: float

    def client(self, timeout_s: float = 10.0) -> ServiceClient:
        """Return a client without retries that takes a replaced key."""
        return ServiceClient(self.service, self.key, retries=0, timeout_s=timeout_s, stored_key=self.stored_key)


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
            client = stack.enter_context(delivery.client(_REPORT_TIMEOUT_S))
            reporter = LinkReporter(client, _front_end_name(), stations, report_s)
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
        stack.enter_context(delivery.client()),
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
