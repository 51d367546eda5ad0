"""Rows of results as stored: in tables, in the segments of sealed days, and as records; carriers' results as bytes.

The live version has one row a consumed measurement, whether or not anything was computed for it: the chain stores none
for a measurement that it consumed before a method had a calibration and an alignment. Such rows are made here, on
reading, with the reason that held when the measurement was consumed: journal numbers tell which activations stood
before it.

Which measurements lack a result is counted here too: of those behind the newest entry that the chain has consumed, and
of all after an alignment that it has not.
"""

import math
from collections import namedtuple
from collections.abc import Iterator, Sequence
from functools import cache, cached_property, partial
from itertools import chain, starmap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Table, and_, func, select

from db.columns import Figure, sound_rows
from db.database import ALL_ROWS, newest_rows, page_of, position_of, start_of_last, within
from db.encoding.column_blob import ColumnBlob, Positions
from db.encoding.measurement_rows import ChunkRun
from db.encoding.record_codec import RecordCodec, decode
from db.encoding.segments import (
    DAY_US,
    RowSeries,
    SegmentCache,
    SegmentHead,
    heads,
    heads_of_numbers,
    heads_where,
    opened,
    read_chunk,
)
from db.measurements.closed_days import kept_from_us
from db.measurements.measurement_pages import EVER, LIGHT, MAX_NUMBER, Chosen, MeasurementPages
from db.tables import (
    alignment,
    attitude,
    calibration,
    journal,
    measurement,
    retention_mark,
    segment,
    torque,
)
from db.tables import head as head_table
from service.ports.archive import LIVE, Cursor, ListPart
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import Method
from service.records.inputs import CalibrationActivation
from service.records.levels.attitude import (
    STEP_DB,
    AttitudeRow,
    BoolArray,
    CarrierResults,
    FloatArray,
    IntArray,
    TorqueCommand,
    row_without_attitude,
)

_ATTITUDE, _TORQUE = RecordCodec(AttitudeRow, attitude), RecordCodec(TorqueCommand, torque)
#: record of a row of ``select(attitude)``, or of ``select(torque)``
attitude_of, torque_of = _ATTITUDE.record, _TORQUE.record
#: of many
attitudes_of, torques_of = _ATTITUDE.records, _TORQUE.records


def attitude_columns(
    key: int,
    version: str,
    rows: Sequence[AttitudeRow],
    sequences: Sequence[int | None],
    carriers: Sequence[CarrierResults | None],
) -> dict[str, Sequence[Any]]:
    """Return the columns of attitude rows, at least one."""
    kind = {"spacecraft_key": (key,) * len(rows), "version": (version,) * len(rows), "sequence": sequences}
    return {**kind, **_ATTITUDE.columns(rows), "carriers": pack_carriers(carriers)}


def torque_columns(
    key: int, version: str, commands: Sequence[TorqueCommand], sequences: Sequence[int | None]
) -> dict[str, Sequence[Any]]:
    """Return the columns of torque commands, at least one."""
    count = len(commands)
    kind = {"spacecraft_key": (key,) * count, "version": (version,) * count, "sequence": sequences}
    return {**kind, **_TORQUE.columns(commands)}


#: of a level: absent, and the greatest
_NONE, _MOST = -(1 << 15), (1 << 15) - 1
_STATE_BITS = 4


def _carrier_type(count: int) -> np.dtype[Any]:
    """Return the type of the results of a row: its plan, levels of both kinds, state and hypothesis in one word."""
    return np.dtype([("plan", "<i4"), ("levels", "<i2", (2, count)), ("words", "u1", (count,))])


