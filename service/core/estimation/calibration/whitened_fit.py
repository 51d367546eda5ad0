"""Last fit of a calibration: rows of each carrier made independent of one another by the learned noise.

Noise that all carriers share (the receiving chain, the analyzer) is counted as each carrier's own in the fit, because
it bends beams during the turns like any other. What it does to levels and daily changes is another matter: it moves all
carriers alike, the next alignment measures it again, and an error that all levels share is no error of the attitude. So
the errors of level and daily change are scaled to what the carriers' own noise makes of them. The law of this file: a
scaled covariance stays one, rows and columns together, and the downlink's gains with it.

Where the dish law is fitted and k comes out negative, which no dish does, the carrier is fitted again with k = 0.
"""

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.coloured_rows import (
    MIN_SIGMA_DB,
    ColouredNoise,
    stretch_variance_db2,
    whitened_rows,
)
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, DOWNLINK_PRIOR_DB_PER_DEG
from service.core.estimation.calibration.joint_tukey import JointProblem
from service.core.estimation.calibration.separable_fit import SeparableFit, fit_separable
from service.core.estimation.noise_identification import IdentifiedNoise

FloatArray = NDArray[np.float64]

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
