"""Angles of attitude sensors freed from their noise without rounding the turns.

A slope fitted against noisy angles comes out too small (errors in variables): by the share of the noise's variance in
the variance of the angles. A star tracker of 0.01 deg costs nothing; an Earth sensor of 0.1 deg would cost a fifth. The
noise of a sensor is read from the differences of neighbours; each row then takes the mean over the longest stretch
that holds the row and scatters no more than that noise, looked for on both sides of it, so that a stretch never
reaches across the edge of a turn. The law of this file: a sensor quieter than ``QUIET_SIGMA_DEG`` is left as it is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: deg, noise that the averages of a calibration take care of by themselves.
QUIET_SIGMA_DEG = 0.02
#: Half-lengths of the stretches, rows, the shortest first.
_REACHES = (2, 4, 7, 15, 30, 60)
#: A stretch is still while its scatter stays below this multiple of the sensor's noise; a mean of few rows scatters
#: more, so short stretches are allowed more.
_STILL_SCATTER = 1.15
_SCATTER_SHARE = 1.6
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


def _smoothed(epoch_s: FloatArray, angle_deg: FloatArray) -> tuple[FloatArray, float, float]:
    """Return one axis smoothed, the noise of its readings and what is left of it."""
    sigma = reading_sigma_deg(angle_deg)
    known = np.flatnonzero(np.isfinite(angle_deg))
    if not sigma > QUIET_SIGMA_DEG:
        return angle_deg, sigma, sigma
    values = angle_deg[known]
    mean, count = values.copy(), np.ones(len(values))
    step_s = float(np.median(np.diff(epoch_s[known])))
    for reach in _REACHES:
        allowed = sigma * (_STILL_SCATTER + _SCATTER_SHARE / math.sqrt(2.0 * reach))
        for before, after in ((reach, reach), (2 * reach, 0), (0, 2 * reach)):
            centre, scatter, rows = _stretch(values, before, after)
            first = np.maximum(np.arange(len(values)) - before, 0)
            last = np.minimum(np.arange(len(values)) + after, len(values) - 1)
            is_whole = epoch_s[known[last]] - epoch_s[known[first]] <= (before + after + 2) * step_s
            is_better = (scatter <= allowed) & is_whole & (rows > count)
            mean, count = np.where(is_better, centre, mean), np.where(is_better, rows, count)
    out = angle_deg.copy()
    out[known] = mean
    return out, sigma, sigma * float(np.sqrt(np.mean(1.0 / count)))


def _stretch(values: FloatArray, before: int, after: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, scatter about it and number of rows of the stretch around each row."""
    place = np.arange(len(values))
    first, last = np.maximum(place - before, 0), np.minimum(place + after, len(values) - 1) + 1
    sums = np.concatenate([[0.0], np.cumsum(values)])
    squares = np.concatenate([[0.0], np.cumsum(values**2)])
    rows = (last - first).astype(np.float64)
    mean = (sums[last] - sums[first]) / rows
    variance = np.maximum((squares[last] - squares[first]) / rows - mean**2, 0.0)
    return mean, np.sqrt(variance * rows / np.maximum(rows - 1.0, 1.0)), rows
