"""Bounds of figures and the marks that they earn.

A bound names a scenario, a method and a figure, what it must reach to be accepted and what is the ambitious goal. A
figure that is not a number misses; one that was not measured, because its scenario was not run, is not judged.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from service.study.estimation.accuracy import Statistics

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
