"""Effect of eclipse nights on an estimate: the same spacecraft with and without the shadow.

A fault of the simulator never changes its noise, so the world of the same seed without a fault has the same attitude,
row by row, and what the answers differ by is the doing of the eclipse. What they differed by before the night, other
orbits and other harmonics, is taken off.
"""

from collections.abc import Sequence

import numpy as np

from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import Float32Array
from service.study.estimation.bounds import AXES, Statistics
from service.study.estimation.flight.episodes import stretches
from service.study.estimation.unit import Course

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
