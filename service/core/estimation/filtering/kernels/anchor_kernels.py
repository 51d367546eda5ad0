"""Kernels of the anchor: the mixture over the hypotheses of the carriers, and the levels that follow from it.

`carrier_mixture` and `anchor_watch` say what is computed. The law of this file: arrays and numbers only, in expressions
that numba compiles as they stand; the same source is run by numpy where nothing is compiled. A kernel calls functions
of this file alone: numba asks no other file whether its machine code is still that of the source.

Shapes: N carriers of B branches in R regimes, K combinations of branches in work, M = K B candidates for the next K.
"""

import math

import numpy as np

from service.core.arrays import FloatArray, IntArray

#: levels end here, deg, and are found to 1/2^20 of it
_GREATEST_DEG = 3.0
_HALVINGS = 20
#: logarithm of what lies beyond so many sigmas of a normal distribution, and its change to the next; between them it is
#: straight to 1e-5
_STEPS_A_SIGMA = 100.0
_LOG_BEYOND = np.array([math.log(0.5 * math.erfc(step / _STEPS_A_SIGMA / math.sqrt(2.0))) for step in range(3700)])
_LOG_CHANGE = np.append(np.diff(_LOG_BEYOND), 0.0)


def mix(
    jacobian: FloatArray,
    residual_db: FloatArray,
    order: IntArray,
    mean_db: FloatArray,
    variance_db2: FloatArray,
    log_probability: FloatArray,
    regime_log_probability: FloatArray,
    prior_sigma: FloatArray,
    most: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return probability (K,), mean (K, 4), covariance (K, 4, 4) and probability of the branches (N, B).

    The carriers are asked in the order given (n,), at most `most` combinations are kept; the other arguments are those
    of `solve_mixture`.
    """
    regimes, carriers, branches = log_probability.shape
    log_weight, regime = regime_log_probability, np.arange(regimes)
    mean, covariance = np.zeros((regimes, 4)), np.zeros((regimes, 4, 4))
    covariance[:] = np.diag(prior_sigma**2)
    share = np.exp(log_probability).reshape(regimes, carriers * branches)
    for carrier in order:
        row, before = jacobian[carrier], share
        across = (covariance.reshape(-1, 4) @ row).reshape(-1, 4)
        variance = (across @ row).reshape(-1, 1) + variance_db2[carrier]
        surprise = (residual_db[carrier] - mean @ row).reshape(-1, 1) - mean_db[carrier]
        weight = log_weight.reshape(-1, 1) + log_probability[:, carrier][regime]
        candidate = (weight - 0.5 * (np.log(variance) + surprise**2 / variance)).ravel()
        candidate -= candidate.max()
        candidate -= math.log(np.exp(candidate).sum())
        rank = np.argsort(-candidate, kind="mergesort")
        parent, log_weight = rank // branches, candidate[rank]
        gain = across[parent] / variance.ravel()[rank].reshape(-1, 1)
        mean = mean[parent] + gain * surprise.ravel()[rank].reshape(-1, 1)
        covariance = covariance[parent] - gain.reshape(-1, 4, 1) * across[parent].reshape(-1, 1, 4)
        share, regime = before[parent[:most]], regime[parent]
        own, first = np.eye(branches)[rank - parent * branches], carrier * branches
        share[:, first : first + branches] = own[:most]
        if len(rank) > most:
            rest = most - 1
            part = np.exp(log_weight[rest:] - log_weight[rest])
            log_weight[rest] += math.log(part.sum())
            part /= part.sum()
            mean[rest], covariance[rest] = merged(part, mean[rest:], covariance[rest:])
            share[rest] = np.bincount(parent[rest:], part, len(before)) @ before
            share[rest, first : first + branches] = part @ own[rest:]
            regime[rest] = regime[-1]
            log_weight, regime, mean, covariance = log_weight[:most], regime[:most], mean[:most], covariance[:most]
    probability = np.exp(log_weight)
    return probability, mean, covariance, (probability @ share).reshape(carriers, branches)


def merged(part: FloatArray, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (4,) and covariance (4, 4) of combinations (n,) of shares `part`."""
    middle = part @ mean
    apart = mean - middle
    within = part @ covariance.reshape(len(part), 16)
    return middle, within.reshape(4, 4) + (apart * part.reshape(-1, 1)).T @ apart


def levels(probability: FloatArray, mean_deg: FloatArray, sigma_deg: FloatArray, risk: float) -> FloatArray:
    """Return the protection levels (3,) of combinations of probability (K,), mean and sigma (K, 3), deg."""
    count = len(probability)
    mean, sigma = mean_deg.T.copy().ravel(), sigma_deg.T.copy().ravel()
    low, high = np.zeros(3), np.full(3, _GREATEST_DEG)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        level = np.repeat(middle, count)
        outside = beyond((level + mean) / sigma) + beyond((level - mean) / sigma)
        is_passed = outside.reshape(3, count) @ probability > risk
        low, high = np.where(is_passed, middle, low), np.where(is_passed, high, middle)
    return high


def beyond(sigmas: FloatArray) -> FloatArray:
    """Return the probability (n,) of a normal error beyond so many sigmas, on one side."""
    position = np.minimum(np.abs(sigmas) * _STEPS_A_SIGMA, len(_LOG_BEYOND) - 1.0)
    step = position.astype(np.int64)
    tail = np.exp(_LOG_BEYOND[step] + (position - step) * _LOG_CHANGE[step])
    outside: FloatArray = np.where(sigmas < 0.0, 1.0 - tail, tail)
    return outside