def pack_carriers(results: Sequence[CarrierResults | None]) -> list[bytes | None]:
    """Return the results of rows as bytes; None stays None."""
    by_plan: dict[tuple[int, int], list[int]] = {}
    for position, each in enumerate(results):
        if each is not None:
            by_plan.setdefault((each.plan_id, len(each.state)), []).append(position)
    packed: list[bytes | None] = [None] * len(results)
    for (plan_id, count), positions in by_plan.items():
        its = [each for position in positions if (each := results[position]) is not None]
        steps = np.rint(np.array([(each.deviation_db, each.residual_db) for each in its]) / STEP_DB)
        words = np.array([each.state for each in its]) | np.array([each.hypothesis for each in its]) << _STATE_BITS
        rows = np.empty(len(its), dtype=_carrier_type(count))
        rows["plan"], rows["words"] = plan_id, words
        rows["levels"] = np.where(np.isnan(steps), _NONE, np.minimum(np.maximum(steps, -_MOST), _MOST))
        whole, size = rows.tobytes(), rows.itemsize
        for place, position in enumerate(positions):
            packed[position] = whole[place * size : (place + 1) * size]
    return packed


def unpack_carriers(blob: bytes) -> CarrierResults:
    """Return the results of a row."""
    row, low = _carrier_rows([blob])[0], (1 << _STATE_BITS) - 1
    deviation_db, residual_db = np.where(row["levels"] == _NONE, np.nan, row["levels"] * STEP_DB)
    words = row["words"].astype(np.int64)
    return CarrierResults(int(row["plan"]), deviation_db, residual_db, words & low, words >> _STATE_BITS)


def carrier_steps(blobs: Sequence[bytes]) -> FloatArray:
    """Return deviations and residuals of rows of one plan, (T, 2 N) steps of ``STEP_DB``, NaN = absent."""
    levels = _carrier_rows(blobs)["levels"].reshape(len(blobs), -1)
    return np.where(levels == _NONE, np.nan, levels)


def _carrier_rows(blobs: Sequence[bytes]) -> NDArray[Any]:
    """Return the results of rows of one plan as `_carrier_type`."""
    fixed = _carrier_type(0).itemsize
    count = (len(blobs[0]) - fixed) // (_carrier_type(1).itemsize - fixed)
    return np.frombuffer(b"".join(blobs), dtype=_carrier_type(count))


def plan_of_carriers(blob: bytes) -> int:
    """Return the plan of the results of a row."""
    return int.from_bytes(blob[:4], "little", signed=True)


#: columns of the tables that the head of a segment states, or that are made from the others
HEAD_COLUMNS = ("spacecraft_key", "version", "method", "checksum")
#: tables of results by the name under which their rows are sealed
TABLES: dict[str, Table] = {table.name: table for table in (attitude, torque)}


@cache
def row_type(table: Table) -> Any:
    """Return the named tuple with the columns of a table of results, in their order."""
    return namedtuple(table.name, table.c.keys())


class ResultSegment:
    """Results of one segment, (T,), by epoch and number."""

    def __init__(self, head: SegmentHead, blob: ColumnBlob) -> None:
        self._table, self._head, self._blob = TABLES[head.series], head, blob
        self.epochs_us: IntArray
        self.numbers: IntArray
        self.epochs_us, self.numbers = blob.whole("epoch_us", "number")
        if {self.epochs_us.dtype.kind, self.numbers.dtype.kind} != {"i"} or not set(blob.names) <= set(
            self._table.c.keys()
        ):
            message = f"it has other columns than {head.series} has"
            raise ValueError(message)

    def values(self, name: str) -> list[Any]:
        """Return a column."""
        return self._blob.values(name, slice(None))

    def rows(self, chosen: Positions = slice(None)) -> list[Any]:
        """Return some rows as `row_type` of their table; they have no checksum of their own."""
        count = len(self.epochs_us[chosen])
        stored = self._blob.columns([name for name in self._blob.names if name not in HEAD_COLUMNS], chosen)
        columns = [stored.get(column.name) or self._column(column) * count for column in self._table.c]
        return list(map(row_type(self._table)._make, zip(*columns, strict=True)))

    def _column(self, column: Any) -> list[Any]:
        """Return the value that all rows have in a column that is not stored."""
        if column.name in HEAD_COLUMNS:
            return [None if column.name == "checksum" else getattr(self._head, column.name)]
        # NaN is null in the table, and a column of it is not kept
        return [math.nan if isinstance(column.type, Figure) else None]

    def after(self, cursor: tuple[int, int] | None) -> BoolArray:
        """Return which rows lie beyond (epoch, number)."""
        if cursor is None:
            return np.ones(len(self.epochs_us), dtype=np.bool_)
        epoch_us, number = cursor
        is_beyond: BoolArray = (self.epochs_us > epoch_us) | ((self.epochs_us == epoch_us) & (self.numbers > number))
        return is_beyond


