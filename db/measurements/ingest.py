"""Storing batches of measurements, the hot path: all batches that wait, by one insert and two updates a spacecraft.

Thirty-two front ends that send a row each would look up the head and their sources a hundred times a commit, together
they do it once.

Of a batch ``received = accepted + duplicates + refused``. Whether a row is known is asked of the table only where its
epoch is not above the newest stored one of its source, and of sealed days only where one reaches to its epoch.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection, bindparam, func, select, update

from db.connection.writer import insert_new
from db.database import lock_head
from db.encoding.measurement_rows import RowContent, StoredArrays, row_content, stored_arrays
from db.encoding.segments import SegmentCache, sealed_contents
from db.measurements.sequence_numbers import BEFORE_ALL_US, MAX_JUMP, NumberedRow, SequenceNumbers, Tail, blocks_of
from db.tables import head, measurement, source, source_key_run
from service.errors import InvalidInputError, source_not_yours
from service.records.epoch import format_epoch
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import (
    DETAIL_NAMES,
    BatchReceipt,
    MeasurementBatch,
    QualityFlag,
    RowNotice,
    RowRefusal,
    Sender,
)


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


#: of rows, all but the checksum
_COLUMNS = tuple(measurement.c.keys())[:-1]
#: columns in which the numbers of a source stand, in the order of `Tail`
_TAIL = ("seq_run", "seq_after_us", "seq_start", "seq_last", "rows_missing")
_NO_TAIL = (None,) * len(_TAIL)
_MOVED = ("row_count", "newest_epoch_us", "station", "key_id", *_TAIL)
#: in the order of `_Source`
_SOURCES = select(*(source.c[name] for name in ("name", "source_key", "is_prime", *_MOVED))).where(
    source.c.spacecraft_key == bindparam("key")
)
_MOVE_HEAD = (
    update(head)
    .where(head.c.spacecraft_key == bindparam("key"))
    .values(newest_number=bindparam("number"), newest_epoch_us=bindparam("epoch_us"))
)
_MOVE_SOURCE = (
    update(source)
    .where(source.c.spacecraft_key == bindparam("of_spacecraft"), source.c.source_key == bindparam("of_key"))
    .values({name: bindparam(name) for name in _MOVED})
)


@dataclass(slots=True)
class _Source:
    """Figures of a source behind the rows that were taken, as the table has them behind those that were written."""

    key: int
    is_prime: bool
    row_count: int
    newest_epoch_us: int | None
    #: that it belongs to, and the key of its newest rows
    station: str | None
    key_id: str | None
    #: where its sequence numbers stand, None before the first
    tail: Tail | None

    def is_as_before(self, sender: Sender) -> bool:
        """Return whether rows come with the key of the rows before, which is of the station of the source."""
        return sender.key_id == self.key_id and sender.station in (None, self.station)

    def figures(self) -> dict[str, Any]:
        """Return its key, and the columns that rows move."""
        values = (self.row_count, self.newest_epoch_us, self.station, self.key_id)
        return dict(zip(("of_key", *_MOVED), (self.key, *values, *(self.tail or _NO_TAIL)), strict=True))


@dataclass(frozen=True, slots=True)
class StoreBatch:
    """The writing of one batch, for the writer, who lets neighbours write together."""

    prepared: PreparedBatch
    cache: SegmentCache

    def __call__(self, connection: Connection) -> BatchReceipt:
        """Store the batch."""
        return self.together(connection, [self])[0]

    @staticmethod
    def together(connection: Connection, works: Sequence["StoreBatch"]) -> list[BatchReceipt]:
        """Store batches one after another, as if each were alone."""
        waiting: dict[int, _Ingest] = {}
        receipts = []
        for work in works:
            key = work.prepared.spacecraft_key
            if work.prepared.epochs_us and key not in waiting:
                waiting[key] = _Ingest(connection, work.cache, key)
            receipts.append(waiting[key].store(work.prepared) if work.prepared.epochs_us else BatchReceipt(0, 0, 0, ()))
        for ingest in waiting.values():
            ingest.flush()
        return receipts


class _Ingest:
    """Rows of one spacecraft that are written in one go; runs in the writer's transaction."""

    def __init__(self, connection: Connection, cache: SegmentCache, key: int) -> None:
        self._connection = connection
        self._cache = cache
        self._key = key
        # of all writers this one alone moves the head and its sources until the transaction ends
        state = lock_head(connection, key)
        self._newest_number, self._newest_epoch_us = state.newest_number, state.newest_epoch_us
        self._consumed_epoch_us = state.consumed_epoch_us
        rows = connection.execute(_SOURCES, {"key": key})
        self._sources = {name: _source_of(figures) for name, *figures in map(tuple, rows)}
        self._rows: list[tuple[Any, ...]] = []
        self._moved: dict[str, _Source] = {}

    def store(self, prepared: PreparedBatch) -> BatchReceipt:
        """Take the new rows of a batch along and return what will be committed of it."""
        sender, name = prepared.batch.sender, prepared.batch.source
        state = self._sources.get(name) or self._begun(name, sender)
        if sender is not None and sender.station is not None and state.station not in (None, sender.station):
            raise source_not_yours(name, state.station, sender.station)
        if not prepared.is_beyond(state.newest_epoch_us):
            # its rows are compared with those of the table
            self.flush()
        outcome = sort_rows(self._connection, self._cache, prepared, state.key, state.newest_epoch_us)
        prepared = outcome.batch
        if not len(outcome.accepted):
            return BatchReceipt(0, len(outcome.duplicates), 0, outcome.refused)
        first_number = self._newest_number + 1
        if sender is not None and not state.is_as_before(sender):
            self._begin_key_run(state, sender)
        # stale, or below the newest epoch that the chain has consumed
        consumed_us = BEFORE_ALL_US if self._consumed_epoch_us is None else self._consumed_epoch_us
        is_late = (prepared.batch.is_stale | (prepared.batch.epochs_us < consumed_us))[outcome.accepted]
        self._add(outcome, state, is_late)
        jumps = self._move(outcome, state)
        self._moved[name] = state
        late = int(is_late.sum())
        return BatchReceipt(
            len(outcome.accepted),
            len(outcome.duplicates),
            late,
            outcome.refused,
            (*outcome.flagged, *jumps),
            first_number=first_number,
            feeds_estimator=state.is_prime,
            is_late=is_late if 0 < late < len(is_late) else None,
        )

    def flush(self) -> None:
        """Write what was taken."""
        if not self._rows:
            return
        columns = zip(_COLUMNS, zip(*self._rows, strict=True), strict=True)
        insert_new(self._connection, measurement, dict(columns), may_exist=False)
        position = {"number": self._newest_number, "epoch_us": self._newest_epoch_us}
        self._connection.execute(_MOVE_HEAD, {"key": self._key, **position})
        figures = [state.figures() for state in self._moved.values()]
        self._connection.execute(_MOVE_SOURCE, [{"of_spacecraft": self._key, **each} for each in figures])
        self._rows.clear()
        self._moved.clear()

    def _begun(self, name: str, sender: Sender | None) -> _Source:
        """Add a source; the first one of a spacecraft becomes the prime one."""
        # where sources are counted, their stations are read
        self.flush()
        if sender is not None:
            _check_number(self._connection, sender)
        created_by = None if sender is None else sender.key_id
        state = _Source(len(self._sources) + 1, not self._sources, 0, None, None, None, None)
        values = {"spacecraft_key": self._key, "source_key": state.key, "name": name, "is_prime": state.is_prime}
        self._connection.execute(source.insert().values(**values, row_count=0, created_by=created_by))
        self._sources[name] = state
        return state

    def _begin_key_run(self, state: _Source, sender: Sender) -> None:
        """Note from which row on a source is sent with another key; without an owner it becomes its station's."""
        run = {"first_number": self._newest_number + 1, "key_id": sender.key_id, "station": sender.station}
        insert = source_key_run.insert().values(spacecraft_key=self._key, source_key=state.key, **run)
        self._connection.execute(insert)
        state.key_id, state.station = sender.key_id, state.station or sender.station

    def _add(self, outcome: SortedRows, state: _Source, is_late: BoolArray) -> None:
        """Note the accepted rows, numbered on from the head."""
        prepared, batch = outcome.batch, outcome.batch.batch
        for position, is_row_late in zip(outcome.accepted.tolist(), is_late.tolist(), strict=True):
            self._newest_number += 1
            epoch_us = prepared.epochs_us[position]
            place = (self._key, epoch_us, state.key, self._newest_number, batch.plan_id, prepared.seqs[position])
            claims = (batch.received_at_us - epoch_us, is_row_late, state.is_prime)
            self._rows.append((*place, *claims, *prepared.arrays[position]))

    def _move(self, outcome: SortedRows, state: _Source) -> list[RowNotice]:
        """Move the head and the figures of a source past the accepted rows; return jumps of numbers."""
        newest_us = int(outcome.batch.batch.epochs_us[outcome.accepted].max())
        jumps = self._number(outcome, state)
        state.row_count += len(outcome.accepted)
        state.newest_epoch_us = max(newest_us, state.newest_epoch_us or newest_us)
        self._newest_epoch_us = max(newest_us, self._newest_epoch_us or newest_us)
        return jumps

    def _number(self, outcome: SortedRows, state: _Source) -> list[RowNotice]:
        """Move the sequence numbers of a source past a batch; return the rows at which they jump."""
        prepared, tail = outcome.batch, state.tail
        first, last = prepared.seqs[0], prepared.seqs[-1]
        jumps: list[RowNotice] = []
        if first is None or last is None:
            return jumps
        rows = len(prepared.epochs_us)
        if tail is not None and first == tail.last + 1 and last - first == rows - 1 and len(outcome.accepted) == rows:
            # nearly always: the whole batch goes on where the one before ended
            state.tail = tail._replace(last=last)
            return jumps
        numbers = SequenceNumbers(self._connection, self._key, state.key)
        for block in blocks_of(_held_rows(outcome), state.newest_epoch_us):
            if tail is not None and block.first - tail.last > MAX_JUMP:
                detail = f"the sequence number before was {tail.last}; no gap is counted in between"
                place = block.first - (prepared.batch.first_seq or 0)
                jumps.append(RowNotice(place, block.first, "seq.jump", detail))
            tail = numbers.added(tail, block, state.newest_epoch_us)
        state.tail = tail
        return jumps


def _source_of(figures: Sequence[Any]) -> _Source:
    key, is_prime, row_count, newest_epoch_us, station, key_id, *numbers = figures
    tail = None if None in numbers else Tail(*numbers)
    return _Source(key, is_prime, row_count, newest_epoch_us, station, key_id, tail)


def _check_number(connection: Connection, sender: Sender) -> None:
    """Refuse a source that is one too many of its station, or of its key."""
    is_its = source.c.created_by == sender.key_id if sender.station is None else source.c.station == sender.station
    made = select(func.count()).select_from(source).where(is_its)
    if connection.execute(made).scalar_one() >= sender.max_sources:
        detail = f"This key has made {sender.max_sources} sources and may make no more."
        raise InvalidInputError("source.too_many", detail)


def _held_rows(outcome: SortedRows) -> Iterator[NumberedRow]:
    """Yield the rows of a batch that the archive holds after it, in order of place."""
    prepared, known = outcome.batch, set(outcome.duplicates)
    for position in sorted((*outcome.accepted.tolist(), *outcome.duplicates)):
        yield NumberedRow(prepared.seqs[position] or 0, prepared.epochs_us[position], position not in known)
