"""Sealed days of results as readers see them: attitude and torque rows, in the order of epochs, from one blob.

A segment holds rows of one table (`series`), one version and one method on one day; all rows of an epoch lie in one
segment, and no two segments of a series reach over each other. It never changes: one that takes in late rows is
replaced by another. Its checksum covers all of it and is checked whenever it is opened; one that differs is a
StorageError ``storage.corrupt`` for the readers of its rows, and for nobody else.
"""

from collections import namedtuple
from collections.abc import Iterator
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, Select, Table, select

from db.encoding.column_codec import CODEC, PackedColumns, Positions
from db.encoding.segments import DAY_US, day_of
from db.measurements.checksum_check import agrees
from db.schema.row_checksum import checksum_of
from db.schema.tables import attitude, spacecraft
from db.schema.tables import result_segment as segment_table
from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.levels.attitude import BoolArray, IntArray

#: segments that are held open for the next reader, of some 3 MB each
_OPEN = 8
#: segments read at once
_AT_ONCE = 4
#: columns of the tables that the head of a segment states, or that are made from the others
HEAD_COLUMNS = ("spacecraft_key", "version", "method", "checksum")
_Head = segment_table.c


@cache
def row_type(table: Table) -> Any:
    """Return the named tuple with the columns of a table of results, in their order."""
    return namedtuple(table.name, table.c.keys())


class ResultSegment:
    """Rows of one segment, (T,), by epoch and number.

    Parameters
    ----------
    head : Any
        Row of the table of segments.
    columns : PackedColumns
        Its content.
    """

    def __init__(self, head: Any, columns: PackedColumns) -> None:
        self._columns = columns
        self._stated = {name: getattr(head, name) for name in ("spacecraft_key", "version", "method")}
        self._count = head.row_count
        self.epochs_us: IntArray = np.array(columns.values("epoch_us", slice(None)), dtype=np.int64)
        self.numbers: IntArray = np.array(columns.values("number", slice(None)), dtype=np.int64)

    def values(self, name: str) -> list[Any]:
        """Return a column."""
        return self._columns.values(name, slice(None))

    def rows(self, table: Table, chosen: Positions) -> list[Any]:
        """Return some rows as `row_type` of their table; they have no checksum of their own."""
        count = len(self.epochs_us[chosen])
        columns = [self._column(column, chosen, count) for column in table.c]
        return list(map(row_type(table)._make, zip(*columns, strict=True)))

    def _column(self, column: Any, chosen: Positions, count: int) -> list[Any]:
        if column.name in HEAD_COLUMNS:
            return [self._stated.get(column.name)] * count
        return self._columns.values(column.name, chosen)

    def after(self, cursor: tuple[int, int] | None) -> BoolArray:
        """Return which rows lie beyond (epoch, number)."""
        if cursor is None:
            return np.ones(self._count, dtype=np.bool_)
        epoch_us, number = cursor
        is_beyond: BoolArray = (self.epochs_us > epoch_us) | ((self.epochs_us == epoch_us) & (self.numbers > number))
        return is_beyond


def is_of(key: int, table: Table, version: str, method: str | None) -> tuple[ColumnElement[bool], ...]:
    """Return the conditions for the segments of a table, a version and, of attitude, a method."""
    return (
        _Head.spacecraft_key == key,
        _Head.series == table.name,
        _Head.version == version,
        _Head.method == (method or ""),
    )


def is_row_of(key: int, table: Table, version: str, method: str | None) -> tuple[ColumnElement[bool], ...]:
    """Return the conditions for the rows of a table that are not sealed, as `is_of` does for segments."""
    of_method = () if method is None else (attitude.c.method == method,)
    return (table.c.spacecraft_key == key, table.c.version == version, *of_method)


def segments(
    connection: Connection, conditions: tuple[ColumnElement[bool], ...], start_us: int, stop_us: int
) -> Iterator[Any]:
    """Yield the rows of the table of segments of one series that reach into [start, stop), by epoch."""
    first = _Head.first_epoch_us
    query = (
        select(segment_table)
        # a segment ends on the day on which it begins
        .where(*conditions, first >= day_of(start_us) * DAY_US, first < stop_us, _Head.last_epoch_us >= start_us)
        .order_by(first)
    )
    return paged(connection, query, first)


def newest_segments(
    connection: Connection, conditions: tuple[ColumnElement[bool], ...], start_us: int, stop_us: int
) -> Iterator[Any]:
    """Yield the rows of the table of segments of one series that reach into [start, stop), the latest first."""
    first = _Head.first_epoch_us
    query = select(segment_table).where(*conditions, first < stop_us, _Head.last_epoch_us >= start_us)
    return paged(connection, query.order_by(first.desc()), first, is_descending=True)


def paged(
    connection: Connection, query: Select[Any], position: ColumnElement[int], *, is_descending: bool = False
) -> Iterator[Any]:
    """Yield the rows of an ordered query of segments, few at a time."""
    limited = query.limit(_AT_ONCE)
    page = connection.execute(limited).all()
    yield from page
    while len(page) == _AT_ONCE:
        end = getattr(page[-1], position.key or "")
        page = connection.execute(limited.where(position < end if is_descending else position > end)).all()
        yield from page


def opened(connection: Connection, head: Any) -> ResultSegment:
    """Return the rows of a segment; StorageError ``storage.corrupt``."""
    try:
        return _opened(tuple(head))
    except (ValueError, KeyError) as fault:
        raise _corrupt(connection, head, str(fault)) from fault


@lru_cache(maxsize=_OPEN)
def _opened(stored: tuple[Any, ...]) -> ResultSegment:
    """Return the rows of a segment after they were checked; known by all that is stored, it is never out of date."""
    head = row_type(segment_table)._make(stored)
    if not agrees(head.checksum, partial(checksum_of, segment_table, head._asdict())):
        message = "its checksum differs from its content"
        raise ValueError(message)
    if head.codec != CODEC:
        message = f"it is written in codec {head.codec}, which this version does not know"
        raise ValueError(message)
    return ResultSegment(head, PackedColumns(head.content, head.row_count))


def _corrupt(connection: Connection, head: Any, reason: str) -> StorageError:
    """Return the error for a segment that cannot be read."""
    owner = connection.scalar(select(spacecraft.c.id).where(spacecraft.c.spacecraft_key == head.spacecraft_key))
    day = format_epoch(day_of(head.first_epoch_us) * DAY_US)[:10]
    detail = (
        f"The sealed {head.series} rows of {owner!r} of {day} (version {head.version}, result segment "
        f"{head.segment_id}) cannot be read: {reason}. Other days are not touched."
    )
    return StorageError("storage.corrupt", detail)
