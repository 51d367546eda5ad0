"""Measures of one estimate in one world, and their statistics over the seeds of a scenario.

A figure is a number under the name that the table of bounds uses. The mean over seeds is taken where the bounds ask
for one; delays and what happens to a single rain count by their worst case, shares are pooled. What did not occur has
no figure.

Gain of a smoothed answer over the filter, on the same rows.

    ratio = sqrt(mean of the smoothed answer's squared errors / mean of the filter's), axis by axis, pooled over seeds

Beside it stand the smoothed answer's own sigma, the share of its errors beyond three sigma within ten minutes of an
event, and its largest error while no carrier is on the air, the filter's beside.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray
from service.study.estimation.bounds import AXES, Accuracy, Statistics, accuracy_statistics, measure_accuracy
from service.study.estimation.flight import episodes
from service.study.estimation.flight.drive import Driven, MethodSeries, PastSeries
from service.study.estimation.flight.world import World

#: rows of this time after the start of operation are not judged, s
SETTLING_S = 3600.0
#: errors that turn a torque the wrong way, yaw, roll, pitch, deg
WRONG_DEG = np.array([0.3, 0.15, 0.15])
#: hours of operation from which the spacecraft does other than it is told; the page of the scenarios tells the deed
WRONG_FROM_H = {
    **dict.fromkeys(
        ("corrections_flipped", "corrections_halved", "corrections_lost", "corrections_doubled"), (9.0, 30.0)
    ),
    "nominal_uncoupled": (0.0,),
}
_US_PER_S = 1_000_000


class ControlOutcome(NamedTuple):
    """Availability and errors of control that follows an estimate."""

    #: minutes in which any allowed torque would be wrong, one of roll and pitch, that of yaw
    wrong_min: float
    wrong_roll_pitch_min: float
    wrong_yaw_min: float
    #: share of the rows without rain over the receiving site in which roll and pitch may be controlled, and yaw
    available_dry: float
    yaw_available_dry: float
    #: (E,) minutes without control in each of the declared nights
    night_off_min: FloatArray


class Measures(NamedTuple):
    """One answer in one world."""

    accuracy: Accuracy
    control: ControlOutcome
    rain: episodes.RainStatistics
    faults: episodes.FaultStatistics
    #: (E, 3) deg, change of the error over each step of a transponder
    group_shift_deg: FloatArray
    dark: episodes.DarkStatistics
    #: (E,) min, and how many begin a day
    alarm_delay_min: FloatArray
    alarms_per_day: float


def judged_rows(world: World, driven: Driven) -> BoolArray:
    """Return which rows of operation are judged."""
    epochs_us = world.ground.epochs_us[driven.rows]
    settled_us = world.ground.phases["operation"].start_us + int(SETTLING_S * _US_PER_S)
    return np.asarray(epochs_us >= settled_us)


def measure_method(world: World, driven: Driven, series: MethodSeries) -> Measures:
    """Return the measures of a method of the product."""
    judged = judged_rows(world, driven)
    rows = driven.rows[judged]
    truth_deg = world.truth.attitude_deg[rows]
    epochs_us, row_min = world.ground.epochs_us[rows], world.row_period_s / 60.0
    signed_deg = series.estimate_deg[judged] - truth_deg
    error_deg = np.abs(signed_deg)
    # a comparison with NaN is false: what has no angle has no torque
    is_wrong: BoolArray = np.asarray((error_deg > WRONG_DEG) & series.is_axis_allowed[judged])
    fade_db = world.truth.downlink_fade_db[rows]
    is_wrong_row: BoolArray = np.asarray(is_wrong.any(axis=1))
    is_dark: BoolArray = np.asarray(world.truth.has_flag("off")[rows].all(axis=1))
    alarm_delays, alarms_per_day = episodes.measure_alarms(
        epochs_us,
        series.is_alarm[judged],
        world.ground.phases["operation"].start_us,
        WRONG_FROM_H.get(world.scenario, ()),
    )
    return Measures(
        measure_accuracy(series.estimate_deg[judged], series.sigma_deg[judged], truth_deg),
        _control(series, judged, is_wrong, fade_db, _nights(world, driven)[judged], row_min),
        episodes.measure_rain(epochs_us, fade_db, series.is_fade[judged], is_wrong_row, row_min),
        episodes.measure_faults(epochs_us, world.truth, rows, series.is_excluded[judged], series.is_carrier_used),
        episodes.measure_group_steps(epochs_us, world.truth.has_flag("group_step")[rows], signed_deg),
        episodes.measure_dark(epochs_us, is_dark, error_deg),
        alarm_delays,
        alarms_per_day,
    )


def _nights(world: World, driven: Driven) -> BoolArray:
    """Return which rows (T,) of operation lie in the shadow or shortly after it."""
    return np.asarray(world.truth.has_flag("eclipse")[driven.rows].any(axis=1))


def _control(
    series: MethodSeries,
    judged: BoolArray,
    is_wrong: BoolArray,
    fade_db: FloatArray,
    is_night: BoolArray,
    row_min: float,
) -> ControlOutcome:
    is_allowed, is_dry = series.is_control_allowed[judged], fade_db == 0.0
    nights = episodes.stretches(is_night)
    return ControlOutcome(
        row_min * float(np.count_nonzero(is_wrong.any(axis=1))),
        row_min * float(np.count_nonzero(is_wrong[:, 1:].any(axis=1))),
        row_min * float(np.count_nonzero(is_wrong[:, 0])),
        _share(is_allowed, is_dry),
        _share(series.is_axis_allowed[judged][:, 0], is_dry),
        np.array([row_min * np.count_nonzero(~is_allowed[first:last]) for first, last in nights]),
    )


def _share(is_so: BoolArray, among: BoolArray) -> float:
    """Return the share of some rows, NaN of none."""
    return float(is_so[among].mean()) if among.any() else float("nan")


def statistics_of(seeds: Sequence[Measures]) -> Statistics:
    """Return the figures of one method over the seeds of a scenario."""
    statistics = accuracy_statistics([seed.accuracy for seed in seeds])
    controls = [seed.control for seed in seeds]
    statistics |= {
        "wrong_min": _mean([control.wrong_min for control in controls]),
        "wrong_min.roll_pitch": _mean([control.wrong_roll_pitch_min for control in controls]),
        "wrong_min.yaw": _mean([control.wrong_yaw_min for control in controls]),
        "available_dry": _mean([control.available_dry for control in controls]),
        "yaw_available_dry": _mean([control.yaw_available_dry for control in controls]),
        "alarms_per_day": _mean([seed.alarms_per_day for seed in seeds]),
    }
    statistics |= _worst("alarm_delay_min", [seed.alarm_delay_min for seed in seeds])
    statistics |= _worst("night_off_min", [control.night_off_min for control in controls])
    shifts = np.concatenate([seed.group_shift_deg for seed in seeds])
    if len(shifts):
        statistics |= {f"group_shift_deg.{axis}": float(shifts[:, k].max()) for k, axis in enumerate(AXES)}
    return {**statistics, **_rain_statistics(seeds), **_fault_statistics(seeds), **_dark_statistics(seeds)}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _worst(name: str, seeds: Sequence[FloatArray]) -> Statistics:
    """Return the worst case of all seeds, nothing where there was none."""
    together = np.concatenate(seeds)
    return {name: float(together.max())} if len(together) else {}


def _rain_statistics(seeds: Sequence[Measures]) -> Statistics:
    """Return the figures of rain over the receiving site; the false share counts where it is dry throughout, too."""
    rains = [seed.rain for seed in seeds]
    dry = sum(rain.dry_rows for rain in rains)
    statistics = {"rain_false_share": sum(rain.false_rows for rain in rains) / dry} if dry else {}
    delay_min = np.concatenate([rain.delay_min for rain in rains])
    if len(delay_min):
        statistics |= {
            "rain_delay_median_min": float(np.median(delay_min)),
            "rain_delay_min": float(delay_min.max()),
            "rain_coverage": float(np.mean(np.concatenate([rain.coverage for rain in rains]))),
            "rain_wrong_min": float(np.concatenate([rain.wrong_min for rain in rains]).max()),
        }
    return statistics


def _fault_statistics(seeds: Sequence[Measures]) -> Statistics:
    """Return the figures of faults of single carriers."""
    faults = [seed.faults for seed in seeds]
    clean = sum(fault.clean_pairs for fault in faults)
    statistics = {"false_exclusion_share": sum(fault.false_pairs for fault in faults) / clean} if clean else {}
    delay_min = np.concatenate([fault.delay_min for fault in faults])
    if len(delay_min):
        found = delay_min <= episodes.FOUND_WITHIN_MIN
        statistics |= {
            "faults": float(len(delay_min)),
            "faults_found_share": float(found.mean()),
            "fault_delay_median_min": float(np.median(delay_min)),
        }
    return statistics


def _dark_statistics(seeds: Sequence[Measures]) -> Statistics:
    """Return the figures of times without any carrier."""
    darks = [seed.dark for seed in seeds]
    rows = sum(dark.rows for dark in darks)
    after = np.concatenate([dark.after for dark in darks])
    if not rows or not len(after):
        return {}
    rms = np.sqrt(np.sum([dark.square_sum for dark in darks], axis=0) / rows)
    by_axis = {"dark_rms_deg": rms, "after_dark_deg": after.max(axis=0)}
    return {f"{name}.{axis}": float(values[k]) for name, values in by_axis.items() for k, axis in enumerate(AXES)}


#: a row is near an event within this time, min
EVENT_MIN = 10.0
#: an error beyond so many sigma is large
LARGE_SIGMAS = 3.0


class SmoothingGain(NamedTuple):
    """Sums over the M rows that filter and smoother both answer; arrays (3,) in the order yaw, roll, pitch."""

    rows: int
    filter_square_deg2: FloatArray
    smoothed_square_deg2: FloatArray
    smoothed_variance_deg2: FloatArray
    #: rows near an event, and large errors among them
    event_rows: int
    filter_large: FloatArray
    smoothed_large: FloatArray
    #: largest error of a row without any carrier, NaN = there is none
    dark_deg: FloatArray
    filter_dark_deg: FloatArray


def measure_gain(world: World, driven: Driven, series: MethodSeries, past: PastSeries) -> SmoothingGain:
    """Return what smoothing gains in one world on the judged rows that it answers."""
    epochs_us = world.ground.epochs_us[driven.rows]
    position = np.minimum(np.searchsorted(epochs_us, past.epochs_us), len(epochs_us) - 1)
    chosen = (epochs_us[position] == past.epochs_us) & judged_rows(world, driven)[position]
    position = position[chosen]
    truth_deg = world.truth.attitude_deg[driven.rows[position]]
    filtered = series.estimate_deg[position] - truth_deg
    smoothed, sigma = past.estimate_deg[chosen] - truth_deg, past.sigma_deg[chosen]
    is_near = _near_events(world)[driven.rows[position]]
    is_dark = world.truth.has_flag("off")[driven.rows[position]].all(axis=1)
    return SmoothingGain(
        len(position),
        np.sum(filtered**2, axis=0),
        np.sum(smoothed**2, axis=0),
        np.sum(sigma**2, axis=0),
        int(is_near.sum()),
        np.count_nonzero(np.abs(filtered[is_near]) > LARGE_SIGMAS * series.sigma_deg[position][is_near], axis=0),
        np.count_nonzero(np.abs(smoothed[is_near]) > LARGE_SIGMAS * sigma[is_near], axis=0),
        _largest(smoothed[is_dark]),
        _largest(filtered[is_dark]),
    )


def _largest(errors_deg: FloatArray) -> FloatArray:
    """Return the largest error (3,) of rows (T, 3), NaN without one."""
    return np.abs(errors_deg).max(axis=0) if len(errors_deg) else np.full(3, np.nan)


def _near_events(world: World) -> BoolArray:
    """Return which rows (T,) of a world lie within ten minutes of one in which anything of a carrier changes."""
    changed = np.flatnonzero((np.diff(world.truth.flags, axis=0) != 0).any(axis=1)) + 1
    reach = max(1, round(EVENT_MIN * 60.0 / world.row_period_s))
    is_near = np.zeros(len(world.ground.epochs_us), dtype=np.bool_)
    for row in changed.tolist():
        is_near[max(0, row - reach) : row + reach + 1] = True
    return is_near


def gain_statistics(name: str, seeds: Sequence[SmoothingGain]) -> Statistics:
    """Return the figures of one smoothed answer over the seeds of a scenario, under its name."""
    rows, near = sum(seed.rows for seed in seeds), sum(seed.event_rows for seed in seeds)
    if not rows:
        return {}
    square = np.sum([seed.smoothed_square_deg2 for seed in seeds], axis=0)
    filtered = np.sum([seed.filter_square_deg2 for seed in seeds], axis=0)
    variance = np.sum([seed.smoothed_variance_deg2 for seed in seeds], axis=0)
    by_axis = {
        "rms_deg": np.sqrt(square / rows),
        "over_filter": np.sqrt(square / filtered),
        "over_sigma": np.sqrt(square / variance),
    }
    if near:
        by_axis["large_near_events"] = np.sum([seed.smoothed_large for seed in seeds], axis=0) / near
        by_axis["filter_large_near_events"] = np.sum([seed.filter_large for seed in seeds], axis=0) / near
    for kind in ("dark_deg", "filter_dark_deg"):
        dark = np.array([getattr(seed, kind) for seed in seeds])
        if np.isfinite(dark).any():
            by_axis[kind] = np.nanmax(dark, axis=0)
    return {f"{name}.{kind}.{axis}": float(of[k]) for kind, of in by_axis.items() for k, axis in enumerate(AXES)}
