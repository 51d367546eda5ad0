"""Mixture of the error of an attitude over the hypotheses of the carriers.

    r_i = J_i d + s_i c + m_ib + n_ib,   n_ib normal with variance v_ib,   branch b of carrier i with probability p_ib

r is what an attitude leaves of the deviations, d its error, c what all carriers share. A branch says what may be wrong
with a carrier: nothing, rain or a wet antenna, another level. N carriers of B branches have B to the power of N
combinations; carrier by carrier the likeliest are kept, and the rest goes on as one normal distribution of their mean
and covariance, so that no probability is lost. Combinations begin in two regimes, calm and storm, which differ in the
probability of the branches: under one weather system many stations are wet at once.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.kernels.kernels import ARRAYS, AnchorKernels

#: combinations kept, the rest among them
KEPT = 32
#: places of two branches: nothing is wrong with the carrier, and it has the level that the filter learned again
DRY, LEARNED = 0, 4
#: hypotheses by name, as sums of branches
HYPOTHESES = {"dry": (0,), "wet": (1, 2), "level_changed": (3,), "level_learned": (4,)}


class Branches(NamedTuple):
    """Hypotheses of N carriers, B = 5 each: dry, light rain, heavy rain, another level, the level learned again."""

    #: (N, B) dB and dB^2
    mean_db: FloatArray
    variance_db2: FloatArray
    #: (R, N, B) in each regime
    log_probability: FloatArray
    #: (R,)
    regime_log_probability: FloatArray


class Mixture(NamedTuple):
    """Error of an attitude: K combinations of branches after the data, the rest of them last."""

    #: (K,) sum one
    probability: FloatArray
    #: (K, 3) deg and (K, 3, 3) deg^2
    mean_deg: FloatArray
    covariance_deg2: FloatArray
    #: (N, B) probability of each branch; a carrier without a reading has that before the data
    branch_probability: FloatArray

    @property
    def error_deg(self) -> FloatArray:
        """(3,) expected error, deg."""
        return np.asarray(self.probability @ self.mean_deg)

    @property
    def sigma_deg(self) -> FloatArray:
        """(3,) one standard deviation of the error, deg."""
        second = np.diagonal(self.covariance_deg2, axis1=1, axis2=2) + self.mean_deg**2
        return np.asarray(np.sqrt(self.probability @ second - self.error_deg**2))


def solve_mixture(
    jacobian: FloatArray,
    residual_db: FloatArray,
    branches: Branches,
    prior_sigma: FloatArray,
    kernels: AnchorKernels = ARRAYS,
) -> Mixture:
    """Return the error of an attitude as a mixture over what may be wrong with the carriers.

    Parameters
    ----------
    jacobian : ndarray, shape (N, 4), dB/deg, the last column dB/dB
        Change of the levels with yaw, roll, pitch and with what the carriers share.
    residual_db : ndarray, shape (N,), dB
        Measured minus what the attitude explains; NaN = no reading.
    branches : Branches
        Hypotheses of the carriers.
    prior_sigma : ndarray, shape (4,), deg, the last dB
        Error of yaw, roll, pitch and of the shared part before the carriers are asked, one standard deviation.
    kernels : AnchorKernels
        Who does the arithmetic.
    """
    present = np.flatnonzero(np.isfinite(residual_db))
    # the surest first: they tell the attitude by which the others are judged
    order = present[np.argsort(branches.variance_db2[present, DRY], kind="stable")]
    probability, mean, covariance, share = kernels.mix(jacobian, residual_db, order, *branches, prior_sigma, KEPT)
    return Mixture(probability, mean[:, :3], covariance[:, :3, :3], share)
