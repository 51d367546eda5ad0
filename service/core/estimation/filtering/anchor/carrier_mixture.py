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

from service.core.estimation.filtering.model.filter_model import FloatArray, IntArray

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


class _Sums(NamedTuple):
    """Combinations in work: K of D = 4 unknowns."""

    log_weight: FloatArray
    mean: FloatArray
    covariance: FloatArray
    regime: IntArray
    #: (K, N, B) probability of each branch
    branch: FloatArray


def solve_mixture(
    jacobian: FloatArray, residual_db: FloatArray, branches: Branches, prior_sigma: FloatArray
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
    """
    present = np.flatnonzero(np.isfinite(residual_db))
    sums = _begun(branches, prior_sigma)
    # the surest first: they tell the attitude by which the others are judged
    for carrier in present[np.argsort(branches.variance_db2[present, DRY], kind="stable")].tolist():
        sums = _with_carrier(sums, carrier, jacobian[carrier], float(residual_db[carrier]), branches)
    probability = np.exp(sums.log_weight)
    branch_share = np.tensordot(probability, sums.branch, axes=1)
    return Mixture(probability, sums.mean[:, :3], sums.covariance[:, :3, :3], branch_share)


def _begun(branches: Branches, prior_sigma: FloatArray) -> _Sums:
    """Return one combination a regime, before any carrier."""
    regimes = len(branches.regime_log_probability)
    return _Sums(
        branches.regime_log_probability,
        np.zeros((regimes, 4)),
        np.tile(np.diag(np.square(prior_sigma)), (regimes, 1, 1)),
        np.arange(regimes),
        np.exp(branches.log_probability),
    )


def _with_carrier(sums: _Sums, carrier: int, row: FloatArray, residual_db: float, branches: Branches) -> _Sums:
    """Return the combinations with each branch of one carrier more, the unlikely ones merged."""
    across = sums.covariance @ row
    variance = (across @ row)[:, None] + branches.variance_db2[carrier]
    surprise = (residual_db - sums.mean @ row)[:, None] - branches.mean_db[carrier]
    log_weight = sums.log_weight[:, None] + branches.log_probability[sums.regime, carrier]
    log_weight = (log_weight - 0.5 * (np.log(variance) + surprise**2 / variance)).ravel()
    log_weight -= log_weight.max()
    log_weight -= np.log(np.exp(log_weight).sum())
    order = np.argsort(-log_weight, kind="stable")
    parent, branch = np.divmod(order, variance.shape[1])
    gain = across[parent] / variance[parent, branch][:, None]
    mean = sums.mean[parent] + gain * surprise[parent, branch][:, None]
    covariance = sums.covariance[parent] - gain[:, :, None] * across[parent][:, None, :]
    kept = slice(0, KEPT - 1 if len(order) > KEPT else len(order))
    branch_share = sums.branch[parent[kept]]
    branch_share[:, carrier] = np.eye(variance.shape[1])[branch[kept]]
    after = _Sums(log_weight[order[kept]], mean[kept], covariance[kept], sums.regime[parent[kept]], branch_share)
    if len(order) <= KEPT:
        return after
    rest = slice(KEPT - 1, None)
    total, share = _shares(log_weight[order[rest]])
    by_parent = np.bincount(parent[rest], share, len(sums.mean))
    branch_share = np.tensordot(by_parent, sums.branch, axes=1)
    branch_share[carrier] = np.bincount(branch[rest], share, variance.shape[1])
    return _with_rest(after, total, share, mean[rest], covariance[rest], branch_share, int(sums.regime[parent[-1]]))


def _shares(log_weight: FloatArray) -> tuple[float, FloatArray]:
    """Return the logarithm of a sum of weights, and the share of each in it."""
    weight = np.exp(log_weight - log_weight[0])
    return float(log_weight[0] + np.log(weight.sum())), weight / weight.sum()


def _with_rest(
    kept: _Sums,
    log_weight: float,
    share: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    branch_share: FloatArray,
    regime: int,
) -> _Sums:
    """Return the kept combinations and the others as one of their mean and covariance."""
    middle = share @ mean
    apart = mean - middle
    spread = np.tensordot(share, covariance, axes=1) + (apart.T * share) @ apart
    return _Sums(
        np.append(kept.log_weight, log_weight),
        np.concatenate([kept.mean, middle[None]]),
        np.concatenate([kept.covariance, spread[None]]),
        np.append(kept.regime, regime),
        np.concatenate([kept.branch, branch_share[None]]),
    )
