"""Mean of the last minutes of every carrier, as a pure step over rows.

``mean_i = sum over rows with epoch > newest - window of x_i / count_i``, x in dB or dBm, NaN = absent. The law of this
file: the mean depends on the rows inside the window and on nothing else. They are copied together in order of epoch
and added in that order, so that a replay from any earlier state gives the live figures bit for bit, whatever older rows
either state still holds.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class TrailingMean(NamedTuple):
    """Rows kept for the mean; arrays are read-only.

    Parameters
    ----------
    epoch_us : ndarray, shape (R,), microseconds UTC
        Strictly increasing.
    rows : ndarray, shape (R, N)
        Values of the carriers, NaN = absent.
    horizon_us : int, microseconds
        Rows this much older than the newest are forgotten; no window may be longer.
    """

    epoch_us: IntArray
    rows: FloatArray
    horizon_us: int


def empty_window(carriers: int, horizon_s: float = 3600.0) -> TrailingMean:
    """Return a window that holds no row yet.

    Examples
    --------
    >>> state = push(empty_window(2), 60_000_000, np.array([1.0, np.nan]))
    >>> mean(push(state, 120_000_000, np.array([3.0, 5.0])), window_s=900.0, min_rows=1)
    array([2., 5.])
    """
    return _frozen(np.empty(0, dtype=np.int64), np.empty((0, carriers)), round(horizon_s * 1e6))


def push(window_state: TrailingMean, epoch_us: int, row: FloatArray) -> TrailingMean:
    """Return the window with one row more.

    Parameters
    ----------
    window_state : TrailingMean
        Window before the row; it is not changed.
    epoch_us : int, microseconds UTC
        Epoch of the row. A row that is not newer than the newest (late, or a duplicate) leaves the window as it is.
    row : ndarray, shape (N,)
        Values, NaN = absent.

    Returns
    -------
    TrailingMean
        Window after the row, without rows older than the horizon.
    """
    if window_state.epoch_us.size and epoch_us <= window_state.epoch_us[-1]:
        return window_state
    first = rows_until(window_state.epoch_us, epoch_us - window_state.horizon_us)
    return _frozen(
        np.concatenate([window_state.epoch_us[first:], [epoch_us]]),
        np.concatenate([window_state.rows[first:], row[np.newaxis]]),
        window_state.horizon_us,
    )


def mean(state: TrailingMean, window_s: float = 900.0, min_rows: int = 8) -> FloatArray:
    """Return the mean of each carrier over the window that ends with the newest row.

    Parameters
    ----------
    state : TrailingMean
        Rows.
    window_s : float, s
        Length of the window, open at its old end: 15 rows at 60 s in 900 s. Not above the horizon.
    min_rows : int
        Carriers with fewer present values give NaN, at least 1.

    Returns
    -------
    ndarray, shape (N,)
        Means, NaN = absent.
    """
    newest_us = state.epoch_us[-1] if state.epoch_us.size else 0
    rows = state.rows[rows_until(state.epoch_us, newest_us - round(window_s * 1e6)) :]
    is_present = np.isfinite(rows)
    if len(rows) >= max(min_rows, 1) and is_present.all():
        return np.asarray(rows.sum(axis=0) / len(rows))
    count = is_present.sum(axis=0)
    total = np.where(is_present, rows, 0.0).sum(axis=0)
    return np.where(count >= max(min_rows, 1), total / np.maximum(count, 1), np.nan)


def rows_until(epochs_us: IntArray, instant_us: int) -> int:
    """Return how many of the epochs, which increase, are not after an instant."""
    return int(epochs_us.searchsorted(instant_us, side="right"))


def _frozen(epoch_us: IntArray, rows: FloatArray, horizon_us: int) -> TrailingMean:
    """Return a window of arrays that nobody can write."""
    epoch_us.setflags(write=False)
    rows.setflags(write=False)
    return TrailingMean(epoch_us, rows, horizon_us)
