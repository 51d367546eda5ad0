"""Results: everything the service computed; implements ``service.ports.Results``."""

from collections.abc import Iterator, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, and_, func, not_, select

from db.database import Database, beyond, within
from db.encoding.row_mapping import attitude_of, torque_of
from db.results.attitude_reader import AttitudeReader, newest_computed
from db.results.calibrations import SqlCalibrations
from db.results.checkpoints import checkpoints
from db.results.jobs import SqlJobs
from db.results.outcomes import Consumed, Result, store_outcomes
from db.results.pending import PendingCount
from db.schema.tables import attitude, torque
from service.ports import LIVE, Outcome
from service.records.calibration import Alignment, Window
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.storage.checkpoint import Checkpoint


class SqlResults(SqlCalibrations, SqlJobs):
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

        return self._database.write(self._database.lease.under(store) if version == LIVE else store)

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
    ) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number of the measurement) beyond a cursor.

        The live version has exactly one row a consumed measurement: ``db.results.attitude_reader`` fills in rows that
        were not computed.
        """
        key = self._database.key(spacecraft_id)
        if version == LIVE:
            with self._database.read() as connection:
                return AttitudeReader(connection, self._database.segments, key, method).rows(window, limit, after)
        query = _of_version(key, version, method).where(within(attitude.c.epoch_us, window))
        query = query.where(beyond(attitude.c.epoch_us, attitude.c.number, after))
        ordered = query.order_by(attitude.c.epoch_us, attitude.c.number).limit(limit)
        return [attitude_of(row) for row in self._database.fetch(ordered)]

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        key = self._database.key(spacecraft_id)
        if version == LIVE:
            with self._database.read() as connection:
                computed = newest_computed(connection, key, method)
                return computed or AttitudeReader(connection, self._database.segments, key, method).newest()
        query = _of_version(key, version, method).order_by(attitude.c.epoch_us.desc(), attitude.c.number.desc())
        row = self._database.fetch_one(query.limit(1))
        return None if row is None else attitude_of(row)

    def commands(
        self, spacecraft_id: str, version: str, window: Window, limit: int, after: tuple[int, int] | None
    ) -> list[TorqueCommand]:
        """Return computed commands in order of (epoch, number) beyond a cursor."""
        query = (
            self._commands(spacecraft_id, version)
            .where(within(torque.c.epoch_us, window), beyond(torque.c.epoch_us, torque.c.number, after))
            .order_by(torque.c.epoch_us, torque.c.number)
            .limit(limit)
        )
        return [torque_of(row) for row in self._database.fetch(query)]

    def newest_command(self, spacecraft_id: str, version: str) -> TorqueCommand | None:
        """Return the newest computed command."""
        query = self._commands(spacecraft_id, version).order_by(torque.c.epoch_us.desc(), torque.c.number.desc())
        row = self._database.fetch_one(query.limit(1))
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

    def pending(self, spacecraft_id: str, methods: Sequence[Method]) -> int:
        """Return how many rows that feed the estimator, later than the alignment's epoch, lack a result of a method."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            return self._pending.count(connection, self._database.segments, key, methods)

    def rows_after(self, spacecraft_id: str, alignment: Alignment) -> tuple[int, int]:
        """Return how many of the earlier stored rows after its epoch an alignment computes, and how many stay."""
        key, number = self._database.key(spacecraft_id), self.alignment_number(spacecraft_id, alignment.id)
        methods = tuple(Method(name) for name in alignment.calibration_by_method)
        live = (attitude.c.spacecraft_key == key, attitude.c.version == LIVE)
        rows = select(attitude.c.epoch_us, attitude.c.number).where(*live, attitude.c.epoch_us > alignment.epoch_us)

        def count(connection: Connection, *conditions: ColumnElement[bool]) -> int:
            found = rows.where(*conditions).distinct().subquery()
            return connection.scalar(select(func.count()).select_from(found)) or 0

        is_own = attitude.c.alignment_id == alignment.id
        with self._database.read() as connection:
            waiting = self._pending.count(connection, self._database.segments, key, methods)
            return waiting + count(connection, is_own, attitude.c.number < number), count(connection, not_(is_own))

    def _commands(self, spacecraft_id: str, version: str) -> Select[Any]:
        key = self._database.key(spacecraft_id)
        return select(torque).where(torque.c.spacecraft_key == key, torque.c.version == version)


def _of_version(key: int, version: str, method: Method) -> Select[Any]:
    return select(attitude).where(
        attitude.c.spacecraft_key == key, attitude.c.version == version, attitude.c.method == method.value
    )


def _numbered(row: Row[Any], result: Result) -> tuple[int, Result]:
    return int(row.sequence), result


def _results(connection: Connection, key: int, sequence: int, limit: int) -> list[tuple[int, Result]]:
    """Return the live results with a sequence in (sequence, sequence + limit]."""

    # sequences of the live version have no gap but that of retention, so the next results are a range in both tables
    def is_next(column: ColumnElement[int | None]) -> ColumnElement[bool]:
        return and_(column > sequence, column <= sequence + limit)

    rows = select(attitude).where(attitude.c.spacecraft_key == key, is_next(attitude.c.sequence))
    commands = select(torque).where(torque.c.spacecraft_key == key, is_next(torque.c.sequence))
    found = [_numbered(row, attitude_of(row)) for row in connection.execute(rows)]
    return found + [_numbered(row, torque_of(row)) for row in connection.execute(commands)]


def _next_sequence(connection: Connection, key: int, sequence: int) -> int | None:
    """Return the smallest sequence above the given one."""
    found = [
        connection.scalar(
            select(func.min(table.c.sequence)).where(table.c.spacecraft_key == key, table.c.sequence > sequence)
        )
        for table in (attitude, torque)
    ]
    return min((number for number in found if number is not None), default=None)
