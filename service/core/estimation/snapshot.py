"""Robust fix of one row by all carriers, with groups that may be wrong as a whole."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import QuadraticResponse, predict_jacobian, response_errors
from service.core.estimation.robust_statistics import TUKEY_SIGMAS, middle_values, tukey_weight

#: Sigmas up to which a carrier keeps its full weight at the end.
CORE_SIGMAS = 2.5
#: 1/deg^2 and 1/dB^2, added to normal matrices of 4 and 5 unknowns: a thousand degrees, so it moves no figure.
_RIDGE = {unknowns: 1e-6 * np.eye(unknowns) for unknowns in (4, 5)}
#: Passes with Tukey's weight before the efficient one takes over.
_TUKEY_PASSES = 4
#: Limit of all passes, and the largest last step, deg and dB.
_PASSES, _TOLERANCE = 40, 1e-10
#: deg, no step and no answer goes further than this: the quadratic means nothing there.
ATTITUDE_LIMIT_DEG = 3.0


class Measured(NamedTuple):
    """Values (..., N) with their common columns (..., N, E)."""

    value_db: FloatArray
    common: FloatArray


class Linearised(NamedTuple):
    """Model at some unknowns: derivative (..., N, U) and measured minus model (..., N), dB."""

    design: FloatArray
    residual_db: FloatArray


def linearised(model: QuadraticResponse, measured: Measured, theta: FloatArray) -> Linearised:
    """Return the derivative of the model by the unknowns, and what it leaves of the values.

    Parameters
    ----------
    model : QuadraticResponse
        N carriers, no NaN.
    measured : Measured
        Values.
    theta : ndarray, shape (..., U)
        Attitude in deg and common levels in dB, U = 3 + E.

    Returns
    -------
    Linearised
    """
    jacobian = predict_jacobian(theta[..., :3], model)
    design = np.empty((*jacobian.shape[:-1], theta.shape[-1]))
    design[..., :3] = jacobian
    design[..., 3:] = measured.common
    # a quadratic is its derivative at half the way times the way
    jacobian += model.slope
    jacobian *= 0.5
    answer = jacobian @ theta[..., :3, np.newaxis] + measured.common @ theta[..., 3:, np.newaxis]
    return Linearised(design, measured.value_db - answer[..., 0])


def normal_matrix(design: FloatArray, weight: FloatArray) -> FloatArray:
    """Return ``B' W B``, shape (..., U, U), of designs (..., N, U) and weights (..., N), kept regular."""
    normal = np.swapaxes(design * weight[..., np.newaxis], -1, -2) @ design
    return np.asarray(normal + _RIDGE[design.shape[-1]])


def newton_step(
    at: Linearised, theta: FloatArray, weight: FloatArray, prior: tuple[FloatArray, FloatArray] | None = None
) -> FloatArray:
    """Return the unknowns after one step of Gauss and Newton.

    Parameters
    ----------
    at : Linearised
        Model at the present unknowns.
    theta : ndarray, shape (..., U)
        Present unknowns.
    weight : ndarray, shape (..., N), 1/dB^2
        Weights of the carriers.
    prior : tuple of ndarray, shapes (U,) and (U, U), optional
        1 / sigma^2 of a pull of each unknown towards zero, and the same as a diagonal matrix.

    Returns
    -------
    ndarray, shape (..., U)
        Attitude within ``ATTITUDE_LIMIT_DEG``.
    """
    weighted = at.design * weight[..., np.newaxis]
    transposed = np.swapaxes(weighted, -1, -2)
    normal = transposed @ at.design + _RIDGE[theta.shape[-1]]
    right = transposed @ at.residual_db[..., np.newaxis]
    if prior is not None:
        normal = normal + prior[1]
        right = right - (prior[0] * theta)[..., np.newaxis]
    moved = theta + np.linalg.solve(normal, right)[..., 0]
    angles = moved[..., :3]
    np.maximum(np.minimum(angles, ATTITUDE_LIMIT_DEG, out=angles), -ATTITUDE_LIMIT_DEG, out=angles)
    return np.asarray(moved)