def read_results(connection: Connection, head: SegmentHead) -> ResultSegment:
    """Return the results of a segment; StorageError ``storage.corrupt``."""
    return opened(connection, head, partial(ResultSegment, head))


#: of a series, its last row
NEWEST = ListPart(EVER, 1, newest_first=True)
#: positions in one query
_LOOKUP = 250
#: rows in memory at once as records
_PAGE_ROWS = 5000


def unsealed_rows(connection: Connection, of: RowSeries, window: Window) -> Iterator[list[Any]]:
    """Yield the rows of the table of rows in a window, some at a time."""
    after: tuple[int, int] | None = None
    while rows := _of_table(connection, of, ListPart(window, _PAGE_ROWS, after)):
        yield rows
        after = position_of(rows[-1])


def _of_table(connection: Connection, of: RowSeries, part: ListPart) -> list[Any]:
    table = of.table
    query = page_of(select(table).where(*of.of_rows()), table.c.epoch_us, table.c.number, part)
    return sound_rows(table, connection.execute(query))


def stored_rows(connection: Connection, of: RowSeries, part: ListPart) -> list[Any]:
    """Return the rows of a part of a series, in order of (epoch, number)."""
    if part.newest_first:
        return newest_rows(partial(stored_rows, connection, of), partial(_start_of_newest, connection, of), part)
    window, limit, after = part.window, part.limit, part.after
    rows = _of_table(connection, of, part)
    sealed: list[Any] = []
    start_us = window.start_us if after is None else max(window.start_us, after[0])
    for head in heads(connection, of.of_segments(), start_us, window.stop_us):
        found = read_results(connection, head)
        is_inside = (found.epochs_us >= window.start_us) & (found.epochs_us < window.stop_us)
        sealed += found.rows(np.flatnonzero(is_inside & found.after(after))[: limit - len(sealed)])
        if len(sealed) >= limit:
            break
    if not sealed:
        return rows
    return sorted(rows + sealed, key=position_of)[:limit]


def newest_row(connection: Connection, of: RowSeries) -> Any | None:
    """Return the row with the greatest (epoch, number)."""
    return next(iter(stored_rows(connection, of, NEWEST)), None)


def _start_of_newest(connection: Connection, of: RowSeries, window: Window, count: int) -> int:
    """Return an epoch from which on so many rows of a window stand; its start where there are fewer."""
    epoch = of.table.c.epoch_us
    query = select(epoch).where(*of.of_rows(), within(epoch, window)).order_by(epoch.desc())
    row = connection.scalar(query.offset(count - 1).limit(1))
    start_us = window.start_us if row is None else int(row)
    found = heads(connection, of.of_segments(), start_us, window.stop_us, newest_first=True)
    epochs_us = (read_results(connection, head).epochs_us for head in found)
    inside = (each[(each >= window.start_us) & (each < window.stop_us)] for each in epochs_us)
    return start_of_last(inside, count, start_us)


def stored_numbers(connection: Connection, of: RowSeries, window: Window) -> IntArray:
    """Return the journal numbers of the rows of a window, in no order."""
    table = of.table
    query = select(table.c.number).where(*of.of_rows(), within(table.c.epoch_us, window))
    found = [np.array(connection.scalars(query).all(), dtype=np.int64)]
    for head in heads(connection, of.of_segments(), window.start_us, window.stop_us):
        each = read_results(connection, head)
        found.append(each.numbers[(each.epochs_us >= window.start_us) & (each.epochs_us < window.stop_us)])
    return np.concatenate(found)


