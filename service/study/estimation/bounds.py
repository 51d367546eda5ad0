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


METHOD, ASKED, PROTOTYPE = "goals of the method", "asked of this version", "study prototype"
_AXES = ("yaw", "roll", "pitch")
_MISMATCHES = (
    "nominal_tau5",
    "nominal_tau120",
    "nominal_drift3",
    "nominal_uncoupled",
    "nominal_10s",
    "nominal_300s",
)
_FALSE_REPORTS = ("corrections_flipped", "corrections_halved", "corrections_lost", "corrections_doubled")
_FAST_RAINS = ("downlink_rain", "downlink_rain_0p3", "downlink_rain_1", "downlink_rain_3")
#: what a trial reached: rms yaw, roll, pitch
_PROTOTYPE_RMS = {
    "white": (0.068, 0.013, 0.013),
    "few8": (0.128, 0.024, 0.029),
    "many32": (0.095, 0.013, 0.020),
    "steps": (0.129, 0.029, 0.023),
    "steps_heavy": (0.18, 0.038, 0.073),
    "uplink_rain": (0.094, 0.019, 0.022),
    "downlink_rain": (0.098, 0.017, 0.021),
    "downlink_slow": (0.093, 0.017, 0.026),
    "downlink_slew": (0.109, 0.020, 0.027),
    "dual_band": (0.099, 0.019, 0.024),
    "transponder": (0.114, 0.024, 0.031),
    "drift": (0.088, 0.029, 0.038),
    "gaps": (0.160, 0.031, 0.047),
    "interference": (0.131, 0.018, 0.033),
    "mixed32": (0.150, 0.025, 0.029),
}


def _angles(
    scenario: str,
    figure: str,
    must: Sequence[Limit | float | None],
    goal: Sequence[Limit | float | None] = (None, None, None),
    *,
    source: str = METHOD,
    is_goal_asked: bool = False,
) -> list[Bound]:
    """Return the bounds of a figure of each axis; numbers are limits from above, None sets none."""
    limits = [(_limit(low), _limit(high)) for low, high in zip(must, goal, strict=True)]
    return [
        Bound(scenario, f"{figure}.{axis}", needed, wanted, source, is_goal_asked=is_goal_asked and wanted is not None)
        for axis, (needed, wanted) in zip(_AXES, limits, strict=True)
        if needed is not None or wanted is not None
    ]


def _limit(value: Limit | float | None) -> Limit | None:
    """Return a limit; a number is one from above."""
    return at_most(value) if isinstance(value, int | float) else value


def _skills(values: Sequence[float]) -> list[Limit]:
    return [at_least(value) for value in values]


def _skill() -> list[Bound]:
    """Return the bounds of skill and slope where the spacecraft moves; where it is quiet both say nothing."""
    return [
        *_angles("octants", "skill", _skills((0.70, 0.97, 0.97)), _skills((0.85, 0.99, 0.99)), is_goal_asked=True),
        *_angles("octants", "slope", [within(1.0, 0.15)] * 3, [within(1.0, 0.05)] * 3),
        *_angles("yaw_hold", "skill", _skills((0.50, 0.85, 0.70)), _skills((0.75, 0.95, 0.90)), is_goal_asked=True),
        Bound("octants", "rms_deg.roll", at_most(0.08), None, METHOD, "paper"),
        Bound("octants", "rms_deg.pitch", at_most(0.10), None, METHOD, "paper"),
    ]


def _accuracy() -> list[Bound]:
    bounds = [
        *_angles("nominal", "rms_deg", (0.13, 0.025, 0.030), (0.085, 0.015, 0.018), is_goal_asked=True),
        *_angles("nominal", "p95_deg", (0.27, 0.05, 0.06), (0.18, 0.03, 0.04)),
        *_angles("mixed", "rms_deg", (0.20, 0.06, 0.08), (0.11, 0.03, 0.035), is_goal_asked=True),
        *_angles("flicker", "rms_deg", (0.17, 0.045, 0.075), source=ASKED),
        *_angles("stale_calibration", "rms_deg", (None, 0.04, 0.05), source=ASKED),
    ]
    for scenario in ("long14", "maneuver", "octants", "init_bias"):
        bounds += _angles(scenario, "rms_deg", (None, 0.035, 0.045), (None, 0.020, 0.025))
    for scenario in _MISMATCHES:
        bounds += _angles(scenario, "rms_deg", (None, 0.035, 0.045), source=ASKED)
        bounds += _angles(scenario, "rms_over_sigma", (1.5, 1.5, 1.5), source=ASKED)
    for scenario in _FALSE_REPORTS:
        bounds += _angles(scenario, "max_deg", (None, 0.10, 0.10), source=ASKED)
    for scenario, limits in _PROTOTYPE_RMS.items():
        bounds += _angles(scenario, "rms_deg", (None, None, None), limits, source=PROTOTYPE)
    honest = {"white": Limit(0.8, 1.2), "nominal": Limit(0.7, 1.4), "flicker": Limit(0.7, 1.4)}
    for scenario, limit in honest.items():
        bounds += _angles(scenario, "rms_over_sigma", [limit] * 3, source=ASKED)
    return bounds


