"""Turns that the readings of an attitude sensor show, and the windows of a calibration and an alignment around them.

The law of this file: angles only; whether powers reach as far is the calibration's question.
"""

from typing import NamedTuple

import numpy as np

from service.pipeline.calibration.geometry_rows import unturned_sides
from service.pipeline.config import CalibrationConfig
from service.records.calibration import Window
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

_MINUTE_US, _HOUR_US, _DAY_US = 60 * US_PER_S, 3600 * US_PER_S, 86_400 * US_PER_S
#: means in which a turn is looked for, and pauses at zero that do not end one
_BIN_US, _PAUSE_US = 5 * _MINUTE_US, 3 * _HOUR_US
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
    bins, first = np.unique(epochs_us // _BIN_US, return_index=True)
    mean_deg = np.array([chunk.mean(axis=0) for chunk in np.split(angles_deg, first[1:])])
    departure_deg = np.abs(mean_deg - np.median(mean_deg, axis=0))
    usual_deg = 1.4826 * np.median(departure_deg, axis=0)
    is_far: BoolArray = np.any(departure_deg > np.maximum(_FAR * usual_deg, min_turn_deg), axis=1)
    is_moved: BoolArray = np.any(departure_deg > np.maximum(_USUAL * usual_deg, 0.5 * min_turn_deg), axis=1)
    found = np.flatnonzero(is_far)
    if not found.size:
        return []
    groups = np.split(found, 1 + np.flatnonzero(np.diff(bins[found]) * _BIN_US > _PAUSE_US))
    edges = [(_edge(is_moved, int(group[0]), -1), _edge(is_moved, int(group[-1]), 1)) for group in groups]
    return [
        Window(int(bins[low]) * _BIN_US - _MARGIN_US, (int(bins[high]) + 1) * _BIN_US + _MARGIN_US)
        for low, high in edges
    ]


def _edge(is_moved: BoolArray, position: int, step: int) -> int:
    """Return the last position in one direction that is still moved."""
    while 0 <= position + step < len(is_moved) and is_moved[position + step]:
        position += step
    return position


def _around(epochs_us: IntArray, turns: Window, begin_us: int) -> FlownWindows:
    """Return the windows around some turns."""
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
    """Return the angles of a window."""
    inside: FloatArray = angles_deg[(epochs_us >= window.start_us) & (epochs_us < window.stop_us)]
    return inside
