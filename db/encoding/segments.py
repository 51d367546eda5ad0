"""Sealed days as the readers of the archive see them: heads, chunks read from blobs, a cache of chunks.

A segment never changes; one that takes in late rows is replaced by another. Its CRC-32 covers its head and its blobs
and is checked whenever it is read: a segment whose checksum differs is a StorageError ``storage.corrupt`` for the
readers of its rows, and for nobody else.
"""

import struct
import zlib
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, LargeBinary, Select, and_, select, tuple_

from db.encoding.record_codec import RowContent, row_content
from db.encoding.segment_codec import (
    CODEC,
    Blobs,
    Extras,
    SealedRows,
    SegmentColumns,
    unpack_columns,
    unpack_extras,
    unpack_powers,
)
from db.schema.tables import measurement_segment as segment_table
from db.schema.tables import source, spacecraft
from service.errors import StorageError
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails, Float32Array, Measurement

DAY_US = 86_400 * US_PER_S
#: bytes of unpacked rows that are kept for the next reader
CACHE_BYTES = 24 << 20
#: heads read at once
_HEADS = 32
HEAD_COLUMNS = tuple(column for column in segment_table.c if not isinstance(column.type, LargeBinary))
#: bytes of a row beside its powers, in memory
_ROW_BYTES = 48


class SegmentHead(NamedTuple):
    """Row of the segment table without its blobs, in the order of its columns."""

    segment_id: int
    spacecraft_key: int
    source_key: int
    plan_id: int
    day: int
    row_count: int
    feeding_count: int
    first_epoch_us: int
    last_epoch_us: int
    first_number: int
    last_number: int
    codec: int
    crc32: int


