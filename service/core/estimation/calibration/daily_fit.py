"""Daily change of one stretch of powers, carrier by carrier, whatever up to 45 per cent of the samples do.

``P_i(t) = h_i + x_i(t)' d_i``: x the columns of the dish law or of two harmonics (``geometry_columns.daily_columns``).
A trimmed start (``trimmed_start``), then Tukey's M-estimate to a fixed point, its scale held at that of the start. The
law of this file: a carrier with fewer present samples than ``MIN_SAMPLES_PER_COEFFICIENT`` a coefficient is NaN, never
a curve through noise.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.joint_tukey import TUKEY_SIGMAS, trimmed_fit

MIN_SAMPLES_PER_COEFFICIENT = 4
#: Samples from which the trimmed start is taken, evenly spread; it only has to find the right half.
_START_SAMPLES = 1500
_MAX_PASSES = 50
#: dB, the fixed point is reached when no fitted value moves by more.
_TOLERANCE_DB = 1e-6
_MAD_TO_SIGMA = 1.4826
_MIN_SCALE_DB = 1e-9
_SCALE_PASSES = 3
_REACH_SIGMAS = 2.5


class DailyFits(NamedTuple):
    """Fits of N carriers with K = 1 + D coefficients; NaN for a carrier that was not fitted.

    Parameters
    ----------
    coefficients : ndarray, shape (N, K)
        Level in dBm, then the daily ones.
    covariance : ndarray, shape (N, K, K)
        For independent residuals of any distribution.
    rms_db : ndarray, shape (N,), dB
        Of the samples used.
    samples_used, samples_rejected : ndarray of int, shape (N,)
        Present samples with and without weight.
    converged : ndarray of bool, shape (N,)
        Whether the fixed point was reached.
    """

    coefficients: FloatArray
    covariance: FloatArray
    rms_db: FloatArray
    samples_used: IntArray
    samples_rejected: IntArray
    converged: BoolArray


def fit_daily(columns: FloatArray, power_dbm: FloatArray) -> DailyFits:
    """Return the robust fits.

    Parameters
    ----------
    columns : ndarray, shape (T, N, D)
        Columns of the daily change without the level; NaN makes a sample absent.
    power_dbm : ndarray, shape (T, N), dBm
        NaN marks an absent sample.

    Returns
    -------
    DailyFits

    References
    ----------
    .. [1] Yohai, V., "High breakdown-point and high efficiency robust estimates for regression", Annals of Statistics
       15, 1987 (a robust start whose scale is kept).

    Examples
    --------
    >>> phase = np.linspace(0.0, 2.0 * np.pi, 200)
    >>> power = -40.0 + 0.3 * np.cos(phase)
    >>> power[20:90] -= 3.0
    >>> fit_daily(np.cos(phase)[:, np.newaxis, np.newaxis], power[:, np.newaxis]).coefficients.round(6)
    array([[-40. ,   0.3]])
    """
    carriers, size = power_dbm.shape[1], columns.shape[2] + 1
    fits = [_fit_one(columns[:, k], power_dbm[:, k], size) for k in range(carriers)]
    parts = list(zip(*fits, strict=True)) if fits else [()] * 6
    return DailyFits(
        np.array(parts[0]).reshape(carriers, size),
        np.array(parts[1]).reshape(carriers, size, size),
        np.array(parts[2], dtype=np.float64),
        np.array(parts[3], dtype=np.int64),
        np.array(parts[4], dtype=np.int64),
        np.array(parts[5], dtype=np.bool_),
    )


def _fit_one(
    columns: FloatArray, power_dbm: FloatArray, size: int
) -> tuple[FloatArray, FloatArray, float, int, int, bool]:
    """Return coefficients, covariance, rms, samples used and rejected, and convergence of one carrier."""
    is_present = np.isfinite(power_dbm) & np.isfinite(columns).all(axis=1)
    samples = int(np.count_nonzero(is_present))
    if samples < MIN_SAMPLES_PER_COEFFICIENT * size:
        return np.full(size, math.nan), np.full((size, size), math.nan), math.nan, 0, 0, False
    design = np.column_stack([np.ones(samples), columns[is_present]])
    middle = float(np.median(power_dbm[is_present]))
    values = power_dbm[is_present] - middle
    fit, scale = _start(design, values)
    fitted, weight, is_converged = design @ fit, np.ones(samples), False
    for _ in range(_MAX_PASSES):
        weight = np.square(np.maximum(1.0 - np.square((values - fitted) / (TUKEY_SIGMAS * scale)), 0.0))
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(design * root[:, np.newaxis], values * root, rcond=None)[0]
        moved, fitted = float(np.abs(design @ fit - fitted).max()), design @ fit
        if moved <= _TOLERANCE_DB:
            is_converged = True
            break
    is_used = weight > 0.0
    residual, used = values[is_used] - fitted[is_used], int(np.count_nonzero(is_used))
    covariance = _covariance(design[is_used], residual, TUKEY_SIGMAS * scale)
    fit[0] += middle
    return fit, covariance, math.sqrt(float(np.mean(residual**2))), used, samples - used, is_converged


def _covariance(design: FloatArray, residual: FloatArray, limit_db: float) -> FloatArray:
    """Return the covariance of a Tukey fit whose residuals are independent, of whatever distribution."""
    inside = 1.0 - np.square(residual / limit_db)
    pull = residual * inside**2
    slope = float(np.mean(inside * (1.0 - 5.0 * np.square(residual / limit_db))))
    inverse = np.linalg.pinv(slope * design.T @ design)
    return np.asarray(inverse @ (design * np.square(pull)[:, np.newaxis]).T @ design @ inverse)


def _start(design: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Return trimmed coefficients and the robust scale of what they leave."""
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), _START_SAMPLES)).astype(np.int64))
    is_present = np.ones((1, len(chosen)), dtype=np.bool_)
    fit = trimmed_fit(design[chosen][np.newaxis], values[chosen][np.newaxis], is_present)[0]
    distance = np.abs(values - design @ fit)
    scale = _MAD_TO_SIGMA * float(np.median(distance))
    # with many wrong samples the median is a large quantile of the good ones: look again at those within reach
    for _ in range(_SCALE_PASSES):
        scale = _MAD_TO_SIGMA * float(np.median(distance[distance <= _REACH_SIGMAS * scale]))
    return fit, max(scale, _MIN_SCALE_DB)
