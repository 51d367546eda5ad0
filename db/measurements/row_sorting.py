"""Sorting of a batch: new rows, duplicates and conflicts, told apart by source, epoch and content.

A leap second shares its microseconds with the second after it. Where a row meets another content and either was
measured within a leap second, it is stored 1 us later with the flag LEAP_SECOND; sent again, it is found there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, and_, select

from db.encoding.measurement_details import details_of
from db.encoding.power_codec import unpack_flags, unpack_parts
from db.encoding.row_content import RowContent, row_content
from db.encoding.segments import SegmentCache, sealed_contents
from db.measurements.prepared_batch import PreparedBatch, prepare
from db.schema.tables import measurement, measurement_detail
from service.records.epoch import format_epoch
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import MeasurementBatch, RowNotice, RowRefusal
from service.records.levels.quality_flag import QualityFlag

#: epochs in one query; SQLite before 3.32 binds 999 values at most
LOOKUP_CHUNK = 500


@dataclass(frozen=True, slots=True)
class SortedRows:
    """Outcome of each row of a batch."""

    #: with the epochs and flags under which its rows are stored
    batch: PreparedBatch
    #: places of the rows to store
    accepted: IntArray
    #: places of the rows that were held already
    duplicates: tuple[int, ...] = ()
    refused: tuple[RowRefusal, ...] = ()
    flagged: tuple[RowNotice, ...] = ()


@dataclass
class _StoredRows:
    """Contents of one source by epoch: stored rows, and rows of the batch."""

    connection: Connection
    cache: SegmentCache
    spacecraft_key: int
    source_key: int
    newest_us: int | None
    contents: dict[int, RowContent] = field(default_factory=dict)

    def fetch(self, epochs_us: Sequence[int]) -> None:
        """Read the contents of those epochs that are stored."""
        newest_us = self.newest_us
        wanted_us = [] if newest_us is None else [each for each in epochs_us if each <= newest_us]
        for start in range(0, len(wanted_us), LOOKUP_CHUNK):
            chunk = wanted_us[start : start + LOOKUP_CHUNK]
            self.contents.update(_contents(self.connection.execute(self._query(chunk)).all()))
        unknown_us = [each for each in wanted_us if each not in self.contents]
        self.contents |= sealed_contents(self.connection, self.cache, self.spacecraft_key, self.source_key, unknown_us)

    def _query(self, epochs_us: Sequence[int]) -> Select[Any]:
        """Return the query for rows with their details."""
        row, detail = measurement.c, measurement_detail.c
        is_its = and_(
            detail.spacecraft_key == row.spacecraft_key,
            detail.epoch_us == row.epoch_us,
            detail.source_key == row.source_key,
        )
        return (
            select(row.epoch_us, row.plan_id, row.powers, row.flags, detail.figures)
            .select_from(measurement)
            .outerjoin(measurement_detail, is_its)
            .where(row.spacecraft_key == self.spacecraft_key, row.source_key == self.source_key)
            .where(row.epoch_us.in_(epochs_us))
        )


def sort_rows(
    connection: Connection, cache: SegmentCache, prepared: PreparedBatch, source_key: int, newest_us: int | None
) -> SortedRows:
    """Return new rows, duplicates and conflicts of a batch.

    Parameters
    ----------
    connection : Connection
        Of the writer.
    cache : SegmentCache
        Sealed days read lately.
    prepared : PreparedBatch
        The batch.
    source_key : int
        Its source.
    newest_us : int or None
        Newest stored epoch of the source, microseconds UTC; None before its first row.
    """
    if prepared.is_ascending and (newest_us is None or prepared.epochs_us[0] > newest_us):
        return SortedRows(prepared, np.arange(len(prepared.epochs_us)))
    stored = _StoredRows(connection, cache, prepared.spacecraft_key, source_key, newest_us)
    stored.fetch(prepared.epochs_us)
    accepted: list[int] = []
    duplicates: list[int] = []
    refused: list[RowRefusal] = []
    moved: list[int] = []
    for position, epoch_us in enumerate(prepared.epochs_us):
        content = prepared.content(position)
        earlier = stored.contents.setdefault(epoch_us, content)
        if earlier != content and (earlier.is_leap or content.is_leap):
            content = content.in_leap_second(prepared.batch.power_dbm.shape[1])
            if epoch_us + 1 not in stored.contents:
                stored.fetch([epoch_us + 1])
            earlier = stored.contents.setdefault(epoch_us + 1, content)
            if earlier is content:
                moved.append(position)
        if earlier is content:
            accepted.append(position)
        elif earlier == content:
            duplicates.append(position)
        else:
            refused.append(_conflict(prepared.batch, position))
    flagged = tuple(_moved_notice(prepared.batch, position) for position in moved)
    batch = _with_moved(prepared, moved) if moved else prepared
    return SortedRows(batch, np.array(accepted, dtype=np.int64), tuple(duplicates), tuple(refused), flagged)


def seq_at(batch: MeasurementBatch, position: int) -> int | None:
    """Return the sequence number of a row."""
    return None if batch.first_seq is None else batch.first_seq + int(batch.index[position])


def _with_moved(prepared: PreparedBatch, moved: Sequence[int]) -> PreparedBatch:
    """Return a batch with some rows 1 us later and flagged."""
    batch = prepared.batch
    epochs_us, flags = batch.epochs_us.copy(), list(batch.flags)
    epochs_us[list(moved)] += 1
    for position in moved:
        masks = flags[position] or (0,) * batch.power_dbm.shape[1]
        flags[position] = tuple(mask | QualityFlag.LEAP_SECOND for mask in masks)
    return prepare(prepared.spacecraft_key, replace(batch, epochs_us=epochs_us, flags=tuple(flags)))


def _contents(rows: Sequence[Row[Any]]) -> Iterator[tuple[int, RowContent]]:
    """Yield the contents of stored rows of (epoch, plan, powers, flags, details)."""
    for positions, power_dbm in unpack_parts([row.powers for row in rows]):
        for position, powers in zip(positions, power_dbm, strict=True):
            epoch_us, plan_id, _, flags, figures = tuple(rows[position])
            masks = None if flags is None else unpack_flags(flags, len(powers))
            details = None if figures is None else details_of(figures, len(powers)).row(...)
            yield epoch_us, row_content(plan_id, powers, masks, details)


def _moved_notice(batch: MeasurementBatch, position: int) -> RowNotice:
    epoch = format_epoch(int(batch.epochs_us[position]) + 1)
    detail = f"a row of the leap second stands at this epoch, or this is one: stored at {epoch}"
    return RowNotice(int(batch.index[position]), seq_at(batch, position), "time.leap_second", detail)


def _conflict(batch: MeasurementBatch, position: int) -> RowRefusal:
    detail = (
        f"Source {batch.source!r} has sent other content for this epoch before (plan, powers, flags or figures beside "
        "the powers); the first row stays. Send a corrected row under its own epoch or from another source."
    )
    return RowRefusal(int(batch.index[position]), seq_at(batch, position), "measurement.conflict", detail)
