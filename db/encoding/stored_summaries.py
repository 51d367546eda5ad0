"""Reading stored summaries: of each the coarsest buckets that lie within one interval, and rows where one ends."""

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from sqlalchemy import Column, Connection, Table, bindparam, func, select

from db.connection.writer import PreparedStatement
from db.encoding.summary_codec import FrameRows, Level, unpack_level, unpack_rows
from db.schema.tables import attitude_summary, carrier_summary, power_summary
from service.core.rows import IntArray, Summaries, joined
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
        With the columns of `SummaryBlobs`; those of rows are absent where no column is sampled in intervals of any
        length.
    name : Column
        Of the id.
    """

    def __init__(self, table: Table, name: Column[int]) -> None:
        self.table = table
        self.name = name
        self.minute_frame = _frame_of(table.c.minute_frames, name)
        self.row_frame = _frame_of(table.c.row_frames, name) if "row_frames" in table.c else None

    def read(
        self,
        connection: Connection,
        wanted: Sequence[Stored],
        intervals: Intervals,
        columns: slice = slice(None),
        *,
        has_rows: bool,
    ) -> tuple[Summaries | None, set[int]]:
        """Return columns of summaries in buckets that fit intervals, and the ids that were read.

        At most ``READ_AT_ONCE`` are asked for. What is missing or damaged is not read: its rows are still there. A
        summary that ends before the columns is read and says nothing.
        ``has_rows`` says whether frames of rows hold all the columns; a day that would need others is not read.
        """
        reading = _Reading(connection, self, intervals, columns, self.row_frame if has_rows else None)
        first_us, last_us = (np.array([each[column] for each in wanted], dtype=np.int64) for column in (1, 2))
        is_whole = intervals.hold(first_us, last_us)
        for column, is_wanted in ((self.table.c.day, is_whole), (self.table.c.hours, ~is_whole)):
            names = [each.summary_id for each, is_its in zip(wanted, is_wanted, strict=True) if is_its]
            is_dense = self.table.c.minute_frames.is_not(None)
            query = select(self.name, column, is_dense).where(self.name.in_(names), column.is_not(None))
            rows = connection.execute(query).all() if names else ()
            for has_minutes in (False, True):
                reading.open([(row[0], row[1]) for row in rows if bool(row[2]) is has_minutes], has_minutes=has_minutes)
        return reading.result(), reading.read - reading.passed_over


class _Reading:
    """Buckets and rows of some summaries, found so far."""

    def __init__(
        self,
        connection: Connection,
        table: SummaryTable,
        intervals: Intervals,
        columns: slice,
        row_frame: PreparedStatement | None,
    ) -> None:
        self._connection = connection
        self._table = table
        self._intervals = intervals
        self._columns = columns
        self._row_frame = row_frame
        #: with the summary of each bucket or row
        self._found: list[tuple[IntArray, Summaries]] = []
        self.read: set[int] = set()
        #: damaged, or an interval ends within a bucket whose rows are not kept beside it
        self.passed_over: set[int] = set()

    def open(self, blobs: Sequence[tuple[int, bytes]], *, has_minutes: bool) -> None:
        """Find the buckets of some levels that fit, and open the frames of those that an interval ends in."""
        self.read.update(name for name, _ in blobs)
        # a day without rows has no bytes
        held = [(name, blob) for name, blob in blobs if blob]
        levels = [(name, level) for name, blob in held if (level := self._unpacked(name, unpack_level, blob))]
        levels = [each for each in levels if each[1].buckets.counts.shape[1] >= (self._columns.stop or 0)]
        if not levels:
            return
        owners = np.repeat([name for name, _ in levels], [len(level.starts) for _, level in levels])
        buckets = joined([level.buckets.columns(self._columns) for _, level in levels])
        starts, sizes = (np.concatenate([level[column] for _, level in levels]) for column in (1, 2))
        is_whole = self._intervals.hold(buckets.first_us, buckets.last_us)
        self._found.append((owners[is_whole], buckets.at(is_whole)))
        frame = self._table.minute_frame if has_minutes else self._row_frame
        if frame is None:
            self.passed_over.update(owners[~is_whole].tolist())
            return
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
        found = [buckets for _, buckets in self._found]
        if self.passed_over:
            is_sound = [~np.isin(owners, list(self.passed_over)) for owners, _ in self._found]
            found = [buckets.at(is_its) for is_its, buckets in zip(is_sound, found, strict=True)]
        return joined(found) if found else None

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
            self.passed_over.add(name)
            return None


def _frame_of(column: Column[Any], name: Column[int]) -> PreparedStatement:
    query = select(func.substr(column, bindparam("first"), bindparam("size"))).where(name == bindparam("of_summary"))
    return PreparedStatement(query, "first", "size", "of_summary")


POWERS = SummaryTable(power_summary, power_summary.c.segment_id)
ATTITUDE = SummaryTable(attitude_summary, attitude_summary.c.summary_id)
CARRIERS = SummaryTable(carrier_summary, carrier_summary.c.carrier_summary_id)
