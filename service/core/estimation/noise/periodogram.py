"""Periodograms of residuals with gaps, and what each kind of noise is expected to leave in them.

``I(f) = |sum m_t x_t exp(-2 pi i f t)|^2 / sum m_t``, m_t 1 where the row is there and 0 where it is not. Of noise with
autocovariance R the expectation is ``sum_lag c(lag) R(lag) exp(-2 pi i f lag) / sum m_t`` with c the number of pairs at
that lag: exact for any window and any gaps, so neither a finite window nor a storm cut out of it biases an estimate
(the "debiased Whittle likelihood" of Sykulski and others, Biometrika 106, 2019). The law of this file: frequencies that
a calibration's own daily change has emptied, once and twice a day, and the zero that the level has, take no part.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
