"""Pages of a series read from its end: the newest rows first, by a reader that gives rows in order of their epochs.

Sealed days lie in order of epochs, and so does what reads them. A page from the end asks where it begins, which costs
no row, and reads from there on; so it costs about what a page from the start does.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from service.records.calibration import Window
from service.records.levels.attitude import IntArray

#: rows of a stretch that holds about one page
_ALL = 1 << 62


class Positioned(Protocol):
    """Row of a series."""

    @property
    def epoch_us(self) -> int:
        """Epoch, microseconds UTC."""

    @property
    def number(self) -> int:
        """Journal number of the measurement."""


PagedRow = TypeVar("PagedRow", bound=Positioned, covariant=True)


class RowPages(Protocol[PagedRow]):
    """Pages of a series in order of (epoch, number)."""

    def __call__(self, window: Window, limit: int, after: tuple[int, int] | None, /) -> Sequence[PagedRow]:
        """Return rows beyond a cursor."""


def newest_rows(
    read: RowPages[PagedRow],
    start_of: Callable[[Window, int], int],
    window: Window,
    limit: int,
    before: tuple[int, int] | None,
) -> list[PagedRow]:
    """Return the last rows of a window below a cursor, that with the greatest (epoch, number) first.

    Parameters
    ----------
    read : RowPages
        Reader in order of (epoch, number).
    start_of : callable
        Gives an epoch from which on a window has so many rows at least; its start where it has fewer.
    window : Window
        Where rows are wanted.
    limit : int
        Most rows.
    before : (epoch, number) or None
        Last row of the page before this one.
    """
    stop_us = window.stop_us if before is None else min(window.stop_us, before[0] + 1)
    window, count = Window(window.start_us, stop_us), limit
    while True:
        start_us = start_of(window, count)
        # a list: a page is cut from its end
        rows = [
            row
            for row in read(Window(start_us, stop_us), _ALL, None)
            if before is None or (row.epoch_us, row.number) < before
        ]
        if len(rows) >= limit or start_us <= window.start_us:
            return rows[::-1][:limit]
        # rows at the cursor's epoch were counted, which the page before had
        count *= 2


def start_of_last(found: Iterable[IntArray], count: int, default_us: int) -> int:
    """Return the epoch from which on ``count`` of some epochs stand, ``default_us`` where there are fewer.

    Parameters
    ----------
    found : iterable of (T,) arrays
        Epochs, the latest segment first; read until they are enough.
    count : int
        How many.
    default_us : int
        Least answer.
    """
    held = np.empty(0, dtype=np.int64)
    for epochs_us in found:
        held = np.concatenate([held, epochs_us[-count:]])
        if len(held) >= count:
            return max(default_us, int(np.partition(held, -count)[-count]))
    return default_us
