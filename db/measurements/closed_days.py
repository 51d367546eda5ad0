"""Closed days of measurements: sealed, a source under a plan at a time (db.sealing); and retention of every series.

Rows older than a series keeps are dropped, some at a time, and counted.

The mark of a series moves before its rows go, in the transaction that drops the first of them, so nothing below it is
taken in again and readers know where a series begins. Of measurements and attitude only what the live chain has
consumed is dropped, whole days at once where they are sealed.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import (
    ColumnElement,
    Connection,
    Integer,
    Table,
    and_,
    delete,
    func,
    literal,
    select,
    true,
    tuple_,
    update,
)

from db.database import Database, lock_head
from db.encoding.measurement_rows import measurement_of
from db.encoding.segments import (
    DAY_US,
    RowSeries,
    SegmentHead,
    day_of,
    measured_arrays,
    read_chunk,
)
from db.sealing import Bins, Change, bins_of, seal_day
from db.tables import (
    attitude,
    head,
    measurement,
    retention_mark,
    segment,
    source,
    torque,
    trace,
)
from service.records.levels.measurement import DETAIL_NAMES, Measurement
from service.records.storage import RetiredRows, SealedPart

#: rows that one transaction drops
ROWS_AT_ONCE = 500
#: alarms or notes that one transaction drops
LOGS_AT_ONCE = 500
#: segments that one transaction drops
SEGMENTS_AT_ONCE = 8
#: about how many bytes a row of attitude takes, and one of torque
ATTITUDE_BYTES, TORQUE_BYTES = 320, 640
#: before every epoch
_NEVER_US = -(1 << 62)


class _Part(NamedTuple):
    """A table that holds rows of a series."""

    table: Table
    #: by which a row is older than another
    epoch_us: ColumnElement[int]
    #: columns that name a row, beside the key of the spacecraft
    key: tuple[ColumnElement[Any], ...]
    #: about how many bytes a row takes
    size: ColumnElement[int]
    #: how many rows of the series a row stands for
    rows: ColumnElement[int]
    at_once: int = ROWS_AT_ONCE
    #: a row may go when the chain has consumed its numbers up to this one
    number: ColumnElement[int] | None = None
    #: columns by which the table is ordered before the epoch
    prefix: tuple[ColumnElement[str], ...] = ()
    #: rows of the table that belong to the series
    is_its: ColumnElement[bool] = true()


def _length(column: ColumnElement[bytes]) -> ColumnElement[int]:
    return func.coalesce(func.length(column), 0)


_ONE = literal(1, Integer)
_ROWS = _Part(
    measurement,
    measurement.c.epoch_us,
    (measurement.c.epoch_us, measurement.c.source_key),
    _length(measurement.c.powers) + _length(measurement.c.flags) + _length(measurement.c.figures) + 64,
    _ONE,
    number=measurement.c.number,
)
_ATTITUDE = _Part(
    attitude,
    attitude.c.epoch_us,
    (attitude.c.version, attitude.c.method, attitude.c.epoch_us, attitude.c.number),
    literal(ATTITUDE_BYTES, Integer),
    _ONE,
    number=attitude.c.number,
    prefix=(attitude.c.version, attitude.c.method),
)
_TORQUE = _Part(
    torque,
    torque.c.epoch_us,
    (torque.c.version, torque.c.epoch_us, torque.c.number),
    literal(TORQUE_BYTES, Integer),
    _ONE,
    number=torque.c.number,
    prefix=(torque.c.version,),
)


def _sealed(table: Table) -> _Part:
    return _Part(
        segment,
        segment.c.last_epoch_us,
        (segment.c.segment_id,),
        _length(segment.c.content) + 128,
        segment.c.row_count,
        SEGMENTS_AT_ONCE,
        number=segment.c.last_number,
        prefix=(segment.c.version, segment.c.method),
        is_its=segment.c.series == table.name,
    )


_TRACE = _Part(trace, trace.c.epoch_us, (trace.c.trace_id,), trace.c.size_bytes + 128, _ONE)
#: which tables hold a series
PARTS: dict[str, tuple[_Part, ...]] = {
    "measurements": (_ROWS, _sealed(measurement)),
    "attitude": (_ATTITUDE, _sealed(attitude)),
    "torques": (_TORQUE, _sealed(torque)),
    "traces": (_TRACE,),
}


def kept_from_us(connection: Connection, key: int, series: str) -> int:
    """Return the epoch from which on a series is kept; before every epoch when nothing was dropped."""
    is_it = (retention_mark.c.spacecraft_key == key, retention_mark.c.series == series)
    mark = connection.scalar(select(retention_mark.c.kept_from_us).where(*is_it))
    return _NEVER_US if mark is None else int(mark)


def drop(database: Database, key: int, series: str, before_us: int) -> Iterator[RetiredRows]:
    """Drop the rows of whole days before an epoch, a transaction a step."""
    stop_us = day_of(before_us) * DAY_US
    for part in PARTS[series]:
        with database.read() as connection:
            ranges = list(_ranges(connection, key, part))
        for is_in_range in ranges:
            step = partial(
                _drop_some,
                key=key,
                series=series,
                part=part,
                is_old=and_(is_in_range, part.epoch_us < stop_us),
                stop_us=stop_us,
            )
            while (rows := database.write(step)) > 0:
                yield RetiredRows(series, rows, stop_us)


def fitting_us(database: Database, key: int, series: str, size_bytes: int) -> int | None:
    """Return the midnight from which on the days of a series fit a size; None when all of them do."""
    by_day: dict[int, int] = {}
    with database.read() as connection:
        for part in PARTS[series]:
            day = part.epoch_us // DAY_US
            query = (
                select(day, func.sum(part.size)).where(part.table.c.spacecraft_key == key, part.is_its).group_by(day)
            )
            for found, size in connection.execute(query):
                by_day[int(found)] = by_day.get(int(found), 0) + int(size)
    held = 0
    for found in sorted(by_day, reverse=True):
        held += by_day[found]
        if held > size_bytes:
            # the newest day stays whatever it takes
            return (min(found + 1, max(by_day))) * DAY_US
    return None


def _ranges(connection: Connection, key: int, part: _Part) -> Iterator[ColumnElement[bool]]:
    """Yield conditions for the ranges of a table within which it is ordered by epoch."""
    is_its = and_(part.table.c.spacecraft_key == key, part.is_its)
    if not part.prefix:
        yield is_its
        return
    query = select(*part.prefix).where(is_its).order_by(*part.prefix).limit(1)
    row = connection.execute(query).first()
    while row is not None:
        yield and_(is_its, *(column == value for column, value in zip(part.prefix, row, strict=True)))
        row = connection.execute(query.where(tuple_(*part.prefix) > tuple(row))).first()


def _drop_some(
    connection: Connection, *, key: int, series: str, part: _Part, is_old: ColumnElement[bool], stop_us: int
) -> int:
    """Drop the first rows before an epoch and count them; 0 when there are none."""
    lock_head(connection, key)
    may_go = is_old
    if part.number is not None:
        consumed = select(head.c.consumed_number).where(head.c.spacecraft_key == key).scalar_subquery()
        # the sum keeps the planner on the key by epoch
        may_go = and_(is_old, part.number + 0 <= consumed)
    rows = delete_some(connection, key, part, may_go, part.epoch_us)
    if rows:
        _count(connection, key, series, stop_us, rows)
    return rows


def delete_some(
    connection: Connection, key: int, part: _Part, may_go: ColumnElement[bool], *order: ColumnElement[int]
) -> int:
    """Delete some rows of a spacecraft and count them; 0 when there are none."""
    its = select(*part.key, part.rows).where(part.table.c.spacecraft_key == key, part.is_its, may_go)
    names = connection.execute(its.order_by(*order).limit(part.at_once)).all()
    is_named = tuple_(*part.key).in_([tuple(name)[:-1] for name in names])
    connection.execute(delete(part.table).where(part.table.c.spacecraft_key == key, is_named))
    return sum(int(name[-1]) for name in names)


def _count(connection: Connection, key: int, series: str, stop_us: int, rows: int) -> None:
    """Move the mark of a series, never back, and add to its count."""
    is_it = (retention_mark.c.spacecraft_key == key, retention_mark.c.series == series)
    known = connection.execute(select(retention_mark).where(*is_it)).first()
    if known is None:
        values = {"spacecraft_key": key, "series": series, "kept_from_us": stop_us, "rows_dropped": rows}
        connection.execute(retention_mark.insert().values(values))
        return
    values = {"kept_from_us": max(known.kept_from_us, stop_us), "rows_dropped": known.rows_dropped + rows}
    connection.execute(update(retention_mark).where(*is_it).values(values))


_C_N0 = "c_n0_db_hz"


class MeasurementRows:
    """Measurements as they are sealed."""

    def sealed(self, connection: Connection, head: SegmentHead) -> list[Measurement]:
        """Return the rows of a segment; StorageError ``storage.corrupt``."""
        return read_chunk(connection, None, head).records(np.arange(head.row_count))

    def columns_and_bins(self, of: RowSeries, rows: Sequence[Any]) -> tuple[dict[str, Any], Bins]:  # noqa: ARG002
        """Return rows as the columns of a segment, and the bins of powers and of C/N0 in the order of the plan."""
        # a segment states its source once
        records = [row if isinstance(row, Measurement) else measurement_of(row, "") for row in rows]
        power_dbm = np.array([row.power_dbm for row in records]).astype(np.float32)
        flags = np.zeros(power_dbm.shape, dtype=np.int32)
        details = np.full((len(records), len(DETAIL_NAMES), power_dbm.shape[1]), np.nan, dtype=np.float32)
        for position, row in enumerate(records):
            if row.flags is not None:
                flags[position] = row.flags
            if row.details is not None:
                details[position] = [getattr(row.details, name) for name in DETAIL_NAMES]
        plain: dict[str, Any] = {
            "epoch_us": np.array([row.epoch_us for row in records]),
            "number": [row.number for row in records],
            "received_at_us": [row.received_at_us for row in records],
            "feeds": np.array([row.feeds_estimator for row in records]),
            "is_late": [row.is_late for row in records],
            "has_flags": [row.flags is not None for row in records],
            "seq": [-1 if row.seq is None else row.seq for row in records],
        }
        bins = bins_of("power_dbm", plain["epoch_us"], power_dbm)
        bins |= bins_of(_C_N0, plain["epoch_us"], details[:, DETAIL_NAMES.index(_C_N0)])
        return measured_arrays(plain, power_dbm, flags, details), bins


def seal_measurements(database: Database, key: int, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
    """Seal the days that ended by an epoch and whose rows were received before an instant, a transaction a step."""
    for of, day in _series(database, key, before_us, received_before_us):
        is_it = (source.c.spacecraft_key == key, source.c.source_key == of.source_key)
        named = database.fetch_one(select(source.c.name).where(*is_it))
        for change in seal_day(database, of, day, MeasurementRows()):
            yield _reported("" if named is None else str(named.name), change)


def _series(database: Database, key: int, before_us: int, received_before_us: int) -> Iterator[tuple[RowSeries, int]]:
    """Yield what to seal, day by day."""
    column = measurement.c
    stop_us, start_us = day_of(before_us) * DAY_US, -(1 << 62)
    first = select(func.min(column.epoch_us)).where(column.spacecraft_key == key, column.epoch_us < stop_us)
    while True:
        with database.read() as connection:
            first_us = connection.scalar(first.where(column.epoch_us >= start_us))
            if first_us is None:
                return
            day = day_of(first_us)
            start_us = (day + 1) * DAY_US
            found = connection.execute(
                select(column.source_key, column.plan_id, func.max(column.epoch_us + column.delay_us))
                .where(column.spacecraft_key == key, column.epoch_us >= day * DAY_US, column.epoch_us < start_us)
                .group_by(column.source_key, column.plan_id)
                .order_by(column.source_key, column.plan_id)
            ).all()
        for source_key, plan_id, received_at_us in found:
            if received_at_us < received_before_us:
                yield RowSeries(key, measurement, source_key=source_key, plan_id=plan_id), day


def _reported(name: str, change: Change) -> SealedPart:
    first_us = min(values["first_epoch_us"] for values, _ in change.written)
    moved, last_us = len(change.sealed), change.sealed[-1][0]
    return SealedPart(name, change.of.plan_id, first_us, last_us, moved, change.rows_of_segments)
