"""The campaign: units spread over workers, their results put together and held against the bounds.

Effect of eclipse nights on an estimate: the same spacecraft with and without the shadow.

A fault of the simulator never changes its noise, so the world of the same seed without a fault has the same attitude,
row by row, and what the answers differ by is the doing of the eclipse. What they differed by before the night, other
orbits and other harmonics, is taken off.

One scenario with one seed: the world exported, the product driven over it, everything measured.

A unit is what a process of the campaign works on, so what it returns travels between processes and stays small.
"""

import platform
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from service.records.catalogue import Method
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.records.levels.measurement import Float32Array
from service.study.estimation import bounds
from service.study.estimation.flight.baselines import BASELINES, UNINFORMED, baseline_answers
from service.study.estimation.flight.drive import Driven, UndrivenError, drive
from service.study.estimation.flight.episodes import stretches
from service.study.estimation.flight.oracle.filter import ORACLE, oracle_series
from service.study.estimation.flight.world import World, simulated_world
from service.study.estimation.measures import (
    Measures,
    SmoothingGain,
    gain_statistics,
    judged_rows,
    measure_gain,
    measure_method,
    statistics_of,
)
from service.study.estimation.trials.snapshot_trials import SnapshotTrials, run_trials, trial_statistics
from service.study.estimation.yardstick import Yardstick, measure_yardstick, measure_yardsticks, yardstick_statistics
from service.study.executors import WorkerChoice, do_work, executor_of

#: not a scenario of the simulator but the trials of the fix of one epoch alone
SNAPSHOT = "snapshot"

_PLAIN = ("nominal", "white", "few8", "many32", "octants", "init_bias", "maneuver", "long14", "demo")
_FAULTS = ("steps", "steps_heavy", "uplink_rain", "transponder", "interference", "gaps", "mixed", "mixed32")
_RAIN = (
    "downlink_rain",
    "downlink_rain_0p02",
    "downlink_rain_0p05",
    "downlink_rain_0p3",
    "downlink_rain_1",
    "downlink_rain_3",
    "downlink_slow",
    "downlink_slew",
    "dual_band",
    "drift",
)
_HARD = (
    "flicker",
    "flicker_storm",
    "flicker_hard",
    "yaw_hold",
    "stale_calibration",
    "eclipse",
    "sun_outage",
    "alc",
    "upc",
    "upc_untold",
    "no_coupling",
    "burn",
    "works",
)
_MISMATCH = (
    "nominal_tau5",
    "nominal_tau120",
    "nominal_drift3",
    "nominal_uncoupled",
    "nominal_10s",
    "nominal_300s",
    "corrections_flipped",
    "corrections_halved",
    "corrections_lost",
    "corrections_doubled",
)
_SOURCES = ("beacons", "sensors", "prime_backup", "replan", "blackout", "few3", "corrections_late", "antenna_wave")
_WEATHER = ("weather_far", "weather_near", "weather_turns", "weather_alignment", "weather_wet_season")
_MOTION = (
    *("wheels", "wheels_hourly", "wheels_unstated", "wheels_unmarked", "wheels_misaligned", "wheels_zero"),
    *("rates", "rates_biased"),
)
_POLARIZATION = ("polarized", "polarized_storm", "feed_turned", "leak_drift")
#: the worlds by which "never confident and wrong" is judged
_YARDSTICK = (
    *_WEATHER,
    "flicker_hard",
    *("nominal", "mixed", "steps_heavy", "octants", "downlink_rain", "yaw_hold"),
)

GROUPS: dict[str, tuple[str, ...]] = {
    "quick": ("nominal", "octants", "downlink_rain"),
    "plain": _PLAIN,
    "faults": _FAULTS,
    "rain": _RAIN,
    "hard": _HARD,
    "mismatch": _MISMATCH,
    "sources": _SOURCES,
    "weather": _WEATHER,
    "motion": _MOTION,
    "polarization": _POLARIZATION,
    "yardstick": _YARDSTICK,
    "snapshot": (SNAPSHOT,),
    "all": (*_PLAIN, *_FAULTS, *_RAIN, *_HARD, *_MISMATCH, *_SOURCES, *_WEATHER, *_MOTION, *_POLARIZATION, SNAPSHOT),
}


class Unit(NamedTuple):
    """One run of a campaign: scenario and seed."""

    scenario: str
    seed: int
    #: None = as long as the scenario is
    operation_days: float | None = None


