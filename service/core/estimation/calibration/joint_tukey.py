"""Tukey's M-estimates from a trimmed start: of all carriers jointly, and of the daily change of each alone.

Daily change of one stretch of powers, carrier by carrier, whatever up to 45 per cent of the samples do:
``P_i(t) = h_i + x_i(t)' d_i``, x the columns of the dish law or of two harmonics (``geometry_columns.daily_columns``).
The scale is held at that of the start. The law of this part: a carrier with fewer present samples than
``MIN_SAMPLES_PER_COEFFICIENT`` a coefficient is NaN, never a curve through noise.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, DOWNLINK_PRIOR_DB_PER_DEG, SOLAR_SIZE
from service.core.estimation.robust_statistics import MAD_TO_SIGMA, TUKEY_SIGMAS, middle_values, tukey_weight


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


_TUKEY_PASSES = 8


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
        white_share = (white * is_present).sum(axis=1) / np.maximum(is_present.sum(axis=1), 1)
        sigma = np.sqrt(white + np.maximum(spread**2 - white_share[:, np.newaxis], 0.0))
        weight = np.where(is_present, tukey_weight(misfit / sigma), 0.0)
        root = np.sqrt(weight) / sigma
        fit = _joint(problem, prior, root)
        misfit = problem.value - (np.einsum("nbk,nk->nb", problem.own, fit.own) + problem.shared @ fit.shared)
    return fit or _joint(problem, prior, weight), weight


def _joint(problem: JointProblem, prior: FloatArray, root: FloatArray) -> SeparableFit:
    """Return the joint fit of rows multiplied by ``root`` (N, B)."""
    scaled = root[..., np.newaxis]
    return fit_separable(
        problem.own * scaled, problem.shared * scaled, problem.value * root, prior, DOWNLINK_PRIOR_DB_PER_DEG
    )


def _robust_scale(misfit: FloatArray, is_present: BoolArray) -> FloatArray:
    """Return the spread (N,) of the present values from their median size."""
    size, _ = middle_values(np.where(is_present, np.abs(misfit), math.nan), axis=1)
    return np.where(np.isfinite(size), np.maximum(MAD_TO_SIGMA * size, 1e-4), 1.0)


MIN_SAMPLES_PER_COEFFICIENT = 4
#: Samples from which the trimmed start is taken, evenly spread; it only has to find the right half.
_START_SAMPLES = 1500
_MAX_PASSES = 50
#: dB, the fixed point is reached when no fitted value moves by more.
_TOLERANCE_DB = 1e-6
_MIN_SCALE_DB = 1e-9
_SCALE_PASSES = 3
_REACH_SIGMAS = 2.5


class DailyFits(NamedTuple):
    """Fits of N carriers with K = 1 + D coefficients; NaN for a carrier that was not fitted.

    Parameters
    ----------
    coefficients : ndarray, shape (N, K)
        Level in dBm, then the daily ones.
    covariance : ndarray, shape (N, K, K)
        For independent residuals of any distribution.
    rms_db : ndarray, shape (N,), dB
        Of the samples used.
    samples_used, samples_rejected : ndarray of int, shape (N,)
        Present samples with and without weight.
    converged : ndarray of bool, shape (N,)
        Whether the fixed point was reached.
    """

    coefficients: FloatArray
    covariance: FloatArray
    rms_db: FloatArray
    samples_used: IntArray
    samples_rejected: IntArray
    converged: BoolArray


def fit_daily(columns: FloatArray, power_dbm: FloatArray) -> DailyFits:
    """Return the robust fits.

    Parameters
    ----------
    columns : ndarray, shape (T, N, D)
        Columns of the daily change without the level; NaN makes a sample absent.
    power_dbm : ndarray, shape (T, N), dBm
        NaN marks an absent sample.

    Returns
    -------
    DailyFits

    References
    ----------
    .. [1] Yohai, V., "High breakdown-point and high efficiency robust estimates for regression", Annals of Statistics
       15, 1987 (a robust start whose scale is kept).

    Examples
    --------
    >>> phase = np.linspace(0.0, 2.0 * np.pi, 200)
    >>> power = -40.0 + 0.3 * np.cos(phase)
    >>> power[20:90] -= 3.0
    >>> fit_daily(np.cos(phase)[:, np.newaxis, np.newaxis], power[:, np.newaxis]).coefficients.round(6)
    array([[-40. ,   0.3]])
    """
    carriers, size = power_dbm.shape[1], columns.shape[2] + 1
    fits = [_daily_fit(columns[:, k], power_dbm[:, k], size) for k in range(carriers)]
    parts = list(zip(*fits, strict=True)) if fits else [()] * 6
    return DailyFits(
        np.array(parts[0]).reshape(carriers, size),
        np.array(parts[1]).reshape(carriers, size, size),
        np.array(parts[2], dtype=np.float64),
        np.array(parts[3], dtype=np.int64),
        np.array(parts[4], dtype=np.int64),
        np.array(parts[5], dtype=np.bool_),
    )


def _daily_fit(
    columns: FloatArray, power_dbm: FloatArray, size: int
) -> tuple[FloatArray, FloatArray, float, int, int, bool]:
    """Return coefficients, covariance, rms, samples used and rejected, and convergence of one carrier."""
    is_present = np.isfinite(power_dbm) & np.isfinite(columns).all(axis=1)
    samples = int(np.count_nonzero(is_present))
    if samples < MIN_SAMPLES_PER_COEFFICIENT * size:
        return np.full(size, math.nan), np.full((size, size), math.nan), math.nan, 0, 0, False
    design = np.column_stack([np.ones(samples), columns[is_present]])
    middle = float(np.median(power_dbm[is_present]))
    values = power_dbm[is_present] - middle
    fit, scale = _start(design, values)
    fitted, weight, is_converged = design @ fit, np.ones(samples), False
    for _ in range(_MAX_PASSES):
        weight = tukey_weight((values - fitted) / scale)
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(design * root[:, np.newaxis], values * root, rcond=None)[0]
        moved, fitted = float(np.abs(design @ fit - fitted).max()), design @ fit
        if moved <= _TOLERANCE_DB:
            is_converged = True
            break
    is_used = weight > 0.0
    residual, used = values[is_used] - fitted[is_used], int(np.count_nonzero(is_used))
    covariance = _covariance(design[is_used], residual, TUKEY_SIGMAS * scale)
    fit[0] += middle
    return fit, covariance, math.sqrt(float(np.mean(residual**2))), used, samples - used, is_converged


def _covariance(design: FloatArray, residual: FloatArray, limit_db: float) -> FloatArray:
    """Return the covariance of a Tukey fit whose residuals are independent, of whatever distribution."""
    inside = 1.0 - np.square(residual / limit_db)
    pull = residual * inside**2
    slope = float(np.mean(inside * (1.0 - 5.0 * np.square(residual / limit_db))))
    inverse = np.linalg.pinv(slope * design.T @ design)
    return np.asarray(inverse @ (design * np.square(pull)[:, np.newaxis]).T @ design @ inverse)


def _start(design: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Return trimmed coefficients and the robust scale of what they leave."""
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), _START_SAMPLES)).astype(np.int64))
    is_present = np.ones((1, len(chosen)), dtype=np.bool_)
    fit = trimmed_fit(design[chosen][np.newaxis], values[chosen][np.newaxis], is_present)[0]
    distance = np.abs(values - design @ fit)
    scale = MAD_TO_SIGMA * float(np.median(distance))
    # with many wrong samples the median is a large quantile of the good ones: look again at those within reach
    for _ in range(_SCALE_PASSES):
        scale = MAD_TO_SIGMA * float(np.median(distance[distance <= _REACH_SIGMAS * scale]))
    return fit, max(scale, _MIN_SCALE_DB)
