"""Sealing closed days of results: attitude and torque rows, live and of replays, become one row for many.

As for measurements (`db.measurements.sealing`), a segment is made in a read transaction; a short write transaction puts
it in the place of the rows and of the segment that it was made of, and changes nothing when these are not exactly those
that were read. A late row stays in its table until the next look, which merges it into the segment of its day.
"""

import logging
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

from sqlalchemy import Connection, Table, and_, delete, func, or_, select, true, tuple_

from db.database import Database, lock_head
from db.encoding.column_codec import CODEC, pack_columns
from db.encoding.segments import DAY_US, day_of
from db.results.stored_rows import HEAD_COLUMNS, TABLES, ResultSeries, is_of, is_row_of, opened, segments
from db.schema.columns import agrees, checksum_of
from db.schema.tables import result_segment
from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.storage import SealedResults

_LOG = logging.getLogger(__name__)
#: rows of a segment; a write transaction takes as many rows away
SEGMENT_ROWS = 4096
#: with more damaged rows than this a day stays as it is; SQLite before 3.32 binds 999 values at most
_MOST_DAMAGED = 250
#: epochs that a line of the log names at most
_NAMED = 5


class _Change(NamedTuple):
    """Changes of one sealing transaction."""

    of: ResultSeries
    #: (epoch, number) of the rows to remove, by epoch, and of damaged ones among them, which stay
    sealed: tuple[tuple[int, int], ...]
    damaged: tuple[tuple[int, int], ...]
    replaced_id: int | None
    written: tuple[dict[str, Any], ...]


def seal(database: Database, key: int, before_us: int) -> Iterator[SealedResults]:
    """Seal the days that ended by an epoch, a transaction a step.

    A segment that cannot be read keeps the late rows of its day in the table of rows. A row that differs from its
    checksum stays there as it is, and is named in the log.
    """
    for of in _series(database, key):
        for day in _days(database, of, day_of(before_us) * DAY_US):
            while (change := _next_change(database, of, day)) is not None:
                if not database.write(partial(_carry_out, change=change)):
                    break
                yield _reported(change)


def _series(database: Database, key: int) -> Iterator[ResultSeries]:
    """Yield what has rows in a table of rows."""
    for table in TABLES.values():
        names = [table.c[name] for name in ("version", "method") if name in table.c]
        query = select(*names).where(table.c.spacecraft_key == key).order_by(*names).limit(1)
        row = database.fetch_one(query)
        while row is not None:
            yield ResultSeries(key, table, *row)
            row = database.fetch_one(query.where(tuple_(*names) > tuple(row)))


def _days(database: Database, of: ResultSeries, stop_us: int) -> Iterator[int]:
    """Yield the days before an epoch that have rows in the table of rows."""
    start_us = -(1 << 62)
    epoch_us = of.table.c.epoch_us
    while True:
        query = select(func.min(epoch_us)).where(*is_row_of(*of), epoch_us >= start_us, epoch_us < stop_us)
        with database.read() as connection:
            first_us = connection.scalar(query)
        if first_us is None:
            return
        yield day_of(first_us)
        start_us = (day_of(first_us) + 1) * DAY_US


def _next_change(database: Database, of: ResultSeries, day: int) -> _Change | None:
    """Return what to do next with a day; None when nothing is left, or nothing can be done."""
    try:
        with database.read() as connection:
            return _prepared(connection, of, day)
    except StorageError as fault:
        if fault.code != "storage.corrupt":
            raise
        _LOG.warning("late results are not merged into a damaged sealed day; they stay readable: %s", fault.detail)
        return None


def _prepared(connection: Connection, of: ResultSeries, day: int) -> _Change | None:
    rows = _rows(connection, of, day)
    is_sound = [row.checksum is None or agrees(row.checksum, partial(_checksum, of.table, row)) for row in rows]
    damaged = tuple(_position(row) for row, is_good in zip(rows, is_sound, strict=True) if not is_good)
    sound = [row for row, is_good in zip(rows, is_sound, strict=True) if is_good]
    if damaged:
        _LOG.error(
            "%d %s rows differ from their checksum and are not sealed: they stay in the row table, at %s; list them "
            "with `soo doctor` and restore them from a backup",
            len(damaged),
            of.table.name,
            ", ".join(format_epoch(epoch_us) for epoch_us, _ in damaged[:_NAMED]),
        )
    if not sound or len(damaged) > _MOST_DAMAGED:
        return None
    known = list(segments(connection, is_of(*of), day * DAY_US, (day + 1) * DAY_US))
    target, stop_us = _target(known, sound)
    sealed = [row for row in sound if stop_us is None or row.epoch_us < stop_us]
    merged = sealed
    if target is not None:
        merged = sorted(sealed + opened(connection, target).rows(of.table, slice(None)), key=_position)
    written = tuple(_segment(of, part) for part in _parts(merged))
    positions = tuple(_position(row) for row in sealed)
    replaced_id = None if target is None else target.segment_id
    return _Change(of, positions, damaged, replaced_id, written)