def unsealed_positions(connection: Connection, of: RowSeries, wanted: set[Cursor]) -> set[Cursor]:
    """Return those of some (epoch, number) that are in the table of rows."""
    epoch, number = of.table.c.epoch_us, of.table.c.number
    # by epoch alone: for pairs SQLite goes through every row of the series
    epochs_us, found = sorted({each[0] for each in wanted}), set[Cursor]()
    for start in range(0, len(epochs_us), _LOOKUP):
        query = select(epoch, number).where(*of.of_rows(), epoch.in_(epochs_us[start : start + _LOOKUP]))
        found |= wanted.intersection((row[0], row[1]) for row in connection.execute(query))
    return found


def sealed_positions(connection: Connection, of: RowSeries, wanted: set[Cursor]) -> set[Cursor]:
    """Return those of some (epoch, number), at least one, that are sealed."""
    found = set[Cursor]()
    for head in heads(connection, of.of_segments(), min(wanted)[0], max(wanted)[0] + 1):
        each = read_results(connection, head)
        found |= wanted.intersection(zip(each.epochs_us.tolist(), each.numbers.tolist(), strict=True))
    return found


def sealed_of_sequences(connection: Connection, key: int, after: int, upto: int) -> Iterator[Any]:
    """Yield the sealed live rows with a sequence in (after, upto]."""
    column = segment.c
    is_its = (column.spacecraft_key == key, column.last_sequence > after, column.first_sequence <= upto)
    for head in heads_where(connection, *is_its):
        found = read_results(connection, head)
        sequences = np.array(found.values("sequence"), dtype=np.int64)
        yield from found.rows(np.flatnonzero((sequences > after) & (sequences <= upto)))


def next_sealed_sequence(connection: Connection, key: int, after: int) -> int | None:
    """Return the smallest sequence above the given one that is sealed."""
    column = segment.c
    is_beyond = and_(column.spacecraft_key == key, column.last_sequence > after)
    first = connection.scalar(select(func.min(column.first_sequence)).where(is_beyond, column.first_sequence > after))
    found = [] if first is None else [int(first)]
    for head in heads_where(connection, is_beyond, column.first_sequence <= after):
        sequences = read_results(connection, head).values("sequence")
        found.append(min(sequence for sequence in sequences if sequence > after))
    return min(found, default=None)


def numbers_where(
    connection: Connection, of: RowSeries, name: str, after_us: int
) -> Iterator[tuple[IntArray, list[Any]]]:
    """Yield numbers of sealed rows later than an epoch, and the column of that name beside them."""
    for head in heads(connection, of.of_segments(), after_us + 1, 1 << 62):
        each = read_results(connection, head)
        is_later: BoolArray = each.epochs_us > after_us
        values = each.values(name)
        yield each.numbers[is_later], [values[position] for position in np.flatnonzero(is_later).tolist()]


def newest_computed(connection: Connection, key: int, method: Method) -> AttitudeRow | None:
    """Return the newest stored row of a method where it is the row of the newest consumed measurement.

    One statement; None says that an `AttitudeReader` must search.
    """
    mark = select(retention_mark.c.kept_from_us).where(
        retention_mark.c.spacecraft_key == key, retention_mark.c.series == "attitude"
    )
    is_newest = attitude.c.epoch_us >= head_table.c.consumed_epoch_us
    is_kept = attitude.c.epoch_us >= func.coalesce(mark.scalar_subquery(), attitude.c.epoch_us)
    query = (
        select(attitude, and_(is_newest, is_kept).label("is_answer"))
        .where(attitude.c.spacecraft_key == key, attitude.c.version == LIVE, attitude.c.method == method.value)
        .join(head_table, head_table.c.spacecraft_key == attitude.c.spacecraft_key)
        .order_by(attitude.c.epoch_us.desc(), attitude.c.number.desc())
    )
    row = next(iter(sound_rows(attitude, connection.execute(query.limit(1)))), None)
    return attitude_of(row) if row is not None and row.is_answer else None


