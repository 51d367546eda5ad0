"""Reading measurements in order: one page of rows at a time, each in one consistent state of the database.

A page begins behind a cursor (epoch, number), which stays true whatever happens to the rows between two pages.

Heads of journals, number and digest of the newest entry, are logged by the service and compared by the doctor. A
database that lost its newest transactions, as a file whose write-ahead log was deleted, is sound in itself. What it
lacks is told by a head that stands elsewhere. The digest is of what an entry says, so it stays when a day is sealed.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from hashlib import sha256
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, func, select

from db.columns import sound_rows
from db.database import Database, beyond, newest_rows, start_of_last, within
from db.encoding.measurement_rows import ChunkRun, OrderedRows, details_of, end_us, measurement_of, powers_of
from db.encoding.segments import (
    MeasurementSegment,
    SegmentCache,
    SegmentHead,
    heads,
    heads_of_numbers,
    of_measurements,
    read_chunk,
)
from db.sealing import bins_within, next_row_us, seasons
from db.tables import head as head_table
from db.tables import journal, measurement, segment, source, spacecraft
from service.core.rows import Summaries
from service.ports.archive import Cursor, Intervals, ListPart, MeasuredFigure, SampledPowers
from service.records.calibration import Window
from service.records.inputs import JournalHead
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import (
    DETAIL_NAMES,
    Float32Array,
    HeadState,
    Measurement,
    MeasurementBlock,
    SourceState,
)
from service.records.storage import Diagnosis

Columns = tuple[ColumnElement[Any], ...]
#: rows of the table of rows in memory at once
_AT_ONCE = 8192
#: above every journal number
MAX_NUMBER = 1 << 62
EVER = Window(-(1 << 62), 1 << 62)
#: for records, compared with their checksums
FULL: Columns = tuple(measurement.c)
#: for records as they are stored, sound or not: of all that reads, the chain alone takes them so
UNCHECKED: Columns = FULL[:-1]
#: for places alone
LIGHT: Columns = tuple(measurement.c[name] for name in ("epoch_us", "number", "delay_us", "source_key", "plan_id"))
#: no bound of epochs: with one the planner goes through all rows in their order
_OF_NUMBERS: Select[Any] = select(*FULL).where(
    measurement.c.spacecraft_key == bindparam("key"),
    measurement.c.number > bindparam("after"),
    measurement.c.number <= bindparam("upto"),
)
_NAMES = select(source.c.source_key, source.c.name).where(source.c.spacecraft_key == bindparam("key"))


class Chosen(NamedTuple):
    """Selection of measurements of a spacecraft."""

    window: Window
    #: of this source only
    source: str | None = None
    #: only those that feed the estimator
    feeds_only: bool = False
    #: only those with a smaller journal number
    before_number: int | None = None


class RowChunk:
    """Rows of one source under one plan as the table of rows gives them; without records in columns of ``LIGHT``."""

    def __init__(self, name: str, rows: Sequence[Row[Any]]) -> None:
        # by columns, which is a tenth of the time
        columns = dict(zip(rows[0]._fields, zip(*rows, strict=True), strict=True))
        self._rows, self._columns = rows, columns
        self.source, self.plan_id = name, columns["plan_id"][0]
        positions = (np.array(columns[name], dtype=np.int64) for name in ("epoch_us", "number", "delay_us"))
        self.epochs_us, self.numbers, delays_us = positions
        self.received_at_us = self.epochs_us + delays_us

    @cached_property
    def _powers(self) -> Float32Array:
        return powers_of(self._columns["powers"])

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm."""
        return self._powers

    def figure(self, name: str) -> Float32Array:
        """Return one of the details, (T, N), NaN = not stated."""
        return details_of(self._columns["figures"], self._powers.shape[1])[:, DETAIL_NAMES.index(name)]

    def records(self, positions: IntArray) -> list[Measurement]:
        """Return the rows at some places."""
        return [measurement_of(self._rows[position], self.source) for position in positions.tolist()]


