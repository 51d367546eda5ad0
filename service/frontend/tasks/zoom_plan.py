"""Narrow carriers get sweeps of their own: those that a wide sweep measures too coarsely or with too much scatter.

A wide sweep of a loaded transponder is as good as one measurement a carrier, but not for a narrow one: in 36 MHz it is
swept over for a moment only, with a filter that is too wide for it. With ``zoom: auto`` such a carrier is moved:

* RBW: the largest of 1 and 3 times a power of ten (every family has those) that is a twentieth of the carrier at most;
* span: integration band and noise windows. The task's own windows are taken where they lie near, else the two gaps
  beside the carrier that the task leaves free, one integration bandwidth wide at most;
* time: what the goal of scatter needs, at least what the filter needs, at most what is left of the period.

Zoom sweeps and not ``LIST:POWer``: they are sweeps like any other, so that every family can take them, noise windows
and evidence traces come with them, and a missing option of the analyzer changes nothing.
"""

import math
from dataclasses import replace

from service.frontend.measurement_task import CarrierPart, MeasurementTask, SweepPart
from service.frontend.tasks.task_plan import (
    GUARD_RBW,
    SWEEP_OVERHEAD_S,
    TaskFinding,
    TaskPlan,
    cycle_s,
    plan_task,
    predict_sigma_db,
    shortest_sweep_s,
)

#: rules whose breach moves a carrier
MOVING_RULES = ("rbw.too_wide", "rbw.wide", "sigma.goal")
#: span of a zoom sweep over the integration bandwidth, beyond which the task's own noise windows are too far away
NEAR_SPANS = 6.0
#: the goal is aimed at with this margin
GOAL_MARGIN = 0.95
#: longest zoom sweep of a task without a period, s
LONGEST_S = 60.0
#: sweep time over the shortest that the filter follows
SETTLED = 1.2
#: points: RBW over their distance, and the fewest that every analyzer sweeps
POINTS_IN_RBW = 3.0
FEWEST_POINTS = 201


def plan_with_zoom(task: MeasurementTask, period_s: float | None = None) -> tuple[MeasurementTask, TaskPlan]:
    """Return the task as it will be measured, and what the planner says of it.

    Parameters
    ----------
    task : MeasurementTask
        As loaded; without ``zoom: auto`` it stays as it is.
    period_s : float, optional
        In place of the task's; 0 sets no bound.
    """
    plan = plan_task(task, period_s)
    if task.task.zoom == "off" or any(finding.rule in {"id.unique", "sweep.unknown"} for finding in plan.errors):
        return task, plan
    wanted_s = task.task.period_s if period_s is None else period_s
    reasons = {finding.subject: finding for finding in plan.findings if finding.rule in MOVING_RULES}
    moves: list[TaskFinding] = []
    for carrier in task.carriers:
        if carrier.id in reasons:
            left_s = wanted_s - cycle_s(task) - SWEEP_OVERHEAD_S if wanted_s else LONGEST_S
            share_s = left_s / max(1, len(reasons) - len(moves))
            task, finding = _move(task, carrier, reasons[carrier.id], share_s)
            moves.append(finding)
    plan = plan_task(task, period_s)
    return task, replace(plan, findings=(*plan.findings, *moves))


def _move(
    task: MeasurementTask, carrier: CarrierPart, reason: TaskFinding, left_s: float
) -> tuple[MeasurementTask, TaskFinding]:
    """Return the task with one carrier in a sweep of its own, or as it was where there is no room for one."""
    parent = next(sweep for sweep in task.sweeps if sweep.id == carrier.sweep)
    rbw_hz = zoom_rbw_hz(carrier)
    windows = _windows(task, carrier, rbw_hz, parent)
    if not windows:
        return task, TaskFinding("zoom.no_room", carrier.id, "no noise lies beside it in the sweep", is_error=False)
    sweep = _zoom_sweep(carrier, windows, rbw_hz, parent)
    shortest_s = SETTLED * shortest_sweep_s(sweep)
    if shortest_s > left_s:
        detail = f"a sweep of its own takes {shortest_s:.2f} s, {max(left_s, 0.0):.2f} s are left of the period"
        return task, TaskFinding("zoom.no_time", carrier.id, detail, is_error=False)
    moved = carrier.model_copy(update={"sweep": sweep.id, "noise": windows})
    sweep = sweep.model_copy(update={"time_s": _time_s(moved, sweep, shortest_s, left_s)})
    carriers = tuple(moved if each.id == carrier.id else each for each in task.carriers)
    changed = task.model_copy(update={"sweeps": (*task.sweeps, sweep), "carriers": carriers})
    detail = (
        f"{reason.rule} in {parent.id}: measured in {sweep.id}, span {(sweep.stop_hz - sweep.start_hz) / 1e3:.0f} kHz, "
        f"RBW {rbw_hz:g} Hz, {sweep.time_s:.2f} s"
    )
    return changed, TaskFinding("zoom.moved", carrier.id, detail, is_error=False)


