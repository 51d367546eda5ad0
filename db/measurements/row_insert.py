"""Batches of rows: prepared, sorted, inserted."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, repeat
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import Connection, Row, Select, and_, select

from db.connection.writer import run_bare
from db.encoding.measurement_runs import PreparedDetails, details_of, prepare_details
from db.encoding.power_codec import NO_FLAGS, StoredRows, pack_flags, pack_powers, unpack_flags, unpack_parts
from db.encoding.record_codec import RowContent, row_content
from db.encoding.segments import SegmentCache, sealed_contents
from db.schema.columns import measurement_checksums
from db.schema.tables import measurement, measurement_detail
from service.records.epoch import format_epoch
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import MeasurementBatch, QualityFlag, RowNotice, RowRefusal


@dataclass(frozen=True, slots=True)
class PreparedBatch:
    """A batch as the writer needs it; made outside the writer's thread."""

    spacecraft_key: int
    batch: MeasurementBatch
    epochs_us: list[int]
    powers: StoredRows
    #: zeros where a row has none
    flags: StoredRows
    #: (T,)
    has_flags: BoolArray
    is_ascending: bool
    #: places in the request without gap, and flags with every row or with none
    is_even: bool
    #: None when no row states any
    details: PreparedDetails | None = None

    def content(self, position: int) -> RowContent:
        """Return the content of a row, for comparison with the stored one."""
        batch, flags = self.batch, self.batch.flags[position]
        details = None if batch.details is None else batch.details.row(position)
        masks = None if flags is None else np.array(flags, dtype="<i4")
        return row_content(batch.plan_id, batch.power_dbm[position], masks, details)


def prepare(spacecraft_key: int, batch: MeasurementBatch) -> PreparedBatch:
    """Return the batch with its rows as bytes."""
    has_flags = np.array([row is not None for row in batch.flags], dtype=np.bool_)
    # nothing to compare, and it is what front ends send as long as all is well
    is_single = len(has_flags) == 1
    return PreparedBatch(
        spacecraft_key,
        batch,
        epochs_us=batch.epochs_us.tolist(),
        powers=pack_powers(batch.power_dbm),
        flags=_flags(batch) if has_flags.any() else NO_FLAGS,
        has_flags=has_flags,
        is_ascending=is_single or bool(np.all(batch.epochs_us[1:] > batch.epochs_us[:-1])),
        is_even=is_single or bool(np.all(np.diff(batch.index) == 1) and has_flags.all() == has_flags.any()),
        details=prepare_details(batch.details),
    )


def _flags(batch: MeasurementBatch) -> StoredRows:
    """Return the bit masks of a batch, zeros where a row has none."""
    blank = (0,) * batch.power_dbm.shape[1]
    return pack_flags(np.array([blank if row is None else row for row in batch.flags], dtype=np.int32))


_AT_ONCE = """
INSERT INTO measurement
  (spacecraft_key, source_key, plan_id, delay_us, feeds, is_late, number, seq, epoch_us, powers, flags,
   checksum)
SELECT ?1, ?2, ?3, ?4 - row.value, ?5, ?6, ?7 + row.key, ?8 + row.key, row.value,
  substr(?9, 1 + row.key * ?10, ?10), substr(?11, 1 + row.key * ?12, ?12), substr(?13, 1 + row.key * 4, 4)
FROM json_each(?14) AS row
"""
_AT_ONCE_ON_A_SERVER = """
INSERT INTO measurement
  (spacecraft_key, source_key, plan_id, delay_us, feeds, is_late, number, seq, epoch_us, powers, flags,
   checksum)
SELECT %s, %s, %s, %s::bigint - row.epoch_us, %s, %s, %s::bigint + row.place, %s::bigint + row.place, row.epoch_us,
  substr(%s::bytea, (1 + row.place * %s)::int, %s), substr(%s::bytea, (1 + row.place * %s)::int, %s),
  substr(%s::bytea, (1 + row.place * 4)::int, 4)
FROM (SELECT epoch_us, place - 1 AS place FROM unnest(%s::bigint[]) WITH ORDINALITY AS given (epoch_us, place)) AS row
"""


class RowRun(NamedTuple):
    """Rows to insert, in order of journal number."""

    spacecraft_key: int
    source_key: int
    plan_id: int
    received_at_us: int
    feeds: bool
    is_late: bool
    #: journal number of the first row
    first_number: int
    #: sequence number of the first row
    first_seq: int | None
    epochs_us: list[int]
    #: of all rows, as ``db.encoding.power_codec`` lays them out
    powers: StoredRows
    flags: StoredRows | None
    #: what each row states beside, None for those that state nothing; None when no row does
    figures: Sequence[bytes | None] | None

    def checksums(self) -> bytes:
        """Checksums of all rows, one behind another."""
        shared = (self.spacecraft_key, self.source_key, self.plan_id, self.is_late, self.feeds)
        columns = (
            self.epochs_us,
            count(self.first_number),
            repeat(None) if self.first_seq is None else count(self.first_seq),
            [self.received_at_us - epoch_us for epoch_us in self.epochs_us],
            self.powers.each(len(self.epochs_us)),
            repeat(None) if self.flags is None else self.flags.each(len(self.epochs_us)),
            repeat(None) if self.figures is None else self.figures,
        )
        return measurement_checksums(shared, zip(*columns, strict=False))


def insert_run(connection: Connection, run: RowRun) -> None:
    """Insert the rows of a run."""
    width, powers = run.powers
    flag_width, flags = (0, None) if run.flags is None else run.flags
    if connection.dialect.name == "sqlite":
        # no part of no bytes is NULL to SQLite, no part of any byte is an empty blob
        of_any = b"\0" if flags == b"" else flags
        parts = (powers, width, of_any, flag_width, run.checksums())
        values = (*run[:8], *parts, json.dumps(run.epochs_us))
        run_bare(connection, _AT_ONCE, values)
    else:
        blobs = (powers, width, width, flags, flag_width, flag_width, run.checksums())
        connection.exec_driver_sql(_AT_ONCE_ON_A_SERVER, (*run[:8], *blobs, run.epochs_us))


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