class MeasurementPages:
    """Reader of a spacecraft's measurements within one read transaction: table of rows and sealed days as one.

    Parameters
    ----------
    connection : Connection
        A transaction; whatever is read through it is one state.
    cache : SegmentCache
        Segments read lately.
    key : int
        Of the spacecraft.
    """

    def __init__(self, connection: Connection, cache: SegmentCache, key: int) -> None:
        self._connection = connection
        self._cache = cache
        self.key = key

    def read(self, chosen: Chosen, limit: int, after: Cursor | None, *, columns: Columns = FULL) -> list[ChunkRun]:
        """Return the next rows behind a cursor as runs; fewer than ``limit`` only when there are no more."""
        parts = self._parts(chosen, limit, after, columns)
        if len(parts) < 2:
            return [ChunkRun(chunk, positions[:limit]) for chunk, positions in parts]
        return OrderedRows(parts, limit).runs()

    def records(self, part: ListPart, source: str | None) -> list[Measurement]:
        """Return the rows of a part of the list of a source, or of all."""
        chosen = Chosen(part.window, source)

        def read(some: ListPart) -> list[Measurement]:
            runs = self.read(chosen._replace(window=some.window), some.limit, some.after)
            return [row for run in runs for row in run.records()]

        def start_of(window: Window, count: int) -> int:
            return self.start_of_newest(chosen._replace(window=window), count)

        return newest_rows(read, start_of, part) if part.newest_first else read(part)

    def start_of_newest(self, chosen: Chosen, count: int) -> int:
        """Return an epoch from which on so many chosen rows stand; the start of the window where there are fewer."""
        order = measurement.c.epoch_us.desc(), measurement.c.number.desc()
        rows = self._rows(chosen, LIGHT).order_by(*order).offset(count - 1).limit(1)
        row = self._connection.execute(rows).first()
        start_us, stop_us = chosen.window.start_us if row is None else row.epoch_us, chosen.window.stop_us
        found = heads(self._connection, self._of_segments(chosen), start_us, stop_us, newest_first=True)
        chunks = (read_chunk(self._connection, self._cache, head) for head in found)
        epochs_us = (chunk.epochs_us[_positions(chunk, chosen, None, stop_us)] for chunk in chunks)
        return start_of_last(epochs_us, count, start_us)

    def read_blocks(
        self, chosen: Chosen, limit: int, after: Cursor | None
    ) -> tuple[list[MeasurementBlock], Cursor | None]:
        """Return the next rows behind a cursor as blocks, and the cursor behind them; None when there are none.

        The last ones may be more than ``limit``, at most twice as many.
        """
        parts = self._parts(chosen, limit, after, FULL)
        if not parts:
            return [], None
        sealed = sum(len(run.positions) for run in parts if isinstance(run.chunk, MeasurementSegment))
        whole = sum(len(run.positions) for run in parts)
        if sealed < limit and whole - sealed < limit:
            # neither kind of rows fills the page: there are no others
            limit = whole
        if len(parts) == 1:
            run = ChunkRun(parts[0].chunk, parts[0].positions[:limit])
            return [run.block()], run.end
        rows = OrderedRows(parts, limit)
        return rows.blocks(), rows.end

    def _parts(self, chosen: Chosen, limit: int, after: Cursor | None, columns: Columns) -> list[ChunkRun]:
        """Return pieces that hold the next ``limit`` rows."""
        sealed = list(self._sealed(chosen, limit, after))
        # behind the place up to which sealed rows fill the page there may be any number of rows: they are not for it
        stop_us = min(chosen.window.stop_us, end_us(sealed, limit) or EVER.stop_us)
        query = (
            self._rows(chosen, columns)
            .where(beyond(measurement.c.epoch_us, measurement.c.number, after), measurement.c.epoch_us < stop_us)
            .order_by(measurement.c.epoch_us, measurement.c.number)
            .limit(limit)
        )
        rows = self._connection.execute(query).all()
        return [*(ChunkRun(chunk, np.arange(len(chunk.epochs_us))) for chunk in self._chunks(rows)), *sealed]

    def read_unsealed(self, chosen: Chosen) -> Iterator[RowChunk]:
        """Yield the rows of the table of rows, some at a time."""
        after: Cursor | None = None
        query = self._rows(chosen, FULL).order_by(measurement.c.epoch_us, measurement.c.number).limit(_AT_ONCE)
        while rows := self._connection.execute(
            query.where(beyond(measurement.c.epoch_us, measurement.c.number, after))
        ).all():
            yield from self._chunks(rows)
            after = rows[-1].epoch_us, rows[-1].number

    def segments(self, chosen: Chosen) -> list[SegmentHead]:
        """Return the heads of segments that may hold chosen rows."""
        window = chosen.window
        return list(heads(self._connection, self._of_segments(chosen), window.start_us, window.stop_us))

    def of_numbers(self, after: int, upto: int, *, is_compared: bool) -> list[Measurement]:
        """Return the rows with a journal number in (after, upto], in no order."""
        rows = self._connection.execute(_OF_NUMBERS, {"key": self.key, "after": after, "upto": upto}).all()
        if is_compared:
            sound_rows(measurement, rows)
        found = [measurement_of(row, self.names[row.source_key]) for row in rows]
        for head in heads_of_numbers(self._connection, self.key, after, upto):
            chunk = read_chunk(self._connection, self._cache, head)
            positions = np.flatnonzero((chunk.numbers > after) & (chunk.numbers <= upto))
            found += chunk.records(positions)
        return found

    def next_number(self, after: int) -> int | None:
        """Return the smallest journal number of a row above the given one."""
        is_next = (measurement.c.spacecraft_key == self.key, measurement.c.number > after)
        found = [self._connection.scalar(select(func.min(measurement.c.number)).where(*is_next))]
        for head in heads_of_numbers(self._connection, self.key, after, MAX_NUMBER):
            if any(number is not None and number < head.first_number for number in found):
                continue
            numbers = read_chunk(self._connection, self._cache, head).numbers
            found.append(int(numbers[numbers > after].min()))
        return min((number for number in found if number is not None), default=None)

    def at(self, source_key: int, epoch_us: int) -> Measurement | None:
        """Return the row of a source at an epoch."""
        window = Window(epoch_us, epoch_us + 1)
        runs = self.read(Chosen(window, self.names[source_key]), 1, None)
        return runs[0].records()[0] if runs else None

    def last_number(self, window: Window) -> int:
        """Return a journal number behind which no row lies in a window; 0 where none does at all."""
        rows = select(func.max(measurement.c.number)).where(
            measurement.c.spacecraft_key == self.key, within(measurement.c.epoch_us, window)
        )
        days = select(func.max(segment.c.last_number)).where(
            *of_measurements(self.key),
            segment.c.first_epoch_us < window.stop_us,
            segment.c.last_epoch_us >= window.start_us,
        )
        return max(self._connection.scalar(query) or 0 for query in (rows, days))

    def plan_ids(self, window: Window) -> set[int]:
        """Return the plans of the rows of a window."""
        held = select(measurement.c.plan_id).where(
            measurement.c.spacecraft_key == self.key, within(measurement.c.epoch_us, window)
        )
        found = set(self._connection.scalars(held.distinct()))
        for head in heads(self._connection, of_measurements(self.key), window.start_us, window.stop_us):
            is_inside = head.first_epoch_us >= window.start_us or head.last_epoch_us < window.stop_us
            # only a segment that reaches beyond both ends may have no row in the window
            if head.plan_id not in found and (is_inside or self._has_rows(head, window)):
                found.add(head.plan_id)
        return found

    def _has_rows(self, head: SegmentHead, window: Window) -> bool:
        chunk = read_chunk(self._connection, self._cache, head)
        return len(_positions(chunk, Chosen(window), None, window.stop_us)) > 0

    def _sealed(self, chosen: Chosen, limit: int, after: Cursor | None) -> Iterator[ChunkRun]:
        """Yield parts of segments until they hold the next ``limit`` rows of their own."""
        start_us = chosen.window.start_us if after is None else max(chosen.window.start_us, after[0])
        parts: list[ChunkRun] = []
        for head in heads(self._connection, self._of_segments(chosen), start_us, chosen.window.stop_us):
            reached_us = end_us(parts, limit)
            if reached_us is not None and head.first_epoch_us >= reached_us:
                return
            chunk = read_chunk(self._connection, self._cache, head)
            positions = _positions(chunk, chosen, after, chosen.window.stop_us)
            if len(positions):
                parts.append(ChunkRun(chunk, positions))
                yield parts[-1]

    def _rows(self, chosen: Chosen, columns: Columns) -> Select[Any]:
        """Return the query for the chosen rows of the table of rows."""
        return select(*columns).where(measurement.c.spacecraft_key == self.key, *self._of_rows(chosen))

    def _of_rows(self, chosen: Chosen) -> list[ColumnElement[bool]]:
        conditions = [within(measurement.c.epoch_us, chosen.window)]
        if chosen.source is not None:
            conditions.append(measurement.c.source_key == self._source_key(chosen.source))
        if chosen.feeds_only:
            conditions.append(measurement.c.feeds)
        if chosen.before_number is not None:
            # the sum keeps the planner on the key by epoch
            conditions.append(measurement.c.number + 0 < chosen.before_number)
        return conditions

    def _of_segments(self, chosen: Chosen) -> list[ColumnElement[bool]]:
        conditions = list(of_measurements(self.key))
        if chosen.source is not None:
            conditions.append(segment.c.source_key == self._source_key(chosen.source))
        if chosen.feeds_only:
            conditions.append(segment.c.feeding_count > 0)
        if chosen.before_number is not None:
            conditions.append(segment.c.first_number < chosen.before_number)
        return conditions

    @cached_property
    def names(self) -> dict[int, str]:
        """Return the names of the sources."""
        return {row[0]: row[1] for row in self._connection.execute(_NAMES, {"key": self.key})}

    def _source_key(self, name: str) -> int:
        """Return the key of a source, 0, which no source has, for an unknown one."""
        return next((key for key, known in self.names.items() if known == name), 0)

    def _chunks(self, rows: Sequence[Row[Any]]) -> list[RowChunk]:
        """Return rows piece by piece; StorageError ``storage.corrupt`` where they came to be compared and differ."""
        if not rows:
            return []
        names = rows[0]._fields
        if "checksum" in names:
            sound_rows(measurement, rows)
        # an attribute of a row costs a microsecond
        kind_of = itemgetter(names.index("source_key"), names.index("plan_id"))
        pieces: dict[tuple[int, int], list[Row[Any]]] = {}
        for row in rows:
            pieces.setdefault(kind_of(row), []).append(row)
        return [RowChunk(self.names[kind[0]], its) for kind, its in pieces.items()]


