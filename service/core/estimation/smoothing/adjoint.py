"""Adjoint of the filter: what later rows say of a state, carried backwards (modified Bryson-Frazier).

    x_s = x + P l,   P_s = P - P M P                  x, P the filter's, l adjoint (D,), M its covariance (D, D)

    step x' = F x + noise              l = F' l',                       M = F' M' F
    row  x' = x + W' w                 l = l' + U' (w - W l'),          M = (I - U' W) M' (I - W' U) + U' U
                                       S = L L',  U = L^-1 H,  W = U P,  w = L^-1 nu

No covariance of the state is inverted, so that a singular one does no harm. Noise of any kind passes: it is in P. The
law of this file: a state that begins again had no past, so that nothing later says anything about it before.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.model.filter_model import FloatArray, IntArray


class Adjoint(NamedTuple):
    """Adjoint of a state of D numbers: the evidence of all later rows about it."""

    #: (D,) and (D, D)
    vector: FloatArray
    covariance: FloatArray


class LinearStep(NamedTuple):
    """Step of a state: most numbers decay by a factor, some are mixtures of others."""

    #: (D,) factor of each number that is no mixture
    factor: FloatArray
    #: (h,) numbers that are mixtures, of which (k,) others, and the shares (h, k)
    targets: IntArray
    sources: IntArray
    shares: FloatArray


class WhitenedRow(NamedTuple):
    """Row of n measurements as it moved the state."""

    #: (n, D) ``L^-1 H`` and ``L^-1 H P``, (n,) ``L^-1 nu``
    jacobian: FloatArray
    cross: FloatArray
    residual: FloatArray


class SmoothedState(NamedTuple):
    """Smoothed numbers (k,) and their covariance (k, k)."""

    mean: FloatArray
    covariance: FloatArray


def no_later_rows(states: int) -> Adjoint:
    """Return the adjoint after the newest row."""
    return Adjoint(np.zeros(states), np.zeros((states, states)))


def whitened_row(
    jacobian: FloatArray, innovation: FloatArray, covariance: FloatArray, cross: FloatArray
) -> WhitenedRow:
    """Return a row from its Jacobian H (n, D), innovations (n,), their covariance S (n, n) and ``H P`` (n, D)."""
    # compiled scipy is imported where it is used
    from scipy.linalg import solve_triangular

    states = jacobian.shape[1]
    lower = np.linalg.cholesky(covariance)
    solved = solve_triangular(lower, np.column_stack([jacobian, cross, innovation]), lower=True, check_finite=False)
    return WhitenedRow(solved[:, :states], solved[:, states:-1], solved[:, -1])


def before_row(adjoint: Adjoint, row: WhitenedRow) -> Adjoint:
    """Return the adjoint before a row."""
    vector = adjoint.vector + row.jacobian.T @ (row.residual - row.cross @ adjoint.vector)
    seen = row.cross @ adjoint.covariance
    # half of the square on either side keeps it symmetric
    middle = seen @ row.cross.T
    middle.ravel()[:: len(middle) + 1] += 1.0
    crossed = row.jacobian.T @ (seen - 0.5 * middle @ row.jacobian)
    return Adjoint(vector, adjoint.covariance - crossed - crossed.T)


def before_step(adjoint: Adjoint, step: LinearStep) -> Adjoint:
    """Return the adjoint before a step; noise and known motion of the step pass."""
    own = step.factor.copy()
    own[step.targets] = 0.0
    vector = own * adjoint.vector
    vector[step.sources] += step.shares.T @ adjoint.vector[step.targets]
    left = own[:, None] * adjoint.covariance
    left[step.sources] += step.shares.T @ adjoint.covariance[step.targets]
    covariance = left * own
    covariance[:, step.sources] += left[:, step.targets] @ step.shares
    return Adjoint(vector, covariance)


def before_start(adjoint: Adjoint, positions: IntArray) -> Adjoint:
    """Return the adjoint before some states began again: nothing later concerns what they were."""
    vector, covariance = adjoint.vector.copy(), adjoint.covariance.copy()
    vector[positions] = 0.0
    covariance[positions] = 0.0
    covariance[:, positions] = 0.0
    return Adjoint(vector, covariance)


def before_resize(adjoint: Adjoint, origin: IntArray, states: int) -> Adjoint:
    """Return the adjoint (states,) of the numbers from which those of now were taken; origin (D,), -1 = it is new."""
    kept = np.flatnonzero(origin >= 0)
    before = no_later_rows(states)
    before.vector[origin[kept]] = adjoint.vector[kept]
    before.covariance[np.ix_(origin[kept], origin[kept])] = adjoint.covariance[np.ix_(kept, kept)]
    return before


def smoothed_state(mean: FloatArray, covariance: FloatArray, adjoint: Adjoint) -> SmoothedState:
    """Return the first k numbers after later rows, from the filter's mean (k,) and covariance rows (k, D)."""
    count = len(mean)
    removed = covariance @ adjoint.covariance @ covariance.T
    own = covariance[:, :count] - 0.5 * (removed + removed.T)
    return SmoothedState(mean + covariance @ adjoint.vector, own)
