"""Batches of rows: prepared, sorted, inserted."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection, select

from db.connection.writer import run_bare
from db.encoding.measurement_rows import RowContent, StoredArrays, row_content, stored_arrays
from db.encoding.segments import SegmentCache, sealed_contents
from db.schema.columns import CHECKSUM_BYTES, measurement_checksum
from db.schema.tables import measurement
from service.records.epoch import format_epoch
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import DETAIL_NAMES, MeasurementBatch, QualityFlag, RowNotice, RowRefusal


@dataclass(frozen=True, slots=True)
class PreparedBatch:
    """A batch as the writer needs it; made outside the writer's thread."""

    spacecraft_key: int
    batch: MeasurementBatch
    epochs_us: list[int]
    #: sequence numbers, None where the source has none
    seqs: list[int | None]
    arrays: list[StoredArrays]
    is_ascending: bool

    def is_beyond(self, epoch_us: int | None) -> bool:
        """Return whether its rows ascend behind an epoch, so that none of them can be known."""
        return self.is_ascending and (epoch_us is None or self.epochs_us[0] > epoch_us)


def prepare(spacecraft_key: int, batch: MeasurementBatch) -> PreparedBatch:
    """Return the batch with its rows as bytes."""
    details = None
    if batch.details is not None:
        details = np.stack([getattr(batch.details, name) for name in DETAIL_NAMES], axis=1)
    return PreparedBatch(
        spacecraft_key,
        batch,
        epochs_us=batch.epochs_us.tolist(),
        seqs=[None if batch.first_seq is None else batch.first_seq + place for place in batch.index.tolist()],
        arrays=stored_arrays(batch.power_dbm, batch.flags, details),
        is_ascending=bool(np.all(batch.epochs_us[1:] > batch.epochs_us[:-1])),
    )


#: arrays of one size in one blob; one statement gives up the interpreter's lock, and waits for it, once
_INSERT = """
INSERT INTO measurement
  (spacecraft_key, epoch_us, source_key, number, plan_id, seq, delay_us, is_late, feeds, powers, flags, figures,
   checksum)
SELECT ?1, json_extract(value, '$[0]'), json_extract(value, '$[1]'), json_extract(value, '$[2]'),
  json_extract(value, '$[3]'), json_extract(value, '$[4]'), json_extract(value, '$[5]'), json_extract(value, '$[6]'),
  json_extract(value, '$[7]'),
  substr(?2, 5 + ?3 * row.key, ?4), substr(?2, 5 + ?4 + ?3 * row.key, ?5), substr(?2, 5 + ?6 + ?3 * row.key, ?7),
  substr(?2, 1 + ?3 * row.key, 4)
FROM json_each(?8) AS row
"""
_INSERT_ON_A_SERVER = """
INSERT INTO measurement
  (spacecraft_key, epoch_us, source_key, number, plan_id, seq, delay_us, is_late, feeds, powers, flags, figures,
   checksum)
SELECT * FROM unnest(%s::int[], %s::bigint[], %s::int[], %s::bigint[], %s::int[], %s::bigint[], %s::bigint[],
  %s::boolean[], %s::boolean[], %s::bytea[], %s::bytea[], %s::bytea[], %s::bytea[])
"""
#: columns before the arrays
_NUMBERS = 9


def insert_rows(connection: Connection, rows: Sequence[tuple[Any, ...]]) -> None:
    """Insert rows of a spacecraft, of all columns of ``measurement`` but the checksum, in their order."""
    if connection.dialect.name != "sqlite":
        whole = [(*row, measurement_checksum(row)) for row in rows]
        connection.exec_driver_sql(_INSERT_ON_A_SERVER, tuple(map(list, zip(*whole, strict=True))))
        return
    of_size: dict[tuple[int | None, ...], list[tuple[Any, ...]]] = {}
    for row in rows:
        of_size.setdefault(tuple([None if part is None else len(part) for part in row[_NUMBERS:]]), []).append(row)
    for (powers, flags, figures), its in of_size.items():
        blob = b"".join([part for row in its for part in (measurement_checksum(row), *row[_NUMBERS:]) if part])
        before = (powers or 0) + (flags or 0)
        sizes = (CHECKSUM_BYTES + before + (figures or 0), powers, flags, before, figures)
        numbers = json.dumps([row[1:_NUMBERS] for row in its])
        run_bare(connection, _INSERT, (its[0][0], blob, *sizes, numbers))


