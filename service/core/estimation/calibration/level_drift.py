"""Random walk of the carriers' levels, from the slopes that quiet days show beyond their noise.

A walk of w dB per square root of hour leaves in the straight line through T hours a slope of variance
``(6/5) w^2 / T``; noise of the density S_0 at low frequency leaves ``12 S_0 / T^3``. What all carriers do together
belongs to the receiving chain and is taken out first. The law of this file: one slope is one figure, so the walk of all
carriers counts as several of each carrier's own, and no walk is believed to be below the floor given.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.noise_identification import IdentifiedNoise

#: Figures that the walk of all carriers is worth in that of one.
_POOL_WEIGHT = 4.0
#: dB per square root of hour, no level wanders more: it would be no level.
_MOST_DB = 0.1
_HOUR_S = 3600.0
_MIN_ROWS = 100
_MIN_COMMON = 4


class LevelDrift(NamedTuple):
    """Slopes of N carriers over quiet days.

    Parameters
    ----------
    slope_db_per_day : ndarray, shape (N,)
        NaN for a carrier seen too little.
    sigma_db_per_day : ndarray, shape (N,)
        What noise alone leaves.
    walk_db : ndarray, shape (N,), dB per square root of hour
        Random walk of the level, never NaN.
    """

    slope_db_per_day: FloatArray
    sigma_db_per_day: FloatArray
    walk_db: FloatArray


def without_common(residual_db: FloatArray) -> FloatArray:
    """Return residuals (T, N) less the median of each row; rows of fewer than four carriers are left as they are."""
    ordered = np.sort(residual_db, axis=1)  # NaN goes last
    count = np.isfinite(residual_db).sum(axis=1)
    rows = np.arange(len(ordered))
    # one carrier that drifts must not make all others drift the other way
    middle = 0.5 * (ordered[rows, np.maximum(count - 1, 0) // 2] + ordered[rows, np.minimum(count // 2, count - 1)])
    return np.asarray(residual_db - np.where(count >= _MIN_COMMON, middle, 0.0)[:, np.newaxis])


def level_drift(residual_db: FloatArray, epoch_s: FloatArray, noise: IdentifiedNoise, floor_db: float) -> LevelDrift:
    """Return slopes and random walks.

    Parameters
    ----------
    residual_db : ndarray, shape (T, N), dB
        Of quiet rows; NaN = absent.
    epoch_s : ndarray, shape (T,), s
        Ascending.
    noise : IdentifiedNoise
        Of the same rows.
    floor_db : float, dB per square root of hour
        Least walk.

    Returns
    -------
    LevelDrift
    """
    own_db = without_common(residual_db)
    is_there = np.isfinite(own_db)
    count = is_there.sum(axis=0)
    is_enough = count >= _MIN_ROWS
    rows = np.maximum(count, 1)
    value = np.where(is_there, own_db, 0.0)
    hours = np.where(is_there, (epoch_s / _HOUR_S)[:, np.newaxis], 0.0)
    centred = np.where(is_there, hours - hours.sum(axis=0) / rows, 0.0)
    square = np.maximum((centred**2).sum(axis=0), 1e-12)
    slope = (centred * value).sum(axis=0) / square
    span_h = np.sqrt(12.0 * square / rows)
    step_h = np.maximum(span_h / rows, 1e-9)
    density = noise.white_db**2 * step_h + (2.0 * noise.tau_s / _HOUR_S * noise.sigma_db**2).sum(axis=1)
    variance = 12.0 * density / np.maximum(span_h, 1e-9) ** 3
    excess = np.where(is_enough, (slope**2 - variance) * span_h * 5.0 / 6.0, 0.0)
    pooled = max(float(excess[is_enough].mean()), 0.0) if is_enough.any() else 0.0
    walk2 = (np.maximum(excess, 0.0) + _POOL_WEIGHT * pooled) / (1.0 + _POOL_WEIGHT)
    return LevelDrift(
        np.where(is_enough, 24.0 * slope, np.nan),
        24.0 * np.sqrt(variance),
        np.clip(np.sqrt(walk2), floor_db, max(floor_db, _MOST_DB)),
    )
