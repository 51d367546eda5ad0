"""Accuracy of a method in one scenario, and the bounds that it is held against."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray

AXES = ("yaw", "roll", "pitch")
#: silence must not buy accuracy
MIN_ANSWERED = 0.9

#: figures by name, ``quantity.axis`` where there is one for each axis
Statistics = dict[str, float]


class Accuracy(NamedTuple):
    """Sums of one answer in one world; arrays (3,) in the order yaw, roll, pitch, deg and deg^2."""

    #: share of the rows that have an answer
    answered: float
    mean_square_error: FloatArray
    mean_square_truth: FloatArray
    #: of the answer's own sigma; NaN where it states none
    mean_square_sigma: FloatArray
    #: of answer and truth about their means, and of the truth
    covariance: FloatArray
    variance: FloatArray
    #: 95 % of the errors are smaller, all of them are
    error_95: FloatArray
    greatest: FloatArray


def measure_accuracy(estimate_deg: FloatArray, sigma_deg: FloatArray, truth_deg: FloatArray) -> Accuracy:
    """Return what the rows (T, 3) of an answer amount to.

    Examples
    --------
    >>> truth = np.array([[0.1, 0.2, 0.3], [-0.1, -0.2, -0.3]])
    >>> measure_accuracy(0.5 * truth, np.full((2, 3), np.nan), truth).mean_square_error.round(6)
    array([0.0025, 0.01  , 0.0225])
    """
    present: BoolArray = np.asarray(np.isfinite(estimate_deg).all(axis=1))
    answered = float(present.mean()) if len(present) else 0.0
    if answered < MIN_ANSWERED:
        nothing = np.full(3, np.nan)
        return Accuracy(answered, *(nothing,) * 7)
    estimate, truth, sigma = estimate_deg[present], truth_deg[present], sigma_deg[present]
    error, centred = np.abs(estimate - truth), truth - truth.mean(axis=0)
    return Accuracy(
        answered,
        np.mean(error**2, axis=0),
        np.mean(truth**2, axis=0),
        np.mean(sigma**2, axis=0),
        np.mean(centred * estimate, axis=0),
        np.mean(centred**2, axis=0),
        np.quantile(error, 0.95, axis=0),
        np.max(error, axis=0),
    )


def accuracy_statistics(seeds: Sequence[Accuracy]) -> Statistics:
    """Return the figures of one answer over the seeds of a scenario; NaN where any seed has none."""
    square = np.mean([seed.mean_square_error for seed in seeds], axis=0)
    truth = np.mean([seed.mean_square_truth for seed in seeds], axis=0)
    sigma = np.mean([seed.mean_square_sigma for seed in seeds], axis=0)
    covariance = np.mean([seed.covariance for seed in seeds], axis=0)
    variance = np.mean([seed.variance for seed in seeds], axis=0)
    # a truth that never moves has neither skill nor slope
    with np.errstate(divide="ignore", invalid="ignore"):
        by_axis = {
            "rms_deg": np.mean([np.sqrt(seed.mean_square_error) for seed in seeds], axis=0),
            "p95_deg": np.mean([seed.error_95 for seed in seeds], axis=0),
            "max_deg": np.max([seed.greatest for seed in seeds], axis=0),
            "truth_rms_deg": np.mean([np.sqrt(seed.mean_square_truth) for seed in seeds], axis=0),
            "skill": 1.0 - square / truth,
            "slope": covariance / variance,
            "rms_over_sigma": np.sqrt(square / sigma),
            "sigma_deg": np.sqrt(sigma),
        }
    statistics = {f"{name}.{axis}": float(values[k]) for name, values in by_axis.items() for k, axis in enumerate(AXES)}
    return {**statistics, "answered": float(np.mean([seed.answered for seed in seeds]))}


#: figures of an answer's errors: those that an answer without any powers can be held to as well
_ACCURACY = ("rms_deg", "p95_deg", "max_deg", "skill", "slope")


class Mark(StrEnum):
    """Mark of a figure against its bounds."""

    GOAL = "goal"
    MUST = "must"
    #: only a goal was set, and it was not reached
    SHORT = "short"
    MISSED = "missed"
    OPEN = "not judged"


class Limit(NamedTuple):
    """Interval in which a figure must lie, both ends inclusive."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Return whether a figure lies inside; NaN never does."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        """Return the interval as a reader would write it."""
        if self.low == -math.inf:
            return f"<= {self.high:g}"
        return f">= {self.low:g}" if self.high == math.inf else f"{self.low:g}..{self.high:g}"


