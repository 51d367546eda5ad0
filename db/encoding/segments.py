"""Sealed days as the readers of the archive see them: heads, the rows of a blob, a cache of what was read lately.

A segment never changes; one that takes in late rows is replaced by another. Its checksum covers its head and its blob
and is compared whenever it is read: a segment that differs is a StorageError ``storage.corrupt`` for the readers of its
rows, and for nobody else.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import repeat, starmap
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Column, ColumnElement, Connection, Select, Table, and_, bindparam, select, tuple_

from db.columns import agrees
from db.encoding.column_blob import ColumnBlob, decimals, levels_of
from db.encoding.measurement_rows import (
    RowContent,
    StoredArrays,
    canonical,
    row_content,
    stored_arrays,
)
from db.tables import measurement, source, spacecraft
from db.tables import segment as segment_table
from service.errors import StorageError
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails, Float32Array, Measurement

DAY_US = 86_400 * US_PER_S
#: bytes of unpacked rows that are kept for the next reader
CACHE_BYTES = 24 << 20
#: heads read at once
_HEADS = 32
HEAD_COLUMNS = tuple(column for column in segment_table.c if column.name != "content")
#: bytes of a row beside its powers, in memory
_ROW_BYTES = 48
_POWER, _FLAGS = "power_dbm_", "flags_"
#: decimal places that levels are tried with
_PLACES = (2, 3, 4, 5)


class RowSeries(NamedTuple):
    """Rows that are sealed together: of one table, version and method of results or source and plan of measurements."""

    key: int
    table: Table
    version: str = ""
    method: str = ""
    source_key: int = 0
    plan_id: int = 0

    def of_segments(self) -> tuple[ColumnElement[bool], ...]:
        """Return the conditions for its segments."""
        names = ("version", "method", "source_key", "plan_id")
        its = (segment_table.c[name] == value for name, value in zip(names, self[2:], strict=True))
        return (segment_table.c.spacecraft_key == self.key, segment_table.c.series == self.table.name, *its)

    def of_rows(self) -> tuple[ColumnElement[bool], ...]:
        """Return the conditions for its rows that are not sealed."""
        columns = self.table.c
        named = zip(("version", "method", "source_key", "plan_id"), self[2:], strict=True)
        its = (columns[name] == value for name, value in named if name in columns)
        return (columns.spacecraft_key == self.key, *its)


def of_measurements(key: int) -> tuple[ColumnElement[bool], ...]:
    """Return the conditions for the segments of all measurements of a spacecraft."""
    return (segment_table.c.spacecraft_key == key, segment_table.c.series == measurement.name)


class SegmentHead(NamedTuple):
    """Row of the segment table without its blob, in the order of its columns."""

    segment_id: int
    spacecraft_key: int
    series: str
    version: str
    method: str
    source_key: int
    plan_id: int
    day: int
    row_count: int
    feeding_count: int
    first_epoch_us: int
    last_epoch_us: int
    first_number: int
    last_number: int
    first_sequence: int | None
    last_sequence: int | None
    checksum: bytes


def series_of(head: SegmentHead, table: Table) -> RowSeries:
    """Return the series of a segment, whose rows come from a table."""
    return RowSeries(head.spacecraft_key, table, head.version, head.method, head.source_key, head.plan_id)


#: columns of a blob that every row has a value in; of a sequence number that there is not, -1
PLAIN_COLUMNS = ("epoch_us", "number", "received_at_us", "feeds", "is_late", "has_flags", "seq")


def measured_arrays(
    plain: Mapping[str, Any], power_dbm: Float32Array, flags: NDArray[np.int32], details: Float32Array
) -> dict[str, Any]:
    """Return measurements of one source under one plan as the columns of a blob.

    Flags and details stand there for carriers that have any.

    Parameters
    ----------
    plain : mapping
        Values of ``PLAIN_COLUMNS``, T each, in order of epoch.
    power_dbm : ndarray, shape (T, N)
        dBm.
    flags : ndarray, shape (T, N)
        Bit masks, 0 where a row has none.
    details : ndarray, shape (T, K, N)
        Figures of DETAIL_NAMES, NaN = not stated.
    """
    columns = {name: plain[name] for name in PLAIN_COLUMNS}
    columns |= {f"{_POWER}{k}": _level_column(levels) for k, levels in enumerate(power_dbm.T)}
    columns |= {f"{_FLAGS}{k}": masks for k, masks in enumerate(flags.T) if masks.any()}
    for kind, name in enumerate(DETAIL_NAMES):
        figures = ((k, details[:, kind, k]) for k in range(details.shape[2]))
        columns |= {f"{name}_{k}": _level_column(each) for k, each in figures if not np.isnan(each).all()}
    return columns


def _level_column(levels: Float32Array) -> Any:
    """Return levels as decimals where these are exact, else as they are, every NaN the same NaN."""
    found = (decimals(levels, places) for places in _PLACES)
    return next((each for each in found if each is not None), canonical(levels))


class MeasurementSegment:
    """Measurements of one segment; powers and the rest are read when they are wanted."""

    def __init__(self, head: SegmentHead, blob: ColumnBlob, name: str) -> None:
        self.source, self.plan_id = name, head.plan_id
        self._blob = blob
        columns = blob.whole(*PLAIN_COLUMNS)
        #: of the blob, in memory
        self.blob_bytes = blob.size
        if [column.dtype.kind for column in columns] != [*"iiibbbi"]:
            message = "it has other columns than measurements have"
            raise ValueError(message)
        self.epochs_us: IntArray
        self.epochs_us, self.numbers, self.received_at_us, self.feeds, self._is_late, self._has_flags, self._seqs = (
            columns
        )
        self._carriers = sum(name.startswith(_POWER) for name in blob.names)
        self._power_dbm: Float32Array | None = None
        self._flags: NDArray[np.int32] | None = None
        self._details: Float32Array | None = None

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm, carrier by carrier in memory, read-only."""
        if self._power_dbm is None:
            self._power_dbm = self._levels(_POWER)
        return self._power_dbm

    def details(self) -> Float32Array:
        """Return the details, (T, K, N), NaN = not stated."""
        if self._details is None:
            found = [self._levels(f"{name}_") for name in DETAIL_NAMES]
            self._details = np.stack(found, axis=1)
        return self._details

    def figure(self, name: str) -> Float32Array:
        """Return one of the details, (T, N), NaN = not stated."""
        return self._levels(f"{name}_")

    def all_flags(self) -> NDArray[np.int32]:
        """Return the bit masks, (T, N), 0 where a row has none."""
        if self._flags is None:
            columns = self._blob.read(f"{_FLAGS}{k}" for k in range(self._carriers))
            self._flags = np.zeros((len(self.epochs_us), self._carriers), dtype=np.int32)
            for name, column in columns.items():
                self._flags[:, int(name.removeprefix(_FLAGS))] = column.to_numpy(zero_copy_only=False)
        return self._flags

    def content(self, position: int) -> RowContent:
        """Return the content of a row."""
        return row_content(self.plan_id, self._arrays(position))

    def records(self, positions: IntArray) -> list[Measurement]:
        """Return the rows at some places."""
        columns = (self.epochs_us, self.received_at_us, self.numbers, self._is_late, self.feeds, self._seqs)
        epochs_us, received_at_us, numbers, is_late, feeds, seqs = (column[positions].tolist() for column in columns)
        details = self.details()[positions]
        has_details: BoolArray = np.any(~np.isnan(details), axis=(1, 2))
        each = zip(
            epochs_us,
            received_at_us,
            numbers,
            repeat(self.source, len(positions)),
            repeat(self.plan_id, len(positions)),
            _rows_of(self.power_dbm()[positions], np.float64),
            _rows_of(self.all_flags()[positions], np.int64, self._has_flags[positions]),
            is_late,
            feeds,
            (None if seq < 0 else seq for seq in seqs),
            (None if its is None else CarrierDetails(*its) for its in _rows_of(details, np.float64, has_details)),
            strict=True,
        )
        return list(starmap(Measurement, each))

    def _arrays(self, position: int) -> StoredArrays:
        """Return the arrays of a row as the table of rows has them."""
        one = slice(position, position + 1)
        flags = self.all_flags()[position] if self._has_flags[position] else None
        return stored_arrays(self.power_dbm()[one], [flags], self.details()[one])[0]

    def _levels(self, prefix: str) -> Float32Array:
        """Return levels of the carriers, (T, N), NaN where a carrier has no column."""
        columns = self._blob.read(f"{prefix}{k}" for k in range(self._carriers))
        levels: Float32Array = np.full((self._carriers, len(self.epochs_us)), np.nan, dtype="<f4")
        for name, column in columns.items():
            levels[int(name.removeprefix(prefix))] = levels_of(column)
        levels.setflags(write=False)
        return levels.T


