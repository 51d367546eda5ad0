"""Arithmetic of the filter's state: what a step does to mean and covariance, and how a row is taken in.

The law of this file: plain arithmetic of arrays, in expressions that numba compiles as they stand; numpy runs the same
source where nothing is compiled. What a number means is the callers' business. `fade` returns arrays of its own, which
`turn` and `add_process_noise` then change in place; nothing else is written.
"""

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    CHAIN,
    FIRST_COMMON,
    RAIN,
    RATE,
    RATE_FLOOR_DEG_H,
    model_error_component,
)

#: attitude, drifts and rates move into one another
_MOVING = 9


def fade(
    mean: FloatArray,
    covariance: FloatArray,
    rain_factor: float,
    seconds: float,
    common_tau_s: FloatArray,
    coloured_tau_s: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, covariance and factors (D,) after every state has decayed by its own correlation time."""
    core = np.ones(FIRST_COMMON)
    core[RAIN] = rain_factor
    common, coloured = np.exp(-seconds / common_tau_s), np.exp(-seconds / coloured_tau_s).T.copy().ravel()
    factor = np.concatenate((core, common, coloured, np.ones(len(coloured_tau_s))))
    return mean * factor, factor.reshape(-1, 1) * factor * covariance, factor


def know_rate(covariance: FloatArray) -> None:
    """Let the rate be known and correlated with nothing, in place."""
    covariance[RATE, :] = 0.0
    covariance[:, RATE] = 0.0
    for position in range(RATE.start, RATE.stop):
        covariance[position, position] = RATE_FLOOR_DEG_H**2


def turn(
    mean: FloatArray,
    covariance: FloatArray,
    transition: FloatArray,
    drift_noise: FloatArray,
    push: FloatArray,
    first_hidden: int,
    first_momentum: int,
) -> None:
    """Move the first nine states: mean to ``T x + push``, covariance to ``T P T' + noise``, in place.

    T (9, 9 + E) takes the first nine states and the E hidden ones, which stand from `first_hidden` on and stay; where
    it has three rows more they move the hidden ones from `first_momentum` on.
    """
    hidden = first_hidden + np.arange(transition.shape[1] - _MOVING)
    positions = np.concatenate((np.arange(_MOVING), hidden))
    targets = np.concatenate((np.arange(_MOVING), first_momentum + np.arange(len(transition) - _MOVING)))
    moved = transition @ covariance[positions]
    own = moved[:, positions] @ transition.T
    moved[:, targets] = 0.5 * (own + own.T) + drift_noise
    # one product serves both sides: symmetric to the last bit
    covariance[targets] = moved
    covariance[:, targets] = moved.T
    mean[targets] = transition @ mean[positions] + push


def add_process_noise(
    covariance: FloatArray,
    factor: FloatArray,
    core_added: FloatArray,
    common_sigma_db: FloatArray,
    coloured_sigma_db: FloatArray,
    coloured_tau_s: FloatArray,
    reference_walk_db: FloatArray,
    scale2: float,
    hours: float,
    held_variance: FloatArray,
    variance: FloatArray,
) -> None:
    """Add the process noise of a step to the diagonal, in place.

    Core (11,) as it is; common (G,) and coloured (N, K) parts what keeps their variance stationary, references (N,) by
    the hour, the last two times `scale2`. One part of each carrier also carries an error of variance `variance` (N,),
    of which the state held `held_variance` (N,) before the step. A growing error is added at once: the attitude has
    moved, and the error with it.
    """
    first = FIRST_COMMON + len(common_sigma_db)
    carriers, components = coloured_sigma_db.shape
    lost = 1.0 - factor[first:-carriers].reshape(components, carriers).T ** 2
    now, held = variance.reshape(-1, 1), held_variance.reshape(-1, 1)
    is_carrying = np.arange(components) == model_error_component(coloured_tau_s).reshape(-1, 1)
    error = np.where(is_carrying, np.maximum(now - (1.0 - lost) * held, lost * now), 0.0)
    coloured = scale2 * coloured_sigma_db**2 * lost + error
    common = common_sigma_db**2 * (1.0 - factor[FIRST_COMMON:first] ** 2)
    reference = scale2 * hours * reference_walk_db**2
    added = np.concatenate((core_added, common, coloured.T.copy().ravel(), reference))
    covariance.ravel()[:: len(covariance) + 1] += added


def linearise(
    mean: FloatArray,
    at_deg: FloatArray,
    gradient_db_deg: FloatArray,
    hessian_db_deg2: FloatArray,
    rain_share: FloatArray,
    deviation_db: FloatArray,
    carriers: IntArray,
    common: int,
    hidden: int,
) -> tuple[FloatArray, FloatArray]:
    """Return innovations (n,) in dB and Jacobian (n, C) of the core states, patterns linearised at `at_deg` (3,)."""
    core = FIRST_COMMON + common + hidden
    bend = (hessian_db_deg2[carriers].reshape(-1, 3) @ at_deg).reshape(-1, 3)
    jacobian = np.ones((len(carriers), core))
    jacobian[:, ATTITUDE] = gradient_db_deg[carriers] + bend
    jacobian[:, ATTITUDE.stop : CHAIN] = 0.0
    jacobian[:, core - hidden :] = 0.0
    jacobian[:, RAIN] = -rain_share[carriers]
    # gradient l - half of bend at: the pattern where it is linearised and its slope from there on
    own = mean[core:].reshape(-1, len(rain_share)).sum(axis=0)[carriers]
    return deviation_db[carriers] + 0.5 * (bend @ at_deg) - jacobian @ mean[:core] - own, jacobian


def project(covariance: FloatArray, jacobian: FloatArray, carriers: IntArray, count: int) -> FloatArray:
    """Return ``H P`` (n, D); `count` is N."""
    core = jacobian.shape[1]
    own = covariance[core:].reshape(-1, count, len(covariance)).sum(axis=0)
    projected: FloatArray = jacobian @ covariance[:core] + own[carriers]
    return projected


def spread(cross: FloatArray, jacobian: FloatArray, carriers: IntArray, count: int) -> FloatArray:
    """Return ``H P H'`` (n, n) of ``H P``, symmetric to the last bit."""
    core = jacobian.shape[1]
    own = np.ascontiguousarray(cross[:, core:]).reshape(len(cross), -1, count).sum(axis=1)
    product = np.ascontiguousarray(cross[:, :core]) @ jacobian.T + own[:, carriers]
    predicted: FloatArray = 0.5 * (product + product.T)
    return predicted


def update_state(
    mean: FloatArray, innovation_db: FloatArray, spread_db2: FloatArray, white_db2: FloatArray, cross: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, ``L^-1 H P`` (n, D) and ``L^-1 nu`` (n,), L the Cholesky factor of the innovations' covariance.

    Raises
    ------
    numpy.linalg.LinAlgError
        The covariance of the innovations is not positive definite.
    """
    factor = np.linalg.cholesky(spread_db2 + np.diag(white_db2))
    whitened, residual = cross.copy(), innovation_db.copy()
    for row in range(len(residual)):
        before = factor[row, :row]
        whitened[row] = (whitened[row] - before @ whitened[:row]) / factor[row, row]
        residual[row] = (residual[row] - before @ residual[:row]) / factor[row, row]
    return mean + residual @ whitened, whitened, residual


def reduce(covariance: FloatArray, whitened: FloatArray) -> FloatArray:
    """Return ``P - W' W`` (D, D) for W of `update_state`, symmetric to the last bit."""
    product = whitened.T @ whitened
    reduced: FloatArray = covariance - 0.5 * (product + product.T)
    return reduced
