"""Least trimmed squares: a first fit that up to 45 per cent of the samples cannot spoil.

``min over c of the sum of the h smallest (y_b - x_b' c)^2``, h a little more than half. Search: fits to small sets of
rows, each improved by *concentration* (fit, keep the h rows that fit best, fit again), which never increases the sum.
The law of this file: the sets come from an additive recurrence (step s takes row ``frac(s alpha + k / K)`` of the
samples, alpha the golden section), so that each set is spread over the whole stretch and the same data always give the
same answer.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Share of the samples that the fit trusts.
TRUSTED_SHARE = 0.53
#: Additive steps, the square roots of small primes: the places of one set move independently of each other.
_STEPS = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0]))
_CONCENTRATIONS = 4
#: Relative weight of the pull towards zero that keeps a fit to a degenerate set finite.
_RIDGE = 1e-6


def spread_sets(samples: int, size: int, sets: int) -> IntArray:
    """Return row indices (sets, size) that fill the samples evenly and look like chance.

    Examples
    --------
    >>> spread_sets(100, 3, 2)
    array([[41, 73, 23],
           [82, 46, 47]])
    """
    step = np.arange(1, sets + 1)[:, np.newaxis]
    return np.asarray(np.floor(np.mod(step * _STEPS[:size], 1.0) * samples), dtype=np.int64)


def trimmed_fit(columns: FloatArray, values: FloatArray, is_present: BoolArray, sets: int = 80) -> FloatArray:
    """Return coefficients that fit the better half of each carrier's samples.

    Parameters
    ----------
    columns : ndarray, shape (N, B, K)
        Columns of the model, K <= 10.
    values : ndarray, shape (N, B)
        Samples.
    is_present : ndarray of bool, shape (N, B)
        Samples that exist.
    sets : int
        Starts of the search.

    Returns
    -------
    ndarray, shape (N, K)
        Zero for a carrier with fewer samples than coefficients.

    Examples
    --------
    >>> line = np.stack([np.ones(40), np.arange(40.0)], axis=1)[np.newaxis]
    >>> values = (line @ [1.0, 0.5]) + np.where(np.arange(40) < 17, 30.0, 0.0)
    >>> trimmed_fit(line, values, np.ones((1, 40), dtype=bool)).round(3)
    array([[1. , 0.5]])
    """
    return np.array(
        [_fit_one(x[seen], y[seen], sets) for x, y, seen in zip(columns, values, is_present, strict=True)]
    ).reshape(len(columns), columns.shape[2])


def _fit_one(columns: FloatArray, values: FloatArray, sets: int) -> FloatArray:
    """Return the coefficients of one carrier."""
    samples, size = columns.shape
    if samples <= size:
        return np.zeros(size)
    length = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns / np.where(length > 0.0, length, 1.0)
    trusted = max(size + 1, math.ceil(TRUSTED_SHARE * samples))
    # two rows more than unknowns: a fit through exactly as many rows as unknowns is mostly noise
    chosen = spread_sets(samples, min(size + 2, len(_STEPS)), sets)
    fits = _least_squares(scaled[chosen], values[chosen])
    for _ in range(_CONCENTRATIONS):
        misfit = np.square(values - fits @ scaled.T)
        best = np.argpartition(misfit, trusted - 1, axis=1)[:, :trusted]
        cost = np.take_along_axis(misfit, best, axis=1).sum(axis=1)
        # half of the starts go on after each pass
        leading = np.argsort(cost, kind="stable")[: max(len(cost) // 2, 4)]
        fits = _least_squares(scaled[best[leading]], values[best[leading]])
    misfit = np.sort(np.square(values - fits @ scaled.T), axis=1)[:, :trusted].sum(axis=1)
    winner = fits[int(np.argmin(misfit))]
    return np.asarray(winner / np.where(length > 0.0, length, 1.0))


def _least_squares(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return least-squares fits (S, K) of sets (S, R, K)."""
    transposed = np.swapaxes(columns, 1, 2)
    normal = transposed @ columns
    ridge = _RIDGE * columns.shape[1] * np.eye(columns.shape[2])
    return np.asarray(np.linalg.solve(normal + ridge, transposed @ values[..., np.newaxis])[..., 0])