class Drawn(NamedTuple):
    """Answer of one method as it is drawn; T rows."""

    #: (T, 3) deg, yaw, roll, pitch
    estimate_deg: Float32Array
    sigma_deg: Float32Array
    #: (T,)
    is_control_allowed: BoolArray
    #: (T, 3) deg, NaN = none stated
    protection_deg: Float32Array | None = None


class Rain(NamedTuple):
    """True rain, and the hypotheses of the carriers."""

    #: (T, N) loss by rain and wet antennas, dB
    loss_db: Float32Array
    #: (T, N) likeliest hypothesis by position, -1 = none
    hypothesis: IntArray


class Course(NamedTuple):
    """Operation phase of one world as it is drawn; T rows."""

    #: (T,) since the start of operation
    hours: Float32Array
    #: (T, 3) deg
    truth_deg: Float32Array
    #: (T,) whether the spacecraft is in the shadow or has not warmed yet
    is_night: BoolArray
    methods: dict[str, Drawn]
    rain: Rain | None = None
    #: (T, 3) deg, robust rows smoothed by all later ones, NaN = no row
    smoothed_deg: Float32Array | None = None


@dataclass(frozen=True)
class UnitResult:
    """Result of one run."""

    unit: Unit
    seconds: float
    #: reason why the chain could not run, empty where it could
    refusal: str = ""
    methods: dict[str, Measures] = field(default_factory=dict)
    baselines: dict[str, bounds.Accuracy] = field(default_factory=dict)
    course: Course | None = None
    #: by name of the answer
    yardsticks: dict[str, Yardstick] = field(default_factory=dict)
    #: of the smoothed answers, by name
    gains: dict[str, SmoothingGain] = field(default_factory=dict)


def run_unit(unit: Unit) -> UnitResult:
    """Export the world of a unit, drive the product over it and measure what it said.

    Raises
    ------
    ExportFailedError
        The simulator wrote no world.
    """
    began_s = time.monotonic()
    world = simulated_world(unit.scenario, unit.seed, unit.operation_days)
    driven = _driven(world)
    if isinstance(driven, str):
        return UnitResult(unit, time.monotonic() - began_s, driven)
    oracle = oracle_series(world, driven.rows)
    everyone = {**driven.methods, ORACLE: oracle}
    methods = {name: measure_method(world, driven, series) for name, series in everyone.items()}
    baselines, course = _baselines(world, driven), _course(world, driven)
    yardsticks = {**measure_yardsticks(world, driven, Method.ROBUST), ORACLE: measure_yardstick(world, driven, oracle)}
    robust = driven.methods.get(Method.ROBUST)
    past = {} if robust is None else driven.smoothed
    gains = {name: measure_gain(world, driven, robust, series) for name, series in past.items() if robust is not None}
    return UnitResult(unit, time.monotonic() - began_s, "", methods, baselines, course, yardsticks, gains)


def _driven(world: World) -> Driven | str:
    """Return what the product made of a world, or why it made nothing."""
    try:
        return drive(world.ground)
    except UndrivenError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - a world that breaks the product must not hide what it does in the others
        return f"the product failed: {type(error).__name__}: {error}"


def _baselines(world: World, driven: Driven) -> dict[str, bounds.Accuracy]:
    """Return what the answers without powers amount to."""
    judged = judged_rows(world, driven)
    epochs_us = world.ground.epochs_us[driven.rows]
    answers = baseline_answers(epochs_us, driven.alignment_epoch_us, driven.alignment_deg, world.ground.corrections)
    truth_deg = world.truth.attitude_deg[driven.rows[judged]]
    unknown = np.full(truth_deg.shape, np.nan)
    return {name: bounds.measure_accuracy(answer[judged], unknown, truth_deg) for name, answer in answers.items()}


def _course(world: World, driven: Driven) -> Course:
    rows = driven.rows
    hours = (world.ground.epochs_us[rows] - world.ground.phases["operation"].start_us) / 3.6e9
    return Course(
        hours.astype(np.float32),
        world.truth.attitude_deg[rows].astype(np.float32),
        np.asarray(world.truth.has_flag("eclipse")[rows].any(axis=1)),
        {
            name: Drawn(
                series.estimate_deg.astype(np.float32),
                series.sigma_deg.astype(np.float32),
                series.is_control_allowed,
                None if series.protection_deg is None else series.protection_deg.astype(np.float32),
            )
            for name, series in driven.methods.items()
        },
        None
        if driven.hypothesis is None
        else Rain(world.truth.station_loss_db[rows].astype(np.float32), driven.hypothesis),
        _smoothed_deg(world.ground.epochs_us[rows], driven),
    )


