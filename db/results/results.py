"""Results: everything the service computed; implements ``service.ports.Results``."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, and_, func, select

from db.database import Database
from db.encoding.measurement_runs import unpack_carriers
from db.encoding.row_mapping import attitude_of, torque_of
from db.results import attitude_summaries, carrier_summaries, result_sealing
from db.results.attitude_reader import AttitudeReader, newest_computed
from db.results.attitude_summaries import TORQUE
from db.results.calibrations import SqlCalibrations
from db.results.carrier_summaries import CarrierRow
from db.results.jobs import SqlJobs, checkpoints
from db.results.outcomes import Consumed, Result, store_outcomes
from db.results.pending import PendingCount
from db.results.replays import SqlReplays, check_held
from db.results.state_summaries import state_history
from db.results.stored_rows import (
    ResultSeries,
    newest_row,
    next_sealed_sequence,
    numbers_where,
    page_of_rows,
    sealed_of_sequences,
)
from db.schema.tables import attitude, torque
from service.core.rows import History, Summaries
from service.ports import LIVE, SMOOTHED, Intervals, Outcome, SampledCarriers
from service.records.calibration import Alignment, Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.attitude import AttitudeRow, CarrierResults, IntArray, TorqueCommand
from service.records.storage import Checkpoint, SealedResults


class SqlResults(SqlCalibrations, SqlJobs, SqlReplays):
    """Results in a relational database."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._pending = PendingCount()

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
        key = self._database.key(spacecraft_id)
        consumed = Consumed(consumed_number, consumed_epoch_us)

        def store(connection: Connection) -> int:
            return store_outcomes(connection, key, version, outcomes, consumed, checkpoint)

        led = self._database.leases.under(store, spacecraft_id) if version in (LIVE, SMOOTHED) else store
        return self._database.write(led, key)

    def checkpoints(
        self, spacecraft_id: str, fingerprint: str, until_number: int, before_us: int | None = None
    ) -> Iterator[Checkpoint]:
        """Yield the sound checkpoints of a fingerprint up to a journal number, before an epoch, newest first."""
        return checkpoints(self._database, self._database.key(spacecraft_id), fingerprint, until_number, before_us)

    def attitude_rows(
        self,
        spacecraft_id: str,
        version: str,
        method: Method,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number of the measurement) beyond a cursor.

        The live version has exactly one row a consumed measurement: ``db.results.attitude_reader`` fills in rows that
        were not computed.
        """
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            if version == LIVE:
                reader = AttitudeReader(connection, self._database.segments, key, method)
                return reader.rows(window, limit, after, newest_first=newest_first)
            of = ResultSeries(key, attitude, version, method.value)
            rows = page_of_rows(connection, of, window, limit, after, newest_first=newest_first)
            check_held(connection, key, version)
        return [attitude_of(row) for row in rows]

    def carrier_results(
        self, spacecraft_id: str, version: str, method: Method, window: Window
    ) -> dict[tuple[int, int], CarrierResults]:
        """Return what a method made of the carriers at the rows of a window, by (epoch, number), where it is stored."""
        rows = self._carrier_rows(spacecraft_id, version, method, window)
        return {(row.epoch_us, row.number): row.results for row in rows if row.results is not None}

    def _carrier_rows(
        self,
        spacecraft_id: str,
        version: str,
        method: Method,
        window: Window,
        limit: int | None = None,
        after: tuple[int, int] | None = None,
    ) -> list[CarrierRow]:
        """Return what a method made of the carriers at the stored rows beyond a cursor."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            of = ResultSeries(key, attitude, version, method.value)
            rows = carrier_summaries.carrier_rows(connection, of, window, limit, after)
            check_held(connection, key, version)
        return rows

    def sampled_attitude(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals, figures: int = 3
    ) -> Iterator[Summaries]:
        """Yield the first figures of the computed rows of a window; every row is in one of the buckets."""
        read = partial(self.attitude_rows, spacecraft_id, version, method)
        key, name = self._database.key(spacecraft_id), _summary_name(version, method.value)
        return attitude_summaries.sampled(self._database, key, name, read, window, intervals, figures)

    def sampled_carriers(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals
    ) -> Iterator[SampledCarriers]:
        """Yield deviations and residuals of a window; every row is in one of the buckets."""
        read = partial(self._carrier_rows, spacecraft_id, version, method)
        key, name = self._database.key(spacecraft_id), _summary_name(version, method.value)
        return carrier_summaries.sampled(self._database, key, name, read, window, intervals)

    def sampled_impulse(
        self, spacecraft_id: str, version: str, window: Window, intervals: Intervals
    ) -> Iterator[Summaries]:
        """Yield the impulse of the commands of a window; every command is in one of the buckets."""
        read = partial(self.commands, spacecraft_id, version)
        key, name = self._database.key(spacecraft_id), _summary_name(version, TORQUE)
        return attitude_summaries.sampled(self._database, key, name, read, window, intervals)

    def state_history(self, spacecraft_id: str, method: Method, window: Window) -> History:
        """Return from when until when the live rows of a method had which states, and where rows are missing."""
        read = partial(self.attitude_rows, spacecraft_id, LIVE, method)
        return state_history(self._database, self._database.key(spacecraft_id), method.value, read, window)

    def complete_summaries(self, spacecraft_id: str, before_us: int) -> Iterator[int]:
        """Summarise live attitude and commands of closed days, a transaction a day."""
        database, key = self._database, self._database.key(spacecraft_id)
        for method in LIVE_METHODS:
            read = partial(self.attitude_rows, spacecraft_id, LIVE, method)
            read_carriers = partial(self._carrier_rows, spacecraft_id, LIVE, method)
            yield from attitude_summaries.complete(database, key, method.value, read, before_us, read_carriers)
        commands = partial(self.commands, spacecraft_id, LIVE)
        yield from attitude_summaries.complete(database, key, TORQUE, commands, before_us)

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            if version == LIVE:
                computed = newest_computed(connection, key, method)
                return computed or AttitudeReader(connection, self._database.segments, key, method).newest()
            row = newest_row(connection, ResultSeries(key, attitude, version, method.value))
        return None if row is None else attitude_of(row)

    def commands(
        self,
        spacecraft_id: str,
        version: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[TorqueCommand]:
        """Return computed commands in order of (epoch, number) beyond a cursor."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            of = ResultSeries(key, torque, version)
            rows = page_of_rows(connection, of, window, limit, after, newest_first=newest_first)
            check_held(connection, key, version)
        return [torque_of(row) for row in rows]

    def newest_command(self, spacecraft_id: str, version: str) -> TorqueCommand | None:
        """Return the newest computed command."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            row = newest_row(connection, ResultSeries(key, torque, version))
        return None if row is None else torque_of(row)

    def results_after(
        self, spacecraft_id: str, sequence: int, limit: int
    ) -> list[tuple[int, AttitudeRow | TorqueCommand]]:
        """Return live results with a sequence above the given one, in order: what a resumed stream missed."""
        key = self._database.key(spacecraft_id)

        with self._database.read() as connection:
            found = _results(connection, key, sequence, limit)
            if not found and (following := _next_sequence(connection, key, sequence)) is not None:
                # retention has taken away what followed
                found = _results(connection, key, following - 1, limit)
        return sorted(found, key=lambda result: result[0])

    def carriers_after(self, spacecraft_id: str, sequence: int, until: int) -> dict[int, CarrierResults]:
        """Return what is stored of the carriers with the live results of sequences in (sequence, until]."""
        key, column = self._database.key(spacecraft_id), attitude.c
        is_wanted = and_(column.spacecraft_key == key, column.sequence > sequence, column.sequence <= until)
        with self._database.read() as connection:
            rows = connection.execute(select(column.sequence, column.carriers).where(is_wanted)).all()
            sealed = [row for row in sealed_of_sequences(connection, key, sequence, until) if hasattr(row, "carriers")]
        return {row.sequence: unpack_carriers(row.carriers) for row in (*rows, *sealed) if row.carriers is not None}

    def pending(self, spacecraft_id: str, methods: Sequence[Method]) -> int:
        """Return how many rows that feed the estimator, later than the alignment's epoch, lack a result of a method."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            return self._pending.count(connection, self._database.segments, key, methods)

    def mark_complete(self, spacecraft_id: str, methods: Sequence[Method]) -> None:
        """Store up to where every row has its results, for the first count of another process."""
        self.pending(spacecraft_id, methods)
        key = self._database.key(spacecraft_id)
        self._database.write(lambda connection: self._pending.store(connection, key))

    def rows_after(self, spacecraft_id: str, alignment: Alignment) -> tuple[int, int]:
        """Return how many of the earlier stored rows after its epoch an alignment computes, and how many stay."""
        key, number = self._database.key(spacecraft_id), self.alignment_number(spacecraft_id, alignment.id)
        methods = tuple(Method(name) for name in alignment.calibration_by_method)
        with self._database.read() as connection:
            waiting = self._pending.count(connection, self._database.segments, key, methods)
            numbers, alignments = _alignments_after(connection, key, alignment.epoch_us)
        is_own = alignments == alignment.id
        computed = np.unique(numbers[is_own & (numbers < number)])
        return waiting + len(computed), len(np.unique(numbers[~is_own]))

    def seal(self, spacecraft_id: str, before_us: int) -> Iterator[SealedResults]:
        """Seal the results of closed days, a transaction a step."""
        return result_sealing.seal(self._database, self._database.key(spacecraft_id), before_us)


def _alignments_after(connection: Connection, key: int, epoch_us: int) -> tuple[IntArray, IntArray]:
    """Return the numbers of the live rows later than an epoch that an alignment computed, and which one it was."""
    column = attitude.c
    is_later = (column.spacecraft_key == key, column.version == LIVE, column.epoch_us > epoch_us)
    rows = select(column.number, column.alignment_id).where(*is_later, column.alignment_id.is_not(None))
    found = [tuple(row) for row in connection.execute(rows)]
    for method in LIVE_METHODS:
        of = ResultSeries(key, attitude, LIVE, method.value)
        for numbers, alignments in numbers_where(connection, of, "alignment_id", epoch_us):
            stated = zip(numbers.tolist(), alignments, strict=True)
            found += [(number, alignment) for number, alignment in stated if alignment is not None]
    both = np.array(found, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _summary_name(version: str, name: str) -> str:
    # only live rows are summarised: under another name there is nothing
    return name if version == LIVE else ""


def _numbered(row: Any) -> tuple[int, Result]:
    # of the columns of both tables only attitude has a method
    return int(row.sequence), attitude_of(row) if hasattr(row, "method") else torque_of(row)


def _results(connection: Connection, key: int, sequence: int, limit: int) -> list[tuple[int, Result]]:
    """Return the live results with a sequence in (sequence, sequence + limit]."""

    # sequences of the live version have no gap but that of retention, so the next results are a range in both tables
    def is_next(column: ColumnElement[int | None]) -> ColumnElement[bool]:
        return and_(column > sequence, column <= sequence + limit)

    rows = select(attitude).where(attitude.c.spacecraft_key == key, is_next(attitude.c.sequence))
    commands = select(torque).where(torque.c.spacecraft_key == key, is_next(torque.c.sequence))
    sealed = sealed_of_sequences(connection, key, sequence, sequence + limit)
    return [_numbered(row) for row in chain(connection.execute(rows), connection.execute(commands), sealed)]


def _next_sequence(connection: Connection, key: int, sequence: int) -> int | None:
    """Return the smallest sequence above the given one."""
    found = [
        connection.scalar(
            select(func.min(table.c.sequence)).where(table.c.spacecraft_key == key, table.c.sequence > sequence)
        )
        for table in (attitude, torque)
    ]
    found.append(next_sealed_sequence(connection, key, sequence))
    return min((number for number in found if number is not None), default=None)