def at_most(high: float) -> Limit:
    """Return the limit from above."""
    return Limit(-math.inf, high)


def at_least(low: float) -> Limit:
    """Return the limit from below."""
    return Limit(low, math.inf)


def within(centre: float, reach: float) -> Limit:
    """Return the limit to both sides."""
    return Limit(round(centre - reach, 9), round(centre + reach, 9))


@dataclass(frozen=True, slots=True)
class Bound:
    """Bound of one figure: must and goal."""

    scenario: str
    figure: str
    must: Limit | None
    goal: Limit | None
    #: who set it
    source: str
    method: str = "robust"
    #: whether this version was asked to reach the goal
    is_goal_asked: bool = False

    def mark(self, value: float | None) -> Mark:
        """Return what a value earns; None = not measured."""
        if value is None:
            return Mark.OPEN
        if self.must is not None and not self.must.holds(value):
            return Mark.MISSED
        if self.goal is not None and self.goal.holds(value):
            return Mark.GOAL
        return Mark.SHORT if self.must is None else Mark.MUST

    @property
    def is_of_accuracy(self) -> bool:
        """Return whether an answer without powers can be held to it."""
        return self.figure.partition(".")[0] in _ACCURACY


class Judged(NamedTuple):
    """A bound with the value that was measured."""

    bound: Bound
    #: None = not measured
    value: float | None
    mark: Mark


#: figures by scenario and method or baseline
StatisticsOf = Mapping[tuple[str, str], Statistics]


#: figures of what an operation phase that is cut short may not hold, or that need another scenario beside their own
OPTIONAL_STATISTICS = (
    "shift_deg",
    "left_deg",
    "alarm_delay",
    "rain_delay",
    "rain_coverage",
    "rain_wrong",
    "night_off",
    "faults_found",
    "fault_delay",
    "group_shift",
    "dark_rms",
    "after_dark",
    "yardstick",
    "rms_over_oracle",
    "rms_over_bound",
    "smoothed",
)


def judge(bounds: Iterable[Bound], statistics: StatisticsOf) -> tuple[Judged, ...]:
    """Return every bound with its value and mark, in the order of the bounds.

    A scenario that was run and lacks a figure that is bounded has missed it: a method that did not answer, a rain that
    did not come.
    """
    run = {scenario for scenario, _method in statistics}
    judged = []
    for bound in bounds:
        value = statistics.get((bound.scenario, bound.method), {}).get(bound.figure)
        if value is None and bound.scenario in run and not bound.figure.startswith(OPTIONAL_STATISTICS):
            value = math.nan
        judged.append(Judged(bound, value, bound.mark(value)))
    return tuple(judged)


def idle_baselines(
    bounds: Sequence[Bound], statistics: StatisticsOf, baselines: Iterable[str]
) -> tuple[tuple[str, str], ...]:
    """Return scenario and baseline wherever an answer without powers keeps every bound of accuracy.

    There the bounds prove nothing about an estimator. Where this version was asked for a goal, the goal counts.
    """
    needed: dict[str, list[Bound]] = {}
    for bound in bounds:
        if bound.is_of_accuracy and bound.must is not None and bound.method == "robust":
            needed.setdefault(bound.scenario, []).append(bound)
    return tuple(
        (scenario, baseline)
        for scenario, own in needed.items()
        for baseline in baselines
        if (scenario, baseline) in statistics
        and all(_keeps(bound, statistics[scenario, baseline].get(bound.figure)) for bound in own)
    )


def _keeps(bound: Bound, value: float | None) -> bool:
    """Return whether a value keeps what a bound demands: the goal where this version was asked for it."""
    demanded = bound.goal if bound.is_goal_asked else bound.must
    return value is not None and (demanded is None or demanded.holds(value))
