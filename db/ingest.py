"""Storing batches of measurements, the hot path: one query, one insert and two updates a batch.

Of a batch ``received = accepted + duplicates + refused``. Whether a row is known is asked of the table only where its
epoch is not above the newest stored one of its source, and of sealed days only where one reaches to its epoch.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import Connection, Row, Select, and_, bindparam, select, update

from db.compiled import CompiledStatement
from db.database import lock_head
from db.measurement_details import PreparedDetails, insert_details, prepare_details
from db.power_codec import NO_FLAGS, StoredRows, canonical_powers, pack_flags, pack_powers, unpack_flags, unpack_parts
from db.row_insert import Run, insert_run
from db.segments import SegmentCache, sealed_contents
from db.sequence_numbers import NumberedRow, SequenceNumbers, Tail, blocks_of
from db.tables import head, measurement, source
from service.records.attitude import BoolArray, IntArray
from service.records.measurement import BatchReceipt, MeasurementBatch, Refusal

#: epochs in one query; SQLite before 3.32 binds 999 values at most
LOOKUP_CHUNK = 500

#: of ``IngestState``
STATE_COLUMNS = (
    head.c.newest_number,
    head.c.newest_epoch_us,
    head.c.consumed_epoch_us,
    source.c.source_key,
    source.c.is_prime,
    source.c.row_count,
    source.c.newest_epoch_us.label("source_newest_epoch_us"),
    source.c.seq_run,
    source.c.seq_after_us,
    source.c.seq_start,
    source.c.seq_last,
    source.c.rows_missing,
)
_READ_STATE = CompiledStatement(
    select(*STATE_COLUMNS)
    .select_from(head)
    .outerjoin(source, and_(source.c.spacecraft_key == head.c.spacecraft_key, source.c.name == bindparam("of_name")))
    .where(head.c.spacecraft_key == bindparam("of_spacecraft")),
    "of_spacecraft",
    "of_name",
)
MOVE_HEAD = CompiledStatement(
    update(head)
    .where(head.c.spacecraft_key == bindparam("of_spacecraft"))
    .values(newest_number=bindparam("to_number"), newest_epoch_us=bindparam("to_epoch_us")),
    "of_spacecraft",
    "to_number",
    "to_epoch_us",
)
_MOVE_SOURCE = CompiledStatement(
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


#: powers and flags of one row, as float32 and int32 little endian
Content = tuple[bytes, bytes | None]


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

    def content(self, place: int) -> Content:
        """Return what a row holds, to be compared with what is stored."""
        flags = self.batch.flags[place]
        powers = canonical_powers(self.batch.power_dbm[place]).tobytes()
        return powers, None if flags is None else np.array(flags, dtype="<i4").tobytes()


class IngestState(NamedTuple):
    """Head of a spacecraft and figures of a source; the columns ``STATE_COLUMNS``."""

    newest_number: int
    newest_epoch_us: int | None
    consumed_epoch_us: int | None
    source_key: int
    is_prime: bool
    row_count: int
    source_newest_epoch_us: int | None
    seq_run: int | None
    seq_after_us: int | None
    seq_start: int | None
    seq_last: int | None
    rows_missing: int | None

    @property
    def tail(self) -> Tail | None:
        """Return where the sequence numbers of the source stand, None before the first."""
        numbers: Any = self[-len(Tail._fields) :]
        return None if None in numbers else Tail(*numbers)


@dataclass(frozen=True, slots=True)
class _Sorted:
    """What becomes of each row of a batch."""

    #: places of the rows to store
    accepted: IntArray
    #: places of the rows that were held already
    duplicates: tuple[int, ...]
    refused: tuple[Refusal, ...]


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


def store_batch(connection: Connection, prepared: PreparedBatch, cache: SegmentCache) -> BatchReceipt:
    """Store and journal the new rows of a batch; runs in the writer's transaction."""
    if not prepared.epochs_us:
        return BatchReceipt(0, 0, 0, ())
    state = _state(connection, prepared.spacecraft_key, prepared.batch.source)
    outcome = _sort(connection, prepared, state, cache)
    if not len(outcome.accepted):
        return BatchReceipt(0, len(outcome.duplicates), 0, outcome.refused)
    is_late = _lateness(prepared.batch, state.consumed_epoch_us)[outcome.accepted]
    for run in _runs(prepared, outcome.accepted, is_late, state):
        insert_run(connection, run)
    _store_details(connection, prepared, outcome.accepted, state)
    _advance(connection, prepared, outcome, state)
    late = int(is_late.sum())
    return BatchReceipt(
        len(outcome.accepted),
        len(outcome.duplicates),
        late,
        outcome.refused,
        first_number=state.newest_number + 1,
        feeds_estimator=bool(state.is_prime),
        is_late=is_late if 0 < late < len(is_late) else None,
    )


