"""Rows of results as stored: in tables, and in the segments of sealed days."""

from collections import namedtuple
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, Select, Table, and_, func, select

from db.database import beyond, within
from db.encoding.column_codec import CODEC, PackedColumns, Positions
from db.encoding.segments import DAY_US, day_of
from db.newest_rows import PagedRow, RowPages, newest_rows, start_of_last
from db.schema.columns import agrees, checksum_of, sound_rows
from db.schema.tables import attitude, result_segment, spacecraft, torque
from db.schema.tables import result_segment as segment_table
from service.errors import StorageError
from service.ports.archive import LIVE
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS
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


#: rows in memory at once as records
_PAGE_ROWS = 5000


#: tables of results by the name under which their rows are sealed
TABLES: dict[str, Table] = {table.name: table for table in (attitude, torque)}


class ResultSeries(NamedTuple):
    """Results of one kind and version of a spacecraft."""

    key: int
    table: Table
    version: str
    #: None for torques
    method: str | None = None


def pages(read: RowPages[PagedRow], window: Window) -> Iterator[Sequence[PagedRow]]:
    """Yield the rows of a window, some at a time."""
    after: tuple[int, int] | None = None
    while rows := read(window, _PAGE_ROWS, after):
        yield rows
        after = rows[-1].epoch_us, rows[-1].number


def stored_rows(
    connection: Connection,
    of: ResultSeries,
    window: Window,
    limit: int | None = None,
    after: tuple[int, int] | None = None,
) -> list[Any]:
    """Return the first rows of a window beyond a cursor, in order of (epoch, number)."""
    table = of.table
    query = (
        select(table)
        .where(*is_row_of(*of), within(table.c.epoch_us, window), beyond(table.c.epoch_us, table.c.number, after))
        .order_by(table.c.epoch_us, table.c.number)
        .limit(limit)
    )
    rows: list[Any] = list(sound_rows(table, connection.execute(query)))
    sealed: list[Any] = []
    start_us = window.start_us if after is None else max(window.start_us, after[0])
    for head in segments(connection, is_of(*of), start_us, window.stop_us):
        segment = opened(connection, head)
        is_inside = (segment.epochs_us >= window.start_us) & (segment.epochs_us < window.stop_us)
        missing = None if limit is None else limit - len(sealed)
        sealed += segment.rows(table, np.flatnonzero(is_inside & segment.after(after))[:missing])
        if limit is not None and len(sealed) >= limit:
            break
    if not sealed:
        return rows
    return sorted(rows + sealed, key=_position)[:limit]


def page_of_rows(
    connection: Connection,
    of: ResultSeries,
    window: Window,
    limit: int,
    after: tuple[int, int] | None,
    *,
    newest_first: bool = False,
) -> list[Any]:
    """Return the first rows of a window beyond a cursor, or the last ones below it, the newest first."""
    if not newest_first:
        return stored_rows(connection, of, window, limit, after)
    read, start_of = partial(stored_rows, connection, of), partial(_start_of_newest, connection, of)
    return newest_rows(read, start_of, window, limit, after)


def _start_of_newest(connection: Connection, of: ResultSeries, window: Window, count: int) -> int:
    """Return an epoch from which on so many rows of a window stand; its start where there are fewer."""
    epoch = of.table.c.epoch_us
    query = select(epoch).where(*is_row_of(*of), within(epoch, window)).order_by(epoch.desc())
    row = connection.scalar(query.offset(count - 1).limit(1))
    start_us = window.start_us if row is None else int(row)
    found = newest_segments(connection, is_of(*of), start_us, window.stop_us)
    epochs_us = (opened(connection, head).epochs_us for head in found)
    inside = (each[(each >= window.start_us) & (each < window.stop_us)] for each in epochs_us)
    return start_of_last(inside, count, start_us)


