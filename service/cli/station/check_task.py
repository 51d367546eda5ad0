"""Tasks of ``soo acquire``, loaded, planned and shown before an analyzer is touched."""

import logging
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from service.frontend.measurement_task import MeasurementTask, load_task
from service.frontend.tasks.station_file import StationEntry
from service.frontend.tasks.task_plan import TaskPlan, cycle_s, sweep_time_s
from service.frontend.tasks.zoom_plan import plan_with_zoom

logger = logging.getLogger("service.cli.station.acquire")


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
    """Return the sweeps of one cycle."""
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
