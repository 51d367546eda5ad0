"""Smoothed rows: the robust filter run backwards over a lag."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, takewhile
from typing import NamedTuple

import numpy as np

from service.core.estimation.effective_row import EffectiveRow, SmoothedState, smoothed_rows
from service.core.estimation.filtering.filter_model import ATTITUDE, rates_deg_h
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import NO_ANGLES, NO_AXES, AttitudeRow, named_axes

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


class SmoothedRows:
    """Smoothed rows of a span, from the chain's robust rows and what the recorder beside it keeps."""

    def __init__(self) -> None:
        self.recorder = RowRecorder(MOST_ROWS)
        self._span = SpanSmoother(self.recorder)
        #: robust rows that are not smoothed yet, by epoch
        self._waiting: dict[int, AttitudeRow] = {}

    def push(self, rows: Sequence[AttitudeRow]) -> list[AttitudeRow]:
        """Take in what the chain made of a measurement and return the rows that are smoothed by now."""
        self._waiting |= {
            row.epoch_us: row for row in rows if row.method is Method.ROBUST and "late" not in row.inhibitions
        }
        return self._made(self._span.pop())

    def rest(self) -> list[AttitudeRow]:
        """Return the rows that are left at the end of the span."""
        return self._made(self._span.rest())

    def _made(self, found: Sequence[SmoothedRow]) -> list[AttitudeRow]:
        if not found:
            return []
        rows = [(self._waiting.pop(each.epoch_us, None), each) for each in found]
        # what the filter could not take has no smoothed row
        self._waiting = {epoch_us: row for epoch_us, row in self._waiting.items() if epoch_us > found[-1].epoch_us}
        return [smoothed_attitude(row, each) for row, each in rows if row is not None]


def smoothed_attitude(row: AttitudeRow, found: SmoothedRow) -> AttitudeRow:
    """Return the smoothed row of a robust one."""
    mean = found.state.mean
    return replace(
        row,
        method=Method.ROBUST_SMOOTHED,
        attitude_deg=named_axes(mean[ATTITUDE]),
        sigma_deg=named_axes(np.sqrt(found.state.covariance.diagonal()[ATTITUDE])),
        rates_deg_s=named_axes(rates_deg_h(mean, found.coupling_per_h) / 3600.0),
        control_allowed=False,
        control_allowed_axes=NO_AXES,
        inhibitions=(*row.inhibitions, "smoothed"),
        advice=(),
        protection_deg=NO_ANGLES,
        lag_s=found.lag_us / US_PER_S,
    )


#: between two instants of the grid, us
GRID_US = 300 * US_PER_S
#: an instant that so many rows lie beyond waits for no more: of 10 rows a second two hours do not fit into memory
MOST_LATER = MOST_ROWS * 9 // 10


def grid_us(epoch_us: int) -> int:
    """Return the last instant of the grid that is not later than an epoch, both microseconds UTC."""
    return epoch_us // GRID_US * GRID_US


class LaggedRows:
    """Smoothed rows of the instants after one, the oldest first.

    Parameters
    ----------
    lag_us : int
        Time of which the rows after an instant are waited for, microseconds.
    after_us : int
        Instant of the grid up to which rows are made already, microseconds UTC.
    """

    def __init__(self, lag_us: int, after_us: int) -> None:
        self.recorder = RowRecorder(MOST_ROWS)
        self._lag_us = lag_us
        self._made_us = after_us
        #: robust rows after the last instant, by epoch
        self._waiting: dict[int, AttitudeRow] = {}

    @property
    def made_us(self) -> int:
        """Return the last instant whose row is made, or has none, microseconds UTC."""
        return self._made_us

    def push(self, epoch_us: int, rows: Sequence[AttitudeRow]) -> list[AttitudeRow]:
        """Take in what the chain made of a measurement at an epoch and return the rows that are due by now."""
        self._waiting |= {
            row.epoch_us: row
            for row in rows
            if row.method is Method.ROBUST and row.epoch_us > self._made_us and "late" not in row.inhibitions
        }
        due_us = grid_us(self._known_us(epoch_us))
        if due_us <= self._made_us:
            return []
        made = self._made(due_us)
        self._made_us = due_us
        self._waiting = {epoch_us: row for epoch_us, row in self._waiting.items() if epoch_us > due_us}
        self._drop()
        return made

    def _known_us(self, epoch_us: int) -> int:
        """Return the epoch up to which enough later rows are known."""
        rows, known_us = self.recorder.rows, epoch_us - self._lag_us
        return max(known_us, rows[-MOST_LATER].epoch_us - 1) if len(rows) >= MOST_LATER else known_us

    def _made(self, due_us: int) -> list[AttitudeRow]:
        """Return the smoothed rows of the instants up to one."""
        epochs_us = [row.epoch_us for row in self.recorder.rows if self._made_us < row.epoch_us <= due_us]
        # of an instant the newest row stays
        chosen = {-(-epoch_us // GRID_US): epoch_us for epoch_us in epochs_us if epoch_us in self._waiting}
        if not chosen:
            return []
        first_us, last_us = min(chosen.values()), max(chosen.values())
        rows = [row for row in self.recorder.rows if row.epoch_us >= first_us]
        found = angles_of(rows, sum(row.epoch_us <= last_us for row in rows))
        wanted = set(chosen.values())
        return [smoothed_attitude(self._waiting[each.epoch_us], each) for each in found if each.epoch_us in wanted]

    def _drop(self) -> None:
        """Drop the rows that no later instant needs, but for the newest, which the next one goes on from."""
        rows = self.recorder.rows
        older = sum(row.epoch_us <= self._made_us for row in rows)
        self.recorder.drop(min(older, len(rows) - 1) if rows else 0)
