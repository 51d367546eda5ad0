"""Sums of test values over a minute: rows may come every second, tests see one value a minute.

    value = sum of z over the rows of the minute / sqrt(rows)

which keeps unit variance. The law of this file: at one row a minute or fewer every row is a minute.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray

#: a minute may be short by this much, microseconds: rows come with some jitter
_MINUTE_US = 59_000_000


class MinuteSums(NamedTuple):
    """Sums since the last minute was closed; M series."""

    start_us: int
    #: (M,)
    total: FloatArray
    rows: FloatArray


class Minute(NamedTuple):
    """Sums after a row, and the values of the minute that it closes."""

    sums: MinuteSums
    is_over: bool
    #: (M,) unit variance, NaN = no row; of the rows so far while the minute lasts
    values: FloatArray


def empty_minute(series: int, epoch_us: int) -> MinuteSums:
    """Return sums of nothing."""
    return MinuteSums(epoch_us, np.zeros(series), np.zeros(series))


def push_minute(sums: MinuteSums, epoch_us: int, values: FloatArray) -> Minute:
    """Return the sums with one row more, and the minute's values.

    Parameters
    ----------
    sums : MinuteSums
        Sums before.
    epoch_us : int, microseconds
        Epoch of the row.
    values : ndarray, shape (M,)
        Values of unit variance, NaN = none in this row.
    """
    is_over = epoch_us - sums.start_us >= _MINUTE_US
    is_present = np.isfinite(values)
    total = sums.total + np.where(is_present, values, 0.0)
    rows = sums.rows + is_present
    closed = np.where(rows > 0.0, total / np.sqrt(np.maximum(rows, 1.0)), np.nan)
    return Minute(
        empty_minute(len(values), epoch_us) if is_over else MinuteSums(sums.start_us, total, rows), is_over, closed
    )
