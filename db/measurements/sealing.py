"""Sealing closed days of measurements: rows of the table become one row for many; late rows are merged in later.

What is to be written is made in a read transaction. A short write transaction then puts it in the place of the rows and
segments it was made of, and fails when these are no longer all there: a crash leaves either rows or segment. Rows are
never changed, and rows stored meanwhile have higher numbers, so a row is moved or stays, never lost.
"""

import logging
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, and_, delete, func, select

from db.database import Database, lock_head
from db.encoding.row_mapping import MEASUREMENT_COLUMNS, RECEIVED_AT_US, measurements_of
from db.encoding.segments import (
    CODEC,
    DAY_US,
    HEAD_COLUMNS,
    Blobs,
    SealedRows,
    SegmentHead,
    crc32_of,
    day_of,
    heads,
    pack,
    read_chunk,
)
from db.encoding.summary_codec import SummaryBlobs
from db.measurements.checksum_check import checksums_of_rows
from db.measurements.power_summaries import store_summary, summary_of
from db.schema.columns import agrees
from db.schema.tables import head as head_table
from db.schema.tables import measurement, measurement_detail, measurement_segment, source
from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.levels.measurement import DETAIL_NAMES, Measurement
from service.records.storage import SealedPart, SegmentState

_LOG = logging.getLogger(__name__)
#: rows of a segment: a day at a row every eight seconds, 1.4 MB of powers of 32 carriers in memory
SEGMENT_ROWS = 10_800
#: with more damaged rows than this a group stays as it is; SQLite before 3.32 binds 999 values at most
_MOST_DAMAGED = 500
#: epochs that a line of the log names at most
_NAMED = 5
_DAMAGED = (
    "%d rows of source %s differ from their checksum and are not sealed: they stay in the row table, at %s; list them "
    "with `soo doctor` and restore them from a backup"
)


class _Group(NamedTuple):
    """Rows of one source under one plan on one day."""

    source_key: int
    plan_id: int
    day: int

    def of_rows(self, key: int) -> ColumnElement[bool]:
        """Return the condition for its rows in the table of rows."""
        return and_(
            measurement.c.spacecraft_key == key,
            measurement.c.epoch_us >= self.day * DAY_US,
            measurement.c.epoch_us < (self.day + 1) * DAY_US,
            measurement.c.source_key == self.source_key,
            measurement.c.plan_id == self.plan_id,
        )


class _Change(NamedTuple):
    """Changes of one sealing transaction."""

    #: rows to remove: of this group up to this epoch and this journal number except damaged ones, and their count
    group: _Group
    last_epoch_us: int
    newest_number: int
    damaged_us: tuple[int, ...]
    rows: int
    details: int
    #: segments to remove, and those that replace them
    replaced: tuple[int, ...]
    written: tuple[tuple[SegmentHead, Blobs, SummaryBlobs], ...]


