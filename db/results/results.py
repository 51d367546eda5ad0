"""Results: everything the service computed; implements ``service.ports.Results``.

Storing what the chain computed, in the transaction that moves the consumer's head.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from itertools import chain, count, repeat, zip_longest
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, Table, and_, bindparam, func, select, update

from db.columns import sound_rows
from db.connection.writer import insert_new
from db.database import ALL_ROWS, lock_head
from db.encoding.segments import RowSeries
from db.measurements.archive import store_inputs
from db.results.calibrations import SqlCalibrations
from db.results.jobs import SqlJobs, SqlReplays, check_held, checkpoints, note_rows, store_checkpoint
from db.results.result_samples import sampled_carriers, sampled_figures, seal_results, state_history
from db.results.stored_rows import (
    AttitudeReader,
    attitude_columns,
    attitude_of,
    attitudes_of,
    newest_computed,
    newest_row,
    next_sealed_sequence,
    numbers_where,
    pending_rows,
    sealed_of_sequences,
    sealed_positions,
    stored_rows,
    torque_columns,
    torque_of,
    torques_of,
    unpack_carriers,
    unsealed_positions,
)
from db.tables import attitude, head, torque
from service.core.rows import History, Summaries
from service.ports.archive import LIVE, SMOOTHED, Cursor, Intervals, ListPart, Outcome, SampledCarriers
from service.records.calibration import Alignment, Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.attitude import AttitudeRow, CarrierResults, IntArray, TorqueCommand
from service.records.storage import Checkpoint, SealedResults

#: columns of an impulse
_AXES = 3

Result = AttitudeRow | TorqueCommand
_ADVANCE = (
    update(head)
    .where(head.c.spacecraft_key == bindparam("key"))
    .values(
        consumed_number=bindparam("number"),
        consumed_epoch_us=bindparam("epoch_us"),
        result_sequence=bindparam("sequence"),
    )
)


def store_outcomes(
    connection: Connection,
    key: int,
    version: str,
    outcomes: Sequence[Outcome],
    consumed_number: int,
    consumed_epoch_us: int | None,
    checkpoint: Checkpoint | None,
) -> int:
    """Store outcomes and return the last result sequence; runs in the writer's transaction."""
    state = lock_head(connection, key)
    results = [each for outcome in outcomes for each in _results_of(outcome)]
    if version != LIVE:
        # rows that stand stay as they are, as `insert_new` says
        inserted = _insert(connection, key, version, _fresh(connection, key, version, results), None)
        note_rows(connection, key, version, *inserted, checkpoint)
        return int(state.result_sequence)
    fresh = results if _are_new(results, state.consumed_number) else _fresh(connection, key, version, results)
    _insert(connection, key, version, fresh, int(state.result_sequence) + 1)
    applied = [outcome.applied for outcome in outcomes if outcome.applied is not None]
    if applied:
        store_inputs(connection, key, applied)
    if checkpoint is not None:
        store_checkpoint(connection, key, LIVE, checkpoint)
    sequence = int(state.result_sequence) + len(fresh)
    # never back
    epochs_us = [epoch_us for epoch_us in (state.consumed_epoch_us, consumed_epoch_us) if epoch_us is not None]
    number, epoch_us = max(state.consumed_number, consumed_number), max(epochs_us, default=None)
    connection.execute(_ADVANCE, {"key": key, "number": number, "epoch_us": epoch_us, "sequence": sequence})
    return sequence


def _results_of(outcome: Outcome) -> Iterator[tuple[Result, CarrierResults | None]]:
    """Yield the results of a row, those of attitude with what is known of the carriers."""
    yield from zip_longest(outcome.rows, outcome.carriers)
    if outcome.command is not None:
        yield outcome.command, None


def _key_of(result: Result) -> tuple[str, Cursor]:
    return (result.method.value if isinstance(result, AttitudeRow) else ""), (result.epoch_us, result.number)


def _are_new(results: Sequence[tuple[Result, Any]], consumed_number: int) -> bool:
    """Return whether no result is stored yet: results go in together with the consumer's position, each once."""
    is_beyond = all(result.number > consumed_number for result, _ in results)
    return is_beyond and len({_key_of(result) for result, _ in results}) == len(results)


