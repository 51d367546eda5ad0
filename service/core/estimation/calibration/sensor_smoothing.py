"""Angles of attitude sensors freed from their noise without rounding the turns.

A slope fitted against noisy angles comes out too small (errors in variables): by the share of the noise's variance in
the variance of the angles. A star tracker of 0.01 deg costs nothing; an Earth sensor of 0.1 deg would cost a fifth. The
noise of a sensor is read from second differences of its readings; the readings are then cut into pieces, each a
constant, by ``min sum ((reading - constant) / sigma)^2 + penalty x pieces``, found exactly by dynamic programming, so
that a piece ends where a turn does and nowhere else. The law of this file: a sensor quieter than ``QUIET_SIGMA_DEG`` is
left as it is.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray

#: deg, noise that the averages of a calibration take care of by themselves.
QUIET_SIGMA_DEG = 0.02
#: What a piece costs: a change is believed when it explains this much of a sum of squares over sigma^2.
SEGMENT_PENALTY = 14.0
#: Longest piece, rows and s: slow motion is followed in steps smaller than the noise of their means.
_LONGEST_ROWS = 120
_LONGEST_S = 7200.0
_MAD_TO_SIGMA = 1.4826


class SmoothedAngles(NamedTuple):
    """Angles with what is left of the noise.

    Parameters
    ----------
    attitude_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch, NaN where no sensor spoke.
    sensor_sigma_deg : ndarray, shape (3,), deg
        Noise of single readings, NaN without readings.
    remaining_sigma_deg : ndarray, shape (3,), deg
        Noise after the smoothing, root of the mean of the rows' variances.
    """

    attitude_deg: FloatArray
    sensor_sigma_deg: FloatArray
    remaining_sigma_deg: FloatArray


def smoothed_angles(epoch_s: FloatArray, attitude_deg: FloatArray) -> SmoothedAngles:
    """Return the angles of each axis, smoothed where its sensor is noisy.

    Parameters
    ----------
    epoch_s : ndarray, shape (T,), s
        Ascending.
    attitude_deg : ndarray, shape (T, 3), deg
        Readings at the rows; NaN = none.

    Returns
    -------
    SmoothedAngles

    Notes
    -----
    5000 rows of one axis take about 0.1 s.
    """
    columns = [_smoothed(epoch_s, one) for one in attitude_deg.T]
    return SmoothedAngles(
        np.stack([column for column, _, _ in columns], axis=1),
        np.array([sigma for _, sigma, _ in columns]),
        np.array([left for _, _, left in columns]),
    )


def reading_sigma_deg(angle_deg: FloatArray) -> float:
    """Return the noise of single readings (T,) from second differences; NaN with fewer than eight.

    Examples
    --------
    >>> reading_sigma_deg(np.arange(9.0))
    0.0
    """
    known = angle_deg[np.isfinite(angle_deg)]
    if len(known) < 8:
        return math.nan
    # of white noise a second difference has six times the variance; slow motion leaves it, and turns are few
    bend = np.abs(known[2:] - 2.0 * known[1:-1] + known[:-2])
    return float(_MAD_TO_SIGMA * np.median(bend) / math.sqrt(6.0))


def segment_starts(epoch_s: FloatArray, scaled: FloatArray) -> IntArray:
    """Return where the pieces of readings (T,) of unit noise begin, ascending, the first at 0.

    Examples
    --------
    >>> segment_starts(np.arange(8) * 60.0, np.array([0.0, 0, 0, 0, 9, 9, 9, 9]))
    array([0, 4])
    """
    count = len(scaled)
    sums = np.concatenate([[0.0], np.cumsum(scaled)])
    squares = np.concatenate([[0.0], np.cumsum(scaled**2)])
    first = np.maximum(
        np.searchsorted(epoch_s, epoch_s - _LONGEST_S, side="left"), np.arange(count) + 1 - _LONGEST_ROWS
    )
    least = np.zeros(count + 1)
    begins = np.zeros(count + 1, dtype=np.int64)
    for stop in range(1, count + 1):
        start = int(max(first[stop - 1], 0))
        rows = stop - np.arange(start, stop)
        total = sums[stop] - sums[start:stop]
        cost = least[start:stop] + (squares[stop] - squares[start:stop]) - total * total / rows
        best = int(np.argmin(cost))
        least[stop] = cost[best] + SEGMENT_PENALTY
        begins[stop] = start + best
    starts = [count]
    while starts[-1] > 0:
        starts.append(int(begins[starts[-1]]))
    return np.array(starts[:0:-1], dtype=np.int64)


def _smoothed(epoch_s: FloatArray, angle_deg: FloatArray) -> tuple[FloatArray, float, float]:
    """Return one axis smoothed, the noise of its readings and what is left of it."""
    sigma = reading_sigma_deg(angle_deg)
    if not sigma > QUIET_SIGMA_DEG:
        return angle_deg, sigma, sigma
    known = np.flatnonzero(np.isfinite(angle_deg))
    values = angle_deg[known]
    starts = segment_starts(epoch_s[known], values / sigma)
    rows = np.diff(np.append(starts, len(values)))
    mean = np.add.reduceat(values, starts) / rows
    out = angle_deg.copy()
    out[known] = np.repeat(mean, rows)
    return out, sigma, sigma * math.sqrt(len(starts) / len(values))
