"""Is the task measurable? Rules that are checked before the analyzer is touched.

=================== =================================================================================== =======
rule                what it says                                                                        outcome
=================== =================================================================================== =======
id.unique           sweeps and carriers have names of their own                                         error
sweep.unknown       a carrier's sweep exists                                                            error
sweep.outside       integration band and noise windows lie inside the sweep                             error
sweep.too_fast      sweep time at least 2.5 span / RBW^2                                                error
sweep.points        distance of points at most RBW / 2                                                  error
sweep.empty         every sweep has a carrier; one that has none is not taken                           warning
points.fixed        the family named may sweep its own number of points, which is enough too            warning
vbw.narrow          VBW at least RBW: below it a peak of the mean of powers is not the carrier's        warning
level.reference     the carriers together stay 5 dB below the reference level                           warning
period.too_short    the sweeps fit into the period                                                      error
rbw.too_wide        RBW at most B/5                                                                     error
rbw.wide            RBW at most B/20                                                                    warning
carriers.overlap    integration bands of one sweep do not overlap                                       error
noise.overlap       a noise window holds no carrier                                                     error
noise.close         a noise window keeps two RBW from every carrier                                     warning
neighbour.close     the next carrier keeps two RBW                                                      warning
sigma.goal          predicted scatter meets the carrier's goal                                          warning
=================== =================================================================================== =======

Narrow carriers get sweeps of their own: those that a wide sweep measures too coarsely or with too much scatter.

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
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from service.core.radio.carrier_power import GAUSSIAN_ENBW_RATIO, TraceGrid, carrier_sigma_db, line_sigma_db, swept_dof
from service.core.radio.levels import dbm_from_mw, mw_from_dbm, ratio_from_db
from service.frontend.drivers.dialects import SIGLENT
from service.frontend.measurement_task import CarrierPart, MeasurementTask, SweepPart, TaskError
from service.records.field_faults import faults_text
from service.records.levels.measurement import SweepSettings

#: bandwidths between a carrier's edge and anything else for the filter's skirt to be down
GUARD_RBW = 2.0
#: C/N in the band where the task says nothing about it, dB
ASSUMED_C_N_DB = 10.0
#: time for settings, transfer and errors of one sweep, s
SWEEP_OVERHEAD_S = 0.1
#: distance of all carriers together from the reference level, dB
HEADROOM_DB = 5.0
#: points that a family sweeps whatever it is told
FIXED_POINTS = {SIGLENT.name: SIGLENT.fixed_points}


@dataclass(frozen=True, slots=True)
class TaskFinding:
    """One rule that the task breaks."""

    rule: str
    #: carrier or sweep
    subject: str
    detail: str
    is_error: bool

    def __str__(self) -> str:
        return f"{'error' if self.is_error else 'warning'} {self.rule}: {self.subject}: {self.detail}"


@dataclass(frozen=True, slots=True)
class TaskPlan:
    """Findings of the planner and predicted scatter of each carrier."""

    findings: tuple[TaskFinding, ...]
    #: carrier -> predicted standard deviation of its level, dB
    sigma_db: dict[str, float]

    @property
    def errors(self) -> tuple[TaskFinding, ...]:
        """The findings that forbid the task."""
        return tuple(finding for finding in self.findings if finding.is_error)

    @property
    def warnings(self) -> tuple[TaskFinding, ...]:
        """The findings that the operator should know."""
        return tuple(finding for finding in self.findings if not finding.is_error)


def shortest_sweep_s(sweep: SweepPart) -> float:
    """Return the sweep time below which the filter does not settle, s."""
    return 2.5 * (sweep.stop_hz - sweep.start_hz) / sweep.rbw_hz**2


def sweep_time_s(sweep: SweepPart) -> float:
    """Return the sweep time that is asked for, or the one the analyzer will couple, s."""
    return sweep.time_s if sweep.time_s is not None else shortest_sweep_s(sweep)


def plan_task(task: MeasurementTask, period_s: float | None = None) -> TaskPlan:
    """Return the findings against a task, and the predicted scatter of every carrier.

    Parameters
    ----------
    task : MeasurementTask
        As loaded.
    period_s : float, optional
        In place of the task's; 0 is not checked.
    """
    findings = [*_names(task), *_period(task, task.task.period_s if period_s is None else period_s)]
    sweeps = {sweep.id: sweep for sweep in task.sweeps}
    for sweep in task.sweeps:
        findings += [*_sweep(sweep), *_means(task, sweep)]
        findings += _separation(sweep, task.carriers_of(sweep.id))
    sigma_db: dict[str, float] = {}
    for carrier in task.carriers:
        own = sweeps.get(carrier.sweep)
        if own is None:
            findings.append(
                TaskFinding("sweep.unknown", carrier.id, f"there is no sweep {carrier.sweep}", is_error=True)
            )
            continue
        findings += _carrier(carrier, own)
        sigma_db[carrier.id] = predict_sigma_db(carrier, own)
        findings += _goal(carrier, sigma_db[carrier.id])
    return TaskPlan(tuple(findings), sigma_db)


def recheck(task: MeasurementTask, sweep: SweepPart, actual: SweepSettings) -> list[TaskFinding]:
    """Return the findings against a sweep as the analyzer takes it that did not hold against the requested one."""
    taken = sweep.model_copy(
        update={
            "points": actual.points,
            "rbw_hz": actual.rbw_hz,
            "vbw_hz": actual.vbw_hz,
            "time_s": actual.sweep_time_s,
        }
    )
    known = {(finding.rule, finding.subject) for finding in _of_sweep(task, sweep)}
    return [finding for finding in _of_sweep(task, taken) if (finding.rule, finding.subject) not in known]


def _of_sweep(task: MeasurementTask, sweep: SweepPart) -> list[TaskFinding]:
    """Return the findings against one sweep and the carriers in it."""
    findings = _sweep(sweep)
    for carrier in task.carriers_of(sweep.id):
        findings += [*_carrier(carrier, sweep), *_goal(carrier, predict_sigma_db(carrier, sweep))]
    return findings


def predict_sigma_db(carrier: CarrierPart, sweep: SweepPart) -> float:
    """Return the standard deviation to be expected of a carrier's level, dB.

    Uses ``limits.c_n0_min`` as the worst signal-to-noise ratio, 10 dB in the symbol rate without it.
    """
    enbw_hz = sweep.rbw_hz * GAUSSIAN_ENBW_RATIO
    step_hz = (sweep.stop_hz - sweep.start_hz) / (sweep.points - 1)
    grid = TraceGrid(sweep.start_hz, step_hz, sweep.points, enbw_hz, sweep_time_s(sweep) * sweep.count)
    width_hz = carrier.symbol_rate or sweep.rbw_hz
    c_n0 = carrier.limits.c_n0_min
    c_n0_ratio = float(ratio_from_db(ASSUMED_C_N_DB)) * width_hz if c_n0 is None else float(ratio_from_db(c_n0))
    noise_to_carrier = carrier.integ_bw_hz / c_n0_ratio
    noise_hz = sum(high - low for low, high in carrier.noise)
    carrier_dof, band_dof, noise_dof = swept_dof(grid, np.array([width_hz, carrier.integ_bw_hz, noise_hz]))
    if carrier.kind == "beacon":
        dwell_s = grid.sweep_time_s * enbw_hz / (sweep.stop_hz - sweep.start_hz)
        ratio = carrier.integ_bw_hz / enbw_hz
        return float(line_sigma_db(noise_to_carrier, enbw_hz * dwell_s, ratio, band_dof, noise_dof))
    return float(carrier_sigma_db(noise_to_carrier, carrier_dof, band_dof, noise_dof))


def cycle_s(task: MeasurementTask) -> float:
    """Return how long one row takes, s."""
    taken = [sweep for sweep in task.sweeps if task.carriers_of(sweep.id)]
    return sum(sweep_time_s(sweep) * sweep.count + SWEEP_OVERHEAD_S for sweep in taken)


def _names(task: MeasurementTask) -> list[TaskFinding]:
    findings = []
    for kind, ids in (("sweep", [s.id for s in task.sweeps]), ("carrier", [c.id for c in task.carriers])):
        twice = sorted({name for name in ids if ids.count(name) > 1})
        findings += [
            TaskFinding("id.unique", name, f"two of the {kind}s have this id", is_error=True) for name in twice
        ]
    return findings


def _period(task: MeasurementTask, period_s: float) -> list[TaskFinding]:
    """Check that all sweeps fit into the period."""
    needed_s = cycle_s(task)
    if period_s == 0.0 or needed_s <= period_s:
        return []
    detail = f"the sweeps take {needed_s:.2f} s of a period of {period_s:g} s"
    return [TaskFinding("period.too_short", task.task.id, detail, is_error=True)]


def _sweep(sweep: SweepPart) -> list[TaskFinding]:
    findings = []
    shortest_s = shortest_sweep_s(sweep)
    if sweep_time_s(sweep) < 0.999 * shortest_s:
        detail = f"{sweep.time_s:g} s where span and RBW need {shortest_s:.3g} s"
        findings.append(TaskFinding("sweep.too_fast", sweep.id, detail, is_error=True))
    step_hz = (sweep.stop_hz - sweep.start_hz) / (sweep.points - 1)
    if step_hz > 0.501 * sweep.rbw_hz:
        detail = f"points lie {step_hz:.0f} Hz apart, RBW {sweep.rbw_hz:.0f} Hz allows half of it"
        findings.append(TaskFinding("sweep.points", sweep.id, detail, is_error=True))
    return findings


def _means(task: MeasurementTask, sweep: SweepPart) -> list[TaskFinding]:
    """Check what is asked of the analyzer in one sweep: points of its family, video filter, reference level."""
    findings = []
    carriers = task.carriers_of(sweep.id)
    if not carriers:
        findings.append(TaskFinding("sweep.empty", sweep.id, "no carrier is measured in it", is_error=False))
    fixed = FIXED_POINTS.get(task.task.analyzer.dialect)
    if fixed is not None and fixed != sweep.points:
        step_hz = (sweep.stop_hz - sweep.start_hz) / (fixed - 1)
        verdict = "still enough" if step_hz <= 0.501 * sweep.rbw_hz else f"too far for RBW {sweep.rbw_hz:.0f} Hz"
        detail = f"firmware with {fixed} fixed points puts them {step_hz:.0f} Hz apart: {verdict}"
        findings.append(TaskFinding("points.fixed", sweep.id, detail, is_error=False))
    if sweep.vbw_hz is not None and sweep.vbw_hz < sweep.rbw_hz:
        detail = f"VBW {sweep.vbw_hz:.0f} Hz is below RBW {sweep.rbw_hz:.0f} Hz"
        findings.append(TaskFinding("vbw.narrow", sweep.id, detail, is_error=False))
    return findings + _reference(task, sweep, carriers)


def _reference(task: MeasurementTask, sweep: SweepPart, carriers: tuple[CarrierPart, ...]) -> list[TaskFinding]:
    """Check the sum of the nominal levels against the reference level."""
    levels = [c.limits.nominal_dbm for c in carriers if c.limits.nominal_dbm is not None]
    reference_dbm = task.input.ref_level_dbm
    if reference_dbm is None or not levels:
        return []
    sum_dbm = float(dbm_from_mw(mw_from_dbm(levels).sum()))
    if sum_dbm <= reference_dbm - HEADROOM_DB:
        return []
    detail = f"the carriers add up to {sum_dbm:.1f} dBm, the reference level is {reference_dbm:g} dBm"
    return [TaskFinding("level.reference", sweep.id, detail, is_error=False)]


def _carrier(carrier: CarrierPart, sweep: SweepPart) -> list[TaskFinding]:
    """Check one carrier against its sweep."""
    findings = []
    bands = [(carrier.fc_hz - carrier.integ_bw_hz / 2, carrier.fc_hz + carrier.integ_bw_hz / 2), *carrier.noise]
    step_hz = (sweep.stop_hz - sweep.start_hz) / (sweep.points - 1)
    for low, high in bands:
        if low < sweep.start_hz - step_hz / 2 or high > sweep.stop_hz + step_hz / 2:
            detail = f"{low / 1e6:.4f}-{high / 1e6:.4f} MHz lies outside of sweep {sweep.id}"
            findings.append(TaskFinding("sweep.outside", carrier.id, detail, is_error=True))
    width_hz = carrier.symbol_rate if carrier.symbol_rate is not None else 4.0 * carrier.integ_bw_hz
    if sweep.rbw_hz > width_hz / 5.0:
        detail = f"RBW {sweep.rbw_hz:.0f} Hz is more than a fifth of {width_hz:.0f} Hz"
        findings.append(TaskFinding("rbw.too_wide", carrier.id, detail, is_error=True))
    elif carrier.kind == "modulated" and sweep.rbw_hz > width_hz / 20.0:
        detail = f"RBW {sweep.rbw_hz:.0f} Hz is more than a twentieth of {width_hz:.0f} Hz: the level is biased low"
        findings.append(TaskFinding("rbw.wide", carrier.id, detail, is_error=False))
    return findings


def _separation(sweep: SweepPart, carriers: tuple[CarrierPart, ...]) -> list[TaskFinding]:
    """Check carriers against one another and against noise windows."""
    findings = []
    guard_hz = GUARD_RBW * sweep.rbw_hz
    for one, other in combinations(carriers, 2):
        distance_hz = abs(one.fc_hz - other.fc_hz)
        if distance_hz < (one.integ_bw_hz + other.integ_bw_hz) / 2 - 1.0:
            detail = f"overlaps the integration band of {other.id}"
            findings.append(TaskFinding("carriers.overlap", one.id, detail, is_error=True))
        elif distance_hz - (one.occupied_hz + other.occupied_hz) / 2 < guard_hz:
            detail = f"{other.id} is closer than {GUARD_RBW:g} RBW"
            findings.append(TaskFinding("neighbour.close", one.id, detail, is_error=False))
    for carrier in carriers:
        for neighbour in carriers:
            findings += _noise_against(carrier, neighbour, guard_hz)
    return findings


def _noise_against(carrier: CarrierPart, neighbour: CarrierPart, guard_hz: float) -> list[TaskFinding]:
    """Check the noise windows of a carrier against one carrier of the sweep."""
    findings = []
    low_edge, high_edge = neighbour.fc_hz - neighbour.occupied_hz / 2, neighbour.fc_hz + neighbour.occupied_hz / 2
    for low, high in carrier.noise:
        gap_hz = max(low - high_edge, low_edge - high)
        where = f"noise window {low / 1e6:.4f}-{high / 1e6:.4f} MHz"
        if gap_hz < 0.0:
            findings.append(TaskFinding("noise.overlap", carrier.id, f"{where} holds {neighbour.id}", is_error=True))
        elif gap_hz < guard_hz:
            detail = f"{where} is closer than {GUARD_RBW:g} RBW to {neighbour.id}"
            findings.append(TaskFinding("noise.close", carrier.id, detail, is_error=False))
    return findings


def _goal(carrier: CarrierPart, sigma_db: float) -> list[TaskFinding]:
    """Check the predicted scatter against the carrier's goal."""
    goal_db = carrier.limits.sigma_goal_db
    if goal_db is None or sigma_db <= goal_db:
        return []
    detail = f"{sigma_db:.3f} dB predicted, {goal_db:g} dB wanted: give it a longer sweep or a narrow one of its own"
    return [TaskFinding("sigma.goal", carrier.id, detail, is_error=False)]


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


