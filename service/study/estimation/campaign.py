"""The campaign: units spread over workers, their results put together and held against the bounds.

Effect of eclipse nights on an estimate: the same spacecraft with and without the shadow.

A fault of the simulator never changes its noise, so the world of the same seed without a fault has the same attitude,
row by row, and what the answers differ by is the doing of the eclipse. What they differed by before the night, other
orbits and other harmonics, is taken off.
"""

import platform
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import Float32Array
from service.study.estimation.bound_table import BOUNDS
from service.study.estimation.bounds import (
    AXES,
    Bound,
    Judged,
    Mark,
    Statistics,
    accuracy_statistics,
    idle_baselines,
    judge,
)
from service.study.estimation.flight.baselines import BASELINES, UNINFORMED
from service.study.estimation.flight.drive import UndrivenError
from service.study.estimation.flight.episodes import stretches
from service.study.estimation.flight.oracle.filter import ORACLE
from service.study.estimation.measures import statistics_of
from service.study.estimation.scenarios import SNAPSHOT
from service.study.estimation.smoothing_gain import gain_statistics
from service.study.estimation.trials.snapshot_trials import SnapshotTrials, run_trials, trial_statistics
from service.study.estimation.unit import Course, Unit, UnitResult, run_unit
from service.study.estimation.yardstick import yardstick_statistics
from service.study.executors import WorkerChoice, do_work, executor_of

#: before a night and after its end, h
BEFORE_H = 1.0
AFTER_H = 3.0
#: differences are means over this time: what a single row does is noise, h
_MEAN_H = 0.5


def night_statistics(pairs: Sequence[tuple[Course, Course]], method: str) -> Statistics:
    """Return the largest shift during the nights and what is left of it afterwards, over all seeds.

    Parameters
    ----------
    pairs : sequence of (Course, Course)
        A world with eclipses and the world of the same seed without.
    method : str
        Whose answer.
    """
    shifts, left = [], []
    for dark, bright in pairs:
        if method not in dark.methods or method not in bright.methods or not np.array_equal(dark.hours, bright.hours):
            continue
        apart = np.asarray(dark.methods[method].estimate_deg - bright.methods[method].estimate_deg, dtype=np.float64)
        for first, last in stretches(dark.is_night):
            begin_h, end_h = float(dark.hours[first]), float(dark.hours[last - 1])
            before = apart[(dark.hours >= begin_h - BEFORE_H) & (dark.hours < begin_h)]
            after = apart[(dark.hours >= end_h + AFTER_H) & (dark.hours < end_h + AFTER_H + BEFORE_H)]
            if len(before) == 0 or len(after) == 0:
                continue
            inside = (dark.hours >= begin_h) & (dark.hours < end_h + AFTER_H)
            moved = apart[inside] - before.mean(axis=0)
            shifts.append(_largest_mean(moved, dark.hours[inside]))
            left.append(np.abs(after.mean(axis=0) - before.mean(axis=0)))
    if not shifts:
        return {}
    worst = {"shift_deg": np.max(shifts, axis=0), "left_deg": np.max(left, axis=0)}
    return {f"{name}.{axis}": float(values[k]) for name, values in worst.items() for k, axis in enumerate(AXES)}


def _largest_mean(moved: FloatArray, hours: Float32Array) -> FloatArray:
    """Return the largest (3,) of the means over consecutive times."""
    chunks = np.floor((hours - hours[0]) / _MEAN_H)
    means = [np.abs(moved[chunks == chunk].mean(axis=0)) for chunk in np.unique(chunks)]
    return np.asarray(np.max(means, axis=0))


METHODS = ("robust", "paper")
#: the slope of yaw scatters by 0.1 from calibration to calibration; its mean is to be judged to 0.03
_SNAPSHOT_SEEDS = 16


class CampaignPlan(NamedTuple):
    """Plan of a campaign: scenarios and seeds."""

    scenarios: tuple[str, ...]
    seeds: int
    workers: WorkerChoice = WorkerChoice()
    #: None = as long as each scenario is
    operation_days: float | None = None


@dataclass(frozen=True)
class Campaign:
    """Results of a campaign."""

    plan: CampaignPlan
    seconds: float
    #: of every unit, in the order of scenarios and seeds
    results: tuple[UnitResult, ...]
    #: by scenario and method or baseline
    statistics: dict[tuple[str, str], Statistics]
    judged: tuple[Judged, ...]
    #: scenario and baseline that keeps all its bounds of accuracy
    idle: tuple[tuple[str, str], ...]

    @property
    def missed(self) -> tuple[Judged, ...]:
        """Bounds that were missed."""
        return tuple(judged for judged in self.judged if judged.mark is Mark.MISSED)

    @property
    def refusals(self) -> tuple[UnitResult, ...]:
        """Units in which the product refused to calibrate or to align, or failed."""
        return tuple(result for result in self.results if result.refusal)


#: called after each piece of work with how many are done and how many there are
Show = Callable[[int, int], None]