def _rows(connection: Connection, of: ResultSeries, day: int) -> list[Any]:
    """Return the first rows of a day in the table of rows, whole epochs."""
    table = of.table
    is_its = and_(*is_row_of(*of), table.c.epoch_us >= day * DAY_US, table.c.epoch_us < (day + 1) * DAY_US)
    query = select(table).where(is_its).order_by(table.c.epoch_us, table.c.number).limit(SEGMENT_ROWS)
    rows: list[Any] = list(connection.execute(query))
    if len(rows) < SEGMENT_ROWS:
        return rows
    last_us = rows[-1].epoch_us
    rest = query.where(table.c.epoch_us == last_us, table.c.number > rows[-1].number)
    return rows + list(connection.execute(rest))


def _target(known: Sequence[Any], rows: Sequence[Any]) -> tuple[Any | None, int | None]:
    """Return the segment that takes rows in, None for a new one, and the epoch from which rows belong elsewhere."""
    if not known:
        return None, None
    first_us = rows[0].epoch_us
    position = max(sum(head.first_epoch_us <= first_us for head in known) - 1, 0)
    target, following = known[position], known[position + 1 :]
    is_new = first_us > target.last_epoch_us and target.row_count + len(rows) > SEGMENT_ROWS
    return (None if is_new else target), (following[0].first_epoch_us if following else None)


def _parts(rows: Sequence[Any]) -> Iterator[Sequence[Any]]:
    """Yield rows in parts of about equal size, none much above ``SEGMENT_ROWS``, an epoch in one part."""
    parts = max(1, round(len(rows) / SEGMENT_ROWS))
    bounds = [len(rows) * part // parts for part in range(1, parts)]
    for position, bound in enumerate(bounds):
        while bound < len(rows) and rows[bound].epoch_us == rows[bound - 1].epoch_us:
            bound += 1
        bounds[position] = bound
    for start, stop in pairwise(sorted({0, *bounds, len(rows)})):
        yield rows[start:stop]


def _segment(of: ResultSeries, rows: Sequence[Any]) -> dict[str, Any]:
    """Return the columns of a segment but its id and checksum."""
    columns = dict(zip(of.table.c.keys(), zip(*rows, strict=True), strict=True))
    kept = {name: values for name, values in columns.items() if name not in HEAD_COLUMNS}
    sequences = [sequence for sequence in columns["sequence"] if sequence is not None]
    return {
        "spacecraft_key": of.key,
        "series": of.table.name,
        "version": of.version,
        "method": of.method or "",
        "row_count": len(rows),
        "codec": CODEC,
        "first_epoch_us": rows[0].epoch_us,
        "last_epoch_us": rows[-1].epoch_us,
        "last_number": max(columns["number"]),
        "first_sequence": min(sequences, default=None),
        "last_sequence": max(sequences, default=None),
        "content": pack_columns(kept),
    }


def _carry_out(connection: Connection, change: _Change) -> bool:
    """Put segments in the place of rows and a segment; False, with nothing changed, when these are not all there."""
    of, table = change.of, change.of.table
    lock_head(connection, of.key)
    (first_us, _), (last_us, last_number) = change.sealed[0], change.sealed[-1]
    epoch_us, number = table.c.epoch_us, table.c.number
    is_in_range = and_(
        *is_row_of(*of), epoch_us >= first_us, epoch_us <= last_us, or_(epoch_us < last_us, number <= last_number)
    )
    is_sound = tuple_(epoch_us, number).not_in(change.damaged) if change.damaged else true()
    there = connection.execute(select(epoch_us, number).where(is_in_range, is_sound).order_by(epoch_us, number))
    if [tuple(row) for row in there] != list(change.sealed):
        # others came in, or another process has sealed or dropped them meanwhile
        return False
    if change.replaced_id is not None:
        is_replaced = result_segment.c.segment_id == change.replaced_id
        if connection.execute(delete(result_segment).where(is_replaced)).rowcount != 1:
            return False
    connection.execute(delete(table).where(is_in_range, is_sound))
    connection.execute(result_segment.insert(), list(change.written))
    return True


def _reported(change: _Change) -> SealedResults:
    of, rows_of_segments = change.of, sum(values["row_count"] for values in change.written)
    return SealedResults(
        of.table.name, of.version, of.method, change.sealed[0][0], len(change.sealed), rows_of_segments
    )


def _checksum(table: Table, row: Any) -> bytes:
    return checksum_of(table, row._asdict())


def _position(row: Any) -> tuple[int, int]:
    return row.epoch_us, row.number
