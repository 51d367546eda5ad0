"""Noise of a carrier's level: a white part and coloured parts, and what a mean of it is worth.

Coloured noise of variance s^2 and correlation time tau, averaged over T with x = T/tau, keeps the variance
``2 s^2 (x - 1 + exp(-x)) / x^2``; white noise of n rows keeps ``s^2 / n``.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray

#: lags between which the decay of the autocovariance is read, rows; shorter ones hold the white part,
#: longer ones are noise
_FIRST_LAG = 3
_LAST_LAG = 20


class NoiseSplit(NamedTuple):
    """White and coloured part of a residual."""

    sigma_white_db: float
    sigma_coloured_db: float
    #: 0 where no coloured part was found
    correlation_time_s: float


def split_noise(residual_db: FloatArray, row_period_s: float) -> NoiseSplit:
    """Split the variance of a residual into a white and an exponentially correlated part.

    Parameters
    ----------
    residual_db : ndarray, shape (T,), dB
        Residual of evenly spaced rows; NaN = absent.
    row_period_s : float, s
        Spacing of the rows.

    Returns
    -------
    NoiseSplit
        Sigmas whose squares add up to the variance. NaN sigmas with fewer than 60 rows present. Over three days of
        60 s rows the sigmas are good to about 10 %, the correlation time to a factor of about 1.5.
    """
    if int(np.count_nonzero(np.isfinite(residual_db))) < 3 * _LAST_LAG:
        return NoiseSplit(float("nan"), float("nan"), 0.0)
    centred = residual_db - np.nanmean(residual_db)
    variance = float(np.nanmean(centred**2))
    lags = np.arange(_FIRST_LAG, _LAST_LAG + 1)
    covariance = np.array([_mean_present(centred[lag:] * centred[:-lag]) for lag in lags])
    usable = covariance > 0.02 * variance
    if np.count_nonzero(usable) < 3:
        return NoiseSplit(float(np.sqrt(variance)), 0.0, 0.0)
    slope, intercept = np.polyfit(lags[usable] * row_period_s, np.log(covariance[usable]), 1)
    coloured = float(np.clip(np.exp(intercept), 0.0, variance))
    # a slope that is not a decay means a correlation longer than the lags can show
    correlation_time_s = -1.0 / slope if slope < 0.0 else _LAST_LAG * row_period_s * 10.0
    return NoiseSplit(float(np.sqrt(variance - coloured)), float(np.sqrt(coloured)), float(correlation_time_s))


def _mean_present(values: FloatArray) -> float:
    """Return the mean of the values that are not NaN, NaN when there are none."""
    present = values[np.isfinite(values)]
    return float(present.mean()) if present.size else float("nan")


def averaged_sigma_db(
    sigma_white_db: FloatArray,
    sigma_coloured_db: FloatArray,
    correlation_time_s: FloatArray,
    *,
    rows: int,
    span_s: float,
) -> FloatArray:
    """Return one standard deviation of the mean of some rows.

    Parameters
    ----------
    sigma_white_db : ndarray, shape (N,), dB
        White noise of one row.
    sigma_coloured_db : ndarray, shape (N,) or (N, C), dB
        One coloured part of each, or C of them.
    correlation_time_s : ndarray, shape (N,) or (N, C), s
        Their correlation times; 0 = there is none.
    rows : int
        Rows in the mean, at least 1.
    span_s : float, s
        Time that the rows cover.

    Returns
    -------
    ndarray, shape (N,), dB

    Examples
    --------
    >>> sigma = averaged_sigma_db(np.array([0.3]), np.array([0.0]), np.array([0.0]), rows=9, span_s=540.0)
    >>> round(float(sigma[0]), 6)
    0.1
    """
    ratio = span_s / np.maximum(correlation_time_s, 1e-9)
    # below 1e-3 the closed form loses its digits; its limit is one
    safe = np.maximum(ratio, 1e-3)
    kept = np.where(ratio < 1e-3, 1.0, 2.0 * (safe - 1.0 + np.exp(-safe)) / safe**2)
    coloured = sigma_coloured_db**2 * kept
    if coloured.ndim > 1:
        coloured = coloured.sum(axis=-1)
    sigma: FloatArray = np.sqrt(sigma_white_db**2 / max(rows, 1) + coloured)
    return sigma
