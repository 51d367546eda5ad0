"""Allan deviation of levels with gaps: how far the means of consecutive spans differ, whatever drifts slowly."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

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