def _control() -> list[Bound]:
    """Return the bounds of wrong torque, availability and alarms; minutes are means of the seeds."""
    none = at_most(0.0)
    return [
        Bound("nominal", "available_dry", at_least(0.99), at_least(0.999), METHOD),
        Bound("mixed", "available_dry", at_least(0.93), at_least(0.98), METHOD),
        Bound("flicker", "available_dry", at_least(0.85), None, ASKED),
        Bound("mixed", "wrong_min", at_most(60.0), none, METHOD, is_goal_asked=True),
        Bound("steps_heavy", "wrong_min", at_most(60.0), none, ASKED),
        Bound("flicker", "wrong_min", at_most(10.0), none, ASKED),
        Bound("flicker_storm", "wrong_min", at_most(30.0), none, ASKED),
        *(Bound(scenario, "wrong_min", none, None, ASKED) for scenario in _FALSE_REPORTS),
        *(Bound(scenario, "alarm_delay_min", at_most(30.0), None, ASKED) for scenario in _FALSE_REPORTS),
        Bound("nominal_uncoupled", "alarm_delay_min", at_most(720.0), None, ASKED),
        Bound("eclipse", "night_off_min", at_most(30.0), None, ASKED),
        *_angles("blackout", "dark_rms_deg", (0.25, 0.04, 0.10), source=ASKED),
        *_angles("blackout", "after_dark_deg", (None, 0.05, 0.05), source=ASKED),
        *_angles("eclipse", "shift_deg", (0.05, 0.02, 0.03), source=ASKED),
        *_angles("eclipse", "left_deg", (0.05, 0.02, 0.03), (0.02, 0.005, 0.005), source=ASKED),
    ]


def _faults() -> list[Bound]:
    """Return the bounds of rain and of carriers' faults."""
    bounds = [
        Bound("nominal", "rain_false_share", at_most(1e-3), at_most(1e-4), METHOD),
        Bound("octants", "rain_false_share", at_most(0.0), None, METHOD),
        Bound("mixed", "faults_found_share", at_least(0.90), at_least(0.96), ASKED, is_goal_asked=True),
        Bound("downlink_rain_0p05", "rain_delay_min", None, at_most(1.0), PROTOTYPE),
        Bound("downlink_rain_0p05", "rain_coverage", None, at_least(0.99), PROTOTYPE),
        Bound("downlink_rain_0p02", "rain_delay_min", None, at_most(0.0), PROTOTYPE),
        Bound("downlink_rain_0p02", "rain_coverage", None, at_least(0.91), PROTOTYPE),
    ]
    for scenario in _FAST_RAINS:
        bounds += [
            Bound(scenario, "rain_delay_min", at_most(3.0), at_most(1.0), METHOD, is_goal_asked=True),
            Bound(scenario, "rain_coverage", at_least(0.95), at_least(0.99), METHOD),
            Bound(scenario, "rain_wrong_min", at_most(2.0), at_most(0.0), METHOD, is_goal_asked=True),
        ]
    for scenario in ("steps", "uplink_rain", "steps_heavy", "mixed32"):
        bounds.append(Bound(scenario, "faults_found_share", at_least(0.90), at_least(0.98), METHOD))
    for scenario in ("steps", "uplink_rain", "steps_heavy", "mixed", "mixed32"):
        bounds.append(Bound(scenario, "fault_delay_median_min", at_most(6.0), at_most(3.0), METHOD))
        bounds.append(Bound(scenario, "false_exclusion_share", at_most(0.01), at_most(0.003), METHOD))
    bounds += _angles("transponder", "group_shift_deg", (None, 0.05, 0.05), source=ASKED)
    bounds.append(Bound("transponder", "false_exclusion_share", at_most(0.01), at_most(0.003), METHOD))
    bounds.append(Bound("nominal", "false_exclusion_share", at_most(0.01), at_most(0.003), METHOD))
    return bounds


