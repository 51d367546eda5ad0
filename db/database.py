"""The database as the repositories see it: read transactions, queued writes, keys of spacecraft, journal numbers.

The journal of a spacecraft is gap-free and in the order of commits, because a number is taken by updating the row
``head`` of the spacecraft in the transaction that uses it: the row stays locked until that transaction ends.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import ColumnElement, Connection, Row, Select, Table, and_, bindparam, func, or_, select, true, update

from db.audit_chain import accompanied
from db.connection.engines import open_engines, sqlite_path, translated_faults
from db.connection.lease import FileLeases, SqlLeases
from db.connection.writer import Writer
from db.encoding.record_codec import encode, kind_of
from db.encoding.segments import SegmentCache
from db.schema.tables import head, journal, spacecraft
from service.errors import NotFoundError
from service.records.calibration import Window
from service.records.inputs import SlowInput
from service.records.operations.access import CURRENT_NOTE

Result = TypeVar("Result")
_LOCKED_HEAD = select(head).where(head.c.spacecraft_key == bindparam("key")).with_for_update()


class EpochSpan(NamedTuple):
    """Interval that a slow input holds for; ``stop_us`` None = open end."""

    start_us: int
    stop_us: int | None


class Database:
    """Engines and writer of one archive, shared by all repositories.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of a SQLite file or of a PostgreSQL database.
    limit_s : float
        Longest wait for a lock or for an answer of a server.
    """

    def __init__(self, url: str, limit_s: float) -> None:
        self.engines = open_engines(url, limit_s)
        self._keys: dict[str, int] = {}
        self._writer = Writer(self.engines.write, self._announce)
        #: which spacecraft this process may write results of
        self.leases = self._opened_leases(url, limit_s)
        #: sealed days read lately
        self.segments = SegmentCache()

    def _opened_leases(self, url: str, limit_s: float) -> SqlLeases:
        """Return the leases of the archive; nothing is connected yet."""
        path = sqlite_path(url)
        if path is not None:
            return FileLeases(path, self._writer)
        # the driver costs time and memory that a file does not need
        from db.connection.lease import ServerLeases

        return ServerLeases(url, limit_s, self.read)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a read transaction: one consistent state of the database."""
        with translated_faults(), self.engines.read.connect() as connection:
            yield connection

    def submit(
        self,
        work: Callable[[Connection], Result],
        reported: Callable[[Result], None] | None = None,
        key: int | None = None,
    ) -> Future[Result]:
        """Queue a write; after its commit the result is reported, in the order of commits, and the future resolves."""
        return self._writer.submit(work, reported, key)

    def write(self, work: Callable[[Connection], Result], key: int | None = None) -> Result:
        """Do a write and wait for its commit; a request's first write takes the request's audit entry along.

        A write of one spacecraft alone, under the lock of its head, names it by its key.
        """
        note = CURRENT_NOTE.get()
        if note is None or note.due is None:
            return self.submit(work, key=key).result()
        result, note.entry = self.submit(accompanied(work, note.due)).result()
        return result

    @property
    def queued_writes(self) -> int:
        """How many writes wait for the writer."""
        return self._writer.waiting

    def close(self) -> None:
        """Commit what is queued and let go of the database."""
        self.leases.give_back()
        self._writer.close()
        self.engines.dispose()

    def key(self, spacecraft_id: str) -> int:
        """Return the key of a spacecraft; NotFoundError ``spacecraft.unknown``."""
        key = self._keys.get(spacecraft_id)
        if key is None:
            # only committed keys are remembered: a key is never given again, and without its head nothing is stored
            with self.read() as connection:
                key = connection.scalar(
                    select(spacecraft.c.spacecraft_key).join(head).where(spacecraft.c.id == spacecraft_id)
                )
            if key is None:
                raise NotFoundError("spacecraft.unknown", f"There is no spacecraft {spacecraft_id!r}.")
            self._keys[spacecraft_id] = key
        return key

    def name(self, key: int) -> str:
        """Return the id of a spacecraft whose key was asked for."""
        return next(name for name, known in tuple(self._keys.items()) if known == key)

    def _announce(self, keys: frozenset[int]) -> None:
        """Announce committed changes to other processes."""
        self.leases.announce(sorted(name for name, key in tuple(self._keys.items()) if key in keys))

    def forget(self, spacecraft_id: str) -> None:
        """Forget the key of a spacecraft that was deleted."""
        self._keys.pop(spacecraft_id, None)

    def fetch(self, statement: Select[Any]) -> Sequence[Row[Any]]:
        """Return all rows of a query in a transaction of its own."""
        with self.read() as connection:
            return connection.execute(statement).all()

    def fetch_one(self, statement: Select[Any]) -> Row[Any] | None:
        """Return the first row of a query, if any, in a transaction of its own."""
        with self.read() as connection:
            return connection.execute(statement).first()


