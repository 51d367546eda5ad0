"""Samples of a long span: count, mean, least and greatest value of every interval, and when the extremes were.

The span is cut into intervals of equal length; interval k holds the instants with

    floor((t - start) count / (stop - start)) = k

Rows come in pieces of any size and are counted once each, so the counts of all intervals add up to the rows that hold
a value. Least and greatest value are kept as they are: no peak is lost however wide the intervals.
"""

from collections.abc import Iterator
from itertools import count

import numpy as np
from numpy.typing import NDArray

from service.core.rows.summaries import Summaries

IntArray = NDArray[np.int64]
#: lengths of whole intervals, s; longer ones are whole days
_BELOW_HOUR_S = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1200, 1800)
_WHOLE_S = (*_BELOW_HOUR_S, 3600, 7200, 10_800, 14_400, 21_600, 28_800, 43_200)
_DAY_S = 86_400


def whole_intervals(start_us: int, stop_us: int, most: int) -> tuple[int, int, int]:
    """Return the span widened to whole intervals of UTC, start and stop in microseconds, and how many there are.

    They are seconds, minutes, hours or days long, the shortest that are at most ``most``: summaries have their buckets.

    Examples
    --------
    >>> whole_intervals(7, 90 * 60_000_000, 3)
    (0, 5400000000, 3)
    """
    steps_us = _step_lengths_us(stop_us - start_us, most)
    each = ((step_us, start_us // step_us, -(-stop_us // step_us)) for step_us in steps_us)
    step_us, first, behind = next(found for found in each if found[2] - found[1] <= most)
    return first * step_us, behind * step_us, behind - first


def _step_lengths_us(span_us: int, most: int) -> Iterator[int]:
    """Yield lengths of intervals, ascending: whole days from about the shortest that would do, without an end."""
    yield from (1_000_000 * step for step in _WHOLE_S)
    fewest_days = max(1, span_us // (most * _DAY_S * 1_000_000))
    yield from (days * _DAY_S * 1_000_000 for days in count(fewest_days))


class SampleBins:
    """Intervals of several columns that rows and summaries of rows are added to, in any order.

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
        self._bounds_us = np.array([*begins, stop_us], dtype=np.int64)
        self._count = count
        none = Summaries.of_rows(self._bounds_us[:-1], np.full((count, columns), np.nan))
        self._held = Summaries._make(array.copy() for array in none)

    def add(self, epochs_us: IntArray, values: NDArray[np.floating]) -> None:
        """Add rows, values of shape (T, columns); NaN = absent."""
        self.add_summaries(Summaries.of_rows(epochs_us, values))

    def add_summaries(self, buckets: Summaries, columns: IntArray | None = None) -> None:
        """Add buckets that lie within one interval each, or outside the span.

        ``columns`` are the columns of the intervals that those of the buckets belong to, the same ones by default.
        """
        owners = self._owners(buckets.first_us)
        order = np.argsort(owners, kind="stable")
        first, last = np.searchsorted(owners[order], (0, self._count))
        inside = order[first:last]
        if not len(inside):
            return
        found = buckets.at(inside).gathered(owners[inside])
        cells = np.unique(owners[inside])[:, None], np.arange(found.counts.shape[1]) if columns is None else columns
        held = self._held
        held.counts[cells] += found.counts
        held.sums[cells] += found.sums
        for extremes, epochs_us, new, new_us, is_better in (
            (held.minima, held.minimum_us, found.minima, found.minimum_us, np.less),
            (held.maxima, held.maximum_us, found.maxima, found.maximum_us, np.greater),
        ):
            is_new = is_better(new, extremes[cells])
            is_equal = new == extremes[cells]
            extremes[cells] = np.where(is_new, new, extremes[cells])
            earlier_us = np.where(is_equal, np.minimum(new_us, epochs_us[cells]), epochs_us[cells])
            epochs_us[cells] = np.where(is_new, new_us, earlier_us)

    def hold(self, first_us: IntArray, last_us: IntArray) -> NDArray[np.bool_]:
        """Return which of some stretches lie within one interval each, or outside the span."""
        return np.asarray(self._owners(first_us) == self._owners(last_us))

    def all_intervals(self) -> Summaries:
        """Return what every interval holds, in order, those without a row among them; ``first_us`` is its begin."""
        return self._held

    def _owners(self, epochs_us: IntArray) -> IntArray:
        """Return the interval of each epoch: -1 before the first, ``count`` behind the last."""
        return np.asarray(np.searchsorted(self._bounds_us, epochs_us, side="right") - 1)