def run_campaign(plan: CampaignPlan, show: Show) -> Campaign:
    """Run every unit of a plan and judge the figures.

    Raises
    ------
    ExportFailedError
        The simulator does not know a scenario, or failed.
    BrokenExecutor, ClusterError
        A process of the study was ended by someone else, or the cluster cannot compute.
    """
    began_s = time.monotonic()
    seeds = range(1, plan.seeds + 1)
    units = [Unit(name, seed, plan.operation_days) for name in plan.scenarios if name != SNAPSHOT for seed in seeds]
    trials = range(1, max(plan.seeds, _SNAPSHOT_SEEDS) + 1) if SNAPSHOT in plan.scenarios else range(0)
    with executor_of(plan.workers) as pool:
        reported: dict[Future[UnitResult], Unit] = {
            pool.submit(do_work, run_unit, unit): unit for unit in _longest_first(units)
        }
        tried = [pool.submit(do_work, _trials, seed) for seed in trials]
        everything: list[Future[UnitResult] | Future[SnapshotTrials | None]] = [*reported, *tried]
        for number, done in enumerate(as_completed(everything), start=1):
            done.result()
            show(number, len(everything))
    by_unit = {unit: future.result() for future, unit in reported.items()}
    results = tuple(by_unit[unit] for unit in units)
    statistics = collect_metrics(results)
    if tried:
        reported_trials = [trial for future in tried if (trial := future.result()) is not None]
        # a calibration that was refused misses every bound
        statistics[SNAPSHOT, "robust"] = trial_statistics(reported_trials) if len(reported_trials) == len(tried) else {}
    return assess(plan, time.monotonic() - began_s, results, statistics)


def assess(
    plan: CampaignPlan,
    seconds: float,
    results: tuple[UnitResult, ...],
    statistics: dict[tuple[str, str], Statistics],
    bounds: Sequence[Bound] = BOUNDS,
) -> Campaign:
    """Return a campaign with its figures held against the bounds; what was not run is left out."""
    run = {scenario for scenario, _method in statistics} | {result.unit.scenario for result in results}
    own = [bound for bound in bounds if bound.scenario in run]
    silent = {(scenario, method): Statistics() for scenario in run for method in METHODS}
    judged = judge(own, {**silent, **statistics})
    return Campaign(plan, seconds, results, statistics, judged, idle_baselines(own, statistics, UNINFORMED))


def collect_metrics(results: Sequence[UnitResult]) -> dict[tuple[str, str], Statistics]:
    """Return the figures of every method and baseline over the seeds of each scenario.

    A method that did not answer in one of the seeds has no figures of the scenario.
    """
    statistics: dict[tuple[str, str], Statistics] = {}
    by_scenario: dict[str, list[UnitResult]] = {}
    for result in results:
        by_scenario.setdefault(result.unit.scenario, []).append(result)
    for scenario, seeds in by_scenario.items():
        statistics |= {(scenario, name): reported for name, reported in _statistics_by_answer(seeds).items()}
    for method in METHODS:
        if ("eclipse", method) in statistics:
            statistics["eclipse", method] |= night_statistics(_courses(by_scenario, "eclipse", "nominal"), method)
    return statistics


def _statistics_by_answer(seeds: Sequence[UnitResult]) -> dict[str, Statistics]:
    """Return the figures of one scenario by method or baseline."""
    methods = [method for method in (*METHODS, ORACLE) if all(method in seed.methods for seed in seeds)]
    baselines = [baseline for baseline in BASELINES if all(baseline in seed.baselines for seed in seeds)]
    reported = {
        **{method: statistics_of([seed.methods[method] for seed in seeds]) for method in methods},
        **{baseline: accuracy_statistics([seed.baselines[baseline] for seed in seeds]) for baseline in baselines},
    }
    for answer in dict.fromkeys(answer for seed in seeds for answer in seed.yardsticks):
        answering = {seed.unit.seed: seed.yardsticks[answer] for seed in seeds if answer in seed.yardsticks}
        reported[answer] = {**reported.get(answer, {}), **yardstick_statistics(answering)}
    for answer in dict.fromkeys(answer for seed in seeds for answer in seed.gains):
        gains = gain_statistics(answer, [seed.gains[answer] for seed in seeds if answer in seed.gains])
        reported.setdefault("robust", {}).update(gains)
    if ORACLE in methods:
        for method in methods:
            reported[method] |= _ratio_to_oracle(reported[method], reported[ORACLE])
            reported[method] |= _ratio_to_bound(reported[method], reported[ORACLE])
    return reported


def _ratio_to_oracle(own: Statistics, oracle: Statistics) -> Statistics:
    """Return rms of an answer over that of the oracle, axis by axis."""
    return {f"rms_over_oracle.{axis}": own[f"rms_deg.{axis}"] / oracle[f"rms_deg.{axis}"] for axis in AXES}


def _ratio_to_bound(own: Statistics, oracle: Statistics) -> Statistics:
    """Return the covariance bound, which the oracle's Riccati equation gives, and an answer's pooled rms over it."""
    statistics = {f"bound_deg.{axis}": oracle[f"sigma_deg.{axis}"] for axis in AXES}
    for axis in AXES:
        rms_deg = own[f"rms_over_sigma.{axis}"] * own[f"sigma_deg.{axis}"]
        statistics[f"rms_over_bound.{axis}"] = rms_deg / statistics[f"bound_deg.{axis}"]
    return statistics


def _courses(by_scenario: Mapping[str, Sequence[UnitResult]], one: str, other: str) -> list[tuple[Course, Course]]:
    """Return the courses of two scenarios, seed by seed where both were run."""
    first, second = (
        {result.unit.seed: result.course for result in by_scenario.get(name, ()) if result.course}
        for name in (one, other)
    )
    return [(first[seed], second[seed]) for seed in sorted(first.keys() & second.keys())]


def versions() -> dict[str, str]:
    """Return what the figures were made with."""
    return {"python": platform.python_version(), **{name: version(name) for name in ("soo", "numpy", "scipy")}}


def _trials(seed: int) -> SnapshotTrials | None:
    """Return the trials of one seed, None where the product refused to calibrate."""
    try:
        return run_trials(seed)
    except UndrivenError:
        return None


def _longest_first(units: Sequence[Unit]) -> list[Unit]:
    """Return the units so that no long one is left to the end."""
    slow = {"long14": 0, "nominal_10s": 1}
    return sorted(units, key=lambda unit: slow.get(unit.scenario, 2))
