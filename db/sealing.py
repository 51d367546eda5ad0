"""Sealed days: rows of a table become one row for many, late rows are merged in later; bins of them stand beside it.

What is to be written is made in a read transaction. A short write transaction puts it in the place of the rows and of
the segment that it was made of, and changes nothing when these are no longer all there: a crash leaves either rows or
segment. What was stored meanwhile stays in its table until the next look, which merges it into the segment of its day.

Bins of an hour, and of a minute where rows are dense, of every column that is sampled, are made with their segment, in
the transaction that writes it, and go with it. Of each there is how many rows hold a value, the sum, the least and the
greatest value and the epochs of these, one Parquet blob for the columns of a quantity. A segment is read as its longest
bins that lie within one interval each; where none do, as rows.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import compress, pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, and_, delete, func, or_, select, true, tuple_

from db.columns import agrees, soundness
from db.database import Database, lock_head, position_of
from db.encoding.column_blob import ColumnBlob, arrow, pack_columns
from db.encoding.segments import DAY_US, RowSeries, SegmentHead, day_of, heads
from db.tables import measurement, segment, summary
from service.core.arrays import IntArray
from service.core.rows import NEVER_US, Summaries, joined
from service.errors import StorageError
from service.ports.archive import Intervals
from service.records.calibration import Window
from service.records.epoch import US_PER_S, format_epoch

_LOG = logging.getLogger(__name__)
HOUR_S, MINUTE_S = 3600, 60
#: rows closer than this, by their median, get minutes too
DENSE_US = 20 * US_PER_S
#: blobs by quantity and length of a bin, s
Bins = Mapping[tuple[str, int], bytes]
Conditions = Sequence[ColumnElement[bool]]
#: days that one read transaction looks at
_SEASON_US = 128 * DAY_US


def bins_of(quantity: str, epochs_us: IntArray, values: NDArray[np.floating]) -> dict[tuple[str, int], bytes]:
    """Return the bins of rows.

    Parameters
    ----------
    quantity : str
        Name of the columns.
    epochs_us : ndarray, shape (T,)
        Ascending.
    values : ndarray, shape (T, C)
        NaN = absent.
    """
    if not len(epochs_us):
        return dict.fromkeys(((quantity, HOUR_S), (quantity, MINUTE_S)), b"")
    is_dense = len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < DENSE_US
    bins, made = Summaries.of_rows(epochs_us, values), {}
    is_empty = bool(np.isnan(values).all())
    for bin_s in (MINUTE_S, HOUR_S) if is_dense else (HOUR_S,):
        bins = bins.gathered(bins.first_us // (bin_s * US_PER_S))
        # without a value no byte, which says that rows need not be read
        made[quantity, bin_s] = b"" if is_empty else _blob(bins, bin_s * US_PER_S)
    return made


def _blob(bins: Summaries, bin_us: int) -> bytes:
    """Return bins as a blob, a row for each bin of each column."""
    pa = arrow()
    starts_us = bins.first_us // bin_us * bin_us
    is_held = bins.counts > 0
    count, columns = bins.counts.shape

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.T).ravel()

    least_us, greatest_us = (
        pa.array(flat(np.where(is_held, each - starts_us[:, None], 0))).dictionary_encode()
        for each in (bins.minimum_us, bins.maximum_us)
    )
    least, greatest = (flat(np.where(is_held, each, np.nan)) for each in (bins.minima, bins.maxima))
    return pack_columns(
        {
            "column": np.repeat(np.arange(columns), count),
            "start_us": np.tile(starts_us, columns),
            "rows": flat(bins.counts),
            "sum": flat(bins.sums),
            "least": least,
            "greatest": greatest,
            "least_us": least_us,
            "greatest_us": greatest_us,
        }
    )


def bins_from(blob: bytes, bin_s: int) -> Summaries:
    """Return the bins of a blob; ValueError where it holds none."""
    held = ColumnBlob(blob)
    column, starts_us, counts, sums = held.whole("column", "start_us", "rows", "sum")
    least, greatest, least_us, greatest_us = held.whole("least", "greatest", "least_us", "greatest_us")
    columns = int(column[-1]) + 1 if len(column) else 0
    if not columns or len(column) % columns:
        message = f"{len(column)} bins of {columns} columns"
        raise ValueError(message)
    counts, sums, least, greatest, least_us, greatest_us = (
        each.reshape(columns, -1).T for each in (counts, sums, least, greatest, least_us, greatest_us)
    )
    first_us, is_held = starts_us[: len(counts)], counts > 0
    return Summaries(
        first_us,
        first_us + bin_s * US_PER_S - 1,
        counts,
        sums,
        np.where(is_held, least, np.inf),
        np.where(is_held, greatest, -np.inf),
        np.where(is_held, first_us[:, None] + least_us, NEVER_US),
        np.where(is_held, first_us[:, None] + greatest_us, NEVER_US),
    )


def stored_blobs(connection: Connection, ids: Sequence[int], quantity: str, bin_s: int) -> dict[int, bytes]:
    """Return the blobs of segments by id; what is missing or damaged is not among them: its rows are still there."""
    found: dict[int, bytes] = {}
    is_one = summary.c.segment_id.in_(ids)
    query = select(summary).where(is_one, summary.c.quantity == quantity, summary.c.bin_s == bin_s)
    for row in connection.execute(query):
        if agrees(summary, row):
            found[row.segment_id] = row.content
        else:
            _warn(row.segment_id, "its checksum differs from its content")
    return found


def bins_within(
    connection: Connection, heads: Sequence[SegmentHead], quantity: str, intervals: Intervals, columns: slice
) -> tuple[Summaries | None, list[SegmentHead]]:
    """Return columns of segments in bins that lie within one interval each, and the segments to be read as rows."""
    parts: list[Summaries] = []
    rest = list(heads)
    for bin_s in (HOUR_S, MINUTE_S):
        fitting = [head.segment_id for head in rest if _fits(head, intervals, bin_s * US_PER_S)]
        read = set()
        for name, blob in stored_blobs(connection, fitting, quantity, bin_s).items():
            try:
                bins = bins_from(blob, bin_s) if blob else None
            except ValueError as fault:
                _warn(name, str(fault))
                continue
            read.add(name)
            if bins is not None:
                parts.append(bins.columns(columns))
        rest = [head for head in rest if head.segment_id not in read]
    return joined(parts) if parts else None, rest


def seasons(
    database: Database, window: Window, next_us: Callable[[Connection, int], int | None]
) -> Iterator[tuple[Connection, Window]]:
    """Yield parts of a window that hold rows, whole days but for its ends, each with a read transaction.

    A row is sealed or not within one transaction, and never leaves its day: each is counted once. ``next_us`` gives an
    epoch up to which no row lies from the given one on, None where none follows.
    """
    epoch_us: int | None = window.start_us
    while epoch_us is not None and epoch_us < window.stop_us:
        with database.read() as connection:
            epoch_us = next_us(connection, epoch_us)
            if epoch_us is None or epoch_us >= window.stop_us:
                return
            stop_us = min(window.stop_us, day_of(epoch_us) * DAY_US + _SEASON_US)
            yield connection, Window(epoch_us, stop_us)
        epoch_us = stop_us


def next_row_us(
    connection: Connection, column: ColumnElement[int], rows: Conditions, segments: Conditions, epoch_us: int
) -> int | None:
    """Return an epoch up to which no row lies from the given one on; None where none follows.

    Parameters
    ----------
    column : ColumnElement
        Epochs of the table of rows.
    rows, segments : sequence of conditions
        Of what is looked for.
    """
    first_us = connection.scalar(select(func.min(column)).where(*rows, column >= epoch_us))
    head = next(heads(connection, segments, epoch_us, 1 << 62), None)
    found = [first_us, None if head is None else head.first_epoch_us]
    return min((max(each, epoch_us) for each in found if each is not None), default=None)


def _fits(head: SegmentHead, intervals: Intervals, bin_us: int) -> bool:
    """Return whether every bin of a segment lies within one interval."""
    starts_us = np.arange(head.first_epoch_us // bin_us, head.last_epoch_us // bin_us + 1) * bin_us
    first_us = np.maximum(starts_us, head.first_epoch_us)
    return bool(intervals.hold(first_us, np.minimum(starts_us + bin_us - 1, head.last_epoch_us)).all())


def _warn(segment_id: int, reason: str) -> None:
    _LOG.warning(
        "a summary of segment %d is damaged, rows are read in its place; `soo doctor` tells more: %s",
        segment_id,
        reason,
    )


def differences(stored: bytes, made: bytes) -> Iterator[str]:
    """Yield the columns of a blob that are not those made again; sums to rounding."""
    if not stored or not made:
        yield from [] if stored == made else ["rows"]
        return
    try:
        one, other = ColumnBlob(stored), ColumnBlob(made)
        if (one.names, one.count) != (other.names, other.count):
            yield "rows"
            return
        for name in one.names:
            held, again = (np.array(each.values(name, slice(None))) for each in (one, other))
            is_sum = held.dtype.kind == "f" and again.dtype.kind == "f"
            if not (np.allclose(held, again, 1e-9, 1e-9, equal_nan=True) if is_sum else np.array_equal(held, again)):
                yield name
    except ValueError as fault:
        yield str(fault)


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