def efficient_weight(standardised: FloatArray) -> FloatArray:
    """Return a weight that is 1 up to ``CORE_SIGMAS`` and falls to 0 at ``TUKEY_SIGMAS``.

    Good carriers weigh alike, which saves the 5 % of variance that Tukey's weight gives away; outliers weigh nothing.

    Examples
    --------
    >>> efficient_weight(np.array([0.0, 2.4, 4.685]))
    array([1., 1., 0.])
    """
    beyond = np.maximum(np.abs(standardised) - CORE_SIGMAS, 0.0) / (TUKEY_SIGMAS - CORE_SIGMAS)
    return np.asarray(np.maximum(1.0 - beyond**2, 0.0) ** 2)


def tukey_cost(standardised: FloatArray) -> FloatArray:
    """Return Tukey's cost of each carrier: half the square near zero, TUKEY_SIGMAS^2 / 6 for outliers.

    Examples
    --------
    >>> tukey_cost(np.array([0.0, 9.0])).round(4)
    array([0.    , 3.6582])
    """
    inside = np.maximum(1.0 - np.square(standardised / TUKEY_SIGMAS), 0.0)
    return np.asarray(TUKEY_SIGMAS**2 / 6.0 * (1.0 - inside**3))


def robust_fit(
    model: QuadraticResponse,
    measured: Measured,
    theta: FloatArray,
    inverse_sigma: FloatArray,
) -> FloatArray:
    """Return the unknowns of the M-estimate nearest to a start: Tukey's weights first, then the efficient ones.

    Parameters
    ----------
    model : QuadraticResponse
        N carriers.
    measured : Measured
        Values.
    theta : ndarray, shape (..., U)
        Start, good enough to tell the outliers.
    inverse_sigma : ndarray, shape (..., N), 1/dB
        Zero for absent carriers.

    Returns
    -------
    ndarray, shape (..., U)
    """
    square = np.square(inverse_sigma)
    for pass_number in range(_PASSES):
        at = linearised(model, measured, theta)
        standardised = at.residual_db * inverse_sigma
        weigh = tukey_weight if pass_number < _TUKEY_PASSES else efficient_weight
        moved = newton_step(at, theta, weigh(standardised) * square)
        step = float(np.abs(moved - theta).max(initial=0.0))
        theta = moved
        if step < _TOLERANCE and pass_number > _TUKEY_PASSES:
            break
    return theta


#: Carriers in a subset. Four of sixteen are all sound in 11.5 % of the subsets when six are wrong, five in 5.8 %: of
#: 3000 rows with six wrong carriers 60 subsets of four lost none, 60 of five lost three.
SUBSET_SIZE = 4
#: 1/deg^2 and 1/dB^2, pull of a subset's fit towards zero (1, 0.7, 0.7 deg; 10 dB): few carriers determine yaw badly.
#: It also decides between two sets of carriers that explain themselves equally well; the fix itself is free of it.
PRIOR_WEIGHT: FloatArray = np.array([1.0, 2.0, 2.0, 0.01])
PRIOR = (PRIOR_WEIGHT, np.diag(PRIOR_WEIGHT))
_CONCENTRATIONS = 2
_FINALISTS = 6
_FINAL_CONCENTRATIONS = 2


def subset_orders(carriers: int, subsets: int = 60) -> IntArray:
    """Return orders of the carriers, shape (subsets, carriers), that start with well spread subsets.

    Keys ``frac(s sqrt(p_i))`` with p_i the primes: the additive recurrence, evenly spread over its cube.

    Examples
    --------
    >>> subset_orders(6, 2)
    array([[2, 4, 0, 5, 3, 1],
           [5, 3, 1, 2, 4, 0]])
    """
    roots = np.sqrt(np.array(_primes(carriers), dtype=np.float64))
    keys = np.mod(np.arange(1, subsets + 1)[:, np.newaxis] * roots, 1.0)
    return np.argsort(keys, axis=1, kind="stable").astype(np.int64)


