"""Turns reduced to levels, and the curvature of a carrier's answer on each side of an axis.

A level is a stretch of rows between which no angle moves: its angles are means, its powers medians, so that an impulse
or a shower within it does no harm and slow noise, alike in all its rows, counts once. On the levels

``dP = sum_j a+_j max(l_j, 0) + a-_j min(l_j, 0) + q+ max(l_d, 0)^2 + q- min(l_d, 0)^2 + b``

is solved for one carrier: dP, b in dB, l in deg, a in dB/deg, q in dB/deg^2 for the axis d. The law of this file: the
standard error of q comes from the scatter of the levels about this model, never from the noise of single rows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.observability import normal_inverse
from service.core.estimation.paper.sensitivity import MIN_EXCURSION_DEG, one_sided_columns

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: deg, rows further than this from the first row of a level begin a new one.
LEVEL_WIDTH_DEG = 0.05
#: A level of fewer rows than this share of the level to which the median row belongs is a slew and is left out.
MIN_LEVEL_SHARE = 0.5
#: Levels up to this many times the range take part in the fit.
RANGE_MARGIN = 1.1
#: A design that amplifies the noise of one level more than this, in the departure at the end of the range, does not
#: measure curvature: it has only one level on the side, or two close together.
MAX_NOISE_GAIN = 3.0


class TurnLevels(NamedTuple):
    """L levels of N carriers.

    Parameters
    ----------
    angle_deg : ndarray, shape (L, 3), deg
        Mean yaw, roll, pitch.
    deviation_db : ndarray, shape (L, N), dB
        Median deviation; NaN where fewer than half of the level's rows are present.
    """

    angle_deg: FloatArray
    deviation_db: FloatArray


class Curvature(NamedTuple):
    """Curvature of one carrier about one axis, sides plus and minus; NaN where the turns do not determine it.

    Parameters
    ----------
    q_db_per_deg2, sigma_db_per_deg2 : ndarray, shape (2,), dB/deg^2
        Coefficient of the square, and its standard error.
    excursion_deg : float, deg
        Largest angle reached on both sides, within the range and its margin.
    """

    q_db_per_deg2: FloatArray
    sigma_db_per_deg2: FloatArray
    excursion_deg: float


def reduce_to_levels(angle_deg: FloatArray, deviation_db: FloatArray) -> TurnLevels:
    """Return the levels of rows given in order of time.

    Parameters
    ----------
    angle_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch. Rows with NaN are left out.
    deviation_db : ndarray, shape (K, N), dB
        NaN marks an absent sample.

    Returns
    -------
    TurnLevels
        Slews, recognised by their few rows, are left out. Rows that are levels already (each far from the next) pass
        through unchanged.

    Examples
    --------
    >>> angle_deg = np.array([[0, 0.10, 0], [0, 0.12, 0], [0, 0.5, 0], [0, 0.5, 0]])
    >>> reduce_to_levels(angle_deg, np.array([[1.0], [2.0], [4.0], [4.0]])).deviation_db
    array([[1.5],
           [4. ]])
    """
    is_row = np.asarray(np.isfinite(angle_deg).all(axis=1))
    angles, deviations = angle_deg[is_row], deviation_db[is_row]
    starts = [0] if len(angles) else []
    for row in range(1, len(angles)):
        if np.abs(angles[row] - angles[starts[-1]]).max() > LEVEL_WIDTH_DEG:
            starts.append(row)
    counts = np.diff([*starts, len(angles)]) if starts else np.zeros(0, dtype=np.int64)
    least = MIN_LEVEL_SHARE * np.median(np.repeat(counts, counts)) if starts else 0.0
    spans = [slice(start, start + int(count)) for start, count in zip(starts, counts, strict=True) if count >= least]
    return TurnLevels(
        angle_deg=np.array([angles[span].mean(axis=0) for span in spans]).reshape(-1, 3),
        deviation_db=np.array([_column_medians(deviations[span]) for span in spans]).reshape(-1, deviations.shape[1]),
    )


def one_sided_curvature(levels: TurnLevels, carrier: int, axis: int, range_deg: float) -> Curvature:
    """Return the curvature of one carrier on both sides of an axis.

    Parameters
    ----------
    levels : TurnLevels
        Levels of the turns.
    carrier : int
        Column of the levels.
    axis : int
        0 yaw, 1 roll, 2 pitch; -1 gives NaN.
    range_deg : float, deg
        Levels with an angle beyond this, and a margin, are left out.

    Returns
    -------
    Curvature
        NaN for a side without two well separated levels, and for both without a level to spare.
    """
    absent = Curvature(np.full(2, math.nan), np.full(2, math.nan), math.nan)
    level_db = levels.deviation_db[:, carrier]
    is_used = np.isfinite(level_db) & (np.abs(levels.angle_deg) <= RANGE_MARGIN * range_deg).all(axis=1)
    if axis < 0 or not is_used.any():
        return absent
    columns, level_db = one_sided_columns(levels.angle_deg[is_used]), level_db[is_used]
    reach_deg = np.abs(columns).max(axis=0)
    is_seen: BoolArray = reach_deg >= MIN_EXCURSION_DEG
    sides = np.array([axis, axis + 3])
    basis = np.column_stack([columns[:, is_seen], np.ones(len(columns)), columns[:, sides[is_seen[sides]]] ** 2])
    spare = len(basis) - basis.shape[1]
    if spare < 1 or not is_seen[sides].any():
        return absent
    inverse = normal_inverse(basis)
    coefficients = inverse @ (basis.T @ level_db)
    scatter_db = math.sqrt(float(np.square(level_db - basis @ coefficients).sum()) / spare)
    found = int(is_seen[sides].sum())
    unit_sigma = np.sqrt(np.diagonal(inverse)[-found:])
    is_measured = unit_sigma * range_deg**2 / 4.0 <= MAX_NOISE_GAIN
    q, sigma = np.full(2, math.nan), np.full(2, math.nan)
    q[is_seen[sides]] = np.where(is_measured, coefficients[-found:], math.nan)
    sigma[is_seen[sides]] = np.where(is_measured, unit_sigma * scatter_db, math.nan)
    return Curvature(q, sigma, float(reach_deg[sides].min()))


def _column_medians(values: FloatArray) -> FloatArray:
    """Return the median of each column over its present values, NaN where fewer than half are present."""
    ordered = np.sort(values, axis=0)  # NaN goes last
    count = np.isfinite(values).sum(axis=0)
    columns = np.arange(values.shape[1])
    lower, upper = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)
    middle = 0.5 * (ordered[lower, columns] + ordered[upper, columns])
    return np.where(2 * count >= len(values), middle, math.nan)