def seal(database: Database, key: int, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
    """Seal the days that ended by an epoch and whose rows were received before an instant, a transaction a step.

    A segment that cannot be read keeps the late rows of its day in the table of rows; its day is left alone. A row that
    differs from its checksum stays in the table of rows as it is, and is named in the log.
    """
    for group in _groups(database, key, before_us, received_before_us):
        while True:
            try:
                with database.read() as connection:
                    name, change = _prepared(connection, key, group)
            except StorageError as fault:
                if fault.code != "storage.corrupt":
                    raise
                _LOG.warning(
                    "late rows are not merged into a damaged sealed day; they stay readable in the row table: %s",
                    fault.detail,
                )
                break
            if change is None:
                break
            if not database.write(partial(_carry_out, key=key, change=change)):
                break
            yield _reported(name, change)


def _groups(database: Database, key: int, before_us: int, received_before_us: int) -> Iterator[_Group]:
    """Yield the groups to seal, day by day."""
    day: int | None = None
    stop_us = day_of(before_us) * DAY_US
    while True:
        with database.read() as connection:
            day = _next_day(connection, key, day, stop_us)
            if day is None:
                return
            found = connection.execute(
                select(measurement.c.source_key, measurement.c.plan_id, func.max(RECEIVED_AT_US))
                .where(measurement.c.spacecraft_key == key)
                .where(measurement.c.epoch_us >= day * DAY_US, measurement.c.epoch_us < (day + 1) * DAY_US)
                .group_by(measurement.c.source_key, measurement.c.plan_id)
                .order_by(measurement.c.source_key, measurement.c.plan_id)
            ).all()
        for source_key, plan_id, received_at_us in found:
            if received_at_us < received_before_us:
                yield _Group(source_key, plan_id, day)


def _next_day(connection: Connection, key: int, day: int | None, stop_us: int) -> int | None:
    """Return the next day with rows in the table of rows."""
    query = select(func.min(measurement.c.epoch_us)).where(
        measurement.c.spacecraft_key == key, measurement.c.epoch_us < stop_us
    )
    if day is not None:
        query = query.where(measurement.c.epoch_us >= (day + 1) * DAY_US)
    epoch_us = connection.scalar(query)
    return None if epoch_us is None else day_of(epoch_us)


def _prepared(connection: Connection, key: int, group: _Group) -> tuple[str, _Change | None]:
    """Return the name of the source, and what to do next with a group; None when it has no rows left."""
    is_it = (source.c.spacecraft_key == key, source.c.source_key == group.source_key)
    name = connection.scalar(select(source.c.name).where(*is_it))
    newest = connection.scalar(select(head_table.c.newest_number).where(head_table.c.spacecraft_key == key))
    is_its = (measurement_segment.c.source_key == group.source_key, measurement_segment.c.plan_id == group.plan_id)
    sealed = list(heads(connection, key, group.day * DAY_US, (group.day + 1) * DAY_US, *is_its))
    rows, damaged_us = _rows(connection, key, group)
    if not rows or len(damaged_us) > _MOST_DAMAGED:
        if damaged_us:
            _LOG.error(_DAMAGED, len(damaged_us), name, ", ".join(map(format_epoch, damaged_us[:_NAMED])))
        return str(name), None
    target, stop_us = _target(sealed, rows)
    if stop_us is not None:
        rows = [row for row in rows if row.epoch_us < stop_us]
    merged = _sealed_rows(rows)
    if target is not None:
        merged = _merged(merged, read_chunk(connection, None, target).rows())
    written = tuple(_segment(key, group, part) for part in _parts(merged))
    details = sum(row.details is not None for row in rows)
    replaced = () if target is None else (target.segment_id,)
    newest_number, last_us = int(newest or 0), rows[-1].epoch_us
    change = _Change(group, last_us, newest_number, damaged_us, len(rows), details, replaced, written)
    return str(name), change


def _rows(connection: Connection, key: int, group: _Group) -> tuple[list[Measurement], tuple[int, ...]]:
    """Return the first rows of a group, by epoch, and the epochs of those among them that are damaged."""
    is_its_detail = and_(
        measurement_detail.c.spacecraft_key == measurement.c.spacecraft_key,
        measurement_detail.c.epoch_us == measurement.c.epoch_us,
        measurement_detail.c.source_key == measurement.c.source_key,
    )
    is_its_source = and_(
        source.c.spacecraft_key == measurement.c.spacecraft_key, source.c.source_key == measurement.c.source_key
    )
    query = (
        select(*MEASUREMENT_COLUMNS, measurement.c.checksum)
        .select_from(measurement)
        .join(source, is_its_source)
        .outerjoin(measurement_detail, is_its_detail)
        .where(group.of_rows(key))
        .order_by(measurement.c.epoch_us)
        .limit(SEGMENT_ROWS)
    )
    rows: list[Any] = list(connection.execute(query))
    sound = [
        row for row in rows if row.checksum is None or agrees(row.checksum, partial(checksums_of_rows, key, [row]))
    ]
    found_us = {row.epoch_us for row in sound}
    return measurements_of(sound), tuple(row.epoch_us for row in rows if row.epoch_us not in found_us)


def _target(sealed: Sequence[SegmentHead], rows: Sequence[Measurement]) -> tuple[SegmentHead | None, int | None]:
    """Return the segment that takes rows in, None for a new one, and the epoch from which rows belong elsewhere."""
    first_us = rows[0].epoch_us
    position = max(sum(found.first_epoch_us <= first_us for found in sealed) - 1, 0)
    following = sealed[position + 1 :]
    stop_us = following[0].first_epoch_us if following else None
    if not sealed:
        return None, None
    target = sealed[position]
    is_behind = first_us > target.last_epoch_us
    is_full = target.row_count + len(rows) > SEGMENT_ROWS
    return (None if is_behind and is_full else target), stop_us


def _sealed_rows(rows: Sequence[Measurement]) -> SealedRows:
    """Return records as columns."""
    carriers, count = len(rows[0].power_dbm), len(rows)
    flags = np.zeros((count, carriers), dtype=np.int32)
    details = np.full((count, len(DETAIL_NAMES), carriers), np.nan, dtype=np.float32)
    for position, row in enumerate(rows):
        if row.flags is not None:
            flags[position] = row.flags
        if row.details is not None:
            details[position] = [getattr(row.details, name) for name in DETAIL_NAMES]
    integers = np.array([(r.epoch_us, r.number, r.received_at_us, r.seq or 0) for r in rows], dtype=np.int64).T
    claims = [
        (row.seq is not None, row.is_late, row.feeds_estimator, row.flags is not None, row.details is not None)
        for row in rows
    ]
    powers = np.array([row.power_dbm for row in rows]).astype(np.float32)
    return SealedRows._make((*integers, *np.array(claims, dtype=np.bool_).T, powers, flags, details))


def _merged(one: SealedRows, other: SealedRows) -> SealedRows:
    """Return the rows of both in order of epoch."""
    order = np.argsort(np.concatenate((one.epochs_us, other.epochs_us)), kind="stable")
    columns: Iterator[tuple[Any, Any]] = zip(one, other, strict=True)
    return SealedRows._make(np.concatenate(pair)[order] for pair in columns)


def _parts(rows: SealedRows) -> Iterator[SealedRows]:
    """Yield rows in parts of equal size, none much above ``SEGMENT_ROWS``."""
    count = len(rows.epochs_us)
    bounds = np.linspace(0, count, max(1, round(count / SEGMENT_ROWS)) + 1).astype(int)
    for start, stop in pairwise(bounds):
        yield SealedRows._make(column[start:stop] for column in rows)


def _segment(key: int, group: _Group, rows: SealedRows) -> tuple[SegmentHead, Blobs, SummaryBlobs]:
    """Return a segment as it is stored, still without an id, and its summary."""
    blobs = pack(rows)
    made = SegmentHead(
        segment_id=0,
        spacecraft_key=key,
        source_key=group.source_key,
        plan_id=group.plan_id,
        day=group.day,
        row_count=len(rows.epochs_us),
        feeding_count=int(rows.feeds.sum()),
        first_epoch_us=int(rows.epochs_us[0]),
        last_epoch_us=int(rows.epochs_us[-1]),
        first_number=int(rows.numbers.min()),
        last_number=int(rows.numbers.max()),
        codec=CODEC,
        crc32=0,
    )
    return made._replace(crc32=crc32_of(made, blobs)), blobs, summary_of(rows)


def _carry_out(connection: Connection, key: int, change: _Change) -> bool:
    """Put segments in the place of rows and segments; False, with nothing changed, when these are not all there."""
    lock_head(connection, key)
    is_moved = and_(
        change.group.of_rows(key),
        measurement.c.epoch_us <= change.last_epoch_us,
        measurement.c.number + 0 <= change.newest_number,
        measurement.c.epoch_us.not_in(change.damaged_us),
    )
    moved = select(measurement.c.epoch_us).where(is_moved)
    is_its_detail = and_(
        measurement_detail.c.spacecraft_key == key,
        measurement_detail.c.source_key == change.group.source_key,
        measurement_detail.c.epoch_us.in_(moved),
    )
    is_replaced = measurement_segment.c.segment_id.in_(change.replaced)
    with connection.begin_nested() as savepoint:
        details = connection.execute(delete(measurement_detail).where(is_its_detail)).rowcount
        rows = connection.execute(delete(measurement).where(is_moved)).rowcount
        segments = connection.execute(delete(measurement_segment).where(is_replaced)).rowcount
        if (details, rows, segments) != (change.details, change.rows, len(change.replaced)):
            # another process has sealed or dropped them meanwhile
            savepoint.rollback()
            return False
        for made, blobs, summary in change.written:
            insert = (
                measurement_segment.insert().values(_values(made, blobs)).returning(measurement_segment.c.segment_id)
            )
            store_summary(connection, connection.execute(insert).scalar_one(), summary)
    return True


def _values(made: SegmentHead, blobs: Blobs) -> dict[str, Any]:
    """Return the columns of a segment but its id."""
    values = {**made._asdict(), **blobs._asdict()}
    del values["segment_id"]
    return values


def _reported(name: str, change: _Change) -> SealedPart:
    of_segments = [made for made, *_ in change.written]
    first_us = min(made.first_epoch_us for made in of_segments)
    rows_of_segments = sum(made.row_count for made in of_segments)
    return SealedPart(name, change.group.plan_id, first_us, change.last_epoch_us, change.rows, rows_of_segments)


def states(database: Database, key: int) -> Iterator[SegmentState]:
    """Read every segment and yield what came of it."""
    seen = 0
    while True:
        with database.read() as connection:
            query = select(*HEAD_COLUMNS).where(measurement_segment.c.spacecraft_key == key)
            is_next = measurement_segment.c.segment_id > seen
            row = connection.execute(query.where(is_next).order_by(measurement_segment.c.segment_id).limit(1)).first()
            if row is None:
                return
            found = SegmentHead(*row)
            yield SegmentState(
                found.segment_id,
                found.source_key,
                found.plan_id,
                found.day * DAY_US,
                found.row_count,
                _fault(connection, found),
            )
        seen = found.segment_id


def _fault(connection: Connection, found: SegmentHead) -> str | None:
    """Return why a segment cannot be read."""
    try:
        read_chunk(connection, None, found).extras()
    except StorageError as fault:
        if fault.code != "storage.corrupt":
            raise
        return fault.detail
    return None