def _primes(count: int) -> list[int]:
    found: list[int] = []
    candidate = 2
    while len(found) < count:
        if all(candidate % prime for prime in found):
            found.append(candidate)
        candidate += 1
    return found


def trimmed_start(
    model: QuadraticResponse, value_db: FloatArray, inverse_sigma: FloatArray, orders: IntArray
) -> FloatArray:
    """Return attitude and common level of the best trimmed fit of each row.

    Parameters
    ----------
    model : QuadraticResponse
        N carriers, no NaN.
    value_db : ndarray, shape (T, N), dB
        Deviations, 0 where absent.
    inverse_sigma : ndarray, shape (T, N), 1/dB
        Zero where absent.
    orders : ndarray of int, shape (S, N)
        Orders of the carriers.

    Returns
    -------
    ndarray, shape (T, 4)
    """
    is_present = inverse_sigma > 0.0
    trusted = (is_present.sum(axis=1) + 5) // 2
    weight = inverse_sigma[:, np.newaxis] ** 2
    measured = Measured(value_db[:, np.newaxis], np.ones((1, 1, model.slope.shape[0], 1)))
    chosen = _first_present(is_present, orders)
    theta = np.zeros((len(value_db), len(orders), 4))
    theta = newton_step(linearised(model, measured, theta), theta, weight * chosen, PRIOR)
    for _ in range(_CONCENTRATIONS):
        at = linearised(model, measured, theta)
        _, best = _trimmed(at, inverse_sigma, trusted)
        theta = newton_step(at, theta, weight * best, PRIOR)
    cost, _ = _trimmed(linearised(model, measured, theta), inverse_sigma, trusted)
    leading = np.argsort(cost, axis=1, kind="stable")[:, :_FINALISTS]
    theta = np.take_along_axis(theta, leading[..., np.newaxis], axis=1)
    for _ in range(_FINAL_CONCENTRATIONS):
        at = linearised(model, measured, theta)
        _, best = _trimmed(at, inverse_sigma, trusted)
        theta = newton_step(at, theta, weight * best)
    standardised = linearised(model, measured, theta).residual_db * inverse_sigma[:, np.newaxis]
    total = tukey_cost(standardised).sum(axis=2) + 0.5 * np.square(theta) @ PRIOR_WEIGHT
    return np.asarray(theta[np.arange(len(theta)), np.argmin(total, axis=1)])


def _first_present(is_present: BoolArray, orders: IntArray) -> BoolArray:
    """Return for each row and order the mask (T, S, N) of its subset."""
    ordered = is_present[:, orders]
    taken = ordered & (np.cumsum(ordered, axis=2) <= SUBSET_SIZE)
    chosen = np.zeros_like(taken)
    np.put_along_axis(chosen, np.broadcast_to(orders, taken.shape), taken, axis=2)
    return chosen


def _trimmed(at: Linearised, inverse_sigma: FloatArray, trusted: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return the trimmed sum (T, S) and the carriers (T, S, N) in it."""
    square = np.square(at.residual_db * inverse_sigma[:, np.newaxis])
    square += np.where(inverse_sigma > 0.0, 0.0, math.inf)[:, np.newaxis]
    ordered = np.sort(square, axis=2)
    row = np.arange(len(ordered))
    limit = ordered[row, :, np.maximum(trusted - 1, 0)]
    is_summed = np.arange(ordered.shape[2]) < trusted[:, np.newaxis]
    cost = np.sum(ordered, axis=2, where=is_summed[:, np.newaxis])
    return np.asarray(cost), square <= limit[..., np.newaxis]


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
    >>> from service.core.estimation.snapshot import subset_orders
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