class SegmentChunk:
    """Rows of one segment; powers and the rest are unpacked when they are wanted."""

    def __init__(self, head: SegmentHead, name: str, blobs: Blobs) -> None:
        self.source, self.plan_id = name, head.plan_id
        self._count = head.row_count
        self._blobs = blobs
        self.columns: SegmentColumns = unpack_columns(blobs.columns, head.row_count)
        self.epochs_us: IntArray = self.columns.epochs_us
        self.numbers: IntArray = self.columns.numbers
        self.received_at_us: IntArray = self.columns.received_at_us
        self.feeds: BoolArray = self.columns.feeds
        self._power_dbm: Float32Array | None = None
        self._extras: Extras | None = None

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm, read-only."""
        if self._power_dbm is None:
            self._power_dbm = unpack_powers(self._blobs.powers, self._count)
        return self._power_dbm

    def extras(self) -> Extras | None:
        """Return flags and details of those rows that have them."""
        if self._extras is None and self._blobs.extras is not None:
            self._extras = unpack_extras(self._blobs.extras, self.columns, self.power_dbm().shape[1])
        return self._extras

    def rows(self) -> SealedRows:
        """Return all rows as columns."""
        columns, extras, power_dbm = self.columns, self.extras(), self.power_dbm()
        flags = np.zeros(power_dbm.shape, dtype=np.int32)
        details = np.full((len(power_dbm), len(DETAIL_NAMES), power_dbm.shape[1]), np.nan, dtype=np.float32)
        if extras is not None:
            flags[columns.has_flags] = extras.flags
            details[columns.has_details] = extras.details
        return SealedRows._make((*columns, power_dbm, flags, details))

    def content(self, position: int) -> RowContent:
        """Return the content of a row."""
        return row_content(self.plan_id, self.power_dbm()[position], self.flags(position), self._figures(position))

    def record(self, position: int) -> Measurement:
        """Return the row at a place."""
        columns, flags = self.columns, self.flags(position)
        if flags is not None:
            flags = flags.astype(np.int64)
            flags.setflags(write=False)
        power_dbm = self.power_dbm()[position].astype(np.float64)
        power_dbm.setflags(write=False)
        return Measurement(
            epoch_us=int(columns.epochs_us[position]),
            received_at_us=int(columns.received_at_us[position]),
            number=int(columns.numbers[position]),
            source=self.source,
            plan_id=self.plan_id,
            power_dbm=power_dbm,
            flags=flags,
            is_late=bool(columns.is_late[position]),
            feeds_estimator=bool(columns.feeds[position]),
            seq=int(columns.seqs[position]) if columns.has_seq[position] else None,
            details=self._details(position),
        )

    def flags(self, position: int) -> IntArray | None:
        """Return the bit masks of a row, None when it has none."""
        extras = self.extras() if self.columns.has_flags[position] else None
        return None if extras is None else extras.flags[int(self.columns.has_flags[:position].sum())]

    def _figures(self, position: int) -> Float32Array | None:
        """Return the details of a row, (K, N), None when it has none."""
        extras = self.extras() if self.columns.has_details[position] else None
        return None if extras is None else extras.details[int(self.columns.has_details[:position].sum())]

    def _details(self, position: int) -> CarrierDetails | None:
        stated = self._figures(position)
        if stated is None:
            return None
        figures = stated.astype(np.float64)
        figures.setflags(write=False)
        return CarrierDetails(*figures)


class SegmentCache:
    """Pieces read lately, as many as fit some bytes; safe from any thread."""

    def __init__(self, size_bytes: int = CACHE_BYTES) -> None:
        self._size_bytes = size_bytes
        self._held: OrderedDict[tuple[int, int], tuple[int, SegmentChunk]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def get(self, head: SegmentHead) -> SegmentChunk | None:
        """Return the piece of a head, if it is held."""
        # an id comes again after a roll-back, with another content
        name = head.segment_id, head.crc32
        with self._lock:
            held = self._held.get(name)
            if held is None:
                return None
            self._held.move_to_end(name)
            return held[1]

    def put(self, head: SegmentHead, chunk: SegmentChunk, carriers: int) -> None:
        """Hold a piece; what was not read for longest goes."""
        size = head.row_count * (4 * carriers + _ROW_BYTES)
        with self._lock:
            if (head.segment_id, head.crc32) not in self._held:
                self._held[head.segment_id, head.crc32] = size, chunk
                self._bytes += size
            while self._bytes > self._size_bytes and len(self._held) > 1:
                self._bytes -= self._held.popitem(last=False)[1][0]

    def for_scan(self) -> "SegmentCache":
        """Return a cache for one reader of more than fits: it finds what is held here and adds nothing."""
        return _ScanCache(self)

    def clear(self) -> None:
        """Forget every piece."""
        with self._lock:
            self._held.clear()
            self._bytes = 0


class _ScanCache(SegmentCache):
    """Cache for one scan, returned by `SegmentCache.for_scan`: it keeps its last chunk only."""

    def __init__(self, shared: SegmentCache) -> None:
        super().__init__(size_bytes=0)
        self._shared = shared

    def get(self, head: SegmentHead) -> SegmentChunk | None:
        """Return the chunk of a head if it was the last one, or if the shared cache holds it."""
        return super().get(head) or self._shared.get(head)


def crc32_of(head: SegmentHead, blobs: Blobs) -> int:
    """Return the checksum of a segment; id and checksum of the head do not count."""
    crc = zlib.crc32(struct.pack("<11q", *head[1:-1]))
    for blob in blobs:
        crc = zlib.crc32(b"" if blob is None else blob, crc)
    return crc


def heads(
    connection: Connection, key: int, start_us: int, stop_us: int, *conditions: ColumnElement[bool]
) -> Iterator[SegmentHead]:
    """Yield the heads of segments that reach into [start, stop), in order of their first epoch."""
    first, key_of_source = segment_table.c.first_epoch_us, segment_table.c.source_key
    query = (
        select(*HEAD_COLUMNS)
        # a segment ends on the day on which it begins
        .where(segment_table.c.spacecraft_key == key, first >= day_of(start_us) * DAY_US, first < stop_us)
        .where(segment_table.c.last_epoch_us >= start_us, *conditions)
        .order_by(first, key_of_source)
        .limit(_HEADS)
    )
    yield from _paged(connection, query)


def newest_heads(
    connection: Connection, key: int, start_us: int, stop_us: int, *conditions: ColumnElement[bool]
) -> Iterator[SegmentHead]:
    """Yield the heads of segments that reach into [start, stop), that with the latest first epoch first."""
    first = segment_table.c.first_epoch_us
    query = (
        select(*HEAD_COLUMNS)
        .where(segment_table.c.spacecraft_key == key, first >= day_of(start_us) * DAY_US, first < stop_us)
        .where(segment_table.c.last_epoch_us >= start_us, *conditions)
        .order_by(first.desc(), segment_table.c.source_key.desc())
        .limit(_HEADS)
    )
    yield from _paged(connection, query, is_descending=True)


def heads_of_numbers(connection: Connection, key: int, after: int, upto: int) -> list[SegmentHead]:
    """Return the heads of segments that may hold journal numbers in (after, upto]."""
    query = select(*HEAD_COLUMNS).where(
        segment_table.c.spacecraft_key == key,
        segment_table.c.last_number > after,
        segment_table.c.first_number <= upto,
    )
    return [SegmentHead(*row) for row in connection.execute(query)]


def read_chunk(connection: Connection, cache: SegmentCache | None, head: SegmentHead) -> SegmentChunk:
    """Return the rows of a segment; StorageError ``storage.corrupt``."""
    known = None if cache is None else cache.get(head)
    if known is not None:
        return known
    is_its_source = and_(source.c.spacecraft_key == head.spacecraft_key, source.c.source_key == head.source_key)
    query = (
        select(segment_table.c.columns, segment_table.c.powers, segment_table.c.extras, source.c.name)
        .select_from(segment_table)
        .outerjoin(source, is_its_source)
        .where(segment_table.c.segment_id == head.segment_id)
    )
    *blobs, name = connection.execute(query).one()
    try:
        chunk = _opened(head, name, Blobs(*blobs))
        carriers = chunk.power_dbm().shape[1]
    except ValueError as fault:
        raise corrupt(connection, head, str(fault)) from fault
    if cache is not None:
        cache.put(head, chunk, carriers)
    return chunk


def sealed_contents(
    connection: Connection, cache: SegmentCache, key: int, source_key: int, epochs_us: Sequence[int]
) -> dict[int, RowContent]:
    """Return the content of those epochs of a source that are sealed."""
    found: dict[int, RowContent] = {}
    if not epochs_us:
        return found
    wanted_us = np.unique(np.array(epochs_us, dtype=np.int64))
    is_its = segment_table.c.source_key == source_key
    for head in heads(connection, key, int(wanted_us[0]), int(wanted_us[-1]) + 1, is_its):
        inside = wanted_us[(wanted_us >= head.first_epoch_us) & (wanted_us <= head.last_epoch_us)]
        if not len(inside):
            continue
        chunk = read_chunk(connection, cache, head)
        positions = np.searchsorted(chunk.epochs_us, inside)
        for position in positions[chunk.epochs_us[positions] == inside].tolist():
            found[int(chunk.epochs_us[position])] = chunk.content(position)
    return found


def corrupt(connection: Connection, head: SegmentHead, reason: str) -> StorageError:
    """Return the error for a segment that cannot be read."""
    is_it = spacecraft.c.spacecraft_key == head.spacecraft_key
    owner, day = connection.scalar(select(spacecraft.c.id).where(is_it)), format_epoch(head.day * DAY_US)[:10]
    detail = (
        f"The sealed rows of {owner!r} of {day} (segment {head.segment_id}) cannot be read: {reason}. Other days are "
        "not touched."
    )
    return StorageError("storage.corrupt", detail)


def _opened(head: SegmentHead, name: str | None, blobs: Blobs) -> SegmentChunk:
    """Return the rows of blobs after they were checked; ValueError says what is wrong."""
    if head.codec != CODEC:
        message = f"it is written in codec {head.codec}, which this version does not know"
        raise ValueError(message)
    if crc32_of(head, blobs) != head.crc32:
        message = "its checksum differs from its content"
        raise ValueError(message)
    if name is None:
        message = f"there is no source {head.source_key}"
        raise ValueError(message)
    return SegmentChunk(head, name, blobs)


def day_of(epoch_us: int) -> int:
    """Return the day of an epoch, whole days since 1970."""
    return epoch_us // DAY_US


def _paged(connection: Connection, query: Select[Any], *, is_descending: bool = False) -> Iterator[SegmentHead]:
    """Yield heads in order of first epoch and source, some at a time."""
    position = tuple_(segment_table.c.first_epoch_us, segment_table.c.source_key)
    page = [SegmentHead(*row) for row in connection.execute(query)]
    yield from page
    while len(page) == _HEADS:
        end = (page[-1].first_epoch_us, page[-1].source_key)
        is_beyond = position < end if is_descending else position > end
        page = [SegmentHead(*row) for row in connection.execute(query.where(is_beyond))]
        yield from page
