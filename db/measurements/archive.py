"""Archive: inputs of the chain and the journal that orders them; implements ``service.ports.Archive``.

Storing slow inputs: references, corrections, telemetry, weather, polarisation, reported commands and operations.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, and_, bindparam, func, or_, select, update

from db.columns import sound_rows
from db.database import (
    Database,
    EpochSpan,
    Repository,
    add_entries,
    count_entries,
    lock_head,
    next_id,
    page_of,
    within,
)
from db.encoding.record_codec import decode, decode_all, decode_input, encode, kind_of
from db.encoding.segments import DAY_US, SegmentCache
from db.measurements import closed_days
from db.measurements.closed_days import seal_measurements
from db.measurements.ingest import StoreBatch, prepare
from db.measurements.measurement_pages import (
    EVER,
    HEAD_COLUMNS,
    SOURCE_COLUMNS,
    UNCHECKED,
    Chosen,
    MeasurementPages,
    head_states,
    journal_heads,
    sampled_powers,
    source_state,
)
from db.tables import carrier_plan, head, journal, operation, source, source_key_run, spacecraft
from service.errors import InvalidInputError, NotFoundError
from service.ports.archive import Cursor, Intervals, ListPart, MeasuredFigure, SampledPowers
from service.records.calibration import Window
from service.records.catalogue import Carrier
from service.records.inputs import (
    AttitudeReference,
    Correction,
    JournalEntry,
    JournalHead,
    Operation,
    PolarizationRecord,
    SlowInput,
    SourceSelection,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import AppliedCommand, FloatArray, IntArray, ReleasedCommand, ReportedCommand
from service.records.levels.measurement import (
    BatchReceipt,
    HeadState,
    InputReceipt,
    Measurement,
    MeasurementBatch,
    MeasurementBlock,
    MeasurementSeries,
    ReferenceSeries,
    RowRefusal,
    SourceState,
)
from service.records.operations.release import InterlockHold
from service.records.storage import RetiredRows, SealedPart

LOOKUP_CHUNK = 500
#: what carries its own key; everything else is journaled by the call that makes it
KEYED = (
    AttitudeReference
    | Correction
    | TelemetryRecord
    | WeatherReport
    | PolarizationRecord
    | AppliedCommand
    | ReleasedCommand
    | ReportedCommand
    | InterlockHold
)


def span_of(record: KEYED) -> EpochSpan:
    """Return the interval that a slow input holds for."""
    if isinstance(record, Correction):
        return EpochSpan(record.start_us, record.stop_us)
    if isinstance(record, AppliedCommand):
        return EpochSpan(record.command.epoch_us, record.command.valid_until_us)
    if isinstance(record, ReleasedCommand):
        return EpochSpan(record.released_us, record.stop_us)
    if isinstance(record, ReportedCommand):
        return EpochSpan(record.reported_us, record.reported_us)
    if isinstance(record, InterlockHold):
        return EpochSpan(record.at_us, None)
    return EpochSpan(record.epoch_us, record.epoch_us)


def store_inputs(connection: Connection, key: int, records: Sequence[SlowInput]) -> InputReceipt:
    """Store and journal those records whose key is new."""
    lock_head(connection, key)
    known = _stored(connection, key, records)
    accepted: list[tuple[SlowInput, EpochSpan | None]] = []
    refused: list[RowRefusal] = []
    for position, record in enumerate(map(_keyed, records)):
        name, document = (kind_of(record), record.key), encode(record)
        stored = known.get(name)
        if stored is None:
            known[name] = document
            accepted.append((record, span_of(record)))
        elif stored != document:
            detail = f"Another {name[0]} with the key {name[1]!r} is stored already; the first one stays."
            refused.append(RowRefusal(position, None, "input.conflict", detail))
    add_entries(connection, key, accepted)
    return InputReceipt(len(accepted), len(records) - len(accepted) - len(refused), tuple(refused))


def store_operation(connection: Connection, key: int, record: Operation) -> Operation:
    """Store and journal a new operation."""
    stored = replace(record, id=next_id(connection, operation, "operation_id", key), revision=1)
    number = _journal_operation(connection, key, stored)
    values = {"spacecraft_key": key, "operation_id": stored.id, "revision": 1, "number": number}
    connection.execute(operation.insert().values(values))
    return stored


def revise_operation(connection: Connection, key: int, record: Operation) -> Operation:
    """Store and journal a changed operation under the next revision."""
    is_it = (operation.c.spacecraft_key == key, operation.c.operation_id == record.id)
    revision = connection.scalar(select(operation.c.revision).where(*is_it))
    if revision is None:
        raise NotFoundError("operation.unknown", f"There is no operation {record.id} of this spacecraft.")
    stored = replace(record, revision=revision + 1)
    number = _journal_operation(connection, key, stored)
    connection.execute(update(operation).where(*is_it).values(revision=stored.revision, number=number))
    return stored


def _journal_operation(connection: Connection, key: int, record: Operation) -> int:
    return add_entries(connection, key, [(record, EpochSpan(record.start_us, record.stop_us))])


def _keyed(record: SlowInput) -> KEYED:
    if isinstance(record, KEYED):
        return record
    message = f"A record of kind {kind_of(record)!r} enters the journal with the call that makes it."
    raise InvalidInputError("input.kind", message)


def _stored(connection: Connection, key: int, records: Sequence[SlowInput]) -> dict[tuple[str, str], str]:
    """Return the documents of those records whose kind and key are stored."""
    wanted: dict[str, list[str]] = {}
    for record in records:
        wanted.setdefault(kind_of(record), []).append(record.key)
    known: dict[tuple[str, str], str] = {}
    for kind, keys in wanted.items():
        for start in range(0, len(keys), LOOKUP_CHUNK):
            query = select(journal.c.key, journal.c.document).where(
                journal.c.spacecraft_key == key,
                journal.c.kind == kind,
                journal.c.key.in_(keys[start : start + LOOKUP_CHUNK]),
            )
            known.update(((kind, name), document) for name, document in connection.execute(query))
    return known


#: rows of a page that is read as blocks, about those of a segment: larger pages are no faster and take more memory
BLOCK_PAGE_ROWS = 8_640
#: rows of a page that is read as records, of which one takes half a kilobyte
RECORD_PAGE_ROWS = 2048
#: blocks of a longer span would drive out of memory what others read again and again
_SCAN_US = 15 * DAY_US
#: kinds of slow inputs that stand at one epoch
_POINT_KINDS = ("reference", "telemetry", "weather", "polarization")
_POSITION = journal.c.start_us, journal.c.number
_OF_NUMBERS = select(journal).where(
    journal.c.spacecraft_key == bindparam("key"),
    journal.c.number > bindparam("after"),
    journal.c.number <= bindparam("upto"),
)
_KEY_RUNS = (
    select(source_key_run)
    .where(source_key_run.c.spacecraft_key == bindparam("key"))
    .order_by(source_key_run.c.first_number)
)


class SqlArchive(Repository):
    """Archive in a relational database."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        #: carriers of the plans met; a stored plan never changes
        self._carriers: dict[tuple[int, int], tuple[str, ...]] = {}
        self._listener: Callable[[MeasurementBatch, BatchReceipt], None] | None = None

    def append_measurements(self, batch: MeasurementBatch) -> Future[BatchReceipt]:
        """Store and journal the rows of a batch; the future resolves after the commit that made them durable."""
        key = self._database.key(batch.spacecraft_id)
        expected, sent = len(self._carrier_ids(key, batch.plan_id)), batch.power_dbm.shape[1]
        if sent != expected:
            detail = f"Plan {batch.plan_id} of {batch.spacecraft_id!r} has {expected} carriers, the rows have {sent}."
            raise InvalidInputError("value.count", detail)
        work = StoreBatch(prepare(key, batch), self._database.segments)
        listener = self._listener
        reported = None if listener is None else partial(listener, batch)
        return self._database.submit(work, reported, key)

    def listen(self, listener: Callable[[MeasurementBatch, BatchReceipt], None] | None) -> None:
        """Notify a listener of every batch right after its commit; None removes it."""
        self._listener = listener

    def append_inputs(self, spacecraft_id: str, records: Sequence[SlowInput]) -> InputReceipt:
        """Store and journal slow inputs; same key, other content: refused ``input.conflict``."""
        key = self._database.key(spacecraft_id)
        return self._database.write(lambda connection: store_inputs(connection, key, records), key)

    def add_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal an operation (its id is ignored) and return it with its id."""
        return self._change(spacecraft_id, store_operation, operation)

    def replace_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal a changed operation under the next revision."""
        return self._change(spacecraft_id, revise_operation, operation)

    def operation(self, spacecraft_id: str, operation_id: int) -> Operation:
        """Return the newest revision of one operation."""
        key = self._database.key(spacecraft_id)
        query = _newest_operations(select(journal), key).where(operation.c.operation_id == operation_id)
        rows = sound_rows(journal, self._database.fetch(query))
        if not rows:
            raise NotFoundError("operation.unknown", f"There is no operation {operation_id} of {spacecraft_id!r}.")
        return decode(Operation, rows[0].document)

    def sources(self, spacecraft_id: str) -> tuple[SourceState, ...]:
        """Return all measurement sources."""
        key = self._database.key(spacecraft_id)
        query = select(*SOURCE_COLUMNS).where(source.c.spacecraft_key == key).order_by(source.c.source_key)
        return tuple(map(source_state, self._database.fetch(query)))

    def every_source(self) -> dict[str, list[SourceState]]:
        """Return the measurement sources of each spacecraft that has one."""
        query = select(spacecraft.c.id, *SOURCE_COLUMNS).join_from(source, spacecraft).order_by(source.c.source_key)
        by_id: dict[str, list[SourceState]] = {}
        for row in self._database.fetch(query):
            by_id.setdefault(row[0], []).append(source_state(row[1:]))
        return by_id

    def select_source(self, spacecraft_id: str, source: str) -> SourceState:
        """Make a source the prime one, journaled; rows stored from then on feed the estimator."""
        return self._change(spacecraft_id, _select_source, source)

    def head(self, spacecraft_id: str) -> HeadState:
        """Return where journal and consumer stand."""
        with self._read(spacecraft_id) as (connection, key):
            return HeadState(*connection.execute(select(*HEAD_COLUMNS).where(head.c.spacecraft_key == key)).one())

    def heads(self) -> dict[str, HeadState]:
        """Return where journal and consumer of every spacecraft stand."""
        with self._database.read() as connection:
            return head_states(connection)

    def journal_heads(self) -> list[JournalHead]:
        """Return number and digest of the newest entry of every journal."""
        with self._database.read() as connection:
            return journal_heads(connection, self._database.segments)

    def journal(self, spacecraft_id: str, after: int, limit: int, *, is_compared: bool = False) -> list[JournalEntry]:
        """Return at most ``limit`` entries with a number above ``after``, in order."""
        with self._read(spacecraft_id) as (connection, key):
            entries = self._entries(connection, key, after, limit, is_compared=is_compared)
            if not entries and (following := self._next_number(connection, key, after)) is not None:
                # retention has taken away what followed
                entries = self._entries(connection, key, following - 1, limit, is_compared=is_compared)
        return entries

    def _entries(
        self, connection: Connection, key: int, after: int, limit: int, *, is_compared: bool
    ) -> list[JournalEntry]:
        """Return the entries with a number in (after, after + limit], in order.

        Numbers have no gap but that of retention, so the next entries are a range of numbers.
        """
        slow, pages = {"key": key, "after": after, "upto": after + limit}, self._pages(connection, key)
        rows = _with_keys(connection, pages, pages.of_numbers(after, after + limit, is_compared=is_compared))
        entries = [JournalEntry(row.number, row) for row in rows]
        entries += _slow_entries(connection.execute(_OF_NUMBERS, slow), is_compared=is_compared)
        return sorted(entries, key=lambda entry: entry.number)

    def _next_number(self, connection: Connection, key: int, after: int) -> int | None:
        newest = select(head.c.newest_number).where(head.c.spacecraft_key == key)
        if (connection.scalar(newest) or 0) <= after:
            # nearly always: followers of the journal are at its end
            return None
        slow = select(func.min(journal.c.number)).where(journal.c.spacecraft_key == key, journal.c.number > after)
        found = (connection.scalar(slow), self._pages(connection, key).next_number(after))
        return min((number for number in found if number is not None), default=None)

    def slow_inputs_before(self, spacecraft_id: str, number: int, kinds: Sequence[str]) -> list[JournalEntry]:
        """Return all slow inputs of some kinds with a number below the given one, in order."""
        key = self._database.key(spacecraft_id)
        query = (
            select(journal)
            .where(journal.c.spacecraft_key == key, journal.c.kind.in_(kinds), journal.c.number < number)
            .order_by(journal.c.number)
        )
        return _slow_entries(self._database.fetch(query), is_compared=False)

    def inputs(self, spacecraft_id: str, kind: str, part: ListPart, *, is_compared: bool = True) -> list[JournalEntry]:
        """Return slow inputs of a kind that overlap a window, in order of (start, number), beyond a cursor."""
        query = _inputs(self._database.key(spacecraft_id), kind, part.window)
        page = page_of(query, *_POSITION, part._replace(window=EVER))
        return _slow_entries(self._database.fetch(page), is_compared=is_compared)

    def newest_measurement(self, spacecraft_id: str) -> Measurement | None:
        """Return the newest row of the prime source."""
        with self._read(spacecraft_id) as (connection, key):
            prime = select(source.c.source_key, source.c.newest_epoch_us).where(source.c.spacecraft_key == key)
            newest = connection.execute(prime.where(source.c.is_prime)).first()
            if newest is None:
                return None
            return self._pages(connection, key).at(newest.source_key, newest.newest_epoch_us)

    def measurements(self, spacecraft_id: str, part: ListPart, source: str | None = None) -> list[Measurement]:
        """Return rows in order of (epoch, number) beyond a cursor; every source unless one is named."""
        with self._read(spacecraft_id) as (connection, key):
            pages = self._pages(connection, key)
            return _with_keys(connection, pages, pages.records(part, source))

    def measurement_blocks(
        self, spacecraft_id: str, window: Window, *, source: str | None = None, feeds_estimator_only: bool = False
    ) -> Iterator[MeasurementBlock]:
        """Yield the rows of a window as blocks in order of (epoch, number); what is held at once is bounded."""
        chosen = Chosen(window, source, feeds_estimator_only)
        return self._blocks(self._database.key(spacecraft_id), chosen)

    def _blocks(self, key: int, chosen: Chosen) -> Iterator[MeasurementBlock]:
        after: Cursor | None = None
        cache, window = self._database.segments, chosen.window
        if window.stop_us - window.start_us > _SCAN_US:
            cache = SegmentCache(0)
        while True:
            with self._database.read() as connection:
                blocks, after = MeasurementPages(connection, cache, key).read_blocks(chosen, BLOCK_PAGE_ROWS, after)
            yield from blocks
            if after is None:
                return

    def sampled_measurements(
        self,
        spacecraft_id: str,
        window: Window,
        intervals: Intervals,
        source: str | None = None,
        figure: MeasuredFigure = "power_dbm",
    ) -> Iterator[SampledPowers]:
        """Yield the rows of a window in buckets that lie within one interval each; every row is in one of them."""
        key, chosen = self._database.key(spacecraft_id), Chosen(window, source)
        carriers_of = partial(self._carrier_ids, key)
        return sampled_powers(self._database, key, chosen, intervals, carriers_of, figure)

    def plan_ids(self, spacecraft_id: str, window: Window) -> tuple[int, ...]:
        """Return the numbers of the carrier plans under which the rows of a window were stored, ascending."""
        with self._read(spacecraft_id) as (connection, key):
            return tuple(sorted(self._pages(connection, key).plan_ids(window)))

    def measurements_after(self, spacecraft_id: str, epoch_us: int, before_number: int) -> Iterator[Measurement]:
        """Yield rows that feed the estimator, later than an epoch, stored before a journal number, by epoch."""
        key = self._database.key(spacecraft_id)
        chosen = Chosen(Window(epoch_us + 1, EVER.stop_us), feeds_only=True, before_number=before_number)
        return self._records(key, chosen)

    def _records(self, key: int, chosen: Chosen) -> Iterator[Measurement]:
        after: Cursor | None = None
        cache = SegmentCache(0)
        while True:
            with self._database.read() as connection:
                runs = MeasurementPages(connection, cache, key).read(chosen, RECORD_PAGE_ROWS, after, columns=UNCHECKED)
            if not runs:
                return
            for run in runs:
                yield from run.records()
            after = runs[-1].end

    def last_number(self, spacecraft_id: str, window: Window) -> int:
        """Return a journal number behind which no row lies in a window; 0 where none does at all."""
        with self._read(spacecraft_id) as (connection, key):
            return self._pages(connection, key).last_number(window)

    def measurement_series(self, spacecraft_id: str, window: Window, carrier_ids: Sequence[str]) -> MeasurementSeries:
        """Return the rows that feed the estimator as arrays, columns matched by carrier id across plans."""
        epochs_us: list[IntArray] = [np.empty(0, dtype=np.int64)]
        powers: list[FloatArray] = [np.empty((0, len(carrier_ids)))]
        for part in self.measurement_parts(spacecraft_id, window, carrier_ids):
            epochs_us.append(part.epochs_us)
            powers.append(part.power_dbm)
        series = MeasurementSeries(tuple(carrier_ids), np.concatenate(epochs_us), np.concatenate(powers))
        series.epochs_us.setflags(write=False)
        series.power_dbm.setflags(write=False)
        return series

    def measurement_parts(
        self, spacecraft_id: str, window: Window, carrier_ids: Sequence[str]
    ) -> Iterator[MeasurementSeries]:
        """Yield the rows that feed the estimator as arrays, a page at once."""
        key = self._database.key(spacecraft_id)
        for block in self._blocks(key, Chosen(window, feeds_only=True)):
            held = {name: column for column, name in enumerate(self._carrier_ids(key, block.plan_id))}
            wanted = [(position, held[name]) for position, name in enumerate(carrier_ids) if name in held]
            power_dbm = np.full((len(block.epochs_us), len(carrier_ids)), np.nan)
            power_dbm[:, [position for position, _ in wanted]] = block.power_dbm[:, [column for _, column in wanted]]
            yield MeasurementSeries(tuple(carrier_ids), block.epochs_us, power_dbm)

    def reference_series(self, spacecraft_id: str, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the attitude references of every sensor in a window."""
        query = _inputs(self._database.key(spacecraft_id), "reference", window)
        sensors: dict[str, list[ReferenceSeries]] = {}
        after: Cursor | None = None
        while rows := self._database.fetch(page_of(query, *_POSITION, ListPart(EVER, RECORD_PAGE_ROWS, after))):
            page: dict[str, list[AttitudeReference]] = {}
            for row in sound_rows(journal, rows):
                reference = decode(AttitudeReference, row.document)
                page.setdefault(reference.source, []).append(reference)
            for name, references in page.items():
                sensors.setdefault(name, []).append(_reference_series(name, references))
            after = rows[-1].start_us, rows[-1].number
        return tuple(_joined_references(name, sensors[name]) for name in sorted(sensors))

    def seal(self, spacecraft_id: str, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
        """Seal closed days, a transaction a step."""
        return seal_measurements(self._database, self._database.key(spacecraft_id), before_us, received_before_us)

    def drop_before(self, spacecraft_id: str, series: str, before_us: int) -> Iterator[RetiredRows]:
        """Drop the rows of a series of whole days before an epoch, a transaction a step."""
        return closed_days.drop(self._database, self._database.key(spacecraft_id), series, before_us)

    def fitting_us(self, spacecraft_id: str, series: str, size_bytes: int) -> int | None:
        """Return from where on a series fits a size; None when all of it does."""
        return closed_days.fitting_us(self._database, self._database.key(spacecraft_id), series, size_bytes)

    def kept_from_us(self, spacecraft_id: str, series: str) -> int:
        """Return the epoch from which on a series is kept."""
        with self._read(spacecraft_id) as (connection, key):
            return closed_days.kept_from_us(connection, key, series)

    def _pages(self, connection: Connection, key: int) -> MeasurementPages:
        return MeasurementPages(connection, self._database.segments, key)

    def _carrier_ids(self, key: int, plan_id: int) -> tuple[str, ...]:
        """Return the carrier ids of a plan; NotFoundError ``plan.unknown``."""
        known = self._carriers.get((key, plan_id))
        if known is None:
            is_it = (carrier_plan.c.spacecraft_key == key, carrier_plan.c.plan_id == plan_id)
            row = self._database.fetch_one(select(carrier_plan.c.document).where(*is_it))
            if row is None:
                raise NotFoundError("plan.unknown", f"The spacecraft has no carrier plan {plan_id}.")
            known = tuple(carrier.id for carrier in decode_all(Carrier, row.document))
            self._carriers[key, plan_id] = known
        return known


def _slow_entries(rows: Iterable[Row[Any]], *, is_compared: bool) -> list[JournalEntry]:
    return [
        JournalEntry(row.number, decode_input(row.kind, row.document), row.start_us, row.stop_us)
        for row in (sound_rows(journal, rows) if is_compared else rows)
    ]


def _inputs(key: int, kind: str, window: Window) -> Select[Any]:
    """Return the query for slow inputs of a kind that overlap a window; of operations the newest revision."""
    query = select(journal).where(journal.c.spacecraft_key == key, journal.c.kind == kind)
    if kind in _POINT_KINDS:
        return query.where(within(journal.c.start_us, window))
    if kind == "operation":
        query = _newest_operations(query, key)
    reaches = or_(
        journal.c.stop_us.is_(None), journal.c.stop_us > window.start_us, journal.c.start_us >= window.start_us
    )
    return query.where(journal.c.start_us < window.stop_us, reaches)


def _newest_operations(query: Select[Any], key: int) -> Select[Any]:
    is_its_entry = and_(journal.c.spacecraft_key == operation.c.spacecraft_key, journal.c.number == operation.c.number)
    return query.join(operation, is_its_entry).where(operation.c.spacecraft_key == key)


def _select_source(connection: Connection, key: int, name: str) -> SourceState:
    is_it = (source.c.spacecraft_key == key, source.c.name == name)
    if connection.execute(select(source).where(*is_it)).first() is None:
        raise NotFoundError("source.unknown", f"No source {name!r} has sent measurements of this spacecraft.")
    connection.execute(update(source).where(source.c.spacecraft_key == key).values(is_prime=(source.c.name == name)))
    count = 1 + count_entries(connection, key, "source")
    add_entries(connection, key, [(SourceSelection(name, count), None)])
    return source_state(connection.execute(select(*SOURCE_COLUMNS).where(*is_it)).one())


def _with_keys(connection: Connection, pages: MeasurementPages, rows: Sequence[Measurement]) -> list[Measurement]:
    """Return rows with the keys that they came with."""
    if not rows:
        return []
    runs: dict[str, list[Any]] = {}
    for run in connection.execute(_KEY_RUNS, {"key": pages.key}):
        runs.setdefault(pages.names[run.source_key], []).append(run)

    def with_key(row: Measurement) -> Measurement:
        of_source = runs.get(row.source, [])
        position = bisect_right(of_source, row.number, key=attrgetter("first_number"))
        if position == 0:
            return row
        run = of_source[position - 1]
        return replace(row, key_id=run.key_id, station=run.station)

    return list(map(with_key, rows))


def _reference_series(name: str, references: list[AttitudeReference]) -> ReferenceSeries:
    epochs_us = np.array([reference.epoch_us for reference in references], dtype=np.int64)
    angles = np.array([(reference.attitude_deg, reference.sigma_deg) for reference in references], dtype=np.float64)
    return ReferenceSeries(name, epochs_us, angles[:, 0], angles[:, 1])


def _joined_references(name: str, parts: list[ReferenceSeries]) -> ReferenceSeries:
    columns = ((part.epochs_us, part.attitude_deg, part.sigma_deg) for part in parts)
    arrays = [np.concatenate(column) for column in zip(*columns, strict=True)]
    for array in arrays:
        array.setflags(write=False)
    return ReferenceSeries(name, *arrays)
