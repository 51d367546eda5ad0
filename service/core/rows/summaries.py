"""Summaries of consecutive rows, bucket by bucket: count, sum, least and greatest value of each column, and when.

Summaries of buckets add up to those of wider buckets without a loss: counts and extremes exactly, sums to rounding. A
row is the smallest bucket.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
#: behind every epoch
NEVER_US = 1 << 62


class Summaries(NamedTuple):
    """Buckets of B stretches of rows, C columns each; epochs in microseconds UTC."""

    #: (B,) epochs of the first and of the last row, whether or not they hold values
    first_us: IntArray
    last_us: IntArray
    #: (B, C) rows that hold a value
    counts: IntArray
    #: (B, C) 0 where there is none
    sums: FloatArray
    #: (B, C) inf and -inf where there is none
    minima: FloatArray
    maxima: FloatArray
    #: (B, C) first row that holds the extreme, behind every epoch where there is none
    minimum_us: IntArray
    maximum_us: IntArray

    @classmethod
    def of_rows(cls, epochs_us: IntArray, values: NDArray[np.floating]) -> "Summaries":
        """Return each row as a bucket; values (T, C), NaN = absent."""
        wide = values.astype(np.float64)
        is_held = ~np.isnan(wide)
        held_us = np.where(is_held, epochs_us[:, None], NEVER_US)
        low, high = np.where(is_held, wide, np.inf), np.where(is_held, wide, -np.inf)
        sums = np.where(is_held, wide, 0.0)
        return cls(epochs_us, epochs_us, is_held.astype(np.int64), sums, low, high, held_us, held_us)

    def at(self, positions: NDArray[np.integer] | NDArray[np.bool_] | slice) -> "Summaries":
        """Return some of the buckets."""
        return Summaries._make(array[positions] for array in self)

    def columns(self, columns: IntArray | slice) -> "Summaries":
        """Return some of the columns."""
        return Summaries._make((self.first_us, self.last_us, *(array[:, columns] for array in self[2:])))

    def gathered(self, owners: IntArray) -> "Summaries":
        """Return one bucket for each run of equal owners, (B,)."""
        starts = np.flatnonzero(np.diff(owners, prepend=owners[:1] - 1))
        if len(starts) == len(owners):
            return self
        lengths = np.diff(starts, append=len(owners))
        minima = np.minimum.reduceat(self.minima, starts, axis=0)
        maxima = np.maximum.reduceat(self.maxima, starts, axis=0)
        at_minima = np.where(self.minima == np.repeat(minima, lengths, axis=0), self.minimum_us, NEVER_US)
        at_maxima = np.where(self.maxima == np.repeat(maxima, lengths, axis=0), self.maximum_us, NEVER_US)
        return Summaries(
            np.minimum.reduceat(self.first_us, starts),
            np.maximum.reduceat(self.last_us, starts),
            np.add.reduceat(self.counts, starts, axis=0),
            np.add.reduceat(self.sums, starts, axis=0),
            minima,
            maxima,
            np.minimum.reduceat(at_minima, starts, axis=0),
            np.minimum.reduceat(at_maxima, starts, axis=0),
        )


def joined(parts: Sequence[Summaries]) -> Summaries:
    """Return the buckets of some parts, at least one, as they follow each other."""
    return Summaries._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))
