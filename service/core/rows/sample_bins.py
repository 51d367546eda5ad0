"""Samples of a long span: count, mean, least and greatest value of every interval, and when the extremes were.

The span is cut into intervals of equal length; interval k holds the instants with

    floor((t - start) count / (stop - start)) = k

Rows come in pieces of any size and are counted once each, so the counts of all intervals add up to the rows that hold
a value. Least and greatest value are kept as they are: no peak is lost however wide the intervals.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Samples:
    """Intervals of one column that hold a value, in order."""

    #: (B,) microseconds UTC, begin of each interval
    starts_us: IntArray
    #: (B,) values, each at least 1
    counts: IntArray
    #: (B,)
    means: FloatArray
    minima: FloatArray
    maxima: FloatArray
    #: (B,) microseconds UTC, first row that holds the extreme
    minimum_epochs_us: IntArray
    maximum_epochs_us: IntArray


class SampleBins:
    """Intervals of several columns that rows are added to.

    Parameters
    ----------
    start_us, stop_us : int
        Span, microseconds UTC; stop exclusive.
    count : int
        Intervals.
    columns : int
        Columns of values.
    """

    def __init__(self, start_us: int, stop_us: int, count: int, columns: int) -> None:
        # in whole numbers of any size: the products exceed 64 bits
        begins = [start_us - (-position * (stop_us - start_us) // count) for position in range(count)]
        self._begins_us = np.array(begins, dtype=np.int64)
        shape = (count, columns)
        self._n = np.zeros(shape, dtype=np.int64)
        self._sums = np.zeros(shape)
        self._minima, self._maxima = np.full(shape, np.inf), np.full(shape, -np.inf)
        self._minimum_us, self._maximum_us = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)

    def add(self, epochs_us: IntArray, values: NDArray[np.floating]) -> None:
        """Add rows in order of epoch, values of shape (T, columns); NaN = absent."""
        positions = self._positions(epochs_us)
        bounds = [0, *(np.flatnonzero(np.diff(positions)) + 1).tolist(), len(positions)]
        for first, last in pairwise(bounds):
            if last > first:
                self._add_to(int(positions[first]), epochs_us[first:last], values[first:last])

    def samples(self, column: int) -> Samples:
        """Return the intervals of a column that hold a value."""
        held = np.flatnonzero(self._n[:, column])
        counts = self._n[held, column]
        return Samples(
            self._begins_us[held],
            counts,
            self._sums[held, column] / counts,
            self._minima[held, column],
            self._maxima[held, column],
            self._minimum_us[held, column],
            self._maximum_us[held, column],
        )

    def _positions(self, epochs_us: IntArray) -> IntArray:
        """Return the interval of each row: how many intervals have begun by then, but for the first."""
        return np.asarray(np.searchsorted(self._begins_us, epochs_us, side="right") - 1)

    def _add_to(self, position: int, epochs_us: IntArray, values: NDArray[np.floating]) -> None:
        """Add rows of one interval."""
        wide = values.astype(np.float64)
        is_absent = np.isnan(wide)
        self._n[position] += np.sum(~is_absent, axis=0)
        self._sums[position] += np.nansum(wide, axis=0)
        columns = np.arange(wide.shape[1])
        low, high = np.where(is_absent, np.inf, wide), np.where(is_absent, -np.inf, wide)
        at_low, at_high = np.argmin(low, axis=0), np.argmax(high, axis=0)
        is_lower = low[at_low, columns] < self._minima[position]
        is_higher = high[at_high, columns] > self._maxima[position]
        self._minima[position][is_lower] = low[at_low, columns][is_lower]
        self._maxima[position][is_higher] = high[at_high, columns][is_higher]
        self._minimum_us[position][is_lower] = epochs_us[at_low][is_lower]
        self._maximum_us[position][is_higher] = epochs_us[at_high][is_higher]
