"""Markers on a trace: where they may stand, which points are peaks, which peak comes next. Arrays in, indices out."""

from enum import Enum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Search(Enum):
    """Direction of a peak search."""

    #: anywhere, the highest one that is lower than the marker
    NEXT = "next"
    LEFT = "left"
    RIGHT = "right"


def peaks(level_dbm: FloatArray, excursion_db: float) -> list[int]:
    """Return the points from which the trace falls by at least the excursion on both sides before it is higher again.

    Examples
    --------
    >>> peaks(np.array([0.0, 7.0, 6.0, 9.0, 0.0, 8.0, 8.0, 1.0]), 6.0)
    [3, 5]
    """
    found: list[int] = []
    highest = lowest = 0
    is_rising = False
    values = level_dbm.tolist()
    for point, level in enumerate(values):
        if is_rising:
            if level > values[highest]:
                highest = point
            elif level <= values[highest] - excursion_db:
                found.append(highest)
                lowest, is_rising = point, False
        elif level < values[lowest]:
            lowest = point
        elif level >= values[lowest] + excursion_db and level > values[lowest]:
            highest, is_rising = point, True
    return found


def next_peak(
    level_dbm: FloatArray, excursion_db: float, point: int, search: Search, *, is_nearest: bool
) -> int | None:
    """Return the peak a search leads to from a point, ``None`` when there is none.

    To a side the nearest peak is taken, or, as some makes do, the highest that is lower than the marker. The peak the
    marker stands on counts as lower than nothing.
    """
    candidates = [peak for peak in peaks(level_dbm, excursion_db) if peak != point]
    if search is Search.LEFT:
        candidates = [peak for peak in candidates if peak < point]
    elif search is Search.RIGHT:
        candidates = [peak for peak in candidates if peak > point]
    if is_nearest and search is not Search.NEXT:
        return min(candidates, key=lambda peak: abs(peak - point), default=None)
    lower = [peak for peak in candidates if level_dbm[peak] <= level_dbm[point]]
    return max(lower, key=lambda peak: float(level_dbm[peak]), default=None)
