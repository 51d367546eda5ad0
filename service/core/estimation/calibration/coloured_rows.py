"""Means of stretches made independent of one another: whitening by the noise model of the carrier.

Noise of a row: white of ``white_db`` and a sum of exponentially correlated parts of ``sigma_db`` and ``tau_s``. Means
of stretches centred at t_a and t_b with n rows each then have the covariance

    white^2 / n [a = b] + sum_k sigma_k^2 (a = b: kept(T / tau_k),  else: exp(-|t_a - t_b| / tau_k))

with ``kept(x) = 2 (x - 1 + exp(-x)) / x^2``. Its Cholesky factor turns rows into rows of independent unit noise, on
which ordinary least squares is the best there is and its covariance is the true one. The law of this file: a row whose
robust weight is w < 1 gets white variance added until it weighs w, so an outlier lets go of its neighbours too.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Weights below this are no weight at all.
MIN_WEIGHT = 1e-6
#: dB, noise of a carrier is not believed to be below this.
MIN_SIGMA_DB = 1e-4


class ColouredNoise(NamedTuple):
    """Noise of N carriers with C correlated parts each.

    Parameters
    ----------
    white_db : ndarray, shape (N,), dB
        White noise of one row.
    sigma_db : ndarray, shape (N, C), dB
        Correlated parts; 0 = there is none.
    tau_s : ndarray, shape (N, C), s
        Correlation times.
    """

    white_db: FloatArray
    sigma_db: FloatArray
    tau_s: FloatArray


def stretch_variance_db2(noise: ColouredNoise, count: FloatArray, span_s: FloatArray) -> FloatArray:
    """Return the variance of the means of stretches.

    Parameters
    ----------
    noise : ColouredNoise
        N carriers.
    count : ndarray, shape (N, B)
        Rows in each mean.
    span_s : ndarray, shape (B,), s
        Length of each stretch.

    Returns
    -------
    ndarray, shape (N, B), dB^2
        Infinite where there is no row.

    Examples
    --------
    >>> noise = ColouredNoise(np.array([0.2]), np.zeros((1, 1)), np.ones((1, 1)))
    >>> stretch_variance_db2(noise, np.array([[4.0, 0.0]]), np.array([240.0, 240.0])).round(6)
    array([[0.01,  inf]])
    """
    white = np.maximum(noise.white_db, MIN_SIGMA_DB)[:, np.newaxis] ** 2
    averaged = np.where(count > 0, white / np.maximum(count, 1), math.inf)
    ratio = np.maximum(span_s / np.maximum(noise.tau_s[..., np.newaxis], 1e-9), 1e-3)
    kept = 2.0 * (ratio - 1.0 + np.exp(-ratio)) / ratio**2
    return np.asarray(averaged + (noise.sigma_db[..., np.newaxis] ** 2 * kept).sum(axis=1))


def whitened_rows(
    rows: FloatArray, centre_s: FloatArray, variance_db2: FloatArray, noise: ColouredNoise, weight: FloatArray
) -> FloatArray:
    """Return rows of independent unit noise.

    Parameters
    ----------
    rows : ndarray, shape (N, B, K)
        Columns and values of the fit.
    centre_s : ndarray, shape (B,), s
        Middle of each stretch.
    variance_db2 : ndarray, shape (N, B), dB^2
        Of :func:`stretch_variance_db2`.
    noise : ColouredNoise
        N carriers.
    weight : ndarray, shape (N, B)
        Robust weights, 0 to 1.

    Returns
    -------
    ndarray, shape (N, B, K)
        Rows without weight are zero.
    """
    # a tenth of a second and 10 MB that only a calibration needs
    from scipy.linalg import solve_triangular

    lag_s = np.abs(centre_s[:, np.newaxis] - centre_s)
    out = np.zeros_like(rows)
    for carrier in range(len(rows)):
        used = np.flatnonzero((weight[carrier] > MIN_WEIGHT) & np.isfinite(variance_db2[carrier]))
        apart_s = lag_s[np.ix_(used, used)]
        covariance = np.zeros_like(apart_s)
        for sigma_db, tau_s in zip(noise.sigma_db[carrier], noise.tau_s[carrier], strict=True):
            if sigma_db > 0.0:
                covariance += sigma_db**2 * np.exp(apart_s / -max(tau_s, 1e-9))
        np.fill_diagonal(covariance, variance_db2[carrier, used] / weight[carrier, used])
        factor = np.linalg.cholesky(covariance)
        out[carrier, used] = solve_triangular(factor, rows[carrier, used], lower=True, check_finite=False)
    return out
