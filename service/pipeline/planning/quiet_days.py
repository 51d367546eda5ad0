"""Quiet days before a calibration: daily change and scatter of each carrier, hours that look like turns, calm hours.

The law of this file: powers and the orbit only; beams enter where turns are suspected, and nowhere else.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.noise import allan_deviation_db
from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.pipeline.calibration.geometry_rows import phase_rad, unturned_sides
from service.pipeline.calibration.minute_rows import MinuteRows
from service.pipeline.calibration.window_harmonics import CarrierHarmonic, robust_harmonics
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.catalogue_checks import SIDEREAL_DAY_S
from service.records.calibration import Window
from service.records.catalogue import CarrierPlan, Ephemeris, Spacecraft
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

_MINUTE_US, _HOUR_US, _DAY_US = 60 * US_PER_S, 3600 * US_PER_S, 86_400 * US_PER_S
#: means in which a turn is looked for, and pauses at zero that do not end one
_TURN_BIN_US, _PAUSE_US = 5 * _MINUTE_US, 3 * _HOUR_US
#: a mean beyond so many usual deviations begins a turn; its edges lie where the deviation is usual again
_FAR, _USUAL = 6.0, 3.0
#: before and after a turn: the slew that begins and ends it
_MARGIN_US = 10 * _MINUTE_US
#: quiet days before the turns: fewest and most
_SHORTEST_QUIET_US, _LONGEST_QUIET_US = _DAY_US, 7 * _DAY_US
_SIDES = ("+yaw", "-yaw", "+roll", "-roll", "+pitch", "-pitch")
_ALIGNMENT_US, _MIN_ALIGNMENT_ROWS = _HOUR_US, 10


class FlownWindows(NamedTuple):
    """Windows that readings show; None where they show none, with the reason."""

    quiet: Window | None
    turns: Window | None
    align: Window | None
    shortcomings: tuple[str, ...]


def flown_windows(epochs_us: IntArray, angles_deg: FloatArray, config: CalibrationConfig) -> FlownWindows:
    """Return the last turns about all axes, the quiet days before them and the hour after them.

    Parameters
    ----------
    epochs_us : ndarray of int, shape (T,), microseconds UTC
        Ascending.
    angles_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch; NaN = absent.
    config : CalibrationConfig
        The least angle of a turn.
    """
    is_whole = np.isfinite(angles_deg).all(axis=1)
    epochs_us, angles_deg = epochs_us[is_whole], angles_deg[is_whole]
    if not len(epochs_us) or epochs_us[-1] - epochs_us[0] < _SHORTEST_QUIET_US:
        return FlownWindows(None, None, None, ("less than a day of readings: three quiet days and turns are wanted",))
    motions = _motions(epochs_us, angles_deg, config.min_turn_deg)
    missing = list(_SIDES)
    for number in range(len(motions) - 1, -1, -1):
        window = motions[number]
        sides = unturned_sides(_within(epochs_us, angles_deg, window), config)
        if not sides:
            begin_us = motions[number - 1].stop_us if number else int(epochs_us[0])
            return _around(epochs_us, window, begin_us)
        missing = min(missing, sides, key=len)
    shown = f"; those that come nearest lack {', '.join(missing)}" if motions else ""
    return FlownWindows(None, None, None, (f"no turns about all three axes to both sides{shown}",))


def _motions(epochs_us: IntArray, angles_deg: FloatArray, min_turn_deg: float) -> list[Window]:
    """Return the stretches in which the angles leave what is usual, pauses included."""
    bins, first = np.unique(epochs_us // _TURN_BIN_US, return_index=True)
    mean_deg = np.array([chunk.mean(axis=0) for chunk in np.split(angles_deg, first[1:])])
    departure_deg = np.abs(mean_deg - np.median(mean_deg, axis=0))
    usual_deg = 1.4826 * np.median(departure_deg, axis=0)
    is_far: BoolArray = np.any(departure_deg > np.maximum(_FAR * usual_deg, min_turn_deg), axis=1)
    is_moved: BoolArray = np.any(departure_deg > np.maximum(_USUAL * usual_deg, 0.5 * min_turn_deg), axis=1)
    found = np.flatnonzero(is_far)
    if not found.size:
        return []
    groups = np.split(found, 1 + np.flatnonzero(np.diff(bins[found]) * _TURN_BIN_US > _PAUSE_US))
    edges = [(_edge(is_moved, int(group[0]), -1), _edge(is_moved, int(group[-1]), 1)) for group in groups]
    return [
        Window(int(bins[low]) * _TURN_BIN_US - _MARGIN_US, (int(bins[high]) + 1) * _TURN_BIN_US + _MARGIN_US)
        for low, high in edges
    ]


def _edge(is_moved: BoolArray, position: int, step: int) -> int:
    """Return the last position in one direction that is still moved."""
    while 0 <= position + step < len(is_moved) and is_moved[position + step]:
        position += step
    return position


def _around(epochs_us: IntArray, turns: Window, begin_us: int) -> FlownWindows:
    shortcomings = []
    quiet: Window | None = Window(max(begin_us, turns.start_us - _LONGEST_QUIET_US), turns.start_us)
    if turns.start_us - begin_us < _SHORTEST_QUIET_US:
        quiet = None
        shortcomings.append("less than a day of readings without motion before the turns; three are wanted")
    align: Window | None = Window(turns.stop_us, turns.stop_us + _ALIGNMENT_US)
    is_inside = (epochs_us >= turns.stop_us) & (epochs_us < turns.stop_us + _ALIGNMENT_US)
    if np.count_nonzero(is_inside) < _MIN_ALIGNMENT_ROWS:
        align = None
        shortcomings.append(
            f"no readings in the hour after the turns, from {format_epoch(turns.stop_us)}: no alignment"
        )
    return FlownWindows(quiet, turns, align, tuple(shortcomings))


def _within(epochs_us: IntArray, angles_deg: FloatArray, window: Window) -> FloatArray:
    inside: FloatArray = angles_deg[(epochs_us >= window.start_us) & (epochs_us < window.stop_us)]
    return inside


#: averaging times of the Allan deviation, s
ALLAN_SPANS_S = (60.0, 300.0, 900.0, 3600.0, 10_800.0, 43_200.0)
#: means in which a turn is looked for, least of them in a row, and pauses that do not end one
_BIN_US, _MIN_BINS, _PAUSE_BINS = 600 * US_PER_S, 2, 9
#: a mean is like a turn beyond this angle, deg, when the beams explain this share of what changed, by so many carriers
_TURN_DEG, _EXPLAINED, _MIN_SEEN = 0.1, 0.8, 6
_STEP_US = 3600 * US_PER_S
#: scatter beyond which a sample counts no more, in squares of the usual one
_GREATEST = 25.0


@dataclass(frozen=True)
class QuietDays:
    """Powers of days without turns and what is known of spacecraft, carriers and orbit."""

    spacecraft: Spacecraft
    plan: CarrierPlan
    ephemeris: Ephemeris
    #: columns in the order of the plan
    rows: MinuteRows


class SuspectedTurn(NamedTuple):
    """Hours in which the powers of the quiet days move as by a turn."""

    window: Window
    #: largest angle of roll or pitch, deg
    reach_deg: float


@dataclass(frozen=True)
class QuietLevels:
    """Levels of N carriers over T rows of quiet days."""

    harmonics: tuple[CarrierHarmonic, ...]
    #: (T, N) dB, level and daily change removed
    residual_db: FloatArray
    #: (S, N) dB over ALLAN_SPANS_S
    allan_db: FloatArray


def sidereal_orbit(start_us: int, stop_us: int) -> Ephemeris:
    """Return an orbit without a track: nodes of any phase a sidereal day apart, which two harmonics can follow."""
    period_us = round(SIDEREAL_DAY_S * US_PER_S)
    nodes_us = tuple(range(start_us - period_us, stop_us + period_us, period_us))
    return Ephemeris(0, nodes_us, SIDEREAL_DAY_S, nodes_us[0], nodes_us[-1], "nodes")


def quiet_levels(days: QuietDays) -> QuietLevels:
    """Return daily change, residual and Allan deviation of every carrier."""
    series, ephemeris = days.rows.series, days.ephemeris
    stop_us = int(series.epochs_us[-1]) + 1
    fits = robust_harmonics(series, ephemeris, stop_us, days.plan.carriers, days.spacecraft.longitude_deg)
    phase = phase_rad(ephemeris, series.epochs_us)
    first, second = (
        evaluate_harmonic(turns * phase, np.array(amplitude_db), np.array(at_rad))
        for turns, amplitude_db, at_rad in (
            (1.0, [fit.harmonic.amplitude_db for fit in fits], [fit.harmonic.phase_rad for fit in fits]),
            (2.0, [fit.second_amplitude_db for fit in fits], [fit.second_phase_rad for fit in fits]),
        )
    )
    level_dbm = np.array([fit.harmonic.offset_dbm for fit in fits])
    residual_db = series.power_dbm - level_dbm - first - np.nan_to_num(second)
    epoch_s = (series.epochs_us - series.epochs_us[0]) / US_PER_S
    return QuietLevels(fits, residual_db, allan_deviation_db(residual_db, epoch_s, np.array(ALLAN_SPANS_S)))


def calmest_window(epochs_us: IntArray, residual_db: FloatArray, length_us: int) -> Window:
    """Return the stretch of a length in which carriers scatter least and are least absent."""
    scale_db = 1.4826 * np.nanmedian(np.abs(residual_db[:, np.isfinite(residual_db).any(axis=0)]), axis=0)
    seen = residual_db[:, np.isfinite(residual_db).any(axis=0)] / np.maximum(scale_db, 1e-3)
    cost = np.nan_to_num(np.minimum(seen**2, _GREATEST), nan=_GREATEST).mean(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(cost - _GREATEST)])
    starts_us = np.arange(int(epochs_us[0]), int(epochs_us[-1]) - length_us + 2, _STEP_US)
    low, high = (np.searchsorted(epochs_us, edge) for edge in (starts_us, starts_us + length_us))
    start_us = int(starts_us[int(np.argmin(summed[high] - summed[low]))])
    return Window(start_us, start_us + length_us)


def suspected_turns(epochs_us: IntArray, residual_db: FloatArray, slope: FloatArray) -> tuple[SuspectedTurn, ...]:
    """Return the stretches in which most of what changed is what a turn in roll and pitch would do.

    Parameters
    ----------
    epochs_us : ndarray of int, shape (T,), microseconds UTC
        Ascending.
    residual_db : ndarray, shape (T, N), dB
        Level and daily change removed; NaN = absent.
    slope : ndarray, shape (N, 3), dB/deg
        Of carriers with yaw, roll, pitch; NaN = not known.
    """
    bins, first = np.unique(epochs_us // _BIN_US, return_index=True)
    reach_deg = np.array([_reach_deg(chunk, slope) for chunk in np.split(residual_db, first[1:])])
    found = np.flatnonzero(reach_deg > _TURN_DEG)
    groups = np.split(found, 1 + np.flatnonzero(np.diff(bins[found]) > _PAUSE_BINS))
    return tuple(
        SuspectedTurn(
            Window(int(bins[group[0]]) * _BIN_US, (int(bins[group[-1]]) + 1) * _BIN_US), float(reach_deg[group].max())
        )
        for group in groups
        if len(group) >= _MIN_BINS
    )


def _reach_deg(residual_db: FloatArray, slope: FloatArray) -> float:
    """Return the larger angle of roll and pitch that explains the mean of some rows; 0 where none does."""
    is_seen = np.isfinite(residual_db).any(axis=0) & np.isfinite(slope).all(axis=1)
    if np.count_nonzero(is_seen) < _MIN_SEEN:
        return 0.0
    mean_db = np.nanmean(residual_db[:, is_seen], axis=0)
    design = np.column_stack([slope[is_seen, 1:], np.ones(len(mean_db))])
    fit = np.linalg.lstsq(design, mean_db)[0]
    left, all_of_it = np.sum((mean_db - design @ fit) ** 2), np.sum((mean_db - mean_db.mean()) ** 2)
    return float(np.abs(fit[:2]).max()) if left < (1.0 - _EXPLAINED) * all_of_it else 0.0