def newest_row(connection: Connection, of: ResultSeries, before_us: int = 1 << 62) -> Any | None:
    """Return the row with the greatest (epoch, number) before an epoch."""
    table, first = of.table, result_segment.c.first_epoch_us
    query = select(table).where(*is_row_of(*of), table.c.epoch_us < before_us)
    newest_of_table = query.order_by(table.c.epoch_us.desc(), table.c.number.desc()).limit(1)
    row: Any = next(iter(sound_rows(table, connection.execute(newest_of_table))), None)
    is_newer = () if row is None else (result_segment.c.last_epoch_us >= row.epoch_us,)
    newest = select(result_segment).where(*is_of(*of), first < before_us, *is_newer)
    head = connection.execute(newest.order_by(first.desc()).limit(1)).first()
    if head is None:
        return row
    segment = opened(connection, head)
    (sealed,) = segment.rows(table, np.flatnonzero(segment.epochs_us < before_us)[-1:])
    return sealed if row is None else max(row, sealed, key=_position)


def stored_numbers(connection: Connection, of: ResultSeries, window: Window) -> IntArray:
    """Return the journal numbers of the rows of a window, in no order."""
    table = of.table
    query = select(table.c.number).where(*is_row_of(*of), within(table.c.epoch_us, window))
    found = [np.array(connection.scalars(query).all(), dtype=np.int64)]
    for head in segments(connection, is_of(*of), window.start_us, window.stop_us):
        segment = opened(connection, head)
        found.append(segment.numbers[(segment.epochs_us >= window.start_us) & (segment.epochs_us < window.stop_us)])
    return np.concatenate(found)


def newest_sealed_us(connection: Connection, key: int) -> int:
    """Return the epoch up to which live attitude may be sealed; before every epoch while none is."""
    newest = [
        connection.scalar(
            select(result_segment.c.last_epoch_us)
            .where(*is_of(key, attitude, LIVE, method.value))
            .order_by(result_segment.c.first_epoch_us.desc())
            .limit(1)
        )
        for method in LIVE_METHODS
    ]
    return max((epoch_us for epoch_us in newest if epoch_us is not None), default=-(1 << 62))


def sealed_keys(connection: Connection, of: ResultSeries, wanted: Iterable[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return those of the wanted (epoch, number) that are sealed."""
    positions = set(wanted)
    if not positions:
        return set()
    epochs_us = [epoch_us for epoch_us, _ in positions]
    found: set[tuple[int, int]] = set()
    for head in segments(connection, is_of(*of), min(epochs_us), max(epochs_us) + 1):
        segment = opened(connection, head)
        held = zip(segment.epochs_us.tolist(), segment.numbers.tolist(), strict=True)
        found.update(positions.intersection(held))
    return found


def sealed_of_sequences(connection: Connection, key: int, after: int, upto: int) -> Iterator[Any]:
    """Yield the sealed live rows with a sequence in (after, upto]."""
    column = result_segment.c
    query = select(result_segment).where(
        column.spacecraft_key == key, column.last_sequence > after, column.first_sequence <= upto
    )
    for head in paged(connection, query.order_by(column.segment_id), column.segment_id):
        segment = opened(connection, head)
        sequences = np.array(segment.values("sequence"), dtype=np.int64)
        yield from segment.rows(TABLES[head.series], np.flatnonzero((sequences > after) & (sequences <= upto)))


def next_sealed_sequence(connection: Connection, key: int, after: int) -> int | None:
    """Return the smallest sequence above the given one that is sealed."""
    column = result_segment.c
    is_beyond = and_(column.spacecraft_key == key, column.last_sequence > after)
    first = connection.scalar(select(func.min(column.first_sequence)).where(is_beyond, column.first_sequence > after))
    found = [] if first is None else [int(first)]
    reaching = select(result_segment).where(is_beyond, column.first_sequence <= after).order_by(column.segment_id)
    for head in paged(connection, reaching, column.segment_id):
        sequences = opened(connection, head).values("sequence")
        found.append(min(sequence for sequence in sequences if sequence > after))
    return min(found, default=None)


def numbers_where(
    connection: Connection, of: ResultSeries, name: str, after_us: int
) -> Iterator[tuple[IntArray, list[Any]]]:
    """Yield numbers of sealed rows later than an epoch, and the column of that name beside them."""
    for head in segments(connection, is_of(*of), after_us + 1, 1 << 62):
        segment = opened(connection, head)
        is_later: BoolArray = segment.epochs_us > after_us
        values = segment.values(name)
        yield segment.numbers[is_later], [values[position] for position in np.flatnonzero(is_later).tolist()]


def _position(row: Any) -> tuple[int, int]:
    return row.epoch_us, row.number
