"""Smoothers over the effective rows of the robust method: a whole span block by block, and one row at a fixed lag.

A span of any length is smoothed in bounded memory: a block leaves when the rows after it reach half a day on, beyond
which later rows say nothing that can be seen. The law of this file: the filter is not touched; what is told here is
about the past and never drives control.
"""

from collections.abc import Sequence
from itertools import islice, takewhile
from typing import NamedTuple

from service.core.estimation.smoothing.adjoint import SmoothedState
from service.core.estimation.smoothing.effective_row import EffectiveRow, smoothed_rows
from service.pipeline.estimation.robust.row_recorder import RowRecorder

_US_PER_H = 3_600_000_000
#: rows of a block leave together when the rows after it reach so far, h
BLOCK_H, REACH_H = 6, 12
#: rows in memory, at 16 carriers 40 kB each: with a row a second, blocks of 55 minutes that look 110 minutes ahead
MOST_ROWS = 10_000


class SmoothedRow(NamedTuple):
    """Smoothed attitude, drift and rate of one row."""

    epoch_us: int
    #: the nine first numbers of the state, deg and deg/h
    state: SmoothedState
    #: time from the row to the newest one that it knows, microseconds
    lag_us: int
    #: exchange of roll and yaw, 1/h
    coupling_per_h: float


class SpanSmoother:
    """Smoother of a span of rows that the recorder takes one after another.

    Parameters
    ----------
    recorder : RowRecorder
        Holds `MOST_ROWS` rows at least.
    """

    def __init__(self, recorder: RowRecorder) -> None:
        self._recorder = recorder
        self._until_us: int | None = None

    def pop(self) -> list[SmoothedRow]:
        """Return the rows of a block that is complete, the oldest first; none while it is not."""
        rows = self._recorder.rows
        if not rows:
            return []
        block_us = rows[0].epoch_us + BLOCK_H * _US_PER_H
        if rows[-1].epoch_us >= block_us + REACH_H * _US_PER_H:
            return self._smoothed(next(k for k, row in enumerate(rows) if row.epoch_us >= block_us))
        return self._smoothed(MOST_ROWS // 3) if len(rows) >= MOST_ROWS else []

    def rest(self) -> list[SmoothedRow]:
        """Return all rows that are left, at the end of the span."""
        return self._smoothed(len(self._recorder.rows))

    def _smoothed(self, count: int) -> list[SmoothedRow]:
        """Return the oldest rows, smoothed by all; rows that left before and were taken again stay as they left."""
        rows = list(self._recorder.rows)
        found = angles_of(rows, count)
        if count < len(rows):
            self._recorder.drop(count)
        known_us, self._until_us = self._until_us, found[-1].epoch_us if found else self._until_us
        return [each for each in found if known_us is None or each.epoch_us > known_us]


def angles_of(rows: Sequence[EffectiveRow], count: int) -> list[SmoothedRow]:
    """Return the oldest rows of some, smoothed by all of them, the oldest first."""
    newest_us = rows[-1].epoch_us if rows else 0
    states = list(islice(smoothed_rows(rows), len(rows) - count, None))[::-1]
    return [
        SmoothedRow(row.epoch_us, state, newest_us - row.epoch_us, row.coupling_per_h)
        for row, state in zip(rows[:count], states, strict=True)
    ]


def lagged_angles(rows: Sequence[EffectiveRow], lag_us: int) -> SmoothedRow | None:
    """Return the newest row that lies at least a lag before the last one, smoothed by those after it; None = none."""
    limit_us = rows[-1].epoch_us - lag_us if rows else 0
    later = list(takewhile(lambda row: row.epoch_us > limit_us, reversed(rows)))
    if len(later) == len(rows):
        return None
    return angles_of([rows[-len(later) - 1], *reversed(later)], 1)[0]
