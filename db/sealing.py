"""Sealing closed days: rows of a table become one row for many, with bins beside it; late rows are merged in later.

What is to be written is made in a read transaction. A short write transaction puts it in the place of the rows and of
the segment that it was made of, and changes nothing when these are no longer all there: a crash leaves either rows or
segment. What was stored meanwhile stays in its table until the next look, which merges it into the segment of its day.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import compress, pairwise
from typing import Any, NamedTuple, Protocol

from sqlalchemy import Connection, and_, delete, or_, select, true, tuple_

from db.database import Database, lock_head, position_of
from db.encoding.column_blob import pack_columns
from db.encoding.segments import DAY_US, RowSeries, SegmentHead, heads
from db.schema.columns import soundness
from db.schema.tables import measurement, segment, summary
from db.summaries import Bins
from service.errors import StorageError
from service.records.epoch import format_epoch

_LOG = logging.getLogger(__name__)
#: rows of a segment, by series: a day at a row every eight seconds, 1.4 MB of powers of 32 carriers in memory
SEGMENT_ROWS = {"measurement": 10_800, "attitude": 4096, "torque": 4096}
#: rows within those of a segment that stay where they are
_MOST_STAYING = 250
#: epochs that a line of the log names at most
_NAMED = 5

Position = tuple[int, int]


class RowKind(Protocol):
    """Rows of a series: each has an epoch and a number."""

    def sealed(self, connection: Connection, head: SegmentHead) -> list[Any]:
        """Return the rows of a segment; StorageError ``storage.corrupt``."""

    def columns_and_bins(self, of: RowSeries, rows: Sequence[Any]) -> tuple[Mapping[str, Any], Bins]:
        """Return rows as the columns of a segment, and what is summarised of them."""


class Change(NamedTuple):
    """Changes of one sealing transaction."""

    of: RowSeries
    #: rows to remove, by epoch and number
    sealed: tuple[Position, ...]
    replaced_id: int | None
    #: segments, and what is summarised of each
    written: tuple[tuple[dict[str, Any], Bins], ...]

    @property
    def rows_of_segments(self) -> int:
        """Return how many rows the segments have."""
        return sum(int(values["row_count"]) for values, _ in self.written)


def seal_day(database: Database, of: RowSeries, day: int, kind: RowKind) -> Iterator[Change]:
    """Seal what the table of rows holds of a day, a transaction a step.

    A segment that cannot be read keeps the late rows of its day in the table of rows. A row that differs from its
    checksum stays there as it is, and is named in the log.
    """
    while (change := _next_change(database, of, day, kind)) is not None:
        if not database.write(partial(carry_out, change=change)):
            return
        yield change


def _next_change(database: Database, of: RowSeries, day: int, kind: RowKind) -> Change | None:
    """Return what to do next with a day; None when nothing is left, or nothing can be done."""
    try:
        with database.read() as connection:
            return _prepared(connection, of, day, kind)
    except StorageError as fault:
        if fault.code != "storage.corrupt":
            raise
        _LOG.warning("late rows are not merged into a damaged sealed day; they stay readable: %s", fault.detail)
        return None


def _prepared(connection: Connection, of: RowSeries, day: int, kind: RowKind) -> Change | None:
    start_us, stop_us, most = day * DAY_US, (day + 1) * DAY_US, SEGMENT_ROWS[of.table.name]
    rows, damaged = _read(connection, of, start_us, stop_us, most)
    if damaged and not (rows and len(damaged) <= _MOST_STAYING):
        # at the end, when nothing else is left
        _LOG.error(
            "%d %s rows differ from their checksum and are not sealed: they stay in the row table, at %s; list them "
            "with `soo doctor` and restore them from a backup",
            len(damaged),
            of.table.name,
            ", ".join(format_epoch(epoch_us) for epoch_us, _ in damaged[:_NAMED]),
        )
    if not rows or len(damaged) > _MOST_STAYING:
        return None
    target, end_us = _target(list(heads(connection, of.of_segments(), start_us, stop_us)), rows, most)
    fresh = [row for row in rows if end_us is None or row.epoch_us < end_us]
    merged = fresh if target is None else sorted(fresh + kind.sealed(connection, target), key=position_of)
    written = tuple(_segment(of, day, part, kind) for part in _parts(merged, most))
    return Change(of, tuple(map(position_of, fresh)), None if target is None else target.segment_id, written)


def _read(
    connection: Connection, of: RowSeries, start_us: int, stop_us: int, limit: int
) -> tuple[list[Any], list[Position]]:
    """Return the first sound rows of a span of the table, whole epochs, and the places of those that are damaged."""
    table = of.table
    is_its = (*of.of_rows(), table.c.epoch_us >= start_us, table.c.epoch_us < stop_us)
    query = select(table).where(*is_its).order_by(table.c.epoch_us, table.c.number).limit(limit)
    rows: list[Any] = list(connection.execute(query).all())
    if len(rows) == limit:
        is_rest = (table.c.epoch_us == rows[-1].epoch_us, table.c.number > rows[-1].number)
        rows += connection.execute(query.limit(None).where(*is_rest)).all()
    sound = list(compress(rows, soundness(table, rows)))
    return sound, sorted(set(map(position_of, rows)) - set(map(position_of, sound)))


def _target(known: Sequence[SegmentHead], rows: Sequence[Any], most: int) -> tuple[SegmentHead | None, int | None]:
    """Return the segment that takes rows in, None for a new one, and the epoch from which rows belong elsewhere."""
    if not known:
        return None, None
    first_us = rows[0].epoch_us
    position = max(sum(head.first_epoch_us <= first_us for head in known) - 1, 0)
    target, following = known[position], known[position + 1 :]
    is_new = first_us > target.last_epoch_us and target.row_count + len(rows) > most
    return (None if is_new else target), (following[0].first_epoch_us if following else None)


def _parts(rows: Sequence[Any], most: int) -> Iterator[Sequence[Any]]:
    """Yield rows in parts of about equal size, none much above ``most``, an epoch in one part."""
    parts = max(1, round(len(rows) / most))
    bounds = {0, len(rows)}
    for bound in (len(rows) * part // parts for part in range(1, parts)):
        # the first row of a later epoch
        bounds.add(next((k for k in range(bound, len(rows)) if rows[k].epoch_us > rows[k - 1].epoch_us), len(rows)))
    for start, stop in pairwise(sorted(bounds)):
        yield rows[start:stop]


def _segment(of: RowSeries, day: int, rows: Sequence[Any], kind: RowKind) -> tuple[dict[str, Any], Bins]:
    """Return the columns of a segment but its id and checksum, and what is summarised of it."""
    columns, bins = kind.columns_and_bins(of, rows)
    numbers = [row.number for row in rows]
    sequences = [] if of.table is measurement else [row.sequence for row in rows if row.sequence is not None]
    values = {
        "spacecraft_key": of.key,
        "series": of.table.name,
        **dict(zip(RowSeries._fields[2:], of[2:], strict=True)),
        "day": day,
        "row_count": len(rows),
        "feeding_count": int(columns["feeds"].sum()) if of.table is measurement else 0,
        "first_epoch_us": rows[0].epoch_us,
        "last_epoch_us": rows[-1].epoch_us,
        "first_number": min(numbers),
        "last_number": max(numbers),
        "first_sequence": min(sequences, default=None),
        "last_sequence": max(sequences, default=None),
        "content": pack_columns(columns),
    }
    return values, bins


def carry_out(connection: Connection, change: Change) -> bool:
    """Put segments in the place of rows and a segment; False, with nothing changed, when these are not all there."""
    of, columns = change.of, change.of.table.c
    lock_head(connection, of.key)
    (first_us, _), (last_us, last_number) = change.sealed[0], change.sealed[-1]
    epoch_us, number = columns.epoch_us, columns.number
    is_in_range = and_(
        *of.of_rows(), epoch_us >= first_us, epoch_us <= last_us, or_(epoch_us < last_us, number <= last_number)
    )
    there = {(row[0], row[1]) for row in connection.execute(select(epoch_us, number).where(is_in_range))}
    # damaged rows, and what came in meanwhile
    staying = sorted(there.difference(change.sealed))
    if len(there) - len(staying) != len(change.sealed) or len(staying) > _MOST_STAYING:
        # another process has sealed or dropped some meanwhile
        return False
    if change.replaced_id is not None:
        is_replaced = segment.c.segment_id == change.replaced_id
        if connection.execute(delete(segment).where(is_replaced)).rowcount != 1:
            return False
    is_sealed = tuple_(epoch_us, number).not_in(staying) if staying else true()
    connection.execute(delete(of.table).where(is_in_range, is_sealed))
    for values, bins in change.written:
        stored = connection.execute(segment.insert().values(values).returning(segment.c.segment_id))
        name = stored.scalar_one()
        rows = [{"segment_id": name, "quantity": key[0], "bin_s": key[1], "content": bins[key]} for key in bins]
        if rows:
            connection.execute(summary.insert(), rows)
    return True
