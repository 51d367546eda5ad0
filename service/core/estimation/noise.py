"""Noise of series: Allan deviation, periodogram, components, quantisation, white and coloured part, noise of means.

Coloured noise of variance s^2 and correlation time tau, averaged over T with x = T/tau, keeps the variance
``2 s^2 (x - 1 + exp(-x)) / x^2``; white noise of n rows keeps ``s^2 / n``.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray

#: fewest pairs of consecutive spans, and the share of a span's usual rows that a mean needs
_MIN_PAIRS, _MIN_SHARE = 3, 0.5


def allan_deviation_db(level_db: FloatArray, epoch_s: FloatArray, span_s: FloatArray) -> FloatArray:
    """Return the Allan deviation of each carrier over some averaging times.

    Parameters
    ----------
    level_db : ndarray, shape (T, N), dB
        NaN = absent.
    epoch_s : ndarray, shape (T,), s
        Ascending.
    span_s : ndarray, shape (S,), s
        Averaging times.

    Returns
    -------
    ndarray, shape (S, N), dB
        NaN with fewer than three pairs of consecutive spans, or where a span is shorter than the rows are apart.

    References
    ----------
    .. [1] Allan, D. W., "Statistics of atomic frequency standards", Proc. IEEE 54, 1966.

    Examples
    --------
    >>> allan_deviation_db(np.array([[0.0], [0.2], [0.0], [0.2]]), 60.0 * np.arange(4), np.array([60.0])).round(3)
    array([[0.141]])
    """
    step_s = float(np.median(np.diff(epoch_s))) if len(epoch_s) > 1 else np.inf
    return np.array([_deviation_db(level_db, epoch_s, float(span), step_s) for span in span_s]).reshape(len(span_s), -1)


def _deviation_db(level_db: FloatArray, epoch_s: FloatArray, span_s: float, step_s: float) -> FloatArray:
    """Return the Allan deviation (N,) over one averaging time."""
    nothing = np.full(level_db.shape[1], np.nan)
    if not len(epoch_s) or span_s < 0.99 * step_s:
        return nothing
    number = np.floor((epoch_s - epoch_s[0]) / span_s + 1e-6).astype(np.int64)
    present = np.isfinite(level_db)
    count, total = np.zeros((number[-1] + 1, level_db.shape[1])), np.zeros((number[-1] + 1, level_db.shape[1]))
    np.add.at(count, number, present)
    np.add.at(total, number, np.where(present, level_db, 0.0))
    means = np.where(count >= max(1.0, _MIN_SHARE * span_s / step_s), total / np.maximum(count, 1.0), np.nan)
    squares = np.square(np.diff(means, axis=0))
    pairs = np.isfinite(squares).sum(axis=0)
    return np.where(pairs >= _MIN_PAIRS, np.sqrt(0.5 * np.nansum(squares, axis=0) / np.maximum(pairs, 1)), nothing)


#: s, the daily change and its second harmonic are fitted before; solar or nodal day, the same to a few minutes
_DAY_S = 86_400.0
#: frequencies on their own at the low end, then groups each longer by this factor
_SINGLE = 16
_GROWTH = 1.12
#: rows of the regular grid at most; finer rows than that are thinned by leaving out
_MAX_ROWS = 60_000


class Grid(NamedTuple):
    """Positions of rows on a regular grid.

    Parameters
    ----------
    position : ndarray of int, shape (K,)
        Grid position of each row that is kept.
    row : ndarray of int, shape (K,)
        Its number among the rows.
    length : int
        Positions of the grid.
    step_s : float, s
        Spacing.
    """

    position: IntArray
    row: IntArray
    length: int
    step_s: float


class Spectra(NamedTuple):
    """Grouped periodograms of N series and the expectations of C correlated parts of unit variance.

    Parameters
    ----------
    power : ndarray, shape (N, F)
        Means of I over the groups.
    expected : ndarray, shape (N, C + 1, F)
        White noise first.
    weight : ndarray, shape (N, F)
        Frequencies in each group; 0 for a series that has too little.
    """

    power: FloatArray
    expected: FloatArray
    weight: FloatArray


def regular_grid(epoch_s: FloatArray) -> Grid:
    """Return the regular grid that rows (T,) in ascending order stand on, at their usual spacing.

    Examples
    --------
    >>> regular_grid(np.array([0.0, 60.0, 121.0, 300.0])).position
    array([0, 1, 2, 5])
    """
    if len(epoch_s) < 2:  # a grid of two empty places keeps every shape downstream
        return Grid(np.zeros(len(epoch_s), dtype=np.int64), np.arange(len(epoch_s)), 2, 1.0)
    step_s = float(np.median(np.diff(epoch_s)))
    step_s = max(step_s, (epoch_s[-1] - epoch_s[0]) / _MAX_ROWS, 1e-6)
    position = np.floor((epoch_s - epoch_s[0]) / step_s + 0.5).astype(np.int64)
    position, row = np.unique(position, return_index=True)
    return Grid(position, row.astype(np.int64), int(position[-1]) + 1, step_s)


def grouped_spectra(residual_db: FloatArray, grid: Grid, tau_s: FloatArray, min_rows: int) -> Spectra:
    """Return the spectra of residuals.

    Parameters
    ----------
    residual_db : ndarray, shape (T, N), dB
        NaN marks an absent sample.
    grid : Grid
        Of the rows.
    tau_s : ndarray, shape (C,), s
        Correlation times.
    min_rows : int
        A series with fewer rows gets no weight.

    Returns
    -------
    Spectra
    """
    values = np.full((residual_db.shape[1], grid.length), np.nan)
    values[:, grid.position] = residual_db[grid.row].T
    is_there = np.isfinite(values)
    rows = is_there.sum(axis=1)
    centred = np.where(is_there, values, 0.0)
    mean = centred.sum(axis=1) / np.maximum(rows, 1)
    centred = np.where(is_there, centred - mean[:, np.newaxis], 0.0)
    first, group = _groups(grid)
    shared = np.maximum(rows, 1)[:, np.newaxis]
    power = np.abs(np.fft.rfft(centred, axis=1)) ** 2 / shared
    pairs = _pairs(is_there)
    lag_s = grid.step_s * np.arange(grid.length)
    kept = np.stack([pairs * np.exp(-lag_s / one) for one in tau_s], axis=1)
    folded = _folded_transform(kept) / shared[:, np.newaxis]
    white = np.ones((len(power), 1, power.shape[1]))
    expected = np.concatenate([white, folded], axis=1)
    size = np.bincount(group[first]).astype(np.float64)
    is_enough = rows >= min_rows
    return Spectra(
        _grouped(power, first, group),
        np.maximum(_grouped(expected, first, group), 1e-12),
        size * is_enough[:, np.newaxis],
    )


def _groups(grid: Grid) -> tuple[IntArray, IntArray]:
    """Return the frequencies that take part and, for every frequency, its group."""
    count = grid.length // 2 + 1
    number = np.arange(count)
    cycles = grid.length * grid.step_s / _DAY_S * np.array([1.0, 2.0])
    is_daily = (np.abs(number[:, np.newaxis] - cycles) < 0.75).any(axis=1)
    usable = np.flatnonzero((number > 0) & ~is_daily)
    if not len(usable):
        usable = number[-1:]
    edges = [0]
    while edges[-1] < len(usable):
        edges.append(edges[-1] + max(1, int(edges[-1] * (_GROWTH - 1.0))) if edges[-1] >= _SINGLE else edges[-1] + 1)
    group = np.zeros(count, dtype=np.int64)
    group[usable] = np.searchsorted(np.array(edges[1:]), np.arange(len(usable)), side="right")
    return usable.astype(np.int64), group


def _grouped(values: FloatArray, usable: IntArray, group: IntArray) -> FloatArray:
    """Return means (..., F) over the groups of the last axis."""
    numbers = group[usable]
    starts = np.searchsorted(numbers, np.arange(int(numbers[-1]) + 1))
    size = np.diff(np.append(starts, len(numbers)))
    return np.asarray(np.add.reduceat(values[..., usable], starts, axis=-1) / size)


def _pairs(is_there: NDArray[np.bool_]) -> FloatArray:
    """Return how many pairs (N, G) stand at each lag."""
    count = is_there.shape[1]
    spectrum = np.abs(np.fft.rfft(is_there.astype(np.float64), n=2 * count, axis=1)) ** 2
    return np.asarray(np.fft.irfft(spectrum, n=2 * count, axis=1)[:, :count])


def _folded_transform(kept: FloatArray) -> FloatArray:
    """Return ``sum_lag kept(|lag|) exp(-2 pi i f lag)`` over both signs of the lag, at the frequencies of the grid."""
    folded = kept.copy()
    # at these frequencies lags count modulo the grid: lag -k falls on G - k
    folded[..., 1:] += kept[..., :0:-1]
    return np.asarray(np.fft.rfft(folded, axis=-1).real)


_PASSES = 500
#: variance below this is nothing, dB^2
_LEAST_DB2 = 1e-12


def fitted_variances(
    spectra: Spectra, start_db2: FloatArray, prior_db2: FloatArray, prior_weight: FloatArray
) -> FloatArray:
    """Return the variances of each series' parts.

    Parameters
    ----------
    spectra : Spectra
        N series, C + 1 parts, F groups.
    start_db2 : ndarray, shape (N, C + 1), dB^2
        Where the climb begins, > 0.
    prior_db2 : ndarray, shape (N, C + 1), dB^2
        Where each variance is drawn to.
    prior_weight : ndarray, shape (C + 1,)
        How many frequencies that is worth; 0 = nothing.

    Returns
    -------
    ndarray, shape (N, C + 1), dB^2
    """
    variance = np.maximum(start_db2, _LEAST_DB2)
    for _ in range(_PASSES):
        measured, expected = _gradients(spectra, variance)
        measured = measured + prior_weight * prior_db2 / variance**2
        expected = expected + prior_weight / variance
        variance = np.maximum(variance * np.sqrt(measured / np.maximum(expected, 1e-300)), _LEAST_DB2)
    return variance


def pooled_variances(spectra: Spectra, start_db2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variances that all series share, each with its own white noise, and their standard errors.

    Parameters
    ----------
    spectra : Spectra
        N series.
    start_db2 : ndarray, shape (N, C + 1), dB^2
        Where the climb begins, > 0.

    Returns
    -------
    shared_db2 : ndarray, shape (C,), dB^2
        Of the correlated parts.
    error_db2 : ndarray, shape (C,), dB^2
        One standard error of each, the other parts being unknown too.
    """
    white = np.maximum(start_db2[:, :1], _LEAST_DB2)
    is_seen = spectra.weight.any(axis=1)
    shared = np.maximum(start_db2[is_seen, 1:].mean(axis=0), _LEAST_DB2) if is_seen.any() else start_db2[0, 1:]
    for _ in range(_PASSES):
        measured, expected = _gradients(spectra, _with_white(white, shared))
        expected = np.maximum(expected, 1e-300)
        white = np.maximum(white * np.sqrt(measured[:, :1] / expected[:, :1]), _LEAST_DB2)
        shared = np.maximum(shared * np.sqrt(measured[:, 1:].sum(axis=0) / expected[:, 1:].sum(axis=0)), _LEAST_DB2)
    total = np.einsum("nc,ncf->nf", _with_white(white, shared), spectra.expected)
    relative = spectra.expected / total[:, np.newaxis]
    information = np.einsum("nf,ncf,ndf->cd", spectra.weight, relative, relative)
    scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True)
    return shared, (np.sqrt(np.maximum(np.diagonal(inverse), 0.0)) / scale)[1:]