def _state(connection: Connection, key: int, name: str) -> IngestState:
    """Return head and source; the first source of a spacecraft becomes the prime one."""
    if connection.dialect.name != "sqlite":
        # elsewhere other processes write too: what is read before the lock is granted could be stale
        lock_head(connection, key)
    row = _READ_STATE.run(connection, key, name).fetchone()
    if row[IngestState._fields.index("source_key")] is not None:
        return IngestState(*row)
    known = connection.execute(select(source.c.source_key).where(source.c.spacecraft_key == key)).all()
    values = {"spacecraft_key": key, "source_key": len(known) + 1, "name": name, "is_prime": not known, "row_count": 0}
    connection.execute(source.insert().values(values))
    return IngestState(*_READ_STATE.run(connection, key, name).fetchone())


def _sort(connection: Connection, prepared: PreparedBatch, state: IngestState, cache: SegmentCache) -> _Sorted:
    """Tell new rows, duplicates and conflicts apart."""
    newest_us = state.source_newest_epoch_us
    if prepared.is_ascending and (newest_us is None or prepared.epochs_us[0] > newest_us):
        return _Sorted(np.arange(len(prepared.epochs_us)), (), ())
    known = _stored(connection, prepared, state, cache)
    accepted: list[int] = []
    duplicates: list[int] = []
    refused: list[Refusal] = []
    for place, epoch_us in enumerate(prepared.epochs_us):
        content = prepared.content(place)
        earlier = known.setdefault(epoch_us, content)
        if earlier is content:
            accepted.append(place)
        elif earlier == content:
            duplicates.append(place)
        else:
            refused.append(_conflict(prepared.batch, place))
    return _Sorted(np.array(accepted, dtype=np.int64), tuple(duplicates), tuple(refused))


def _stored(
    connection: Connection, prepared: PreparedBatch, state: IngestState, cache: SegmentCache
) -> dict[int, Content]:
    """Return the content of those epochs of a source that are stored."""
    newest_us = state.source_newest_epoch_us
    epochs_us = [] if newest_us is None else [epoch_us for epoch_us in prepared.epochs_us if epoch_us <= newest_us]
    known: dict[int, Content] = {}
    for start in range(0, len(epochs_us), LOOKUP_CHUNK):
        query: Select[Any] = select(measurement.c.epoch_us, measurement.c.powers, measurement.c.flags).where(
            measurement.c.spacecraft_key == prepared.spacecraft_key,
            measurement.c.source_key == state.source_key,
            measurement.c.epoch_us.in_(epochs_us[start : start + LOOKUP_CHUNK]),
        )
        known.update(_contents(connection.execute(query).all()))
    unknown_us = [epoch_us for epoch_us in epochs_us if epoch_us not in known]
    known.update(sealed_contents(connection, cache, prepared.spacecraft_key, state.source_key, unknown_us))
    return known


def _contents(rows: Sequence[Row[Any]]) -> Iterator[tuple[int, Content]]:
    """Yield what stored rows of (epoch, powers, flags) hold."""
    for places, power_dbm in unpack_parts([row.powers for row in rows]):
        for place, powers in zip(places, power_dbm, strict=True):
            epoch_us, _, blob = tuple(rows[place])
            flags = None if blob is None else unpack_flags(blob, len(powers)).astype("<i4").tobytes()
            yield epoch_us, (powers.tobytes(), flags)


def _conflict(batch: MeasurementBatch, place: int) -> Refusal:
    detail = (
        f"Source {batch.source!r} has sent other powers or flags for this epoch before; the first ones stay. "
        "Send a corrected row under its own epoch or from another source."
    )
    return Refusal(int(batch.index[place]), _seq(batch, place), "measurement.conflict", detail)


def _seq(batch: MeasurementBatch, place: int) -> int | None:
    return None if batch.first_seq is None else batch.first_seq + int(batch.index[place])


def _lateness(batch: MeasurementBatch, consumed_us: int | None) -> BoolArray:
    """Return which rows are late: stale, or below the newest epoch that the chain has consumed."""
    return batch.is_stale if consumed_us is None else batch.is_stale | (batch.epochs_us < consumed_us)


