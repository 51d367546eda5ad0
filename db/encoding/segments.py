"""Sealed days as the readers of the archive see them: heads, chunks read from blobs, a cache of chunks.

A segment never changes; one that takes in late rows is replaced by another. Its CRC-32 covers its head and its blobs
and is checked whenever it is read: a segment whose checksum differs is a StorageError ``storage.corrupt`` for the
readers of its rows, and for nobody else.

Sealed measurements as bytes: arrays in, compressed columns out, and back without a bit lost.

Codec 1. Each column of integers is delta-coded and laid out byte plane by byte plane (all lowest bytes first), because
steady steps leave most planes constant; powers are laid out carrier by carrier, so that neighbours resemble each other.
Everything is then compressed by zstd at level 3. What few rows have (flags, details) stands in a blob of its own, which
holds only the rows that have it.
"""

import struct
import zlib
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, LargeBinary, Select, and_, select, tuple_

from db.encoding.record_codec import RowContent, row_content
from db.schema.tables import measurement_segment as segment_table
from db.schema.tables import source, spacecraft
from service.errors import StorageError
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails, Float32Array, Measurement

#: the layout that is written; readers know which one a segment has
CODEC = 1
_LEVEL = 3
_INTEGERS = 4
_LATE, _FEEDS, _HAS_SEQ, _HAS_FLAGS, _HAS_DETAILS = (1 << position for position in range(5))


class SealedRows(NamedTuple):
    """Rows of one source under one plan, in order of epoch."""

    #: (T,) microseconds UTC, ascending
    epochs_us: IntArray
    #: (T,) journal numbers
    numbers: IntArray
    #: (T,) microseconds UTC
    received_at_us: IntArray
    #: (T,) sequence numbers, 0 where there is none
    seqs: IntArray
    #: (T,) each
    has_seq: BoolArray
    is_late: BoolArray
    feeds: BoolArray
    has_flags: BoolArray
    has_details: BoolArray
    #: (T, N) dBm
    power_dbm: Float32Array
    #: (T, N) bit masks, 0 where a row has none
    flags: NDArray[np.int32]
    #: (T, K, N), K = len(DETAIL_NAMES), NaN = not stated
    details: Float32Array


class Blobs(NamedTuple):
    """A segment as it is stored."""

    columns: bytes
    powers: bytes
    #: None when no row has flags or details
    extras: bytes | None


class SegmentColumns(NamedTuple):
    """Columns of a segment other than powers, flags and details; all (T,)."""

    epochs_us: IntArray
    numbers: IntArray
    received_at_us: IntArray
    seqs: IntArray
    has_seq: BoolArray
    is_late: BoolArray
    feeds: BoolArray
    has_flags: BoolArray
    has_details: BoolArray


class Extras(NamedTuple):
    """Flags and details of those rows that have them, in order."""

    #: (F, N)
    flags: NDArray[np.int32]
    #: (D, K, N)
    details: Float32Array


def pack(rows: SealedRows) -> Blobs:
    """Return rows as blobs."""
    integers = np.stack((rows.epochs_us, rows.numbers, rows.received_at_us, rows.seqs)).astype("<i8")
    claims = (rows.is_late, rows.feeds, rows.has_seq, rows.has_flags, rows.has_details)
    bits = np.zeros(len(rows.epochs_us), dtype=np.uint8)
    for position, claim in enumerate(claims):
        bits |= claim.astype(np.uint8) << position
    powers = np.ascontiguousarray(rows.power_dbm.T.astype("<f4"))
    return Blobs(_packed(_planes(integers) + bits.tobytes()), _packed(powers.tobytes()), _pack_extras(rows))


def unpack_columns(blob: bytes, count: int) -> SegmentColumns:
    """Return the columns of a segment of ``count`` rows."""
    raw = _unpacked(blob, count * (8 * _INTEGERS + 1))
    epochs_us, numbers, received_at_us, seqs = _integers(raw[: 8 * _INTEGERS * count], count)
    bits = np.frombuffer(raw, dtype=np.uint8, offset=8 * _INTEGERS * count)
    claims = ((bits & mask) != 0 for mask in (_HAS_SEQ, _LATE, _FEEDS, _HAS_FLAGS, _HAS_DETAILS))
    return SegmentColumns(epochs_us, numbers, received_at_us, seqs, *claims)


def unpack_powers(blob: bytes, count: int) -> Float32Array:
    """Return the powers of a segment, (T, N) dBm, carrier by carrier in memory, read-only."""
    powers: Float32Array = np.frombuffer(_unpacked(blob, None), dtype="<f4").reshape(-1, count).T
    powers.setflags(write=False)
    return powers


def unpack_extras(blob: bytes, columns: SegmentColumns, carriers: int) -> Extras:
    """Return flags and details of a segment."""
    raw = _unpacked(blob, None)
    flagged, detailed = int(columns.has_flags.sum()), int(columns.has_details.sum())
    kinds = [position for position in range(len(DETAIL_NAMES)) if raw[0] >> position & 1]
    flags = np.frombuffer(raw, dtype="<i4", count=flagged * carriers, offset=1).reshape(carriers, flagged).T
    stated = np.frombuffer(raw, dtype="<f4", offset=1 + 4 * flagged * carriers).reshape(len(kinds), carriers, detailed)
    details = np.full((detailed, len(DETAIL_NAMES), carriers), np.nan, dtype=np.float32)
    details[:, kinds] = stated.transpose(2, 0, 1)
    return Extras(flags, details)


def _pack_extras(rows: SealedRows) -> bytes | None:
    if not rows.has_flags.any() and not rows.has_details.any():
        return None
    details = rows.details[rows.has_details]
    kinds = np.flatnonzero((~np.isnan(details)).any(axis=(0, 2)))
    mask = bytes([int(np.bitwise_or.reduce(1 << kinds, initial=0))])
    flags = np.ascontiguousarray(rows.flags[rows.has_flags].T.astype("<i4"))
    stated = np.ascontiguousarray(details[:, kinds].transpose(1, 2, 0).astype("<f4"))
    return _packed(mask + flags.tobytes() + stated.tobytes())


def _planes(integers: IntArray) -> bytes:
    """Return (C, T) integers as differences along T, byte plane by byte plane."""
    steps = np.diff(integers, axis=1, prepend=0)
    return np.ascontiguousarray(steps.view(np.uint8).reshape(*integers.shape, 8).transpose(0, 2, 1)).tobytes()


def _integers(raw: bytes, count: int) -> IntArray:
    """Return the (C, T) integers that ``_planes`` made bytes of; sums of differences wrap as the differences did."""
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(_INTEGERS, 8, count)
    steps = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<i8")[:, :, 0]
    integers: IntArray = np.cumsum(steps, axis=1, dtype=np.int64)
    integers.setflags(write=False)
    return integers


def _packed(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=_LEVEL).compress(raw)


def _unpacked(blob: bytes, size: int | None) -> bytes:
    """Return the bytes of a blob; ValueError when they cannot be had or are not ``size``."""
    try:
        raw = zstandard.ZstdDecompressor().decompress(blob)
    except zstandard.ZstdError as fault:
        raise ValueError(str(fault)) from fault
    if size is not None and len(raw) != size:
        message = f"{len(raw)} bytes where {size} belong"
        raise ValueError(message)
    return raw


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
