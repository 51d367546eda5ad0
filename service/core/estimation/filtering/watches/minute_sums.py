"""Sums of test values over a minute: rows may come every second, tests see one value a minute.

    value = sum of z over the rows of the minute / sqrt(rows)

which keeps unit variance. The law of this file: at one row a minute or fewer every row is a minute.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.model.filter_model import FloatArray

#: a minute may be short by this much, microseconds: rows come with some jitter
_MINUTE_US = 59_000_000


class MinuteSums(NamedTuple):
    """Sums since the last minute was closed; M series."""

    start_us: int
    #: (M,)
    total: FloatArray
    rows: FloatArray


class Minute(NamedTuple):
    """Values of a closed minute."""

    sums: MinuteSums
    #: (M,) unit variance, NaN = no row; None = the minute is not over
    values: FloatArray | None


def empty_minute(series: int, epoch_us: int) -> MinuteSums:
    """Return sums of nothing."""
    return MinuteSums(epoch_us, np.zeros(series), np.zeros(series))


def push_minute(sums: MinuteSums, epoch_us: int, values: FloatArray) -> Minute:
    """Return the sums with one row more, and the minute's values when it is over.

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
    if is_over and not sums.rows.any():
        # the usual row is a minute of its own
        return Minute(empty_minute(len(values), epoch_us), _finite(values))
    is_present = np.isfinite(values)
    total = sums.total + np.where(is_present, values, 0.0)
    rows = sums.rows + is_present
    if not is_over:
        return Minute(MinuteSums(sums.start_us, total, rows), None)
    closed = np.where(rows > 0.0, total / np.sqrt(np.maximum(rows, 1.0)), np.nan)
    return Minute(empty_minute(len(values), epoch_us), closed)


def _finite(values: FloatArray) -> FloatArray:
    """Return the values with NaN for what is not finite."""
    # one product tells of all: cheaper than a test of each
    return values if math.isfinite(values @ values) else np.where(np.isfinite(values), values, np.nan)