def _positions(chunk: MeasurementSegment, chosen: Chosen, after: Cursor | None, stop_us: int) -> IntArray:
    """Return the places of the chosen rows of a segment behind a cursor."""
    first, last = np.searchsorted(chunk.epochs_us, (chosen.window.start_us, stop_us))
    positions: IntArray = np.arange(first, last)
    if chosen.feeds_only:
        positions = positions[chunk.feeds[positions]]
    if chosen.before_number is not None:
        positions = positions[chunk.numbers[positions] < chosen.before_number]
    if after is None:
        return positions
    epochs_us, numbers = chunk.epochs_us[positions], chunk.numbers[positions]
    is_beyond: BoolArray = (epochs_us > after[0]) | ((epochs_us == after[0]) & (numbers > after[1]))
    return positions[is_beyond]


def sampled_powers(
    database: Database,
    key: int,
    chosen: Chosen,
    intervals: Intervals,
    carriers_of: Callable[[int], Sequence[str]],
    figure: MeasuredFigure = "power_dbm",
) -> Iterator[SampledPowers]:
    """Yield rows in buckets that lie within one interval each, a read transaction a season.

    ``carriers_of`` gives the carriers of a plan.
    """

    def next_us(connection: Connection, epoch_us: int) -> int | None:
        row = measurement.c
        return next_row_us(connection, row.epoch_us, [row.spacecraft_key == key], of_measurements(key), epoch_us)

    for connection, window in seasons(database, chosen.window, next_us):
        pages, part = MeasurementPages(connection, database.segments, key), chosen._replace(window=window)
        heads = pages.segments(part)
        for plan_id in sorted({head.plan_id for head in heads}):
            of_plan = [head for head in heads if head.plan_id == plan_id]
            columns = slice(len(carriers_of(plan_id)))
            buckets, rest = bins_within(connection, of_plan, figure, intervals, columns)
            if buckets is not None:
                yield SampledPowers(plan_id, buckets)
            for head in rest:
                yield SampledPowers(plan_id, _bucket(read_chunk(connection, None, head), figure))
        for chunk in pages.read_unsealed(part):
            yield SampledPowers(chunk.plan_id, _bucket(chunk, figure))


