"""Yardstick of integrity: is an answer ever confident and wrong, and what does it pay for never being so.

    wrong torque   minutes with control allowed while roll or pitch is wrong by more than 0.15 deg
    misleading     rows with |error| > protection level in an axis; rows closer than six hours are one episode
    dry            rows in which fewer than two stations lose more than 0.3 dB, in the truth

Every row of operation counts, the first hour too. Means and worst seeds are those of the seeds' own figures. Beside the
answer of a method stand the trivial ones: its angles with control never and always allowed, and with three of its sigma
as protection level; a yardstick that one of them passes measures nothing.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.estimation.bounds import AXES, Statistics
from service.study.estimation.flight.drive import Driven, MethodSeries
from service.study.estimation.flight.world import Truth, World

#: error of roll or pitch from which a torque is wrong, deg
WRONG_DEG = 0.15
#: loss from which a station counts as wet, dB, and the number of wet stations from which a row is not dry
WET_DB, WET_STATIONS = 0.3, 2
#: misleading rows closer than this are one episode, h
EPISODE_H = 6.0
#: sigmas of the trivial protection level
TRIVIAL_SIGMAS = 3.0
_ROLL_PITCH = slice(1, 3)
_US_PER_H = 3.6e9


class Protection(NamedTuple):
    """Protection levels of one answer in one world."""

    #: share of all rows that mislead, and their episodes
    misleading_share: float
    episodes: int
    #: share of the rows without a level of roll or of pitch
    without_share: float
    #: (2,) deg, median of the level of roll and of pitch in dry rows
    median_dry_deg: FloatArray


class Yardstick(NamedTuple):
    """One answer in one world; arrays (3,) in the order yaw, roll, pitch."""

    wrong_min: float
    rms_deg: FloatArray
    rms_over_sigma: FloatArray
    #: share of the dry rows with control allowed
    allowed_dry: float
    #: None = the answer states no level
    protection: Protection | None


def measure_yardsticks(world: World, driven: Driven, method: str) -> dict[str, Yardstick]:
    """Return the yardsticks of a method and of the trivial answers made of it, by name of the answer."""
    series = driven.methods.get(method)
    if series is None:
        return {}
    nowhere, everywhere = np.zeros_like(series.is_control_allowed), np.ones_like(series.is_control_allowed)
    answers = {
        method: series,
        "never allow": replace(series, is_control_allowed=nowhere),
        "always allow": replace(series, is_control_allowed=everywhere),
        "three sigma": replace(series, protection_deg=TRIVIAL_SIGMAS * series.sigma_deg),
    }
    return {name: measure_yardstick(world, driven, answer) for name, answer in answers.items()}


def measure_yardstick(world: World, driven: Driven, series: MethodSeries) -> Yardstick:
    """Return the yardstick of one answer."""
    error_deg = series.estimate_deg - world.truth.attitude_deg[driven.rows]
    # a comparison with NaN is false: what has no angle has no torque
    is_wrong = (np.abs(error_deg[:, _ROLL_PITCH]) > WRONG_DEG).any(axis=1) & series.is_control_allowed
    is_answered = np.isfinite(error_deg).all(axis=1)
    if not is_answered.any():
        square = variance = np.full(3, np.nan)
    else:
        square = np.mean(error_deg[is_answered] ** 2, axis=0)
        variance = np.mean(series.sigma_deg[is_answered] ** 2, axis=0)
    is_dry = dry_rows(world.truth)[driven.rows]
    return Yardstick(
        world.row_period_s / 60.0 * float(np.count_nonzero(is_wrong)),
        np.sqrt(square),
        np.sqrt(square / variance),
        float(series.is_control_allowed[is_dry].mean()) if is_dry.any() else float("nan"),
        _protection(world.ground.epochs_us[driven.rows], error_deg, series.protection_deg, is_dry),
    )


def dry_rows(truth: Truth) -> BoolArray:
    """Return in which rows (T,) fewer than two stations lose more than 0.3 dB; rain over the site takes them all."""
    names = np.array(truth.stations)
    wet = [truth.station_loss_db[:, names == name].max(axis=1) > WET_DB for name in np.unique(names)]
    return np.asarray((np.sum(wet, axis=0) < WET_STATIONS) & (truth.downlink_fade_db <= WET_DB))


def _protection(
    epochs_us: IntArray, error_deg: FloatArray, level_deg: FloatArray | None, is_dry: BoolArray
) -> Protection | None:
    """Return what the levels (T, 3) of an answer are worth; a row without a level misleads nobody."""
    if level_deg is None:
        return None
    is_misleading = (np.abs(error_deg) > level_deg).any(axis=1)
    is_without = ~np.isfinite(level_deg[:, _ROLL_PITCH]).all(axis=1)
    hours = epochs_us[is_misleading] / _US_PER_H
    nominal_deg = level_deg[is_dry & ~is_without, _ROLL_PITCH]
    return Protection(
        float(is_misleading.mean()),
        int(len(hours) > 0) + int(np.count_nonzero(np.diff(hours) > EPISODE_H)),
        float(is_without.mean()),
        np.median(nominal_deg, axis=0) if len(nominal_deg) else np.full(2, np.nan),
    )


def yardstick_statistics(seeds: Mapping[int, Yardstick]) -> Statistics:
    """Return the figures of one answer over the seeds of a scenario, keyed by seed: means, the worst and its seed."""
    statistics = _over_seeds("wrong_min", {seed: one.wrong_min for seed, one in seeds.items()}, max)
    statistics |= _over_seeds("allowed_dry", {seed: one.allowed_dry for seed, one in seeds.items()}, min)
    for k, axis in enumerate(AXES):
        for name in ("rms_deg", "rms_over_sigma"):
            by_seed = {seed: float(getattr(one, name)[k]) for seed, one in seeds.items()}
            statistics |= _over_seeds(f"{name}.{axis}", by_seed, max)
    levels = {seed: one.protection for seed, one in seeds.items() if one.protection is not None}
    if levels:
        statistics |= _over_seeds("misleading_share", {k: one.misleading_share for k, one in levels.items()}, max)
        statistics |= _over_seeds("without_share", {k: one.without_share for k, one in levels.items()}, max)
        statistics["yardstick.episodes"] = float(sum(one.episodes for one in levels.values()))
        medians = np.mean([one.median_dry_deg for one in levels.values()], axis=0)
        statistics |= {f"yardstick.level_deg.{axis}": float(medians[k]) for k, axis in enumerate(AXES[_ROLL_PITCH])}
    return statistics


def _over_seeds(name: str, by_seed: Mapping[int, float], worst: Callable[[Iterable[float]], float]) -> Statistics:
    """Return the mean, the worst and its seed of one figure over the seeds that have it."""
    present = {seed: value for seed, value in by_seed.items() if not math.isnan(value)}
    if not present:
        return {}
    extreme = worst(present.values())
    return {
        f"yardstick.{name}": float(np.mean(list(present.values()))),
        f"yardstick.{name}.worst": extreme,
        f"yardstick.{name}.worst_seed": float(next(seed for seed, value in present.items() if value == extreme)),
    }