def _snapshot() -> list[Bound]:
    """Return the bounds of the fix of one epoch alone, and of the level that is expected of a carrier."""
    return [
        *_angles("snapshot", "over_bound_true", (1.05,) * 3, (1.02,) * 3, is_goal_asked=True),
        *_angles("snapshot", "over_bound_fitted", (1.25,) * 3, (1.10,) * 3),
        Bound("snapshot", "yaw_scale", within(1.0, 0.10), within(1.0, 0.03), METHOD, is_goal_asked=True),
        Bound("snapshot", "breakdown", at_least(5.0), at_least(6.0), METHOD, is_goal_asked=True),
        Bound("snapshot", "level_day1_db", at_most(0.05), at_most(0.02), METHOD),
        Bound("snapshot", "level_day7_db", at_most(0.12), at_most(0.05), METHOD),
        Bound("snapshot", "false_exclusion_share", at_most(0.01), at_most(0.003), METHOD),
    ]


#: in the weather of real links: wrong torque, minutes in two days; rms over sigma of roll and pitch, must and goal;
#: share of dry rows with control; rms yaw, roll, pitch, must and goal
_WEATHER: dict[str, tuple[float, tuple[float, float], tuple[float, float] | None, tuple[tuple[float, ...], ...]]] = {
    "weather_far": (40.0, (1.3, 1.1), (0.93, 0.97), ((0.115, 0.050, 0.058), (0.10, 0.035, 0.045))),
    "weather_near": (60.0, (1.5, 1.5), (0.75, 0.75), ((0.13, 0.07, 0.07), (0.13, 0.07, 0.07))),
    "weather_turns": (40.0, (1.4, 1.4), None, ()),
    "weather_alignment": (40.0, (1.4, 1.4), None, ()),
    "flicker_hard": (10.0, (1.3, 1.3), None, ()),
}
_ORDINARY = ("nominal", "mixed", "steps_heavy", "octants", "downlink_rain", "yaw_hold")


def _integrity() -> list[Bound]:
    """Return the bounds of being confident and wrong, over all rows of operation."""
    bounds = []
    for scenario, (wrong_min, ratio, dry, rms) in _WEATHER.items():
        bounds.append(Bound(scenario, "yardstick.wrong_min", at_most(wrong_min), at_most(0.0), ASKED))
        bounds += _misleading(scenario, 1e-3, 2.0)
        for axis in _AXES[1:]:
            must, goal = at_most(ratio[0]), at_most(ratio[1])
            bounds.append(Bound(scenario, f"yardstick.rms_over_sigma.{axis}", must, goal, ASKED))
        if dry is not None:
            bounds.append(Bound(scenario, "yardstick.allowed_dry", at_least(dry[0]), at_least(dry[1]), ASKED))
        if rms:
            bounds += _angles(scenario, "yardstick.rms_deg", *rms, source=ASKED)
    for scenario in _ORDINARY:
        bounds.append(Bound(scenario, "yardstick.wrong_min", at_most(0.0), None, ASKED))
        bounds += _misleading(scenario, 0.0, 0.0)
        bounds += _angles(scenario, "rms_over_oracle", (1.12, 1.10, 1.10), source=ASKED)
    bounds += _angles("nominal", "yardstick.level_deg", (None, 0.12, 0.15), (None, 0.10, 0.12), source=ASKED)
    return bounds


def _misleading(scenario: str, share: float, episodes: float) -> list[Bound]:
    """Return the bounds of rows whose error passes the protection level; every level must be there nearly always."""
    return [
        Bound(scenario, "yardstick.misleading_share", at_most(share), at_most(0.0), ASKED),
        Bound(scenario, "yardstick.episodes", at_most(episodes), at_most(0.0), ASKED),
        Bound(scenario, "yardstick.without_share", at_most(0.05), None, ASKED),
    ]


def _smoothed() -> list[Bound]:
    """Return the bounds of smoothed angles over the filter's on the same rows."""
    bounds = [
        *_angles("nominal", "smoothed.over_filter", (0.88, 0.75, 0.78), source=ASKED),
        *_angles("nominal", "smoothed_2h.over_filter", (0.92, 0.78, 0.85), source=ASKED),
        *_angles("blackout", "smoothed.dark_deg", (0.25, 0.05, 0.06), source=ASKED),
    ]
    for scenario in ("mixed", "steps", "uplink_rain", "transponder"):
        bounds += _angles(scenario, "smoothed.over_filter", (0.95, 0.95, 0.95), source=ASKED)
    return bounds


BOUNDS: tuple[Bound, ...] = tuple(
    _skill() + _accuracy() + _control() + _faults() + _snapshot() + _integrity() + _smoothed()
)
