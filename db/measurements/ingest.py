"""Storing single rows of many front ends together: one query, one insert and two updates for all that wait.

Each statement gives up the interpreter's lock and waits for it behind the decoders of the next requests. Thirty-two
front ends that send a row each would pay that a hundred times a commit, together they pay it four times. Only the rows
that nearly all are go this way: one row a batch, from a known source, behind its newest one and next in its sequence.
Everything else takes ``store_batch``, in its turn. On PostgreSQL, where a statement costs a way to the server and not
a lock, all do.

Storing batches of measurements, the hot path: one query, one insert and two updates a batch.

Of a batch ``received = accepted + duplicates + refused``. Whether a row is known is asked of the table only where its
epoch is not above the newest stored one of its source, and of sealed days only where one reaches to its epoch.
"""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import Connection, and_, bindparam, func, select, update

from db.connection.writer import PreparedStatement, run_bare
from db.database import lock_head
from db.encoding.measurement_runs import insert_details
from db.encoding.segments import SegmentCache
from db.measurements.row_insert import PreparedBatch, RowRun, SortedRows, insert_run, seq_at, sort_rows
from db.measurements.sequence_numbers import MAX_JUMP, NumberedRow, SequenceNumbers, Tail, blocks_of
from db.schema.columns import measurement_checksums
from db.schema.tables import head, source, source_key_run
from service.errors import InvalidInputError, source_not_yours
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import BatchReceipt, MeasurementBatch, RowNotice, Sender

#: of ``IngestState``
STATE_COLUMNS = (
    head.c.newest_number,
    head.c.newest_epoch_us,
    head.c.consumed_epoch_us,
    source.c.source_key,
    source.c.is_prime,
    source.c.row_count,
    source.c.newest_epoch_us.label("source_newest_epoch_us"),
    source.c.station,
    source.c.key_id,
    source.c.seq_run,
    source.c.seq_after_us,
    source.c.seq_start,
    source.c.seq_last,
    source.c.rows_missing,
)
_READ_STATE = PreparedStatement(
    select(*STATE_COLUMNS)
    .select_from(head)
    .outerjoin(source, and_(source.c.spacecraft_key == head.c.spacecraft_key, source.c.name == bindparam("of_name")))
    .where(head.c.spacecraft_key == bindparam("of_spacecraft")),
    "of_spacecraft",
    "of_name",
)
MOVE_HEAD = PreparedStatement(
    update(head)
    .where(head.c.spacecraft_key == bindparam("of_spacecraft"))
    .values(newest_number=bindparam("to_number"), newest_epoch_us=bindparam("to_epoch_us")),
    "of_spacecraft",
    "to_number",
    "to_epoch_us",
)
_MOVE_SOURCE = PreparedStatement(
    update(source)
    .where(source.c.spacecraft_key == bindparam("of_spacecraft"), source.c.source_key == bindparam("of_source"))
    .values(
        row_count=bindparam("to_count"),
        newest_epoch_us=bindparam("to_epoch_us"),
        seq_run=bindparam("to_run"),
        seq_after_us=bindparam("to_after_us"),
        seq_start=bindparam("to_start"),
        seq_last=bindparam("to_last"),
        rows_missing=bindparam("to_missing"),
    ),
    "of_spacecraft",
    "of_source",
    "to_count",
    "to_epoch_us",
    "to_run",
    "to_after_us",
    "to_start",
    "to_last",
    "to_missing",
)
_NO_NUMBERS = (None,) * len(Tail._fields)


class IngestState(NamedTuple):
    """Head of a spacecraft and figures of a source; the columns ``STATE_COLUMNS``."""

    newest_number: int
    newest_epoch_us: int | None
    consumed_epoch_us: int | None
    source_key: int
    is_prime: bool
    row_count: int
    source_newest_epoch_us: int | None
    #: that it belongs to, and the key of its newest rows
    station: str | None
    key_id: str | None
    seq_run: int | None
    seq_after_us: int | None
    seq_start: int | None
    seq_last: int | None
    rows_missing: int | None

    def is_as_before(self, sender: Sender | None) -> bool:
        """Return whether rows come with the key of the rows before, which is of the station of the source."""
        return sender is None or (sender.key_id == self.key_id and sender.station in (None, self.station))

    @property
    def tail(self) -> Tail | None:
        """Return where the sequence numbers of the source stand, None before the first."""
        numbers: Any = self[-len(Tail._fields) :]
        return None if None in numbers else Tail(*numbers)