class _Consumed(NamedTuple):
    """A consumed measurement."""

    epoch_us: int
    number: int
    received_at_us: int


class AttitudeReader:
    """Reader of the live attitude of one method within one read transaction."""

    def __init__(self, connection: Connection, cache: SegmentCache, key: int, method: Method) -> None:
        self._connection = connection
        self._pages = MeasurementPages(connection, cache, key)
        self._key = key
        self._method = method
        self._stored = RowSeries(key, attitude, LIVE, method.value)
        self._measured_from_us = kept_from_us(connection, key, "measurements")

    def rows(self, part: ListPart) -> list[AttitudeRow]:
        """Return the rows of a part of the list."""
        start_us = max(part.window.start_us, kept_from_us(self._connection, self._key, "attitude"))
        # of measurements that retention took away the attitude alone is left
        left = Window(start_us, min(part.window.stop_us, self._measured_from_us))
        rest = Window(max(start_us, self._measured_from_us), part.window.stop_us)
        pieces = [(left, self._left), (rest, self._measured)]
        found: list[AttitudeRow] = []
        for window, read in pieces[::-1] if part.newest_first else pieces:
            if len(found) < part.limit and window.start_us < window.stop_us:
                found += read(part._replace(window=window, limit=part.limit - len(found)))
        return found

    def newest(self) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        return next(iter(self.rows(NEWEST)), None)

    def _left(self, part: ListPart) -> list[AttitudeRow]:
        return attitudes_of(stored_rows(self._connection, self._stored, part))

    def _measured(self, part: ListPart) -> list[AttitudeRow]:
        if part.newest_first:
            return newest_rows(self._measured, self._start_of_newest, part)
        runs = self._pages.read(self._consumed(part.window), part.limit, part.after, columns=LIGHT)
        return self._records([measurement for run in runs for measurement in _of_run(run)])

    def _start_of_newest(self, window: Window, count: int) -> int:
        return self._pages.start_of_newest(self._consumed(window), count)

    def _consumed(self, window: Window) -> Chosen:
        """Return the selection of the measurements that the chain has consumed."""
        number = self._connection.scalar(
            select(head_table.c.consumed_number).where(head_table.c.spacecraft_key == self._key)
        )
        return Chosen(window, feeds_only=True, before_number=(number or 0) + 1)

    def _records(self, measurements: Sequence[_Consumed]) -> list[AttitudeRow]:
        if not measurements:
            return []
        window = Window(measurements[0].epoch_us, measurements[-1].epoch_us + 1)
        rows = attitudes_of(stored_rows(self._connection, self._stored, ListPart(window, ALL_ROWS)))
        stored = {position_of(row): row for row in rows}
        return [
            stored.get((measurement.epoch_us, measurement.number)) or self._without_attitude(measurement)
            for measurement in measurements
        ]

    def _without_attitude(self, measurement: _Consumed) -> AttitudeRow:
        is_calibrated = self._calibrated_number is not None and self._calibrated_number < measurement.number
        inhibition = "not_aligned" if is_calibrated else "no_calibration"
        return row_without_attitude(
            measurement.epoch_us, measurement.received_at_us, measurement.number, self._method, (inhibition,)
        )

    @cached_property
    def _calibrated_number(self) -> int | None:
        """Return the number of the activation from which on the method had a calibration."""
        held = select(calibration.c.calibration_id, calibration.c.method)
        methods = {
            row[0]: row[1] for row in self._connection.execute(held.where(calibration.c.spacecraft_key == self._key))
        }
        activations = (
            select(journal.c.number, journal.c.document)
            .where(journal.c.spacecraft_key == self._key, journal.c.kind == "activation")
            .order_by(journal.c.number)
        )
        for number, document in self._connection.execute(activations):
            method = methods[decode(CalibrationActivation, document).calibration_id]
            # a geometry calibration carries the paper part too; a paper one serves only paper
            if self._method is Method.PAPER or method == CalibrationMethod.GEOMETRY.value:
                return int(number)
        return None


