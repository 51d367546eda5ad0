"""The database as the repositories see it: read transactions, queued writes, keys of spacecraft, journal numbers.

Sealed days lie in order of epochs, and so does what reads them. A page from the end asks where it begins, which costs
no row, and reads from there on; so it costs about what a page from the start does.

The journal of a spacecraft is gap-free and in the order of commits, because a number is taken by updating the row
``head`` of the spacecraft in the transaction that uses it: the row stays locked until that transaction ends.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, Table, and_, bindparam, func, or_, select, true, update

from db.connection.engines import open_engines, sqlite_path, translated_faults
from db.connection.lease import FileLeases, SqlLeases
from db.connection.writer import Writer, insert_new
from db.encoding.record_codec import encode, kind_of
from db.encoding.segments import SegmentCache
from db.tables import audit_entry, audit_head, head, journal, spacecraft
from service.errors import NotFoundError
from service.ports.archive import Cursor, ListPart
from service.records.calibration import Window
from service.records.inputs import SlowInput
from service.records.levels.attitude import IntArray
from service.records.operations.access import (
    CURRENT_NOTE,
    GENESIS,
    AuditEntry,
    AuditEvent,
    AuditHead,
    naming_result,
    next_entry,
)

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")
PagedRow = TypeVar("PagedRow")
#: above every limit
ALL_ROWS = 1 << 62
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
        # the driver, as in `open_engines`
        from db.connection.server_leases import ServerLeases

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
        event = note.due

        def accompanied(connection: Connection) -> tuple[Result, AuditEntry]:
            result = work(connection)
            return result, append_entry(connection, naming_result(event, result))

        result, note.entry = self.submit(accompanied).result()
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

    @contextmanager
    def _read(self, spacecraft_id: str) -> Iterator[tuple[Connection, int]]:
        """Open a read transaction about a spacecraft, whose key comes with it."""
        key = self._database.key(spacecraft_id)
        with self._database.read() as connection:
            yield connection, key

    def _change(
        self,
        spacecraft_id: str,
        work: Callable[Concatenate[Connection, int, Arguments], Result],
        *arguments: Arguments.args,
        **options: Arguments.kwargs,
    ) -> Result:
        """Do a write of a spacecraft, by its key, while no other writer may change it, and wait for the commit."""
        key = self._database.key(spacecraft_id)

        def write(connection: Connection) -> Result:
            lock_head(connection, key)
            return work(connection, key, *arguments, **options)

        return self._database.write(write)


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
    position: ColumnElement[int], number: ColumnElement[int], after: Cursor | None, *, newest_first: bool = False
) -> ColumnElement[bool]:
    """Return the condition that (place, number) lies behind a cursor, or before it where the newest come first."""
    if after is None:
        return true()
    # the first part alone bounds the range of the index
    if newest_first:
        return and_(position <= after[0], or_(position < after[0], number < after[1]))
    return and_(position >= after[0], or_(position > after[0], number > after[1]))


def page_of(
    query: Select[Any], position: ColumnElement[int], number: ColumnElement[int], part: ListPart
) -> Select[Any]:
    """Return the query for a part of a list by (place, number)."""
    order = (position.desc(), number.desc()) if part.newest_first else (position, number)
    is_next = beyond(position, number, part.after, newest_first=part.newest_first)
    return query.where(within(position, part.window), is_next).order_by(*order).limit(part.limit)


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
        {
            "spacecraft_key": key,
            "number": number,
            "kind": kind_of(record),
            "key": record.key,
            "start_us": (span or here).start_us,
            "stop_us": (span or here).stop_us,
            "document": encode(record),
        }
        for number, (record, span) in enumerate(entries, start=newest_number - len(entries) + 1)
    ]
    if rows:
        connection.execute(journal.insert(), rows)
    return int(newest_number)


def newest_rows(
    read: Callable[[ListPart], Sequence[PagedRow]], start_of: Callable[[Window, int], int], part: ListPart
) -> list[PagedRow]:
    """Return the last rows of a window below a cursor, that with the greatest (epoch, number) first.

    Parameters
    ----------
    read : callable
        Reader in order of (epoch, number).
    start_of : callable
        Gives an epoch from which on a window has so many rows at least; its start where it has fewer.
    part : ListPart
        Rows that are asked for.
    """
    before, window, count = part.after, part.window, part.limit
    if before is not None:
        window = Window(window.start_us, min(window.stop_us, before[0] + 1))
    while True:
        start_us = start_of(window, count)
        # a list: a page is cut from its end
        rows = [
            row
            for row in read(ListPart(Window(start_us, window.stop_us), ALL_ROWS))
            if before is None or position_of(row) < before
        ]
        if len(rows) >= part.limit or start_us <= window.start_us:
            return rows[::-1][: part.limit]
        # rows at the cursor's epoch were counted, which the page before had
        count *= 2


def position_of(row: Any) -> Cursor:
    """Return the place of a row in the order of its series."""
    return row.epoch_us, row.number


def start_of_last(found: Iterable[IntArray], count: int, default_us: int) -> int:
    """Return the epoch from which on ``count`` of some epochs stand, ``default_us`` where there are fewer.

    Parameters
    ----------
    found : iterable of (T,) arrays
        Epochs, the latest segment first; read until they are enough.
    count : int
        How many.
    default_us : int
        Least answer.
    """
    held = np.empty(0, dtype=np.int64)
    for epochs_us in found:
        held = np.concatenate([held, epochs_us[-count:]])
        if len(held) >= count:
            return max(default_us, int(np.partition(held, -count)[-count]))
    return default_us


def append_entry(connection: Connection, event: AuditEvent) -> AuditEntry:
    """Add a deed to the chain in the transaction of a connection."""
    entry = next_entry(lock_audit_head(connection), event)
    values = {"number": entry.number, **asdict(event), "previous_hash": entry.previous_hash, "hash": entry.hash}
    connection.execute(audit_entry.insert().values(values))
    connection.execute(update(audit_head).values(number=entry.number, hash=entry.hash))
    return entry


def lock_audit_head(connection: Connection) -> AuditHead:
    """Return the head and keep every other writer of entries away until the transaction ends."""
    query = select(audit_head).with_for_update()
    row = connection.execute(query).first()
    if row is None:
        insert_new(connection, audit_head, {"head_key": (1,), "number": (0,), "hash": (GENESIS,)})
        row = connection.execute(query).one()
    return AuditHead(row.number, row.hash)