def _fresh(
    connection: Connection, key: int, version: str, results: Sequence[tuple[Result, CarrierResults | None]]
) -> list[tuple[Result, CarrierResults | None]]:
    """Return those results that are not stored yet, each once; of a row that was run again the first time counts."""
    positions: dict[str, set[Cursor]] = {}
    for result, _ in results:
        method, position = _key_of(result)
        positions.setdefault(method, set()).add(position)
    stored: dict[str, set[Cursor]] = {}
    for method, wanted in positions.items():
        of = RowSeries(key, attitude if method else torque, version, method)
        stored[method] = sealed_positions(connection, of, wanted)
        if version == LIVE:
            stored[method] |= unsealed_positions(connection, of, wanted)
    fresh: list[tuple[Result, CarrierResults | None]] = []
    for each in results:
        method, position = _key_of(each[0])
        if position not in stored[method]:
            stored[method].add(position)
            fresh.append(each)
    return fresh


def _insert(
    connection: Connection,
    key: int,
    version: str,
    results: Sequence[tuple[Result, CarrierResults | None]],
    sequence: int | None,
) -> tuple[int, int]:
    """Insert results, numbered from a sequence on; return how many rows of attitude and of torque were new."""
    sequences = repeat(None) if sequence is None else count(sequence)
    numbered = list(zip(results, sequences, strict=False))
    rows = [(result, number, carriers) for (result, carriers), number in numbered if isinstance(result, AttitudeRow)]
    commands = [(result, number) for (result, _), number in numbered if isinstance(result, TorqueCommand)]
    return (
        insert_new(connection, attitude, attitude_columns(key, version, *zip(*rows, strict=True))) if rows else 0,
        insert_new(connection, torque, torque_columns(key, version, *zip(*commands, strict=True))) if commands else 0,
    )


