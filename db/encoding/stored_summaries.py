"""Reading stored summaries: of each the coarsest buckets that lie within one interval, and rows where one ends."""

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from sqlalchemy import Column, Connection, Table, bindparam, func, select

from db.connection.prepared_statements import PreparedStatement
from db.encoding.summary_codec import FrameRows, Level, unpack_level, unpack_rows
from db.schema.tables import attitude_summary, power_summary
from service.core.rows.summaries import IntArray, Summaries, joined
from service.ports import Intervals

_LOG = logging.getLogger(__name__)
#: summaries that are asked for at once; SQLite before 3.32 binds 999 values at most
READ_AT_ONCE = 500
_Unpacked = TypeVar("_Unpacked", Level, FrameRows)


class Stored(NamedTuple):
    """Summary by its id, with the span that its rows lie in."""

    summary_id: int
    first_us: int
    last_us: int


class SummaryTable:
    """Table of summaries.

    Parameters
    ----------
    table : Table
        With the columns of `SummaryBlobs`.
    name : Column
        Of the id.
    """

    def __init__(self, table: Table, name: Column[int]) -> None:
        self.table = table
        self.name = name
        self.minute_frame, self.row_frame = (
            _frame_of(column, name) for column in (table.c.minute_frames, table.c.row_frames)
        )

    def read(
        self, connection: Connection, wanted: Sequence[Stored], intervals: Intervals, columns: int
    ) -> tuple[Summaries | None, set[int]]:
        """Return the first columns of summaries in buckets that fit intervals, and the ids that were read.

        At most ``READ_AT_ONCE`` are asked for. What is missing or damaged is not read: its rows are still there.
        """
        reading = _Reading(connection, self, intervals, columns)
        first_us, last_us = (np.array([each[column] for each in wanted], dtype=np.int64) for column in (1, 2))
        is_whole = intervals.hold(first_us, last_us)
        for column, is_wanted in ((self.table.c.day, is_whole), (self.table.c.hours, ~is_whole)):
            names = [each.summary_id for each, is_its in zip(wanted, is_wanted, strict=True) if is_its]
            is_dense = self.table.c.minute_frames.is_not(None)
            query = select(self.name, column, is_dense).where(self.name.in_(names), column.is_not(None))
            rows = connection.execute(query).all() if names else ()
            for has_minutes in (False, True):
                reading.open([(row[0], row[1]) for row in rows if bool(row[2]) is has_minutes], has_minutes=has_minutes)
        return reading.result(), reading.read - reading.damaged


class _Reading:
    """Buckets and rows of some summaries, found so far."""

    def __init__(self, connection: Connection, table: SummaryTable, intervals: Intervals, columns: int) -> None:
        self._connection = connection
        self._table = table
        self._intervals = intervals
        self._columns = slice(columns)
        #: with the summary of each bucket or row
        self._found: list[tuple[IntArray, Summaries]] = []
        self.read: set[int] = set()
        self.damaged: set[int] = set()

    def open(self, blobs: Sequence[tuple[int, bytes]], *, has_minutes: bool) -> None:
        """Find the buckets of some levels that fit, and open the frames of those that an interval ends in."""
        self.read.update(name for name, _ in blobs)
        # a day without rows has no bytes
        held = [(name, blob) for name, blob in blobs if blob]
        levels = [(name, level) for name, blob in held if (level := self._unpacked(name, unpack_level, blob))]
        if not levels:
            return
        owners = np.repeat([name for name, _ in levels], [len(level.starts) for _, level in levels])
        buckets = joined([level.buckets.columns(self._columns) for _, level in levels])
        starts, sizes = (np.concatenate([level[column] for _, level in levels]) for column in (1, 2))
        is_whole = self._intervals.hold(buckets.first_us, buckets.last_us)
        self._found.append((owners[is_whole], buckets.at(is_whole)))
        frame = self._table.minute_frame if has_minutes else self._table.row_frame
        frames = []
        for position in np.flatnonzero(~is_whole).tolist():
            name = int(owners[position])
            row = frame.run(self._connection, int(starts[position]) + 1, int(sizes[position]), name).fetchone()
            frames.append((name, bytes(row[0])))
        if has_minutes:
            self.open(frames, has_minutes=False)
        else:
            self._add_rows(frames)

    def result(self) -> Summaries | None:
        """Return all that was found of summaries that are not damaged."""
        if self.damaged:
            is_sound = [~np.isin(owners, list(self.damaged)) for owners, _ in self._found]
            found = [buckets.at(is_its) for is_its, (_, buckets) in zip(is_sound, self._found, strict=True)]
            return joined(found)
        return joined([buckets for _, buckets in self._found]) if self._found else None

    def _add_rows(self, frames: Sequence[tuple[int, bytes]]) -> None:
        opened = [(name, rows) for name, blob in frames if (rows := self._unpacked(name, unpack_rows, blob))]
        if opened:
            owners = np.repeat([name for name, _ in opened], [len(rows.epochs_us) for _, rows in opened])
            epochs_us = np.concatenate([rows.epochs_us for _, rows in opened])
            values = np.concatenate([rows.values for _, rows in opened])
            self._found.append((owners, Summaries.of_rows(epochs_us, values)))

    def _unpacked(self, name: int, unpack: Callable[[bytes], _Unpacked], blob: bytes) -> _Unpacked | None:
        """Return what bytes hold, None where they are damaged."""
        try:
            return unpack(blob)
        except ValueError as fault:
            _LOG.warning(
                "%s %d is damaged, rows are read in its place; `soo doctor` tells more: %s",
                self._table.table.name,
                name,
                fault,
            )
            self.damaged.add(name)
            return None


def _frame_of(column: Column[Any], name: Column[int]) -> PreparedStatement:
    query = select(func.substr(column, bindparam("first"), bindparam("size"))).where(name == bindparam("of_summary"))
    return PreparedStatement(query, "first", "size", "of_summary")


POWERS = SummaryTable(power_summary, power_summary.c.segment_id)
ATTITUDE = SummaryTable(attitude_summary, attitude_summary.c.summary_id)