class Repository:
    """Part of the archive in a relational database.

    Parameters
    ----------
    database : Database
        Where its rows are kept.
    """

    def __init__(self, database: Database) -> None:
        self._database = database


def lock_head(connection: Connection, key: int) -> Row[Any]:
    """Return the head of a spacecraft and keep every other writer of it away until the transaction ends."""
    row = connection.execute(_LOCKED_HEAD, {"key": key}).one_or_none()
    if row is None:
        raise NotFoundError("spacecraft.unknown", "The spacecraft was deleted.")
    return row


def next_id(connection: Connection, table: Table, column: str, key: int) -> int:
    """Return the next id of a spacecraft's table; the caller holds the head, and rows are never removed."""
    newest = connection.scalar(select(func.max(table.c[column])).where(table.c.spacecraft_key == key))
    return 1 + (newest or 0)


def beyond(
    position: ColumnElement[int],
    number: ColumnElement[int],
    after: tuple[int, int] | None,
    *,
    newest_first: bool = False,
) -> ColumnElement[bool]:
    """Return the condition that (place, number) lies behind a cursor, or before it where the newest come first."""
    if after is None:
        return true()
    # the first part alone bounds the range of the index
    if newest_first:
        return and_(position <= after[0], or_(position < after[0], number < after[1]))
    return and_(position >= after[0], or_(position > after[0], number > after[1]))


def page_of(
    query: Select[Any],
    position: ColumnElement[int],
    number: ColumnElement[int],
    limit: int,
    after: tuple[int, int] | None,
    *,
    newest_first: bool = False,
) -> Select[Any]:
    """Return the query for a page of rows beyond a cursor, in order of (place, number) or in the reverse order."""
    order = (position.desc(), number.desc()) if newest_first else (position, number)
    is_next = beyond(position, number, after, newest_first=newest_first)
    return query.where(is_next).order_by(*order).limit(limit)


def within(epoch_us: ColumnElement[int], window: Window) -> ColumnElement[bool]:
    """Return the condition that an epoch lies in a window."""
    return and_(epoch_us >= window.start_us, epoch_us < window.stop_us)


def count_entries(connection: Connection, key: int, kind: str) -> int:
    """Return how many entries of a kind the journal of a spacecraft holds."""
    query = select(func.count()).where(journal.c.spacecraft_key == key, journal.c.kind == kind)
    return connection.scalar(query) or 0


def add_entries(connection: Connection, key: int, entries: Sequence[tuple[SlowInput, EpochSpan | None]]) -> int:
    """Journal slow inputs under the next numbers and return the number of the last.

    An input without a span of its own stands at the newest epoch of the spacecraft's measurements.
    """
    moved = (
        update(head)
        .where(head.c.spacecraft_key == key)
        .values(newest_number=head.c.newest_number + len(entries))
        .returning(head.c.newest_number, head.c.newest_epoch_us)
    )
    newest_number, newest_epoch_us = connection.execute(moved).one()
    here = EpochSpan(newest_epoch_us or 0, newest_epoch_us or 0)
    rows = [
        _journal_row(key, newest_number - len(entries) + position, record, span or here)
        for position, (record, span) in enumerate(entries, start=1)
    ]
    if rows:
        connection.execute(journal.insert(), rows)
    return int(newest_number)


def _journal_row(key: int, number: int, record: SlowInput, span: EpochSpan) -> dict[str, Any]:
    return {
        "spacecraft_key": key,
        "number": number,
        "kind": kind_of(record),
        "key": record.key,
        "start_us": span.start_us,
        "stop_us": span.stop_us,
        "document": encode(record),
    }
