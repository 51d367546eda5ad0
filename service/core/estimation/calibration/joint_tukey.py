"""Tukey's M-estimate of all carriers jointly, from a trimmed start of each."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    DOWNLINK_PRIOR_DB_PER_DEG,
    SOLAR_SIZE,
)


class SeparableFit(NamedTuple):
    """Fit of N carriers with K own and R shared coefficients.

    Parameters
    ----------
    own : ndarray, shape (N, K)
        c.
    shared : ndarray, shape (R,)
        t.
    own_covariance : ndarray, shape (N, K, K)
        Of c_i, the errors of t included.
    shared_covariance : ndarray, shape (R, R)
        Of t.
    gain : ndarray, shape (N, K, R)
        ``d c_i / d t``: the errors of c_i and c_j correlate by ``gain_i shared_covariance gain_j'``.
    """

    own: FloatArray
    shared: FloatArray
    own_covariance: FloatArray
    shared_covariance: FloatArray
    gain: FloatArray


def fit_separable(
    own_columns: FloatArray, shared_columns: FloatArray, values: FloatArray, own_prior: FloatArray, shared_prior: float
) -> SeparableFit:
    """Return the joint fit.

    Parameters
    ----------
    own_columns : ndarray, shape (N, B, K)
        A, rows whitened; rows of absent samples are zero.
    shared_columns : ndarray, shape (N, B, R)
        S, whitened alike.
    values : ndarray, shape (N, B)
        y, whitened alike.
    own_prior : ndarray, shape (N, K)
        One sigma of each own coefficient before the data; 0 holds it at zero.
    shared_prior : float
        The same for the shared ones, > 0.

    Returns
    -------
    SeparableFit

    Examples
    --------
    >>> own, shared = np.ones((2, 3, 1)), np.array([[[0.0], [1.0], [2.0]], [[0.0], [1.0], [3.0]]])
    >>> fit = fit_separable(own, shared, own[..., 0] * 5.0 + shared[..., 0] * 2.0, np.full((2, 1), 1e6), 1e6)
    >>> fit.own.round(6), fit.shared.round(6)
    (array([[5.],
           [5.]]), array([2.]))
    """
    carriers, _, own_size = own_columns.shape
    shared_size = shared_columns.shape[2]
    is_free = own_prior > 0.0
    prior_row = np.eye(own_size) / np.where(is_free, own_prior, 1.0)[:, np.newaxis]
    own = np.concatenate([own_columns * is_free[:, np.newaxis], prior_row], axis=1)
    pad = np.zeros((carriers, own_size, shared_size + 1))
    rest = np.concatenate([shared_columns, values[..., np.newaxis]], axis=2)
    triangle = _triangle(np.concatenate([own, np.concatenate([rest, pad], axis=1)], axis=2))
    upper = triangle[:, :own_size, :own_size]
    coupling = triangle[:, :own_size, own_size:-1]
    below = triangle[:, own_size:, own_size:].reshape(-1, shared_size + 1)
    stacked = np.concatenate([below, np.eye(shared_size, shared_size + 1) / shared_prior])
    shared_triangle = _triangle(stacked)
    shared_root = np.linalg.inv(shared_triangle[:shared_size, :shared_size])
    shared = shared_root @ shared_triangle[:shared_size, shared_size]
    inverse = np.linalg.inv(upper)
    gain = -inverse @ coupling
    right = triangle[:, :own_size, -1]
    own_fit = np.einsum("nij,nj->ni", inverse, right) + gain @ shared
    shared_covariance = shared_root @ shared_root.T
    held = np.where(is_free, 1.0, 0.0)
    own_covariance = inverse @ np.swapaxes(inverse, 1, 2) + gain @ shared_covariance @ np.swapaxes(gain, 1, 2)
    return SeparableFit(
        own=own_fit * held,
        shared=shared,
        own_covariance=own_covariance * held[:, :, np.newaxis] * held[:, np.newaxis],
        shared_covariance=shared_covariance,
        gain=gain * held[:, :, np.newaxis],
    )


def _triangle(equations: FloatArray) -> FloatArray:
    """Return R of the QR decomposition of equations (..., rows, unknowns + 1)."""
    return np.asarray(np.linalg.qr(equations, mode="r"))


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


#: Sigmas at which Tukey's weight becomes zero; 95 % efficient on normal noise.
TUKEY_SIGMAS = 4.685
_TUKEY_PASSES = 8
_MAD_TO_SIGMA = 1.4826


class JointProblem(NamedTuple):
    """Thinned rows of N carriers in B stretches.

    Parameters
    ----------
    own : ndarray, shape (N, B, K)
        Columns of the carriers' own coefficients, the beam's last.
    shared : ndarray, shape (N, B, R)
        Columns of the shared ones.
    value : ndarray, shape (N, B), dB
        Powers less a rough level.
    rows_used : ndarray, shape (N, B)
        Rows in each mean; 0 = absent.
    centre_s, span_s : ndarray, shape (B,), s
        Middle and length of the stretches.
    is_near_zero : ndarray of bool, shape (B,)
        Stretches that tell level and daily change.
    beam_size : int
        How many of the own columns answer to the attitude.
    """

    own: FloatArray
    shared: FloatArray
    value: FloatArray
    rows_used: FloatArray
    centre_s: FloatArray
    span_s: FloatArray
    is_near_zero: BoolArray
    beam_size: int = BEAM_SIZE


def fit_jointly(problem: JointProblem, prior: FloatArray, white_db: FloatArray) -> tuple[SeparableFit, FloatArray]:
    """Return Tukey's joint fit, and the weights.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows.
    prior : ndarray, shape (N, K)
        One sigma of each own coefficient before the data.
    white_db : ndarray, shape (N,), dB
        White noise of one row.

    Returns
    -------
    fit : SeparableFit
        Coefficients.
    weight : ndarray, shape (N, B)
        Tukey's weights, 0 where absent.
    """
    is_present = problem.rows_used > 0
    base = problem.own.shape[2] - problem.beam_size
    is_quiet = is_present & problem.is_near_zero
    # the solar day looks like the dish's; the start does without
    first = problem.own[..., : base - SOLAR_SIZE]
    misfit = problem.value - np.einsum("nbk,nk->nb", first, trimmed_fit(first, problem.value, is_quiet))
    # quiet rows outnumber the turns: trimmed together, the turns could go as outliers and nobody would know the beam
    is_turned = is_present & ~problem.is_near_zero
    beam = problem.own[..., base:]
    misfit = misfit - np.einsum("nbk,nk->nb", beam, trimmed_fit(beam, misfit, is_turned))
    white = np.maximum(white_db, 1e-4)[:, np.newaxis] ** 2 / np.maximum(problem.rows_used, 1)
    fit, weight = None, np.zeros_like(white)
    for _ in range(_TUKEY_PASSES):
        spread = _robust_scale(misfit, is_present)[:, np.newaxis]
        # what the spread of the stretches has beyond white noise is taken alike for all of them
        white_share = _masked_mean(white, is_present)[:, np.newaxis]
        sigma = np.sqrt(white + np.maximum(spread**2 - white_share, 0.0))
        weight = np.where(is_present, _tukey_weight(misfit / sigma), 0.0)
        root = np.sqrt(weight) / sigma
        fit = _joint(problem, prior, root)
        misfit = problem.value - _model(problem, fit)
    return fit or _joint(problem, prior, weight), weight


def _joint(problem: JointProblem, prior: FloatArray, root: FloatArray) -> SeparableFit:
    """Return the joint fit of rows multiplied by ``root`` (N, B)."""
    scaled = root[..., np.newaxis]
    return fit_separable(
        problem.own * scaled, problem.shared * scaled, problem.value * root, prior, DOWNLINK_PRIOR_DB_PER_DEG
    )


def _model(problem: JointProblem, fit: SeparableFit) -> FloatArray:
    """Return the model (N, B) at the stretches."""
    return np.asarray(np.einsum("nbk,nk->nb", problem.own, fit.own) + problem.shared @ fit.shared)


def _tukey_weight(standardised: FloatArray) -> FloatArray:
    """Return Tukey's biweight."""
    inside = np.maximum(1.0 - np.square(standardised / TUKEY_SIGMAS), 0.0)
    return np.asarray(inside**2)


def _robust_scale(misfit: FloatArray, is_present: BoolArray) -> FloatArray:
    """Return the spread (N,) of the present values from their median size."""
    ordered = np.sort(np.where(is_present, np.abs(misfit), math.inf), axis=1)
    middle = np.maximum(is_present.sum(axis=1) - 1, 0) // 2
    size = ordered[np.arange(len(ordered)), middle]
    return np.where(np.isfinite(size), np.maximum(_MAD_TO_SIGMA * size, 1e-4), 1.0)


def _masked_mean(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Return means (N,) over the mask."""
    return np.asarray((values * mask).sum(axis=1) / np.maximum(mask.sum(axis=1), 1))
