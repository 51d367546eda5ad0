"""Summaries of a day as bytes: the day, its hours, minutes where rows are dense, and the rows that split a bucket.

An interval of a chart ends where it ends, in the middle of an hour. What lies on either side of it is told by the rows
of that hour, or of that minute, alone: the sampled columns are stored once more, a frame of its own for each of the
narrowest buckets. An interval then costs the same however much there is around it. Every frame carries the checksum of
zstd; a frame that differs from it is a ValueError.

Reading stored summaries: of each the coarsest buckets that lie within one interval, and rows where one ends.
"""

import logging
import struct
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import zstandard
from numpy.typing import NDArray
from sqlalchemy import Column, Connection, Table, bindparam, func, select

from db.connection.writer import PreparedStatement
from db.schema.tables import attitude_summary, carrier_summary, power_summary
from service.core.arrays import IntArray
from service.core.rows import NEVER_US, Summaries, joined
from service.ports.archive import Intervals
from service.records.epoch import US_PER_S

HOUR_US, MINUTE_US = 3600 * US_PER_S, 60 * US_PER_S
#: rows closer than this, by their median, get minutes too
DENSE_US = 20 * US_PER_S
_LEVEL = 3
#: buckets, columns, step of the values (0 = doubles)
_LEVEL_SHAPE = struct.Struct("<2qd")
#: rows, columns, bytes of a value
_ROWS_SHAPE = struct.Struct("<3q")


class SummaryBlobs(NamedTuple):
    """Summaries of one day as they are stored; frames stand one after another."""

    day: bytes
    hours: bytes
    #: of the minutes, a frame an hour; None where an hour is the narrowest bucket
    minute_frames: bytes | None
    #: a frame for each of the narrowest buckets
    row_frames: bytes


class Level(NamedTuple):
    """Buckets, and where the frame of each begins and how long it is, bytes."""

    buckets: Summaries
    starts: IntArray
    sizes: IntArray


class FrameRows(NamedTuple):
    """Rows of a narrowest bucket: (T,) microseconds UTC and (T, C) values."""

    epochs_us: IntArray
    values: NDArray[np.floating]


def pack_day(epochs_us: IntArray, values: NDArray[np.floating], row_columns: int) -> SummaryBlobs:
    """Return the summaries of the rows of a day.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Ascending, T > 0.
    values : ndarray, shape (T, C)
        NaN = absent.
    row_columns : int
        Columns that are sampled in intervals of any length: the first ones; 0 = none, no rows are kept.
    """
    has_minutes = is_dense(epochs_us)
    owners = epochs_us // (MINUTE_US if has_minutes else HOUR_US)
    frames = [_pack_rows(epochs_us[part], values[part, :row_columns]) if row_columns else b"" for part in _runs(owners)]
    level = _over(Summaries.of_rows(epochs_us, values).gathered(owners), frames)
    return _pack_levels(level, b"".join(frames), 0.0, has_minutes=has_minutes)


