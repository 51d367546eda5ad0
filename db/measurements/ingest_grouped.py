"""Storing single rows of many front ends together: one query, one insert and two updates for all that wait.

Each statement gives up the interpreter's lock and waits for it behind the decoders of the next requests. Thirty-two
front ends that send a row each would pay that a hundred times a commit, together they pay it four times. Only the rows
that nearly all are go this way: one row a batch, from a known source, behind its newest one and next in its sequence.
Everything else takes ``store_batch``, in its turn. On PostgreSQL, where a statement costs a way to the server and not
a lock, all do.
"""

import json
import sqlite3
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from sqlalchemy import Connection, bindparam, select

from db.connection.writer import PreparedStatement, run_bare
from db.encoding.segments import SegmentCache
from db.measurements.ingest import MOVE_HEAD, STATE_COLUMNS, IngestState, later, store_batch
from db.measurements.row_insert import PreparedBatch
from db.schema.columns import measurement_checksums
from db.schema.tables import head, source
from service.records.levels.measurement import BatchReceipt

#: UPDATE .. FROM
_IS_KNOWN_TO_SQLITE = sqlite3.sqlite_version_info >= (3, 33)
_READ_STATES = PreparedStatement(
    select(source.c.name, *STATE_COLUMNS)
    .select_from(head)
    .join(source, source.c.spacecraft_key == head.c.spacecraft_key)
    .where(head.c.spacecraft_key == bindparam("of_spacecraft")),
    "of_spacecraft",
)
_INSERT_ROWS = """
INSERT INTO measurement
  (spacecraft_key, epoch_us, source_key, number, plan_id, seq, delay_us, is_late, feeds, powers, flags,
   checksum)
SELECT ?1, json_extract(value, '$[0]'), json_extract(value, '$[1]'), ?2 + row.key, json_extract(value, '$[2]'),
  json_extract(value, '$[3]'), json_extract(value, '$[4]'), json_extract(value, '$[5]'), json_extract(value, '$[6]'),
  substr(?3, json_extract(value, '$[7]'), json_extract(value, '$[8]')),
  substr(?3, json_extract(value, '$[9]'), json_extract(value, '$[10]')),
  substr(?3, json_extract(value, '$[11]'), json_extract(value, '$[12]'))
FROM json_each(?4) AS row
"""
_INSERT_DETAILS = """
INSERT INTO measurement_detail (spacecraft_key, epoch_us, source_key, figures)
SELECT ?1, json_extract(value, '$[0]'), json_extract(value, '$[1]'),
  substr(?2, json_extract(value, '$[2]'), json_extract(value, '$[3]'))
FROM json_each(?3) AS row
"""
_MOVE_SOURCES = """
UPDATE source SET row_count = moved.row_count, newest_epoch_us = moved.newest_epoch_us, seq_last = moved.seq_last
FROM (
  SELECT json_extract(value, '$[0]') AS source_key, json_extract(value, '$[1]') AS row_count,
    json_extract(value, '$[2]') AS newest_epoch_us, json_extract(value, '$[3]') AS seq_last
  FROM json_each(?2)
) AS moved
WHERE source.spacecraft_key = ?1 AND source.source_key = moved.source_key
"""


@dataclass(frozen=True, slots=True)
class StoreBatch:
    """The writing of one batch, for the writer, who lets neighbours write together."""

    prepared: PreparedBatch
    cache: SegmentCache

    def __call__(self, connection: Connection) -> BatchReceipt:
        """Store the batch."""
        return store_batch(connection, self.prepared, self.cache)

    @staticmethod
    def together(connection: Connection, works: Sequence["StoreBatch"]) -> list[BatchReceipt]:
        """Store batches one after another, as if each were alone."""
        if connection.dialect.name != "sqlite" or not _IS_KNOWN_TO_SQLITE:
            return [work(connection) for work in works]
        of_spacecraft = Counter(work.prepared.spacecraft_key for work in works)
        waiting: dict[int, _Together] = {}
        receipts = []
        for work in works:
            key = work.prepared.spacecraft_key
            receipt = None
            if of_spacecraft[key] > 1 and len(work.prepared.epochs_us) == 1:
                if key not in waiting:
                    waiting[key] = _Together(connection, key)
                receipt = waiting[key].consume(work.prepared)
            if receipt is None:
                if key in waiting:
                    waiting.pop(key).flush()
                receipt = work(connection)
            receipts.append(receipt)
        for together in waiting.values():
            together.flush()
        return receipts


