"""Start and single steps of the robust fix."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import QuadraticResponse, predict_jacobian
from service.core.estimation.robust_statistics import TUKEY_SIGMAS, tukey_weight

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
    """Return the first primes."""
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