def _gradients(spectra: Spectra, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what periodograms and their expectations pull each variance (N, C + 1) up and down by."""
    total = np.einsum("nc,ncf->nf", variance, spectra.expected)
    weight = spectra.weight / total
    measured = np.einsum("ncf,nf->nc", spectra.expected, weight * spectra.power / total)
    return measured, np.einsum("ncf,nf->nc", spectra.expected, weight)


def _with_white(white: FloatArray, shared: FloatArray) -> FloatArray:
    """Return the variances (N, C + 1) of own white noise (N, 1) and shared correlated parts (C,)."""
    return np.concatenate([white, np.broadcast_to(shared, (len(white), len(shared)))], axis=1)


#: dB, resolution of the histogram; steps from five of it up to ``_LARGEST_DB`` are looked for.
_BIN_DB = 0.002
_SMALLEST_DB = 0.01
_LARGEST_DB = 1.0
#: dB, readings further from the median belong to something else.
_REACH_DB = 4.0
#: Rows without which nothing is said.
_MIN_ROWS = 200
#: R that chance does not reach: at least this, and this many of its standard deviations.
_LEAST = 0.2
_CHANCE_SIGMAS = 8.0
_PADDED = 1 << 14


def quantisation_step_db(power_dbm: FloatArray) -> float:
    """Return the step of readings (T,), 0 where none is seen.

    Parameters
    ----------
    power_dbm : ndarray, shape (T,), dBm
        Readings; NaN = absent.

    Returns
    -------
    float, dB
        Good to about one per cent.

    Examples
    --------
    >>> level = np.random.default_rng(1).normal(-40.0, 0.2, 1000)
    >>> round(quantisation_step_db(np.round(level / 0.15) * 0.15), 2), quantisation_step_db(level)
    (0.15, 0.0)
    """
    known = power_dbm[np.isfinite(power_dbm)]
    if len(known) < _MIN_ROWS:
        return 0.0
    # relative to a whole number of bins, so that a grid keeps its place
    centre = round(float(np.median(known)) / _BIN_DB)
    position = np.round(known / _BIN_DB).astype(np.int64) - centre + round(_REACH_DB / _BIN_DB)
    bins = 2 * round(_REACH_DB / _BIN_DB) + 1
    near = position[(position >= 0) & (position < bins)]
    histogram = np.bincount(near, minlength=bins) / max(len(near), 1)
    found = np.abs(np.fft.rfft(histogram, n=_PADDED))
    frequency = np.arange(len(found)) / (_PADDED * _BIN_DB)
    least = max(_LEAST, _CHANCE_SIGMAS / math.sqrt(len(near)))
    # the distribution as a whole is one lobe from zero on; the grid shows after it has died away
    below = np.flatnonzero(found < 0.5 * least)
    if not len(below):
        return 0.0
    is_open = (np.arange(len(found)) > below[0]) & (frequency >= 1.0 / _LARGEST_DB) & (frequency <= 1.0 / _SMALLEST_DB)
    high = np.flatnonzero(is_open & (found >= least))
    if not len(high):
        return 0.0
    # harmonics of a sharp grid are as high as the first: the lowest peak is the grid
    last = high[0] + np.argmax(np.append(found[high[0] :] < 0.5 * least, True))
    peak = high[0] + int(np.argmax(found[high[0] : last]))
    return float(1.0 / frequency[peak])


#: lags between which the decay of the autocovariance is read, rows; shorter ones hold the white part,
#: longer ones are noise
_FIRST_LAG = 3
_LAST_LAG = 20


class NoiseSplit(NamedTuple):
    """White and coloured part of a residual."""

    sigma_white_db: float
    sigma_coloured_db: float
    #: 0 where no coloured part was found
    correlation_time_s: float


def split_noise(residual_db: FloatArray, row_period_s: float) -> NoiseSplit:
    """Split the variance of a residual into a white and an exponentially correlated part.

    Parameters
    ----------
    residual_db : ndarray, shape (T,), dB
        Residual of evenly spaced rows; NaN = absent.
    row_period_s : float, s
        Spacing of the rows.

    Returns
    -------
    NoiseSplit
        Sigmas whose squares add up to the variance. NaN sigmas with fewer than 60 rows present. Over three days of
        60 s rows the sigmas are good to about 10 %, the correlation time to a factor of about 1.5.
    """
    if int(np.count_nonzero(np.isfinite(residual_db))) < 3 * _LAST_LAG:
        return NoiseSplit(float("nan"), float("nan"), 0.0)
    centred = residual_db - np.nanmean(residual_db)
    variance = float(np.nanmean(centred**2))
    lags = np.arange(_FIRST_LAG, _LAST_LAG + 1)
    covariance = np.array([_mean_present(centred[lag:] * centred[:-lag]) for lag in lags])
    usable = covariance > 0.02 * variance
    if np.count_nonzero(usable) < 3:
        return NoiseSplit(float(np.sqrt(variance)), 0.0, 0.0)
    slope, intercept = np.polyfit(lags[usable] * row_period_s, np.log(covariance[usable]), 1)
    coloured = float(np.clip(np.exp(intercept), 0.0, variance))
    # a slope that is not a decay means a correlation longer than the lags can show
    correlation_time_s = -1.0 / slope if slope < 0.0 else _LAST_LAG * row_period_s * 10.0
    return NoiseSplit(float(np.sqrt(variance - coloured)), float(np.sqrt(coloured)), float(correlation_time_s))


def _mean_present(values: FloatArray) -> float:
    """Return the mean of the values that are not NaN, NaN when there are none."""
    present = values[np.isfinite(values)]
    return float(present.mean()) if present.size else float("nan")


def averaged_sigma_db(
    sigma_white_db: FloatArray,
    sigma_coloured_db: FloatArray,
    correlation_time_s: FloatArray,
    *,
    rows: int,
    span_s: float,
) -> FloatArray:
    """Return one standard deviation of the mean of some rows.

    Parameters
    ----------
    sigma_white_db : ndarray, shape (N,), dB
        White noise of one row.
    sigma_coloured_db : ndarray, shape (N,) or (N, C), dB
        One coloured part of each, or C of them.
    correlation_time_s : ndarray, shape (N,) or (N, C), s
        Their correlation times; 0 = there is none.
    rows : int
        Rows in the mean, at least 1.
    span_s : float, s
        Time that the rows cover.

    Returns
    -------
    ndarray, shape (N,), dB

    Examples
    --------
    >>> sigma = averaged_sigma_db(np.array([0.3]), np.array([0.0]), np.array([0.0]), rows=9, span_s=540.0)
    >>> round(float(sigma[0]), 6)
    0.1
    """
    ratio = span_s / np.maximum(correlation_time_s, 1e-9)
    # below 1e-3 the closed form loses its digits; its limit is one
    safe = np.maximum(ratio, 1e-3)
    kept = np.where(ratio < 1e-3, 1.0, 2.0 * (safe - 1.0 + np.exp(-safe)) / safe**2)
    coloured = sigma_coloured_db**2 * kept
    if coloured.ndim > 1:
        coloured = coloured.sum(axis=-1)
    sigma: FloatArray = np.sqrt(sigma_white_db**2 / max(rows, 1) + coloured)
    return sigma