class SqlResults(SqlCalibrations, SqlJobs, SqlReplays):
    """Results in a relational database."""

    def save_outcomes(
        self,
        spacecraft_id: str,
        version: str,
        outcomes: Sequence[Outcome],
        consumed_number: int,
        consumed_epoch_us: int | None,
        checkpoint: Checkpoint | None = None,
    ) -> int:
        """Store outcomes in one transaction and return the last result sequence."""
        store = self._storing(spacecraft_id, version, outcomes, consumed_number, consumed_epoch_us, checkpoint)
        return self._database.write(store, self._database.key(spacecraft_id))

    def submit_outcomes(
        self,
        spacecraft_id: str,
        outcomes: Sequence[Outcome],
        consumed_number: int,
        consumed_epoch_us: int | None,
        checkpoint: Checkpoint | None = None,
    ) -> Future[int]:
        """Queue live outcomes; the future gives the last sequence after the commit."""
        store = self._storing(spacecraft_id, LIVE, outcomes, consumed_number, consumed_epoch_us, checkpoint)
        return self._database.submit(store, key=self._database.key(spacecraft_id))

    def _storing(self, spacecraft_id: str, version: str, *what: Any) -> Callable[[Connection], int]:
        """Return the write that stores outcomes, under the lease of the spacecraft but for replays."""
        key = self._database.key(spacecraft_id)

        def store(connection: Connection) -> int:
            return store_outcomes(connection, key, version, *what)

        return self._database.leases.under(store, spacecraft_id) if version in (LIVE, SMOOTHED) else store

    def checkpoints(
        self, spacecraft_id: str, fingerprint: str, until_number: int, before_us: int | None = None
    ) -> Iterator[Checkpoint]:
        """Yield the sound checkpoints of a fingerprint up to a journal number, before an epoch, newest first."""
        key = self._database.key(spacecraft_id)
        return checkpoints(self._database, key, LIVE, fingerprint, until_number, before_us)

    def attitude_rows(self, spacecraft_id: str, version: str, method: Method, part: ListPart) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number of the measurement) beyond a cursor.

        The live version has exactly one row a consumed measurement: ``db.results.stored_rows`` fills in rows that
        were not computed.
        """
        if version != LIVE:
            return attitudes_of(self._stored_rows(spacecraft_id, attitude, version, part, method.value))
        with self._read(spacecraft_id) as (connection, key):
            return AttitudeReader(connection, self._database.segments, key, method).rows(part)

    def carrier_results(
        self, spacecraft_id: str, version: str, method: Method, window: Window
    ) -> dict[tuple[int, int], CarrierResults]:
        """Return what a method made of the carriers at the rows of a window, by (epoch, number), where it is stored."""
        rows = self._stored_rows(spacecraft_id, attitude, version, ListPart(window, ALL_ROWS), method.value)
        return {(row.epoch_us, row.number): unpack_carriers(row.carriers) for row in rows if row.carriers is not None}

    def sampled_attitude(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals, figures: int = 3
    ) -> Iterator[Summaries]:
        """Yield the first figures of the computed rows of a window; every row is in one of the buckets."""
        of = RowSeries(self._database.key(spacecraft_id), attitude, version, method.value)
        return sampled_figures(self._database, of, window, intervals, figures)

    def sampled_carriers(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals
    ) -> Iterator[SampledCarriers]:
        """Yield deviations and residuals of a window; every row is in one of the buckets."""
        of = RowSeries(self._database.key(spacecraft_id), attitude, version, method.value)
        return sampled_carriers(self._database, of, window, intervals)

    def sampled_impulse(
        self, spacecraft_id: str, version: str, window: Window, intervals: Intervals
    ) -> Iterator[Summaries]:
        """Yield the impulse of the commands of a window; every command is in one of the buckets."""
        of = RowSeries(self._database.key(spacecraft_id), torque, version)
        return sampled_figures(self._database, of, window, intervals, _AXES)

    def state_history(self, spacecraft_id: str, method: Method, window: Window) -> History:
        """Return from when until when the live rows of a method had which states, and where rows are missing."""
        read = partial(self.attitude_rows, spacecraft_id, LIVE, method)
        return state_history(self._database, self._database.key(spacecraft_id), method.value, read, window)

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        with self._read(spacecraft_id) as (connection, key):
            if version == LIVE:
                computed = newest_computed(connection, key, method)
                return computed or AttitudeReader(connection, self._database.segments, key, method).newest()
            row = newest_row(connection, RowSeries(key, attitude, version, method.value))
        return None if row is None else attitude_of(row)

    def commands(self, spacecraft_id: str, version: str, part: ListPart) -> list[TorqueCommand]:
        """Return computed commands in order of (epoch, number) beyond a cursor."""
        return torques_of(self._stored_rows(spacecraft_id, torque, version, part))

    def _stored_rows(
        self, spacecraft_id: str, table: Table, version: str, part: ListPart, method: str = ""
    ) -> list[Any]:
        """Return rows as they are stored; NotFoundError ``replay.unknown`` where the version was deleted."""
        with self._read(spacecraft_id) as (connection, key):
            rows = stored_rows(connection, RowSeries(key, table, version, method), part)
            check_held(connection, key, version)
        return rows

    def newest_command(self, spacecraft_id: str, version: str) -> TorqueCommand | None:
        """Return the newest computed command."""
        with self._read(spacecraft_id) as (connection, key):
            row = newest_row(connection, RowSeries(key, torque, version))
        return None if row is None else torque_of(row)

    def results_after(
        self, spacecraft_id: str, sequence: int, limit: int
    ) -> list[tuple[int, AttitudeRow | TorqueCommand]]:
        """Return live results with a sequence above the given one, in order: what a resumed stream missed."""
        with self._read(spacecraft_id) as (connection, key):
            found = _results(connection, key, sequence, limit)
            if not found and (following := _next_sequence(connection, key, sequence)) is not None:
                # retention has taken away what followed
                found = _results(connection, key, following - 1, limit)
        return sorted(found, key=lambda result: result[0])

    def carriers_after(self, spacecraft_id: str, sequence: int, until: int) -> dict[int, CarrierResults]:
        """Return what is stored of the carriers with the live results of sequences in (sequence, until]."""
        column = attitude.c
        with self._read(spacecraft_id) as (connection, key):
            is_wanted = and_(column.spacecraft_key == key, column.sequence > sequence, column.sequence <= until)
            rows = connection.execute(select(column.sequence, column.carriers).where(is_wanted)).all()
            sealed = [row for row in sealed_of_sequences(connection, key, sequence, until) if hasattr(row, "carriers")]
        return {row.sequence: unpack_carriers(row.carriers) for row in (*rows, *sealed) if row.carriers is not None}

    def pending(self, spacecraft_id: str, methods: Sequence[Method]) -> int:
        """Return how many rows that feed the estimator, later than the alignment's epoch, lack a result of a method."""
        with self._read(spacecraft_id) as (connection, key):
            return pending_rows(connection, self._database.segments, key, methods)

    def rows_after(self, spacecraft_id: str, alignment: Alignment) -> tuple[int, int]:
        """Return how many of the earlier stored rows after its epoch an alignment computes, and how many stay."""
        number = self.alignment_number(spacecraft_id, alignment.id)
        methods = tuple(Method(name) for name in alignment.calibration_by_method)
        with self._read(spacecraft_id) as (connection, key):
            waiting = pending_rows(connection, self._database.segments, key, methods)
            numbers, alignments = _alignments_after(connection, key, alignment.epoch_us)
        is_own = alignments == alignment.id
        computed = np.unique(numbers[is_own & (numbers < number)])
        return waiting + len(computed), len(np.unique(numbers[~is_own]))

    def seal(self, spacecraft_id: str, before_us: int) -> Iterator[SealedResults]:
        """Seal the results of closed days, a transaction a step."""
        return seal_results(self._database, self._database.key(spacecraft_id), before_us)