def _of_run(run: ChunkRun) -> Iterator[_Consumed]:
    columns = (run.chunk.epochs_us, run.chunk.numbers, run.chunk.received_at_us)
    return starmap(_Consumed, zip(*(column[run.positions].tolist() for column in columns), strict=True))


#: rows looked at at once
_AT_ONCE = 10_000


def pending_rows(connection: Connection, cache: SegmentCache, key: int, methods: Sequence[Method]) -> int:
    """Return how many rows after the newest alignment lack a result of one of the methods; 0 without one."""
    newest = (
        select(alignment.c.number, alignment.c.epoch_us, head_table.c.consumed_number)
        .join(head_table, head_table.c.spacecraft_key == alignment.c.spacecraft_key)
        .where(alignment.c.spacecraft_key == key)
        .order_by(alignment.c.alignment_id.desc())
    )
    aligned = connection.execute(newest.limit(1)).first()
    if aligned is None or not methods:
        return 0
    # an alignment counts as consumed when every row after it has its results, and so does each row from then on
    complete = aligned.consumed_number if aligned.consumed_number >= aligned.number else 0
    # what retention has taken away is not awaited
    epoch_us = max(aligned.epoch_us, kept_from_us(connection, key, "attitude") - 1)
    names = [method.value for method in methods]
    of_rows = _lacking_rows(connection, key, epoch_us, complete, names)
    return sum(map(len, chain(of_rows, _lacking_sealed(connection, cache, key, epoch_us, complete, names))))


def _lacking_rows(
    connection: Connection, key: int, epoch_us: int, complete: int, names: Sequence[str]
) -> Iterator[IntArray]:
    """Yield the numbers of rows of the table of rows that lack a result, some of a day at a time."""
    query = (
        select(measurement.c.epoch_us, measurement.c.number)
        .where(measurement.c.spacecraft_key == key, measurement.c.number > complete)
        # the sum keeps the planner on the index by number, where only what has come since is read
        .where(measurement.c.feeds, measurement.c.epoch_us + 0 > epoch_us)
    )
    for rows in connection.execute(query).partitions(_AT_ONCE):
        epochs_us, numbers = np.array([tuple(row) for row in rows], dtype=np.int64).T
        days = epochs_us // DAY_US
        for day in np.unique(days).tolist():
            its_us = epochs_us[days == day]
            window = Window(int(its_us.min()), int(its_us.max()) + 1)
            lacking = _lacking(connection, key, window, numbers[days == day], names)
            if len(lacking):
                yield lacking


def _lacking_sealed(
    connection: Connection, cache: SegmentCache, key: int, epoch_us: int, complete: int, names: Sequence[str]
) -> Iterator[IntArray]:
    """Yield the numbers of sealed rows that lack a result, segment by segment."""
    for found in heads_of_numbers(connection, key, complete, MAX_NUMBER):
        if found.last_epoch_us <= epoch_us or not found.feeding_count:
            continue
        chunk = read_chunk(connection, cache, found)
        numbers = chunk.numbers[chunk.feeds & (chunk.epochs_us > epoch_us) & (chunk.numbers > complete)]
        window = Window(found.first_epoch_us, found.last_epoch_us + 1)
        lacking = _lacking(connection, key, window, numbers, names)
        if len(lacking):
            yield lacking


def _lacking(connection: Connection, key: int, window: Window, numbers: IntArray, names: Sequence[str]) -> IntArray:
    """Return those numbers of measurements of a window that lack a result."""
    is_whole = np.ones(len(numbers), dtype=np.bool_)
    for name in names:
        held = stored_numbers(connection, RowSeries(key, attitude, LIVE, name), window)
        is_whole &= np.isin(numbers, held)
    return numbers[~is_whole]
