"""Gaps of a sequence of rows: where the distance of two rows is more than the usual one.

The usual distance of a stretch is the median of its distances, so that a front end whose period is changed is judged by
the period it has. A gap is a distance above ``GAP_PERIODS`` usual ones; rows missing = round(distance / usual) - 1.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
#: a distance of more periods than this lacks a row
GAP_PERIODS = 1.5
#: rows whose median distance is the usual one
STRETCH_ROWS = 500


class Gap(NamedTuple):
    """Instants without a row: start inclusive, stop exclusive, microseconds UTC."""

    start_us: int
    stop_us: int
    rows_missing: int


class GapSearch:
    """Search for gaps in rows that come in pieces.

    Parameters
    ----------
    start_us : int
        Where rows are expected from; None = from the first row on.
    """

    def __init__(self, start_us: int | None = None) -> None:
        self._start_us = start_us
        self._held = np.empty(0, dtype=np.int64)
        self._last_us: int | None = None
        self._period_us = 0.0

    @property
    def period_us(self) -> int:
        """Usual distance of the newest rows; 0 where none is known."""
        return round(self._period_us)

    def add(self, epochs_us: IntArray) -> Iterator[Gap]:
        """Yield the gaps that rows in order of epoch complete; rows of one epoch count as one."""
        self._held = np.concatenate([self._held, epochs_us])
        while len(self._held) >= STRETCH_ROWS:
            stretch, self._held = self._held[:STRETCH_ROWS], self._held[STRETCH_ROWS:]
            yield from self._stretch(stretch)

    def end(self, stop_us: int | None = None) -> Iterator[Gap]:
        """Yield the last gaps, with the one between the last row and where rows are expected to, if it is given."""
        if len(self._held):
            yield from self._stretch(self._held)
            self._held = self._held[:0]
        if stop_us is not None and self._last_us is not None:
            yield from self._between(np.array([self._last_us, stop_us]))

    def _stretch(self, epochs_us: IntArray) -> Iterator[Gap]:
        steps_us = np.diff(epochs_us)
        steps_us = steps_us[steps_us > 0]
        if len(steps_us):
            self._period_us = float(np.median(steps_us))
        if self._last_us is not None:
            epochs_us = np.concatenate([[self._last_us], epochs_us])
        elif self._start_us is not None and self._period_us > 0.0:
            # a row that stood right at the start would have been the first
            epochs_us = np.concatenate([[self._start_us - round(self._period_us)], epochs_us])
        yield from self._between(epochs_us)
        self._last_us = int(epochs_us[-1])

    def _between(self, epochs_us: IntArray) -> Iterator[Gap]:
        """Yield the gaps between rows."""
        if self._period_us <= 0.0:
            return
        periods = np.diff(epochs_us) / self._period_us
        for position in np.flatnonzero(periods > GAP_PERIODS).tolist():
            start_us = int(epochs_us[position]) + round(self._period_us)
            yield Gap(start_us, int(epochs_us[position + 1]), round(float(periods[position])) - 1)