def _bucket(chunk: RowChunk | MeasurementSegment, figure: MeasuredFigure) -> Summaries:
    """Return the rows of a piece as buckets of their own."""
    values = chunk.power_dbm() if figure == "power_dbm" else chunk.figure(figure)
    return Summaries.of_rows(chunk.epochs_us, values)


#: where the journal and its consumer stand, in the order of `HeadState`
HEAD_COLUMNS = (
    head_table.c.newest_number,
    head_table.c.consumed_number,
    head_table.c.newest_epoch_us,
    head_table.c.consumed_epoch_us,
    head_table.c.result_sequence,
)
#: in the order in which `source_state` takes them
SOURCE_COLUMNS = tuple(
    source.c[name] for name in ("name", "is_prime", "newest_epoch_us", "row_count", "rows_missing", "station", "key_id")
)
_DIGITS = 16
_LOST = "Stop the service. Restore a backup, or put the missing files back; then let the front ends send again."
_OTHER = "Right after a restore, wrong otherwise: compare the archive with a backup of before."


def source_state(row: Sequence[Any]) -> SourceState:
    """Return the state of a source from its columns."""
    name, is_prime, *figures = row
    return SourceState(name, "prime" if is_prime else "backup", *figures)


def head_states(connection: Connection) -> dict[str, HeadState]:
    """Return where the journal of each spacecraft and its consumer stand."""
    query = select(spacecraft.c.id, *HEAD_COLUMNS).join_from(head_table, spacecraft)
    return {row[0]: HeadState(*row[1:]) for row in connection.execute(query)}