_Name = Annotated[str, Field(min_length=1, max_length=64)]


class StationEntry(BaseModel):
    """One analyzer."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    #: measurement task, relative to the station file
    task: Path
    spacecraft: _Name
    #: name of this source of measurements
    source: _Name = "sa-1"
    #: VISA resource name, in place of the task's
    resource: str | None = None
    #: time from row to row in place of the task's, s; 0 = as fast as the analyzer answers
    period_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    #: whose clock stamps the rows
    epoch: Literal["system", "analyzer"] = "system"
    #: further wait for a sweep that a trigger holds back, s
    hold_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class StationFile(BaseModel):
    """All analyzers of a front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    analyzers: Annotated[tuple[StationEntry, ...], Field(min_length=1, max_length=63)]

    @model_validator(mode="before")
    @classmethod
    def _read_list(cls, document: object) -> object:
        """Let a bare list stand for the analyzers."""
        return {"analyzers": document} if isinstance(document, list) else document

    @model_validator(mode="after")
    def _have_sources_of_their_own(self) -> Self:
        sources = [(entry.spacecraft, entry.source) for entry in self.analyzers]
        twice = sorted(
            {f"{spacecraft}.{source}" for spacecraft, source in sources if sources.count((spacecraft, source)) > 1}
        )
        if twice:
            message = f"two analyzers are {', '.join(twice)}: give each a source of its own"
            raise ValueError(message)
        return self


def load_station(path: Path) -> tuple[StationEntry, ...]:
    """Return the analyzers of a station file, paths made absolute.

    Raises
    ------
    TaskError
        The file cannot be read, or is no station file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        message = f"station {path}: {error.strerror}"
        raise TaskError(message) from error
    try:
        station = TypeAdapter(StationFile).validate_json(content)
    except ValidationError as error:
        message = f"station {path}: {faults_text(error.errors(), 'station')}"
        raise TaskError(message) from error
    return tuple(entry.model_copy(update={"task": path.parent / entry.task}) for entry in station.analyzers)