def zoom_rbw_hz(carrier: CarrierPart) -> float:
    """Return the resolution bandwidth of a carrier's own sweep, Hz.

    Examples
    --------
    >>> noise = ((1.0e9, 1.1e9),)
    >>> zoom_rbw_hz(CarrierPart(id="c", sweep="s", fc_hz=1e9, symbol_rate=128e3, integ_bw_hz=160e3, noise=noise))
    3000.0
    """
    limit_hz = (carrier.symbol_rate or 4.0 * carrier.integ_bw_hz) / 20.0
    decade_hz = 10.0 ** math.floor(math.log10(limit_hz))
    return 3.0 * decade_hz if 3.0 * decade_hz <= limit_hz else decade_hz


def _zoom_sweep(
    carrier: CarrierPart, windows: tuple[tuple[float, float], ...], rbw_hz: float, parent: SweepPart
) -> SweepPart:
    """Return a sweep over a carrier and its noise windows, one RBW wider on both sides."""
    half_hz = carrier.integ_bw_hz / 2.0
    low_hz = min(carrier.fc_hz - half_hz, *(low for low, _ in windows)) - rbw_hz
    high_hz = max(carrier.fc_hz + half_hz, *(high for _, high in windows)) + rbw_hz
    points = max(FEWEST_POINTS, math.ceil(POINTS_IN_RBW * (high_hz - low_hz) / rbw_hz) + 1)
    return SweepPart(
        id=f"{carrier.id[:56]}.zoom",
        start_hz=low_hz,
        stop_hz=high_hz,
        rbw_hz=rbw_hz,
        points=min(points, 100_001),
        detector=parent.detector,
    )


def _windows(
    task: MeasurementTask, carrier: CarrierPart, rbw_hz: float, parent: SweepPart
) -> tuple[tuple[float, float], ...]:
    """Return noise windows of a carrier's own sweep: the task's where they are near, else the gaps beside it."""
    reach_hz = NEAR_SPANS * carrier.integ_bw_hz / 2.0
    near = tuple(
        (low, high)
        for low, high in carrier.noise
        if carrier.fc_hz - reach_hz <= low and high <= carrier.fc_hz + reach_hz
    )
    return near or _gaps(task, carrier, rbw_hz, parent)


def _gaps(
    task: MeasurementTask, carrier: CarrierPart, rbw_hz: float, parent: SweepPart
) -> tuple[tuple[float, float], ...]:
    """Return the free frequencies beside a carrier that no carrier of the task and no edge of its sweep takes."""
    others = [each for each in task.carriers if each.id != carrier.id]
    guard_hz = GUARD_RBW * rbw_hz
    half_hz = max(carrier.occupied_hz, carrier.integ_bw_hz) / 2.0
    edges = [
        (each.fc_hz - each.occupied_hz / 2.0 - guard_hz, each.fc_hz + each.occupied_hz / 2.0 + guard_hz)
        for each in others
    ]
    floor_hz = max([parent.start_hz, *(high for _, high in edges if high <= carrier.fc_hz)])
    ceiling_hz = min([parent.stop_hz, *(low for low, _ in edges if low >= carrier.fc_hz)])
    low_hz, high_hz = carrier.fc_hz - half_hz - guard_hz, carrier.fc_hz + half_hz + guard_hz
    width_hz = carrier.integ_bw_hz
    gaps = ((max(floor_hz, low_hz - width_hz), low_hz), (high_hz, min(ceiling_hz, high_hz + width_hz)))
    # a quarter of the carrier's width keeps the noise below the carrier's own scatter
    return tuple((low, high) for low, high in gaps if high - low >= width_hz / 4.0)


def _time_s(carrier: CarrierPart, sweep: SweepPart, shortest_s: float, left_s: float) -> float:
    """Return the time of a carrier's own sweep: for its goal, within what the filter needs and the period has left."""
    goal_db = carrier.limits.sigma_goal_db
    if goal_db is None:
        return round(shortest_s, 4)
    at_shortest_db = predict_sigma_db(carrier, sweep.model_copy(update={"time_s": shortest_s}))
    needed_s = shortest_s * (at_shortest_db / (GOAL_MARGIN * goal_db)) ** 2
    return round(min(max(needed_s, shortest_s), left_s, LONGEST_S), 4)
