"""Sealing closed days of measurements, a source under a plan at a time (db.sealing)."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection, func, select

from db.database import Database
from db.encoding.measurement_rows import measurement_of
from db.encoding.segments import (
    DAY_US,
    MeasuredColumns,
    RowSeries,
    SegmentHead,
    day_of,
    measured_arrays,
    read_chunk,
)
from db.schema.tables import measurement, source
from db.sealing import Change, Position, seal_day, sound_and_damaged
from db.summaries import Bins, bins_of
from service.records.levels.measurement import DETAIL_NAMES, Measurement
from service.records.storage import SealedPart

_C_N0 = "c_n0_db_hz"


class MeasurementRows:
    """Measurements as they are sealed."""

    def read(
        self, connection: Connection, of: RowSeries, start_us: int, stop_us: int, limit: int
    ) -> tuple[list[Measurement], list[Position]]:
        """Return the first rows of a span of the table, by epoch, and the places of those that are damaged."""
        epoch_us = measurement.c.epoch_us
        query = select(measurement).where(*of.of_rows(), epoch_us >= start_us, epoch_us < stop_us)
        rows = connection.execute(query.order_by(epoch_us).limit(limit)).all()
        sound, damaged = sound_and_damaged(measurement, rows)
        # a segment states its source once
        return [measurement_of(row, "") for row in sound], damaged

    def sealed(self, connection: Connection, head: SegmentHead) -> list[Measurement]:
        """Return the rows of a segment; StorageError ``storage.corrupt``."""
        return read_chunk(connection, None, head).records(np.arange(head.row_count))

    def columns_and_bins(self, of: RowSeries, rows: Sequence[Measurement]) -> tuple[dict[str, Any], Bins]:  # noqa: ARG002
        """Return rows as the columns of a segment, and the bins of powers and of C/N0 in the order of the plan."""
        columns = _columns(rows)
        c_n0_db_hz = columns.details[:, DETAIL_NAMES.index(_C_N0)]
        of_powers = bins_of("power_dbm", columns.epochs_us, columns.power_dbm)
        return measured_arrays(columns), of_powers | bins_of(_C_N0, columns.epochs_us, c_n0_db_hz)


ROWS = MeasurementRows()


def seal(database: Database, key: int, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
    """Seal the days that ended by an epoch and whose rows were received before an instant, a transaction a step."""
    for of, day in _series(database, key, before_us, received_before_us):
        is_it = (source.c.spacecraft_key == key, source.c.source_key == of.source_key)
        named = database.fetch_one(select(source.c.name).where(*is_it))
        for change in seal_day(database, of, day, ROWS):
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


def _columns(rows: Sequence[Measurement]) -> MeasuredColumns:
    """Return records as columns."""
    carriers, count = len(rows[0].power_dbm), len(rows)
    flags = np.zeros((count, carriers), dtype=np.int32)
    details = np.full((count, len(DETAIL_NAMES), carriers), np.nan, dtype=np.float32)
    for position, row in enumerate(rows):
        if row.flags is not None:
            flags[position] = row.flags
        if row.details is not None:
            details[position] = [getattr(row.details, name) for name in DETAIL_NAMES]
    places = ([getattr(row, name) for row in rows] for name in ("epoch_us", "number", "received_at_us"))
    claims = [(row.feeds_estimator, row.is_late, row.flags is not None) for row in rows]
    seqs = np.array([-1 if row.seq is None else row.seq for row in rows], dtype=np.int64)
    powers = np.array([row.power_dbm for row in rows]).astype(np.float32)
    epochs_us, numbers, received_at_us = (np.array(each, dtype=np.int64) for each in places)
    feeds, is_late, has_flags = np.array(claims, dtype=np.bool_).T
    columns = (epochs_us, numbers, received_at_us, feeds, is_late, has_flags, seqs, powers, flags, details)
    return MeasuredColumns._make(columns)


def _reported(name: str, change: Change) -> SealedPart:
    first_us = min(values["first_epoch_us"] for values, _ in change.written)
    moved, last_us = len(change.sealed), change.sealed[-1][0]
    return SealedPart(name, change.of.plan_id, first_us, last_us, moved, change.rows_of_segments)
