"""Start of the snapshot fix: least trimmed squares from small subsets, robust to nearly half of all carriers.

``min over theta of the sum of the h smallest (r_i / sigma_i)^2``, h = (n + 5) // 2 of n carriers present: with four
unknowns the fit survives ``n - h = floor((n - 4) / 2)`` wrong carriers, the most that any method can. Fits to subsets
of four carriers are improved by concentration (fit, keep the h carriers that fit best, fit again), which never
increases the sum; the best few are concentrated further, and of these the one of least Tukey cost wins: sigmas are
known, so how many carriers agree says more than how closely half of them do. The law of this file: subsets are given
as orders of carriers, of which a row takes the first four that are present, so absent carriers cost no subset, and no
chance is involved.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.quadratic_response import QuadraticResponse
from service.core.estimation.snapshot.snapshot_steps import Linearised, Measured, linearised, newton_step, tukey_cost

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

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