def _rows_of(
    values: NDArray[Any], kind: type[np.generic], is_stated: BoolArray | None = None
) -> Sequence[NDArray[Any] | None]:
    """Return the rows of an array as read-only arrays, None where nothing is stated."""
    if is_stated is not None and not is_stated.any():
        return [None] * len(values)
    rows = np.array(values, dtype=kind, order="C")
    rows.setflags(write=False)
    return list(rows) if is_stated is None else [row if its else None for row, its in zip(rows, is_stated, strict=True)]


class SegmentCache:
    """Pieces read lately, as many as fit some bytes, one at least; safe from any thread.

    Who reads more than fits takes one of no bytes, so that what others read again and again stays.
    """

    def __init__(self, size_bytes: int = CACHE_BYTES) -> None:
        self._size_bytes = size_bytes
        self._held: OrderedDict[tuple[int, bytes], tuple[int, MeasurementSegment]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def get(self, head: SegmentHead) -> MeasurementSegment | None:
        """Return the piece of a head, if it is held."""
        # an id comes again after a roll-back, with another content
        name = head.segment_id, head.checksum
        with self._lock:
            held = self._held.get(name)
            if held is None:
                return None
            self._held.move_to_end(name)
            return held[1]

    def put(self, head: SegmentHead, chunk: MeasurementSegment, carriers: int) -> None:
        """Hold a piece; what was not read for longest goes."""
        size = head.row_count * (4 * carriers + _ROW_BYTES) + chunk.blob_bytes
        with self._lock:
            if (head.segment_id, head.checksum) not in self._held:
                self._held[head.segment_id, head.checksum] = size, chunk
                self._bytes += size
            while self._bytes > self._size_bytes and len(self._held) > 1:
                self._bytes -= self._held.popitem(last=False)[1][0]


def heads(
    connection: Connection,
    conditions: Sequence[ColumnElement[bool]],
    start_us: int,
    stop_us: int,
    *,
    newest_first: bool = False,
) -> Iterator[SegmentHead]:
    """Yield the heads of segments that reach into [start, stop), in order of their first epoch, some at a time."""
    first = segment_table.c.first_epoch_us
    # a segment ends on the day on which it begins
    is_inside = (first >= day_of(start_us) * DAY_US, first < stop_us, segment_table.c.last_epoch_us >= start_us)
    query = select(*HEAD_COLUMNS).where(*conditions, *is_inside)
    return _paged(connection, query, (first, segment_table.c.source_key), newest_first=newest_first)


def heads_where(connection: Connection, *conditions: ColumnElement[bool]) -> Iterator[SegmentHead]:
    """Yield the heads of segments by their ids, some at a time."""
    return _paged(connection, select(*HEAD_COLUMNS).where(*conditions), (segment_table.c.segment_id,))


def _paged(
    connection: Connection, query: Select[Any], columns: Sequence[Column[int]], *, newest_first: bool = False
) -> Iterator[SegmentHead]:
    """Yield heads in the order of columns, or in the reverse order."""
    query = query.order_by(*(column.desc() if newest_first else column for column in columns)).limit(_HEADS)
    page = [SegmentHead(*row) for row in connection.execute(query)]
    yield from page
    while len(page) == _HEADS:
        position, end = tuple_(*columns), tuple(getattr(page[-1], column.name) for column in columns)
        is_beyond = position < end if newest_first else position > end
        page = [SegmentHead(*row) for row in connection.execute(query.where(is_beyond))]
        yield from page


#: who follows a journal asks at every row: made once, a statement costs half
_HEADS_OF_NUMBERS = (
    select(*HEAD_COLUMNS)
    .where(segment_table.c.spacecraft_key == bindparam("key"), segment_table.c.series == measurement.name)
    .where(segment_table.c.last_number > bindparam("after"), segment_table.c.first_number <= bindparam("upto"))
    .order_by(segment_table.c.segment_id)
)


def heads_of_numbers(connection: Connection, key: int, after: int, upto: int) -> list[SegmentHead]:
    """Return the heads of segments that may hold measurements of journal numbers in (after, upto]."""
    numbers = {"key": key, "after": after, "upto": upto}
    return [SegmentHead(*row) for row in connection.execute(_HEADS_OF_NUMBERS, numbers)]


def read_chunk(connection: Connection, cache: SegmentCache | None, head: SegmentHead) -> MeasurementSegment:
    """Return the measurements of a segment; StorageError ``storage.corrupt``."""
    known = None if cache is None else cache.get(head)
    if known is not None:
        return known
    is_its = and_(source.c.spacecraft_key == head.spacecraft_key, source.c.source_key == head.source_key)
    name = connection.scalar(select(source.c.name).where(is_its))
    chunk = opened(connection, head, partial(_measured, head, name))
    if cache is not None:
        cache.put(head, chunk, chunk.power_dbm().shape[1])
    return chunk


def _measured(head: SegmentHead, name: str | None, blob: ColumnBlob) -> MeasurementSegment:
    if name is None:
        message = f"there is no source {head.source_key}"
        raise ValueError(message)
    chunk = MeasurementSegment(head, blob, name)
    chunk.power_dbm()
    return chunk


_Chunk = TypeVar("_Chunk")


def opened(connection: Connection, head: SegmentHead, read: Callable[[ColumnBlob], _Chunk]) -> _Chunk:
    """Return what a reader makes of the blob of a segment after it was compared; StorageError ``storage.corrupt``."""
    is_it = segment_table.c.segment_id == head.segment_id
    row = connection.execute(select(segment_table).where(is_it)).first()
    try:
        if row is None or not agrees(segment_table, row):
            message = "its checksum differs from its content"
            raise ValueError(message)  # noqa: TRY301 - told as every other fault of the blob
        return read(ColumnBlob(row.content, row.row_count))
    except ValueError as fault:
        raise corrupt(connection, head, str(fault)) from fault


def sealed_contents(
    connection: Connection, cache: SegmentCache, key: int, source_key: int, epochs_us: Sequence[int]
) -> Mapping[int, RowContent]:
    """Return the content of those epochs of a source that are sealed."""
    found: dict[int, RowContent] = {}
    if not epochs_us:
        return found
    wanted_us = np.unique(np.array(epochs_us, dtype=np.int64))
    is_its = (*of_measurements(key), segment_table.c.source_key == source_key)
    for head in heads(connection, is_its, int(wanted_us[0]), int(wanted_us[-1]) + 1):
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
    version = f" (version {head.version})" if head.version else ""
    detail = (
        f"The sealed {head.series} rows of {owner!r}{version} of {day} (segment {head.segment_id}) cannot be read: "
        f"{reason}. Other days are not touched."
    )
    return StorageError("storage.corrupt", detail)


def day_of(epoch_us: int) -> int:
    """Return the day of an epoch, whole days since 1970."""
    return epoch_us // DAY_US
