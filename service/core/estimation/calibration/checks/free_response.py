"""Answer of the carriers to the attitude with all slopes free: yaw is fitted, not told by the stations' places.

``P_i = h_i + D_i(t) + S_i(t) + s_i' l + l' M_i l / 2`` with the nine coefficients of each carrier free
(``quadratic_response``). A sensor whose axes are exchanged or flipped changes these coefficients as the angles change
and the quality of the fit not at all, so that they can be judged afterwards (``sensor_axes``).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.coloured_rows import ColouredNoise, stretch_variance_db2, whitened_rows
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE
from service.core.estimation.calibration.joint_tukey import JointProblem, fit_jointly
from service.core.estimation.calibration.quadratic_response import symmetric_matrix
from service.core.estimation.calibration.separable_fit import fit_separable

FloatArray = NDArray[np.float64]

#: one sigma of slopes (dB/deg) and curvatures (dB/deg^2) before the data, as wide as those of the beams
_PRIOR = (10.0, 10.0, 10.0, 15.0, 15.0, 15.0, 15.0, 15.0, 15.0)


class FreeResponse(NamedTuple):
    """Free answer of N carriers.

    Parameters
    ----------
    slope : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch as the sensor names them.
    curvature : ndarray, shape (N, 3, 3), dB/deg^2
        Symmetric.
    covariance : ndarray, shape (N, 3, 3), dB^2/deg^2
        Of the slopes, by each carrier's own noise.
    """

    slope: FloatArray
    curvature: FloatArray
    covariance: FloatArray


def fit_free_response(
    problem: JointProblem, monomials: FloatArray, prior: FloatArray, white_db: FloatArray, noise: ColouredNoise
) -> FreeResponse:
    """Return the free answer of all carriers.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows of N carriers in B stretches; its columns of the beams and of the downlink are replaced.
    monomials : ndarray, shape (N, B, 9)
        Means of ``response_monomials``.
    prior : ndarray, shape (N, K)
        One sigma of each own coefficient of ``problem``.
    white_db : ndarray, shape (N,), dB
        Scatter of single rows, for the robust weights.
    noise : ColouredNoise
        Own noise of the carriers, for the whitening.
    """
    size = monomials.shape[2]
    own = np.concatenate([problem.own[..., :-BEAM_SIZE], monomials], axis=2)
    nothing = np.zeros((*problem.value.shape, 0))
    free = problem._replace(own=own, shared=nothing, beam_size=size)
    wide = np.concatenate([prior[:, :-BEAM_SIZE], np.tile(_PRIOR, (len(prior), 1))], axis=1)
    _fit, weight = fit_jointly(free, wide, white_db)
    variance = stretch_variance_db2(noise, free.rows_used, free.span_s)
    stacked = np.concatenate([own, free.value[..., np.newaxis]], axis=2)
    white = whitened_rows(stacked, free.centre_s, variance, noise, weight)
    fit = fit_separable(white[..., :-1], nothing, white[..., -1], wide, 1.0)
    found = fit.own[:, -size:]
    slopes = slice(-size, 3 - size)
    return FreeResponse(found[:, :3], symmetric_matrix(found[:, 3:]), fit.own_covariance[:, slopes, slopes])
