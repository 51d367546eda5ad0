"""Smoothed rows at a fixed lag, one for each instant of a grid, while a chain runs over its journal.

The row of an instant is the newest one of the five minutes up to it. It is made when the data reach the lag beyond the
instant, by what the chain has consumed by then. So it does not depend on where a run began or ended, as long as the run
began before these five minutes.
"""

from collections.abc import Sequence

from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.smoothed.smoothed_rows import smoothed_attitude
from service.pipeline.estimation.smoothed.smoother import MOST_ROWS, angles_of
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow

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