def journal_heads(connection: Connection, cache: SegmentCache) -> list[JournalHead]:
    """Return the head of every journal that has entries."""
    query = select(spacecraft.c.id, spacecraft.c.spacecraft_key, head_table.c.newest_number)
    rows = connection.execute(query.join_from(spacecraft, head_table).where(head_table.c.newest_number > 0)).all()
    digests = [_digest(connection, cache, row.spacecraft_key, row.newest_number) for row in rows]
    held = zip(rows, digests, strict=True)
    return [JournalHead(row.id, row.newest_number, digest) for row, digest in held if digest is not None]


def compared_heads(connection: Connection, announced: Iterable[JournalHead]) -> Iterator[Diagnosis]:
    """Compare journals with heads that were logged; an entry that retention took away is not compared."""
    by_spacecraft: dict[str, list[JournalHead]] = {}
    for each in sorted(set(announced)):
        by_spacecraft.setdefault(each.spacecraft_id, []).append(each)
    query = select(spacecraft.c.spacecraft_key, head_table.c.newest_number).join_from(spacecraft, head_table)
    for name, logged in by_spacecraft.items():
        row = connection.execute(query.where(spacecraft.c.id == name)).first()
        key, newest = (0, 0) if row is None else row
        last = logged[-1].number
        if last > newest:
            detail = f"{name}: {last - newest} entries are lost: the log names {last}, the journal ends at {newest}"
            yield Diagnosis("log", "fault", detail, _LOST)
        cache = SegmentCache()
        held = [(each, _digest(connection, cache, key, each.number)) for each in logged if each.number <= newest]
        others = [each.number for each, digest in held if digest not in {None, each.digest}]
        if others:
            detail = (
                f"{name}: {len(others)} of {len(logged)} entries are not those that the log names, {others[0]} first"
            )
            yield Diagnosis("log", "fault", detail, _OTHER)
        elif last <= newest:
            yield Diagnosis("log", "ok", f"{name}: {len(logged)} entries are those that the log names, up to {last}")


def _digest(connection: Connection, cache: SegmentCache, key: int, number: int) -> str | None:
    """Return the digest of an entry, None when it is not held."""
    columns = (journal.c.kind, journal.c.key, journal.c.start_us, journal.c.stop_us, journal.c.document)
    is_it = (journal.c.spacecraft_key == key, journal.c.number == number)
    entry = connection.execute(select(*columns).where(*is_it)).first()
    if entry is not None:
        return sha256(json.dumps(list(entry)).encode()).hexdigest()[:_DIGITS]
    rows = MeasurementPages(connection, cache, key).of_numbers(number - 1, number, is_compared=False)
    return sha256(_content(rows[0])).hexdigest()[:_DIGITS] if rows else None


def _content(row: Measurement) -> bytes:
    """Return the content of a row as bytes, the same for the table of rows and for a sealed day."""
    plain = (row.epoch_us, row.received_at_us, row.number, row.source, row.plan_id, row.is_late, row.feeds_estimator)
    parts = [json.dumps([*plain, row.seq]).encode(), row.power_dbm.astype("<f4").tobytes()]
    parts.append(b"" if row.flags is None else row.flags.astype("<i4").tobytes())
    details = [] if row.details is None else [getattr(row.details, name) for name in DETAIL_NAMES]
    parts.append(np.array(details, dtype="<f4").tobytes())
    return b"".join(len(part).to_bytes(4, "little") + part for part in parts)
