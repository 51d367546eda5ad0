"""Rows of a calibration thinned by averaging stretches over which the attitude stands still.

A stretch ends when it is ``stretch_s`` long, or when an angle has moved from its first row by more than
``STILL_LIMIT_DEG``. Averaging loses little: the model is linear in its columns, so columns are averaged as the powers
are, over the same samples, and what two rows a minute apart know of noise with correlation times of many minutes they
know together. It gains twice: the fit is ten times shorter, and the noise of the attitude sensor, which on its own row
would shrink the slopes (errors in variables), is averaged before it enters. The law of this file: a sample far from the
median of its own stretch is an impulse and no part of the mean.

Angles of attitude sensors freed from their noise without rounding the turns.

A slope fitted against noisy angles comes out too small (errors in variables): by the share of the noise's variance in
the variance of the angles. A star tracker of 0.01 deg costs nothing; an Earth sensor of 0.1 deg would cost a fifth. The
noise of a sensor is read from second differences of its readings; the readings are then cut into pieces, each a
constant, by ``min sum ((reading - constant) / sigma)^2 + penalty x pieces``, found exactly by dynamic programming, so
that a piece ends where a turn does and nowhere else. A sensor quieter than ``QUIET_SIGMA_DEG`` is left as it is.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.robust_statistics import MAD_TO_SIGMA, middle_values

#: deg, yaw, roll, pitch: a stretch ends beyond this; yaw moves a station eight times less.
STILL_LIMIT_DEG = (0.12, 0.06, 0.06)
#: A sample this many robust sigmas from the median of its stretch is an impulse.
IMPULSE_SIGMAS = 6.0
#: dB, below this a spread is rounding.
_MIN_SPREAD_DB = 1e-6


class Stretches(NamedTuple):
    """Rows by stretch: B stretches of at most L rows.

    Parameters
    ----------
    rows : ndarray of int, shape (B, L)
        Indices of the rows, the last one repeated where the stretch is shorter.
    is_filled : ndarray of bool, shape (B, L)
        False for the repetitions.
    """

    rows: IntArray
    is_filled: BoolArray


class Means(NamedTuple):
    """Means of N carriers over B stretches.

    Parameters
    ----------
    power_db : ndarray, shape (N, B), dB
        Mean of the samples kept; 0 where there is none.
    columns : ndarray, shape (N, B, K)
        Means of the model's columns over the same samples.
    rows_used : ndarray of int, shape (N, B)
        Samples in the mean.
    is_kept : ndarray of bool, shape (T, N)
        Samples that take part.
    white_db : ndarray, shape (N,), dB
        Scatter of single samples within stretches.
    """

    power_db: FloatArray
    columns: FloatArray
    rows_used: IntArray
    is_kept: BoolArray
    white_db: FloatArray


def still_stretches(epoch_s: FloatArray, attitude_deg: FloatArray, stretch_s: float) -> Stretches:
    """Return the stretches of rows in order of time.

    Parameters
    ----------
    epoch_s : ndarray, shape (T,), s
        Ascending, T >= 1.
    attitude_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch. Rows with NaN belong to no stretch.
    stretch_s : float, s
        Longest stretch.

    Returns
    -------
    Stretches

    Examples
    --------
    >>> angles = np.array([[0, 0, 0], [0, 0, 0], [0, 0.5, 0], [0, 0.5, 0], [0, 0.5, 0]])
    >>> still_stretches(np.arange(5) * 60.0, angles, 120.0).rows
    array([[0, 1],
           [2, 3],
           [4, 4]])
    """
    known = np.flatnonzero(np.isfinite(attitude_deg).all(axis=1))
    position = np.concatenate([epoch_s[known, np.newaxis], attitude_deg[known] / STILL_LIMIT_DEG], axis=1)
    starts: list[int] = []
    first = [-math.inf] * 4
    for row, (time, yaw, roll, pitch) in enumerate(position.tolist()):
        moved = max(abs(yaw - first[1]), abs(roll - first[2]), abs(pitch - first[3]))
        if time - first[0] >= stretch_s or moved > 1.0:
            starts.append(row)
            first = [time, yaw, roll, pitch]
    if not starts:  # one stretch of no row keeps every shape downstream
        return Stretches(np.zeros((1, 1), dtype=np.int64), np.zeros((1, 1), dtype=np.bool_))
    lengths = np.diff([*starts, len(known)]).astype(np.int64)
    longest = int(lengths.max())
    steps = np.arange(longest)
    offsets = np.minimum(steps, lengths[:, np.newaxis] - 1)
    rows = known[np.array(starts, dtype=np.int64)[:, np.newaxis] + offsets]
    return Stretches(rows.astype(np.int64), steps < lengths[:, np.newaxis])


def stretch_means(stretches: Stretches, power_db: FloatArray, columns: FloatArray) -> Means:
    """Return the means of powers and columns over the samples that are no impulses.

    Parameters
    ----------
    stretches : Stretches
        B stretches.
    power_db : ndarray, shape (T, N), dB
        Powers less a rough level. NaN marks an absent sample.
    columns : ndarray, shape (T, N, K)
        Columns of the model. A sample whose columns are not finite is absent.

    Returns
    -------
    Means
    """
    is_present = np.isfinite(power_db) & np.isfinite(columns).all(axis=2)
    samples = np.where(is_present, power_db, math.nan)[stretches.rows]
    samples[~stretches.is_filled] = math.nan
    distance = np.abs(samples - _median(samples)[:, np.newaxis])
    spread = MAD_TO_SIGMA * _small_sample_mad(distance, np.isfinite(samples).sum(axis=1))
    is_kept_there = distance <= np.maximum(IMPULSE_SIGMAS * spread, _MIN_SPREAD_DB)
    is_kept = np.zeros_like(is_present)
    filled = np.broadcast_to(is_kept_there, samples.shape)[stretches.is_filled]
    is_kept[stretches.rows[stretches.is_filled]] = filled
    kept_count = is_kept_there.sum(axis=1)
    weight = np.where(is_kept, 1.0, 0.0)
    values = np.concatenate(
        [np.where(is_kept, power_db, 0.0)[..., np.newaxis], np.where(is_kept[..., np.newaxis], columns, 0.0)], axis=2
    )
    gathered = values[stretches.rows] * (weight[stretches.rows] * stretches.is_filled[..., np.newaxis])[..., np.newaxis]
    means = gathered.sum(axis=1) / np.maximum(kept_count, 1)[..., np.newaxis]
    means = np.ascontiguousarray(means.transpose(1, 0, 2))
    return Means(means[..., 0], means[..., 1:], kept_count.T.astype(np.int64), is_kept, spread)


def _small_sample_mad(distance: FloatArray, count: IntArray) -> FloatArray:
    """Return the median distance (N,) from the median, freed from what short stretches hide of it."""
    # a median of n samples follows them: distances are short by sqrt(1 - 1 / n) or so; single samples say nothing
    share = np.where(count >= 2, np.sqrt(1.0 - 1.0 / np.maximum(count, 2)), math.nan)
    scaled = (distance / share[:, np.newaxis]).reshape(-1, distance.shape[2])
    return np.asarray(np.nan_to_num(_median(scaled[np.newaxis])[0]))


def _median(samples: FloatArray) -> FloatArray:
    """Return medians (B, N) over axis 1 of (B, L, N), NaN where nothing is present."""
    lower, upper = middle_values(samples, axis=1)
    return 0.5 * (lower + upper)


#: deg, noise that the averages of a calibration take care of by themselves.
QUIET_SIGMA_DEG = 0.02
#: What a piece costs: a change is believed when it explains this much of a sum of squares over sigma^2.
SEGMENT_PENALTY = 14.0
#: Longest piece, rows and s: slow motion is followed in steps smaller than the noise of their means.
_LONGEST_ROWS = 120
_LONGEST_S = 7200.0


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
    return float(MAD_TO_SIGMA * np.median(bend) / math.sqrt(6.0))


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