def pack_buckets(minutes: Summaries, step: float, *, has_minutes: bool) -> SummaryBlobs:
    """Return the summaries of a day, without rows, from those of its minutes; values are multiples of a step."""
    buckets = minutes if has_minutes else minutes.gathered(minutes.first_us // HOUR_US)
    return _pack_levels(_over(buckets, [b""] * len(buckets.first_us)), b"", step, has_minutes=has_minutes)


def is_dense(epochs_us: IntArray) -> bool:
    """Return whether the rows of a day get minutes."""
    return len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < DENSE_US


def _pack_levels(level: Level, row_frames: bytes, step: float, *, has_minutes: bool) -> SummaryBlobs:
    """Return the narrowest buckets and those above them."""
    minute_frames = None
    if has_minutes:
        hours = level.buckets.first_us // HOUR_US
        frames = [_pack_level(_part(level, part), step) for part in _runs(hours)]
        level, minute_frames = _over(level.buckets.gathered(hours), frames), b"".join(frames)
    day = level.buckets.gathered(np.zeros(len(level.starts), dtype=np.int64))
    return SummaryBlobs(_pack_level(_over(day, [b""]), step), _pack_level(level, step), minute_frames, row_frames)


def unpack_level(blob: bytes) -> Level:
    """Return buckets; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, step = _LEVEL_SHAPE.unpack_from(raw)
    words = _unshuffled(raw[_LEVEL_SHAPE.size :])
    if len(words) != count * (4 + 6 * columns):
        message = f"{len(words)} values where {count} buckets of {columns} columns belong"
        raise ValueError(message)
    first_us, length_us, starts, sizes = words[: 4 * count].reshape(4, count)
    first_us, starts = np.cumsum(first_us), np.cumsum(starts)
    integers = words[4 * count :].reshape(6, columns, count).transpose(0, 2, 1)
    counts, minimum_us, maximum_us = integers[:3]
    is_held = counts > 0
    sums, minima, maxima = integers[3:] * step if step else integers[3:].view("<f8")
    buckets = Summaries(
        first_us,
        first_us + length_us,
        counts,
        sums,
        np.where(is_held, minima, np.inf),
        np.where(is_held, maxima, -np.inf),
        np.where(is_held, first_us[:, None] + minimum_us, NEVER_US),
        np.where(is_held, first_us[:, None] + maximum_us, NEVER_US),
    )
    return Level(buckets, starts, sizes)


def unpack_rows(blob: bytes) -> FrameRows:
    """Return the rows of a narrowest bucket; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, width = _ROWS_SHAPE.unpack_from(raw)
    stop = _ROWS_SHAPE.size + 8 * count
    epochs_us = np.cumsum(_unshuffled(raw[_ROWS_SHAPE.size : stop]))
    values = _unshuffled(raw[stop:], width).view(f"<f{width}")
    return FrameRows(epochs_us, values.reshape(columns, count).T)


def _runs(owners: IntArray) -> list[slice]:
    bounds = [0, *(np.flatnonzero(np.diff(owners)) + 1).tolist(), len(owners)]
    return [slice(start, stop) for start, stop in pairwise(bounds)]


def _over(buckets: Summaries, frames: Sequence[bytes]) -> Level:
    sizes = np.array([len(frame) for frame in frames], dtype=np.int64)
    return Level(buckets, np.cumsum(sizes) - sizes, sizes)


def _part(level: Level, part: slice) -> Level:
    return Level(level.buckets.at(part), level.starts[part], level.sizes[part])


def _pack_level(level: Level, step: float) -> bytes:
    """Return buckets as bytes: small differences where numbers grow, equal bytes of all numbers together."""
    buckets, first_us = level.buckets, level.buckets.first_us
    is_held = buckets.counts > 0
    epochs_us = [np.where(is_held, each - first_us[:, None], 0) for each in (buckets.minimum_us, buckets.maximum_us)]
    values = [np.where(is_held, each, 0.0) for each in (buckets.sums, buckets.minima, buckets.maxima)]
    words = [np.rint(each / step).astype("<i8") if step else each.astype("<f8").view("<i8") for each in values]
    ones = [np.diff(first_us, prepend=0), buckets.last_us - first_us, np.diff(level.starts, prepend=0), level.sizes]
    columns = [each.T.ravel() for each in (buckets.counts, *epochs_us, *words)]
    return _packed(_LEVEL_SHAPE.pack(*buckets.counts.shape, step) + _shuffled(np.concatenate((*ones, *columns))))


def _pack_rows(epochs_us: IntArray, values: NDArray[np.floating]) -> bytes:
    width = values.dtype.itemsize
    columns = np.ascontiguousarray(values.T, dtype=f"<f{width}")
    shape = _ROWS_SHAPE.pack(*values.shape, width)
    return _packed(shape + _shuffled(np.diff(epochs_us, prepend=0)) + _shuffled(columns))


def _shuffled(values: NDArray[np.generic]) -> bytes:
    """Return the first bytes of all values, then the second ones, and so on."""
    width = values.dtype.itemsize
    return np.ascontiguousarray(values).view(np.uint8).reshape(-1, width).T.tobytes()


def _unshuffled(raw: bytes, width: int = 8) -> IntArray:
    """Return the values that bytes were made of, as integers of a width."""
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(width, -1)
    integers: IntArray = np.ascontiguousarray(planes.T).view(f"<i{width}").ravel()
    return integers


def _packed(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(raw)


def _unpacked(blob: bytes) -> bytes:
    try:
        return zstandard.ZstdDecompressor().decompress(blob)
    except (zstandard.ZstdError, MemoryError) as fault:
        # a damaged size may be larger than any memory
        raise ValueError(str(fault)) from fault


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