class _Blobs:
    """Bytes one behind another, and where each part stands, counted from one as SQL does."""

    def __init__(self) -> None:
        # never empty: a part of no bytes is NULL to SQLite
        self._parts: list[bytes] = [b"\0"]
        self._size = 1

    def add(self, part: bytes) -> tuple[int, int]:
        """Return first place and number of bytes of a part."""
        position = self._size + 1
        self._parts.append(part)
        self._size += len(part)
        return position, len(part)

    def joined(self) -> bytes:
        """Return all."""
        return b"".join(self._parts)


class _Together:
    """Rows of one spacecraft that are written in one go."""

    def __init__(self, connection: Connection, key: int) -> None:
        self._connection = connection
        self._key = key
        #: of every source by name, as if what was taken were written
        self._states: dict[str, IngestState] = {}
        self._first_number = 0
        self._newest_epoch_us: int | None = None
        for name, *values in _READ_STATES.run(connection, key).fetchall():
            state = self._states[name] = IngestState(*values)
            self._first_number, self._newest_epoch_us = state.newest_number + 1, state.newest_epoch_us
        self._moved: set[str] = set()
        self._rows: list[tuple[Any, ...]] = []
        self._blobs = _Blobs()
        self._details: list[tuple[Any, ...]] = []
        self._figures = _Blobs()

    def consume(self, prepared: PreparedBatch) -> BatchReceipt | None:
        """Take a batch of one row along and tell what will be committed of it; None when it is none for here."""
        batch, epoch_us = prepared.batch, prepared.epochs_us[0]
        state = self._states.get(batch.source)
        if state is None or (state.source_newest_epoch_us is not None and epoch_us <= state.source_newest_epoch_us):
            return None
        seq = None if batch.first_seq is None else batch.first_seq + int(batch.index[0])
        if seq is not None and (state.tail is None or seq != state.tail.last + 1):
            return None
        consumed_us = state.consumed_epoch_us
        is_late = bool(batch.is_stale[0]) or (consumed_us is not None and epoch_us < consumed_us)
        self._add(prepared, state, seq, is_late=is_late)
        number = self._first_number + len(self._rows) - 1
        return BatchReceipt(1, 0, int(is_late), (), first_number=number, feeds_estimator=bool(state.is_prime))

    def flush(self) -> None:
        """Write what was taken."""
        if not self._rows:
            return
        values = (self._key, self._first_number, self._blobs.joined(), json.dumps(self._rows))
        run_bare(self._connection, _INSERT_ROWS, values)
        if self._details:
            run_bare(self._connection, _INSERT_DETAILS, (self._key, self._figures.joined(), json.dumps(self._details)))
        MOVE_HEAD.run(self._connection, self._key, self._first_number + len(self._rows) - 1, self._newest_epoch_us)
        moved = [
            (state.source_key, state.row_count, state.source_newest_epoch_us, state.seq_last)
            for state in map(self._states.__getitem__, self._moved)
        ]
        run_bare(self._connection, _MOVE_SOURCES, (self._key, json.dumps(moved)))

    def _add(self, prepared: PreparedBatch, state: IngestState, seq: int | None, *, is_late: bool) -> None:
        """Note a row, and where its source stands behind it."""
        batch, epoch_us, details = prepared.batch, prepared.epochs_us[0], prepared.details
        position, delay_us = (epoch_us, state.source_key), batch.received_at_us - epoch_us
        claims, number = (is_late, bool(state.is_prime)), self._first_number + len(self._rows)
        powers, flags = prepared.powers.rows, prepared.flags.rows if prepared.has_flags[0] else None
        figures = None if details is None else details.figures
        shared = (self._key, state.source_key, batch.plan_id, *claims)
        checksum = measurement_checksums(shared, [(epoch_us, number, seq, delay_us, powers, flags, figures)])
        parts = [(1, None) if part is None else self._blobs.add(part) for part in (powers, flags, checksum)]
        self._rows.append((*position, batch.plan_id, seq, delay_us, *claims, *chain.from_iterable(parts)))
        if figures is not None:
            self._details.append((*position, *self._figures.add(figures)))
        self._newest_epoch_us = later(epoch_us, self._newest_epoch_us)
        self._moved.add(batch.source)
        last = state.seq_last if seq is None else seq
        moved = state._replace(row_count=state.row_count + 1, source_newest_epoch_us=epoch_us, seq_last=last)
        self._states[batch.source] = moved