def _smoothed_deg(epochs_us: IntArray, driven: Driven) -> Float32Array | None:
    """Return the smoothed angles at each row (T, 3)."""
    series = driven.smoothed.get("smoothed")
    if series is None:
        return None
    angles = np.full((len(epochs_us), 3), np.nan, dtype=np.float32)
    _, own, theirs = np.intersect1d(epochs_us, series.epochs_us, return_indices=True)
    angles[own] = series.estimate_deg[theirs]
    return angles


#: before a night and after its end, h
BEFORE_H = 1.0
AFTER_H = 3.0
#: differences are means over this time: what a single row does is noise, h
_MEAN_H = 0.5


def night_statistics(pairs: Sequence[tuple[Course, Course]], method: str) -> bounds.Statistics:
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
    return {f"{name}.{axis}": float(values[k]) for name, values in worst.items() for k, axis in enumerate(bounds.AXES)}


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
    statistics: dict[tuple[str, str], bounds.Statistics]
    judged: tuple[bounds.Judged, ...]
    #: scenario and baseline that keeps all its bounds of accuracy
    idle: tuple[tuple[str, str], ...]

    @property
    def missed(self) -> tuple[bounds.Judged, ...]:
        """Bounds that were missed."""
        return tuple(judged for judged in self.judged if judged.mark is bounds.Mark.MISSED)

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
    statistics: dict[tuple[str, str], bounds.Statistics],
    all_bounds: Sequence[bounds.Bound] = bounds.BOUNDS,
) -> Campaign:
    """Return a campaign with its figures held against the bounds; what was not run is left out."""
    run = {scenario for scenario, _method in statistics} | {result.unit.scenario for result in results}
    own = [bound for bound in all_bounds if bound.scenario in run]
    silent = {(scenario, method): bounds.Statistics() for scenario in run for method in METHODS}
    judged = bounds.judge(own, {**silent, **statistics})
    return Campaign(plan, seconds, results, statistics, judged, bounds.idle_baselines(own, statistics, UNINFORMED))


def collect_metrics(results: Sequence[UnitResult]) -> dict[tuple[str, str], bounds.Statistics]:
    """Return the figures of every method and baseline over the seeds of each scenario.

    A method that did not answer in one of the seeds has no figures of the scenario.
    """
    statistics: dict[tuple[str, str], bounds.Statistics] = {}
    by_scenario: dict[str, list[UnitResult]] = {}
    for result in results:
        by_scenario.setdefault(result.unit.scenario, []).append(result)
    for scenario, seeds in by_scenario.items():
        statistics |= {(scenario, name): reported for name, reported in _statistics_by_answer(seeds).items()}
    for method in METHODS:
        if ("eclipse", method) in statistics:
            statistics["eclipse", method] |= night_statistics(_courses(by_scenario, "eclipse", "nominal"), method)
    return statistics


def _statistics_by_answer(seeds: Sequence[UnitResult]) -> dict[str, bounds.Statistics]:
    """Return the figures of one scenario by method or baseline."""
    methods = [method for method in (*METHODS, ORACLE) if all(method in seed.methods for seed in seeds)]
    baselines = [baseline for baseline in BASELINES if all(baseline in seed.baselines for seed in seeds)]
    reported = {
        **{method: statistics_of([seed.methods[method] for seed in seeds]) for method in methods},
        **{
            baseline: bounds.accuracy_statistics([seed.baselines[baseline] for seed in seeds]) for baseline in baselines
        },
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


def _ratio_to_oracle(own: bounds.Statistics, oracle: bounds.Statistics) -> bounds.Statistics:
    """Return rms of an answer over that of the oracle, axis by axis."""
    return {f"rms_over_oracle.{axis}": own[f"rms_deg.{axis}"] / oracle[f"rms_deg.{axis}"] for axis in bounds.AXES}


def _ratio_to_bound(own: bounds.Statistics, oracle: bounds.Statistics) -> bounds.Statistics:
    """Return the covariance bound, which the oracle's Riccati equation gives, and an answer's pooled rms over it."""
    statistics = {f"bound_deg.{axis}": oracle[f"sigma_deg.{axis}"] for axis in bounds.AXES}
    for axis in bounds.AXES:
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