def _runs(prepared: PreparedBatch, accepted: IntArray, is_late: BoolArray, state: IngestState) -> Iterator[Run]:
    """Yield the accepted rows as runs, numbered on from the head."""
    batch, details = prepared.batch, prepared.details
    is_whole = prepared.is_even and len(accepted) == len(prepared.epochs_us) and is_late.all() == is_late.any()
    breaks = [] if is_whole else _breaks(prepared, accepted, is_late)
    for start, stop in pairwise([0, *breaks, len(accepted)]):
        place = int(accepted[start])
        after = place + stop - start
        yield Run(
            spacecraft_key=prepared.spacecraft_key,
            source_key=state.source_key,
            plan_id=batch.plan_id,
            received_at_us=batch.received_at_us,
            feeds=bool(state.is_prime),
            is_late=bool(is_late[start]),
            first_number=state.newest_number + 1 + start,
            first_seq=_seq(batch, place),
            epochs_us=prepared.epochs_us[place:after],
            powers=prepared.powers.part(place, after),
            flags=prepared.flags.part(place, after) if prepared.has_flags[place] else None,
            figures=None if details is None else list(map(details.of_row, range(place, after))),
        )


def _breaks(prepared: PreparedBatch, accepted: IntArray, is_late: BoolArray) -> list[int]:
    """Return where a row does not follow the one before it as the rows of a run do."""
    places = (accepted, prepared.batch.index[accepted])
    claims = (is_late.astype(np.int64), prepared.has_flags[accepted].astype(np.int64))
    is_break = np.diff(np.stack((*places, *claims)), axis=1) != [[1], [1], [0], [0]]
    found: list[int] = (np.flatnonzero(is_break.any(axis=0)) + 1).tolist()
    return found


def _store_details(connection: Connection, prepared: PreparedBatch, accepted: IntArray, state: IngestState) -> None:
    """Store what the new rows state beside their powers."""
    details = prepared.details
    if details is None:
        return
    places = accepted[details.is_stated[accepted]].tolist()
    width, figures = details.width, details.figures
    if len(places) < len(prepared.epochs_us):
        figures = b"".join(figures[place * width : (place + 1) * width] for place in places)
    epochs_us = [prepared.epochs_us[place] for place in places]
    insert_details(connection, prepared.spacecraft_key, state.source_key, epochs_us, width, figures)


def _advance(connection: Connection, prepared: PreparedBatch, outcome: _Sorted, state: IngestState) -> None:
    """Move the head of the spacecraft and the figures of the source past the stored rows."""
    key, stored = prepared.spacecraft_key, len(outcome.accepted)
    newest_us = int(prepared.batch.epochs_us[outcome.accepted].max())
    MOVE_HEAD.run(connection, key, state.newest_number + stored, later(newest_us, state.newest_epoch_us))
    source_newest_us = later(newest_us, state.source_newest_epoch_us)
    tail = _numbered(connection, prepared, outcome, state)
    numbers = _NO_NUMBERS if tail is None else tail
    _MOVE_SOURCE.run(connection, key, state.source_key, state.row_count + stored, source_newest_us, *numbers)


def _numbered(connection: Connection, prepared: PreparedBatch, outcome: _Sorted, state: IngestState) -> Tail | None:
    """Return where the sequence numbers of the source stand after the batch."""
    batch, tail, newest_us = prepared.batch, state.tail, state.source_newest_epoch_us
    if batch.first_seq is None:
        return tail
    rows = len(prepared.epochs_us)
    first, last = batch.first_seq + int(batch.index[0]), batch.first_seq + int(batch.index[-1])
    follows = tail is not None and first == tail.last + 1 and last - first == rows - 1
    if tail is not None and follows and len(outcome.accepted) == rows:
        # nearly always: the whole batch goes on where the one before ended
        return tail._replace(last=last)
    numbers = SequenceNumbers(connection, prepared.spacecraft_key, state.source_key)
    for block in blocks_of(_held_rows(prepared, outcome), newest_us):
        tail = numbers.added(tail, block, newest_us)
    return tail


def _held_rows(prepared: PreparedBatch, outcome: _Sorted) -> Iterator[NumberedRow]:
    """Yield the rows of a batch that the archive holds after it, in order of place."""
    seqs = ((prepared.batch.first_seq or 0) + prepared.batch.index).tolist()
    known = set(outcome.duplicates)
    for place in sorted((*outcome.accepted.tolist(), *outcome.duplicates)):
        yield NumberedRow(seqs[place], prepared.epochs_us[place], place not in known)


def later(epoch_us: int, other_us: int | None) -> int:
    """Return the later of two epochs."""
    return epoch_us if other_us is None else max(epoch_us, other_us)
