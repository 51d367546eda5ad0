"""Robust fix of one row by all carriers, with groups that may be wrong as a whole."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import QuadraticResponse, response_errors
from service.core.estimation.robust_statistics import TUKEY_SIGMAS, middle_values
from service.core.estimation.snapshot.snapshot_steps import (
    PRIOR_WEIGHT,
    Measured,
    efficient_weight,
    linearised,
    newton_step,
    normal_matrix,
    robust_fit,
    trimmed_start,
    tukey_cost,
)

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
    is_member = (members > 0.0) & (inverse > 0.0)
    residual_db = np.where(is_member, linearised(model, measured, theta).residual_db, math.nan)
    theta[..., 4] = np.nan_to_num(middle_values(residual_db, axis=-1)[0])
    theta = robust_fit(model, measured, theta, inverse)
    cost = tukey_cost(linearised(model, measured, theta).residual_db * inverse).sum(axis=-1)
    return cost, theta


#: One carrier more than unknowns.
MIN_CARRIERS = 5
#: A carrier of less weight than this is excluded: beyond 4.1 sigmas.
EXCLUDED_WEIGHT = 0.05
#: A trimmed spread within this factor of the stated sigmas is chance.
SPREAD_MARGIN = 2.0


class CarrierUse(IntEnum):
    """Use of a carrier in a fix, or the reason against it."""

    USED = 0
    ABSENT = 1
    EXCLUDED = 2
    GROUP_MOVED = 3


class Snapshots(NamedTuple):
    """Fixes of T epochs; NaN where the carriers do not determine the attitude.

    Parameters
    ----------
    attitude_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch.
    covariance_deg2 : ndarray, shape (T, 3, 3), deg^2
        Noise, model error and calibration error together.
    common_db, common_sigma_db : ndarray, shape (T,), dB
        Level common to all carriers and its standard deviation.
    residual_db : ndarray, shape (T, N), dB
        Measured minus model, NaN for absent carriers.
    sigma_db : ndarray, shape (T, N), dB
        What was expected of each deviation, NaN for absent carriers.
    weight : ndarray, shape (T, N)
        Tukey's weight, 0 to 1; 0 for absent carriers.
    use : ndarray of int, shape (T, N)
        :class:`CarrierUse`.
    group : ndarray of int, shape (T,)
        Label of the group found moved, -1 = none.
    carriers_used : ndarray of int, shape (T,)
        Carriers neither absent nor excluded.
    """

    attitude_deg: FloatArray
    covariance_deg2: FloatArray
    common_db: FloatArray
    common_sigma_db: FloatArray
    residual_db: FloatArray
    sigma_db: FloatArray
    weight: FloatArray
    use: IntArray
    group: IntArray
    carriers_used: IntArray


class _Row(NamedTuple):
    """Values ready for the kernels, NaN replaced: value, inverse sigma and sigma (T, N), presence (T, N)."""

    model: QuadraticResponse
    value_db: FloatArray
    noise_db2: FloatArray
    is_present: BoolArray


def solve_snapshots(
    model: QuadraticResponse,
    deviation_db: FloatArray,
    sigma_db: FloatArray,
    orders: IntArray,
    *,
    model_error_db: float = 0.01,
    group: IntArray | None = None,
) -> Snapshots:
    """Return the attitude of every row of deviations.

    Parameters
    ----------
    model : QuadraticResponse
        N carriers; NaN makes a carrier absent.
    deviation_db : ndarray, shape (T, N), dB
        Measured minus reference power, daily change removed. NaN marks an absent carrier.
    sigma_db : ndarray, shape (N,) or (T, N), dB
        Noise of each deviation, that of its reference included; NaN or not positive makes it absent.
    orders : ndarray of int, shape (S, N)
        Orders of the carriers whose first four make the starts, ``subset_orders(N)``.
    model_error_db : float, dB
        What the quadratic does not describe.
    group : ndarray of int, shape (N,), optional
        Label >= 0 of each carrier's transponder; -1 for one that belongs to none. Without labels no group is tried.

    Returns
    -------
    Snapshots
        NaN with fewer than five carriers, and where the carriers kept do not determine the attitude.

    Notes
    -----
    Without faults the standard deviation is within 3 % of the bound of Cramer and Rao; 6 of 16 carriers may be wrong
    (``tests/regression/test_robust_figures.py``).

    References
    ----------
    .. [1] Yohai, V. J., "High breakdown-point and high efficiency robust estimates for regression", Annals of
       Statistics 15, 1987.
    .. [2] Rousseeuw, P. J. and Van Driessen, K., "Computing LTS regression for large data sets", Data Mining and
       Knowledge Discovery 12, 2006 (concentration).

    Examples
    --------
    >>> from service.core.estimation.calibration.geometry_columns import exact_response
    >>> from service.core.estimation.snapshot.snapshot_steps import subset_orders
    >>> rng = np.random.default_rng(1)
    >>> model = exact_response(rng.normal(0.0, [0.2, 1.4, 1.2], (12, 3)), np.tile(-2.0 * np.eye(3), (12, 1, 1)))
    >>> deviation_db = model.slope @ [0.3, -0.1, 0.2] - 0.14 + 0.5 - 3.0 * (np.arange(12) == 4)
    >>> fixes = solve_snapshots(model, deviation_db[np.newaxis], np.full(12, 0.05), subset_orders(12))
    >>> fixes.attitude_deg.round(6), fixes.common_db.round(6), np.flatnonzero(fixes.use[0] == CarrierUse.EXCLUDED)
    (array([[ 0.3, -0.1,  0.2]]), array([0.5]), array([4]))
    """
    row = _prepared(model, deviation_db, sigma_db, model_error_db)
    start_sigma = np.sqrt(row.noise_db2)
    theta = trimmed_start(row.model, row.value_db, _inverse(start_sigma, row.is_present), orders)
    variance, _ = response_errors(theta[:, :3], row.model)
    sigma = np.sqrt(row.noise_db2 + variance)
    measured = Measured(row.value_db, np.ones((*row.value_db.shape, 1)))
    scale = _widening(linearised(row.model, measured, theta).residual_db, sigma, row.is_present)
    sigma = sigma * scale[:, np.newaxis]
    inverse_sigma = _inverse(sigma, row.is_present)
    theta = robust_fit(row.model, measured, theta, inverse_sigma)
    members, labels = group_memberships(np.full(deviation_db.shape[1], -1) if group is None else group)
    moved, theta = moved_groups(row.model, measured, theta, inverse_sigma, members[:-1])
    return _assembled(row, sigma, theta, members[moved], labels[moved])


def _prepared(model: QuadraticResponse, deviation_db: FloatArray, sigma_db: FloatArray, model_error_db: float) -> _Row:
    """Return values without NaN, and which carriers are present."""
    is_known = np.isfinite(model.slope).all(axis=1) & np.isfinite(model.curvature).all(axis=(1, 2))
    is_known &= np.isfinite(model.covariance).all(axis=(1, 2))
    is_present = np.isfinite(deviation_db) & is_known & np.isfinite(sigma_db) & (sigma_db > 0.0)
    safe = QuadraticResponse(*(np.where(is_known.reshape(-1, *(1,) * (field.ndim - 1)), field, 0.0) for field in model))
    noise_db2 = np.where(is_present, sigma_db, 1.0) ** 2 + model_error_db**2
    return _Row(safe, np.where(is_present, deviation_db, 0.0), noise_db2, is_present)


def _inverse(sigma_db: FloatArray, is_present: BoolArray) -> FloatArray:
    """Return 1 / sigma, zero for absent carriers."""
    return np.where(is_present, 1.0 / sigma_db, 0.0)


def _widening(residual_db: FloatArray, sigma_db: FloatArray, is_present: BoolArray) -> FloatArray:
    """Return by what factor (T,) >= 1 the sigmas are too small for the better half of the carriers."""
    size = np.sort(np.where(is_present, np.abs(residual_db) / sigma_db, math.inf), axis=1)
    trusted = np.maximum((is_present.sum(axis=1) + MIN_CARRIERS) // 2, 1)
    used = np.arange(size.shape[1]) < trusted[:, np.newaxis]
    total = np.sum(np.where(used, size, 0.0) ** 2, axis=1, where=np.isfinite(size))
    return np.asarray(np.maximum(np.sqrt(total / np.maximum(trusted - 4, 1)) / SPREAD_MARGIN, 1.0))


def _assembled(row: _Row, sigma: FloatArray, theta: FloatArray, membership: FloatArray, group: IntArray) -> Snapshots:
    """Return the fixes with weights and covariance at the final unknowns."""
    measured = Measured(row.value_db, np.stack([np.ones_like(membership), membership], axis=-1))
    design, residual = linearised(row.model, measured, theta)
    weight = np.where(row.is_present, efficient_weight(residual / sigma), 0.0)
    is_excluded = row.is_present & (weight < EXCLUDED_WEIGHT)
    is_used = row.is_present & ~is_excluded
    inverse, is_determined = _inverses(design, weight / sigma**2, group)
    gain = inverse @ np.swapaxes(design * (weight / sigma**2)[..., np.newaxis], -1, -2)
    _, shared = response_errors(theta[:, :3], row.model)
    alone = np.maximum(sigma**2 - np.square(shared).sum(axis=-1), 0.0)
    through = gain @ shared
    covariance = (gain * alone[:, np.newaxis]) @ np.swapaxes(gain, -1, -2) + through @ np.swapaxes(through, -1, -2)
    count = is_used.sum(axis=1)
    is_fix = is_determined & (count >= MIN_CARRIERS + (group >= 0))
    use = np.select(
        [~row.is_present, is_excluded, membership > 0.0],
        [CarrierUse.ABSENT, CarrierUse.EXCLUDED, CarrierUse.GROUP_MOVED],
        CarrierUse.USED,
    )

    def blank(values: FloatArray) -> FloatArray:
        return np.where(is_fix.reshape(-1, *(1,) * (values.ndim - 1)), values, math.nan)

    return Snapshots(
        attitude_deg=blank(theta[:, :3]),
        covariance_deg2=blank(covariance[:, :3, :3]),
        common_db=blank(theta[:, 3]),
        common_sigma_db=blank(np.sqrt(covariance[:, 3, 3])),
        residual_db=blank(np.where(row.is_present, residual, math.nan)),
        sigma_db=np.where(row.is_present, sigma, math.nan),
        weight=weight,
        use=use.astype(np.int64),
        group=np.where(is_fix, group, -1),
        carriers_used=count.astype(np.int64),
    )


#: Smallest eigenvalue of a normal matrix of unit diagonal that still counts as determined.
_MIN_EIGENVALUE = 1e-6


def _inverses(design: FloatArray, weight: FloatArray, group: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return inverse normal matrices (T, 5, 5), and whether the attitude is determined."""
    normal = normal_matrix(design, weight)
    # without a moved group its level is no unknown
    is_free = np.ones(normal.shape[:2], dtype=np.bool_)
    is_free[:, 4] = group >= 0
    outer = is_free[:, :, np.newaxis] & is_free[:, np.newaxis]
    normal = np.where(outer, normal, np.eye(5))
    length = np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    scaled = normal / (length[:, :, np.newaxis] * length[:, np.newaxis])
    is_determined = np.linalg.eigvalsh(scaled)[:, 0] > _MIN_EIGENVALUE
    safe = np.where(is_determined[:, np.newaxis, np.newaxis], scaled, np.eye(5))
    inverse = np.linalg.inv(safe) / (length[:, :, np.newaxis] * length[:, np.newaxis])
    return inverse * outer, is_determined