def store_batch(connection: Connection, prepared: PreparedBatch, cache: SegmentCache) -> BatchReceipt:
    """Store and journal the new rows of a batch; runs in the writer's transaction."""
    if not prepared.epochs_us:
        return BatchReceipt(0, 0, 0, ())
    sender = prepared.batch.sender
    state = _state(connection, prepared.spacecraft_key, prepared.batch.source, sender)
    if sender is not None and sender.station is not None and state.station not in (None, sender.station):
        raise source_not_yours(prepared.batch.source, state.station, sender.station)
    outcome = sort_rows(connection, cache, prepared, state.source_key, state.source_newest_epoch_us)
    prepared = outcome.batch
    if not len(outcome.accepted):
        return BatchReceipt(0, len(outcome.duplicates), 0, outcome.refused)
    is_late = _lateness(prepared.batch, state.consumed_epoch_us)[outcome.accepted]
    for run in _runs(prepared, outcome.accepted, is_late, state):
        insert_run(connection, run)
    _store_details(connection, prepared, outcome.accepted, state)
    jumps = _advance(connection, prepared, outcome, state)
    if sender is not None and not state.is_as_before(sender):
        _begin_key_run(connection, prepared.spacecraft_key, state, sender)
    late = int(is_late.sum())
    return BatchReceipt(
        len(outcome.accepted),
        len(outcome.duplicates),
        late,
        outcome.refused,
        (*outcome.flagged, *jumps),
        first_number=state.newest_number + 1,
        feeds_estimator=bool(state.is_prime),
        is_late=is_late if 0 < late < len(is_late) else None,
    )


def _state(connection: Connection, key: int, name: str, sender: Sender | None) -> IngestState:
    """Return head and source; the first source of a spacecraft becomes the prime one."""
    if connection.dialect.name != "sqlite":
        # elsewhere other processes write too: what is read before the lock is granted could be stale
        lock_head(connection, key)
    row = _READ_STATE.run(connection, key, name).fetchone() or lock_head(connection, key)
    if row[IngestState._fields.index("source_key")] is not None:
        return IngestState(*row)
    known = connection.execute(select(source.c.source_key).where(source.c.spacecraft_key == key)).all()
    values = {"spacecraft_key": key, "source_key": len(known) + 1, "name": name, "is_prime": not known, "row_count": 0}
    if sender is not None:
        _check_number(connection, sender)
        values["created_by"] = sender.key_id
    connection.execute(source.insert().values(values))
    return IngestState(*_READ_STATE.run(connection, key, name).fetchone())


def _begin_key_run(connection: Connection, key: int, state: IngestState, sender: Sender) -> None:
    """Note from which row on a source is sent with another key; without an owner it becomes its station's."""
    run = {"first_number": state.newest_number + 1, "key_id": sender.key_id, "station": sender.station}
    connection.execute(source_key_run.insert().values(spacecraft_key=key, source_key=state.source_key, **run))
    is_it = (source.c.spacecraft_key == key, source.c.source_key == state.source_key)
    owner = state.station or sender.station
    connection.execute(update(source).where(*is_it).values(key_id=sender.key_id, station=owner))


def _check_number(connection: Connection, sender: Sender) -> None:
    """Refuse a source that is one too many of its station, or of its key."""
    is_its = source.c.created_by == sender.key_id if sender.station is None else source.c.station == sender.station
    made = select(func.count()).select_from(source).where(is_its)
    if connection.execute(made).scalar_one() >= sender.max_sources:
        detail = f"This key has made {sender.max_sources} sources and may make no more."
        raise InvalidInputError("source.too_many", detail)


def _lateness(batch: MeasurementBatch, consumed_us: int | None) -> BoolArray:
    """Return which rows are late: stale, or below the newest epoch that the chain has consumed."""
    return batch.is_stale if consumed_us is None else batch.is_stale | (batch.epochs_us < consumed_us)


def _runs(prepared: PreparedBatch, accepted: IntArray, is_late: BoolArray, state: IngestState) -> Iterator[RowRun]:
    """Yield the accepted rows as runs, numbered on from the head."""
    batch, details = prepared.batch, prepared.details
    is_whole = prepared.is_even and len(accepted) == len(prepared.epochs_us) and is_late.all() == is_late.any()
    breaks = [] if is_whole else _breaks(prepared, accepted, is_late)
    for start, stop in pairwise([0, *breaks, len(accepted)]):
        position = int(accepted[start])
        after = position + stop - start
        yield RowRun(
            spacecraft_key=prepared.spacecraft_key,
            source_key=state.source_key,
            plan_id=batch.plan_id,
            received_at_us=batch.received_at_us,
            feeds=bool(state.is_prime),
            is_late=bool(is_late[start]),
            first_number=state.newest_number + 1 + start,
            first_seq=seq_at(batch, position),
            epochs_us=prepared.epochs_us[position:after],
            powers=prepared.powers.part(position, after),
            flags=prepared.flags.part(position, after) if prepared.has_flags[position] else None,
            figures=None if details is None else list(map(details.of_row, range(position, after))),
        )