#: epochs in one query
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
        newest_us, row = self.newest_us, measurement.c
        query = select(row.epoch_us, row.plan_id, row.powers, row.flags, row.figures).where(
            row.spacecraft_key == self.spacecraft_key, row.source_key == self.source_key
        )
        wanted_us = [] if newest_us is None else [each for each in epochs_us if each <= newest_us]
        for start in range(0, len(wanted_us), LOOKUP_CHUNK):
            is_one = row.epoch_us.in_(wanted_us[start : start + LOOKUP_CHUNK])
            for epoch_us, plan_id, *arrays in self.connection.execute(query.where(is_one)):
                self.contents[epoch_us] = row_content(plan_id, (arrays[0], arrays[1], arrays[2]))
        unknown_us = [each for each in wanted_us if each not in self.contents]
        self.contents |= sealed_contents(self.connection, self.cache, self.spacecraft_key, self.source_key, unknown_us)


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
    if prepared.is_beyond(newest_us):
        return SortedRows(prepared, np.arange(len(prepared.epochs_us)))
    stored = _StoredRows(connection, cache, prepared.spacecraft_key, source_key, newest_us)
    stored.fetch(prepared.epochs_us)
    accepted: list[int] = []
    duplicates: list[int] = []
    refused: list[RowRefusal] = []
    moved: list[int] = []
    for position, epoch_us in enumerate(prepared.epochs_us):
        content = row_content(prepared.batch.plan_id, prepared.arrays[position])
        earlier = stored.contents.setdefault(epoch_us, content)
        if earlier != content and (earlier.is_leap or content.is_leap):
            content = content.in_leap_second()
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
            refused.append(_conflict(prepared, position))
    flagged = tuple(_moved_notice(prepared, position) for position in moved)
    batch = _with_moved(prepared, moved) if moved else prepared
    return SortedRows(batch, np.array(accepted, dtype=np.int64), tuple(duplicates), tuple(refused), flagged)


def _with_moved(prepared: PreparedBatch, moved: Sequence[int]) -> PreparedBatch:
    """Return a batch with some rows 1 us later and flagged."""
    batch = prepared.batch
    epochs_us, flags = batch.epochs_us.copy(), list(batch.flags)
    epochs_us[list(moved)] += 1
    for position in moved:
        masks = flags[position] or (0,) * batch.power_dbm.shape[1]
        flags[position] = tuple(mask | QualityFlag.LEAP_SECOND for mask in masks)
    return prepare(prepared.spacecraft_key, replace(batch, epochs_us=epochs_us, flags=tuple(flags)))


def _moved_notice(prepared: PreparedBatch, position: int) -> RowNotice:
    epoch = format_epoch(prepared.epochs_us[position] + 1)
    detail = f"a row of the leap second stands at this epoch, or this is one: stored at {epoch}"
    return RowNotice(int(prepared.batch.index[position]), prepared.seqs[position], "time.leap_second", detail)


def _conflict(prepared: PreparedBatch, position: int) -> RowRefusal:
    detail = (
        f"Source {prepared.batch.source!r} has sent other content for this epoch before (plan, powers, flags or "
        "figures beside the powers); the first row stays. Send a corrected row under its own epoch or from another "
        "source."
    )
    return RowRefusal(int(prepared.batch.index[position]), prepared.seqs[position], "measurement.conflict", detail)
