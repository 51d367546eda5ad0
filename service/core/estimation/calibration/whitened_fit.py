"""Last fit of a calibration: rows of each carrier made independent of one another by the learned noise."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, DOWNLINK_PRIOR_DB_PER_DEG
from service.core.estimation.calibration.joint_tukey import JointProblem, SeparableFit, fit_separable
from service.core.estimation.noise_identification import IdentifiedNoise

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
    # the carriers have the same few times
    decay = {tau_s: np.exp(lag_s / -max(tau_s, 1e-9)) for tau_s in np.unique(noise.tau_s).tolist()}
    out = np.zeros_like(rows)
    for carrier in range(len(rows)):
        used = np.flatnonzero((weight[carrier] > MIN_WEIGHT) & np.isfinite(variance_db2[carrier]))
        covariance = np.zeros_like(lag_s)
        for sigma_db, tau_s in zip(noise.sigma_db[carrier].tolist(), noise.tau_s[carrier].tolist(), strict=True):
            if sigma_db > 0.0:
                covariance += sigma_db**2 * decay[tau_s]
        covariance = covariance if len(used) == len(lag_s) else covariance[np.ix_(used, used)]
        np.fill_diagonal(covariance, variance_db2[carrier, used] / weight[carrier, used])
        factor = np.linalg.cholesky(covariance)
        out[carrier, used] = solve_triangular(factor, rows[carrier, used], lower=True, check_finite=False)
    return out


#: Position of k among the own coefficients of a dish law.
_K_POSITION = 3


def whitened_fit(
    problem: JointProblem, prior: FloatArray, identified: IdentifiedNoise, weight: FloatArray, *, is_dish_law: bool
) -> SeparableFit:
    """Return the fit of rows whitened by the noise.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows of N carriers in B stretches.
    prior : ndarray, shape (N, K)
        One sigma of each own coefficient before the data.
    identified : IdentifiedNoise
        Noise of the carriers.
    weight : ndarray, shape (N, B)
        Robust weights.
    is_dish_law : bool
        Whether the daily coefficients are the dish law.

    Returns
    -------
    SeparableFit
        Errors of level and daily change without the part that all carriers share.
    """
    fit = _fit(problem, prior, _noise(identified, identified.whole_db), weight, is_dish_law=is_dish_law)
    if not identified.common_db.any():
        return fit
    own = _fit(problem, prior, coloured_noise(identified), weight, is_dish_law=is_dish_law)
    scale = np.sqrt(_variances(own) / np.maximum(_variances(fit), 1e-300))
    scale[:, -BEAM_SIZE:] = 1.0
    return fit._replace(
        own_covariance=fit.own_covariance * scale[:, :, np.newaxis] * scale[:, np.newaxis],
        gain=fit.gain * scale[:, :, np.newaxis],
    )


def coloured_noise(identified: IdentifiedNoise) -> ColouredNoise:
    """Return the carriers' own noise in the form that the whitening takes."""
    return _noise(identified, identified.sigma_db)


def _noise(identified: IdentifiedNoise, sigma_db: FloatArray) -> ColouredNoise:
    """Return the noise of the rows with some sizes of the correlated parts."""
    tau_s = np.tile(identified.tau_s, (len(sigma_db), 1))
    return ColouredNoise(np.maximum(identified.white_db, MIN_SIGMA_DB), sigma_db, tau_s)


def _variances(fit: SeparableFit) -> FloatArray:
    """Return the variances (N, K) of the own coefficients."""
    return np.diagonal(fit.own_covariance, axis1=1, axis2=2)


def _fit(
    problem: JointProblem, prior: FloatArray, noise: ColouredNoise, weight: FloatArray, *, is_dish_law: bool
) -> SeparableFit:
    """Return the fit on whitened rows, once more with k = 0 where k came out negative."""
    variance = stretch_variance_db2(noise, problem.rows_used, problem.span_s)
    stacked = np.concatenate([problem.own, problem.shared, problem.value[..., np.newaxis]], axis=2)
    white = whitened_rows(stacked, problem.centre_s, variance, noise, weight)
    size = problem.own.shape[2]

    def fit_with(chosen: FloatArray) -> SeparableFit:
        return fit_separable(white[..., :size], white[..., size:-1], white[..., -1], chosen, DOWNLINK_PRIOR_DB_PER_DEG)

    fit = fit_with(prior)
    if is_dish_law and (fit.own[:, _K_POSITION] < 0.0).any():
        held = prior.copy()
        held[fit.own[:, _K_POSITION] < 0.0, _K_POSITION] = 0.0
        fit = fit_with(held)
    return fit
