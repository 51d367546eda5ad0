"""Carriers of one transponder that moved together, told from an attitude and from single faults.

Hypothesis g: all members of group g carry one level of their own beside the level common to all. Started from the fit
without the group and finished by Tukey's M-estimate, it is accepted when its cost plus ``GROUP_PENALTY`` is below the
cost of the fix without groups. The law of this file: a group is tried only where two carriers are excluded already, so
a clean row never pays, neither in time nor in variance.
"""

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.quadratic_response import QuadraticResponse
from service.core.estimation.snapshot.snapshot_start import PRIOR_WEIGHT
from service.core.estimation.snapshot.snapshot_steps import (
    TUKEY_SIGMAS,
    Measured,
    linearised,
    newton_step,
    robust_fit,
    tukey_cost,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Cost that a group's own level must save; chance saves this much once in 2000 rows.
GROUP_PENALTY = 6.0
#: A group of fewer carriers is two single faults.
MIN_MEMBERS = 2
#: Excluded carriers from which on groups are tried.
_MIN_EXCLUDED = 2


def group_memberships(group: IntArray) -> tuple[FloatArray, IntArray]:
    """Return memberships (G + 1, N) of 0 and 1 and labels (G + 1,) of the groups with enough members.

    The last row stands for no group: empty, of label -1, so that index -1 means what it says.

    Examples
    --------
    >>> group_memberships(np.array([3, 3, 5, -1]))
    (array([[1., 1., 0., 0.],
           [0., 0., 0., 0.]]), array([ 3, -1]))
    """
    labels = np.unique(group[group >= 0])
    members = (group == labels[:, np.newaxis]).astype(np.float64)
    is_large = members.sum(axis=1) >= MIN_MEMBERS
    none = np.zeros((1, len(group)))
    return np.concatenate([members[is_large], none]), np.append(labels[is_large], -1).astype(np.int64)


def moved_groups(
    model: QuadraticResponse, measured: Measured, theta: FloatArray, inverse_sigma: FloatArray, members: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the group that moved in each row, and the unknowns with its level.

    Parameters
    ----------
    model : QuadraticResponse
        N carriers.
    measured : Measured
        Values (T, N) with the common level's column.
    theta : ndarray, shape (T, 4)
        Fix without groups.
    inverse_sigma : ndarray, shape (T, N), 1/dB
        Zero where absent.
    members : ndarray, shape (G, N)
        1 for members.

    Returns
    -------
    moved : ndarray of int, shape (T,)
        Row of ``members``, -1 = none.
    theta : ndarray, shape (T, 5)
        Unknowns; the last one, the group's level in dB, is 0 where none moved.
    """
    moved = np.full(len(theta), -1, dtype=np.int64)
    out = np.concatenate([theta, np.zeros((len(theta), 1))], axis=1)
    standardised = linearised(model, measured, theta).residual_db * inverse_sigma
    suspect = np.flatnonzero((np.abs(standardised) > 0.85 * TUKEY_SIGMAS).sum(axis=1) >= _MIN_EXCLUDED)
    if not suspect.size or not len(members):
        return moved, out
    cost, fitted = _hypotheses(model, measured.value_db[suspect], inverse_sigma[suspect], members)
    best = np.argmin(cost, axis=1)
    plain = tukey_cost(standardised[suspect]).sum(axis=1)
    is_moved = cost[np.arange(len(best)), best] + GROUP_PENALTY < plain
    rows = suspect[is_moved]
    moved[rows] = best[is_moved]
    out[rows] = fitted[np.flatnonzero(is_moved), best[is_moved]]
    return moved, out


def _hypotheses(
    model: QuadraticResponse, value_db: FloatArray, inverse_sigma: FloatArray, members: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return cost (T, G) and unknowns (T, G, 5) of each group's hypothesis."""
    value, inverse = value_db[:, np.newaxis], inverse_sigma[:, np.newaxis]
    ones = np.ones((1, *members.shape, 1))
    measured = Measured(value, np.concatenate([ones, members[np.newaxis, ..., np.newaxis]], axis=-1))
    theta = np.zeros((len(value_db), len(members), 5))
    prior = np.append(PRIOR_WEIGHT, PRIOR_WEIGHT[3])
    outside = inverse**2 * (1.0 - members)
    for _ in range(2):
        theta = newton_step(linearised(model, measured, theta), theta, outside, (prior, np.diag(prior)))
    theta[..., 4] = _middle(linearised(model, measured, theta).residual_db, members * (inverse > 0.0))
    theta = robust_fit(model, measured, theta, inverse)
    cost = tukey_cost(linearised(model, measured, theta).residual_db * inverse).sum(axis=-1)
    return cost, theta


def _middle(residual_db: FloatArray, is_member: FloatArray) -> FloatArray:
    """Return the (lower) median (T, G) over the members present, 0 where there is none."""
    ordered = np.sort(np.where(is_member > 0.0, residual_db, np.inf), axis=-1)
    count = (is_member > 0.0).sum(axis=-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., np.newaxis] // 2, axis=-1)[..., 0]
    return np.where(count > 0, middle, 0.0)