def _alignments_after(connection: Connection, key: int, epoch_us: int) -> tuple[IntArray, IntArray]:
    """Return the numbers of the live rows later than an epoch that an alignment computed, and which one it was."""
    column = attitude.c
    is_later = (column.spacecraft_key == key, column.version == LIVE, column.epoch_us > epoch_us)
    rows = select(column.number, column.alignment_id).where(*is_later, column.alignment_id.is_not(None))
    found = [tuple(row) for row in connection.execute(rows)]
    for method in LIVE_METHODS:
        of = RowSeries(key, attitude, LIVE, method.value)
        for numbers, alignments in numbers_where(connection, of, "alignment_id", epoch_us):
            stated = zip(numbers.tolist(), alignments, strict=True)
            found += [(number, alignment) for number, alignment in stated if alignment is not None]
    both = np.array(found, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _numbered(row: Any) -> tuple[int, Result]:
    # of the columns of both tables only attitude has a method
    return int(row.sequence), attitude_of(row) if hasattr(row, "method") else torque_of(row)


def _results(connection: Connection, key: int, sequence: int, limit: int) -> list[tuple[int, Result]]:
    # sequences of the live version have no gap but that of retention, so the next results are a range in both tables
    def is_next(column: ColumnElement[int | None]) -> ColumnElement[bool]:
        return and_(column > sequence, column <= sequence + limit)

    rows = select(attitude).where(attitude.c.spacecraft_key == key, is_next(attitude.c.sequence))
    commands = select(torque).where(torque.c.spacecraft_key == key, is_next(torque.c.sequence))
    sealed = sealed_of_sequences(connection, key, sequence, sequence + limit)
    found = (sound_rows(attitude, connection.execute(rows)), sound_rows(torque, connection.execute(commands)))
    return [_numbered(row) for row in chain(*found, sealed)]


def _next_sequence(connection: Connection, key: int, sequence: int) -> int | None:
    found = [
        connection.scalar(
            select(func.min(table.c.sequence)).where(table.c.spacecraft_key == key, table.c.sequence > sequence)
        )
        for table in (attitude, torque)
    ]
    found.append(next_sealed_sequence(connection, key, sequence))
    return min((number for number in found if number is not None), default=None)