def _breaks(prepared: PreparedBatch, accepted: IntArray, is_late: BoolArray) -> list[int]:
    """Return where a row does not follow the one before it as the rows of a run do."""
    positions = (accepted, prepared.batch.index[accepted])
    claims = (is_late.astype(np.int64), prepared.has_flags[accepted].astype(np.int64))
    is_break = np.diff(np.stack((*positions, *claims)), axis=1) != [[1], [1], [0], [0]]
    found: list[int] = (np.flatnonzero(is_break.any(axis=0)) + 1).tolist()
    return found


def _store_details(connection: Connection, prepared: PreparedBatch, accepted: IntArray, state: IngestState) -> None:
    """Store what the new rows state beside their powers."""
    details = prepared.details
    if details is None:
        return
    positions = accepted[details.is_stated[accepted]].tolist()
    width, figures = details.width, details.figures
    if len(positions) < len(prepared.epochs_us):
        figures = b"".join(figures[position * width : (position + 1) * width] for position in positions)
    epochs_us = [prepared.epochs_us[position] for position in positions]
    insert_details(connection, prepared.spacecraft_key, state.source_key, epochs_us, width, figures)


def _advance(
    connection: Connection, prepared: PreparedBatch, outcome: SortedRows, state: IngestState
) -> list[RowNotice]:
    """Move the head of the spacecraft and the figures of the source past the stored rows; return jumps of numbers."""
    key, stored = prepared.spacecraft_key, len(outcome.accepted)
    newest_us = int(prepared.batch.epochs_us[outcome.accepted].max())
    MOVE_HEAD.run(connection, key, state.newest_number + stored, later(newest_us, state.newest_epoch_us))
    source_newest_us = later(newest_us, state.source_newest_epoch_us)
    tail, jumps = _numbered(connection, prepared, outcome, state)
    numbers = _NO_NUMBERS if tail is None else tail
    _MOVE_SOURCE.run(connection, key, state.source_key, state.row_count + stored, source_newest_us, *numbers)
    return jumps


def _numbered(
    connection: Connection, prepared: PreparedBatch, outcome: SortedRows, state: IngestState
) -> tuple[Tail | None, list[RowNotice]]:
    """Return where the sequence numbers of the source stand after the batch, and the rows at which they jump."""
    batch, tail, newest_us = prepared.batch, state.tail, state.source_newest_epoch_us
    jumps: list[RowNotice] = []
    if batch.first_seq is None:
        return tail, jumps
    rows = len(prepared.epochs_us)
    first, last = batch.first_seq + int(batch.index[0]), batch.first_seq + int(batch.index[-1])
    follows = tail is not None and first == tail.last + 1 and last - first == rows - 1
    if tail is not None and follows and len(outcome.accepted) == rows:
        # nearly always: the whole batch goes on where the one before ended
        return tail._replace(last=last), jumps
    numbers = SequenceNumbers(connection, prepared.spacecraft_key, state.source_key)
    for block in blocks_of(_held_rows(prepared, outcome), newest_us):
        if tail is not None and block.first - tail.last > MAX_JUMP:
            detail = f"the sequence number before was {tail.last}; no gap is counted in between"
            jumps.append(RowNotice(block.first - batch.first_seq, block.first, "seq.jump", detail))
        tail = numbers.added(tail, block, newest_us)
    return tail, jumps


def _held_rows(prepared: PreparedBatch, outcome: SortedRows) -> Iterator[NumberedRow]:
    """Yield the rows of a batch that the archive holds after it, in order of place."""
    seqs = ((prepared.batch.first_seq or 0) + prepared.batch.index).tolist()
    known = set(outcome.duplicates)
    for position in sorted((*outcome.accepted.tolist(), *outcome.duplicates)):
        yield NumberedRow(seqs[position], prepared.epochs_us[position], position not in known)


def later(epoch_us: int, other_us: int | None) -> int:
    """Return the later of two epochs."""
    return epoch_us if other_us is None else max(epoch_us, other_us)


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
        if state is None or not state.is_as_before(batch.sender):
            return None
        if state.source_newest_epoch_us is not None and epoch_us <= state.source_newest_epoch_us:
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
