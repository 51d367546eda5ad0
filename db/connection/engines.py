"""Engines: one for the single writer, one for readers, with the same durability on both databases.

SQLite runs in WAL mode with ``synchronous=FULL``, so a commit that returned survives a kill and a power loss.
Transactions are opened and closed by explicit statements, because the driver's own control would break SAVEPOINT and
would let a transaction that the database has already given up pass for committed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError

from db.connection.file_identity import FileWatch
from db.connection.sqlite_files import make_private
from service.errors import StorageError

#: wait for a lock where no other is wanted, s
BUSY_TIMEOUT_S = 10.0
READERS = 8


@dataclass(frozen=True, slots=True)
class Engines:
    """The two ways into one database."""

    write: Engine
    read: Engine

    def dispose(self) -> None:
        """Close all connections."""
        self.read.dispose()
        self.write.dispose()


def open_engines(url: str, limit_s: float | None = None) -> Engines:
    """Return engines for a database URL; nothing is connected yet.

    Parameters
    ----------
    url : str
        SQLAlchemy URL.
    limit_s : float, optional
        Longest wait for a lock, and for an answer of a server; without it a lock is waited for for 10 s and a server
        for as long as it takes.

    Raises
    ------
    ValueError
        The URL cannot be read, or names an in-memory SQLite database, which no second connection can see, or another
        database than SQLite and PostgreSQL.
    """
    try:
        target = make_url(url)
    except ArgumentError as fault:
        message = "the database's URL cannot be read; write sqlite:///file or postgresql+psycopg://user@host/name"
        raise ValueError(message) from fault
    if target.get_backend_name() == "sqlite":
        return _sqlite_engines(target, BUSY_TIMEOUT_S if limit_s is None else limit_s)
    if target.get_backend_name() == "postgresql":
        # the driver costs time and memory that a file does not need
        from db.connection.postgresql_engines import postgresql_engines

        return Engines(*postgresql_engines(target, READERS, limit_s))
    message = f"database {target.get_backend_name()!r} is not supported: use sqlite:///file or postgresql+psycopg://..."
    raise ValueError(message)


@contextmanager
def translated_faults() -> Iterator[None]:
    """Turn whatever the database says into a StorageError."""
    try:
        yield
    except SQLAlchemyError as fault:
        raise storage_error(fault) from fault


def storage_error(fault: SQLAlchemyError) -> StorageError:
    """Return the error that a caller sees for a fault of the database."""
    said = str(fault.orig) if isinstance(fault, DBAPIError) else str(fault)
    detail = f"The database did not carry out the request: {said.strip()}. Nothing was acknowledged."
    return StorageError("storage.unavailable", detail)


def _sqlite_engines(target: URL, busy_s: float) -> Engines:
    if target.database in (None, "", ":memory:"):
        message = "an in-memory database keeps nothing: name a file, sqlite:///path/to/file.db"
        raise ValueError(message)
    write = create_engine(target, pool_size=1, max_overflow=0)
    read = create_engine(target, pool_size=READERS, max_overflow=READERS)
    for engine in (write, read):
        event.listen(engine, "connect", partial(_prepare, busy_s))
    event.listen(read, "connect", _forbid_writing)
    watch = FileWatch(Path(target.database or ""))
    event.listen(write, "connect", lambda *_: watch.note())
    event.listen(read, "connect", lambda *_: watch.note())
    event.listen(write, "begin", _begin_immediate)
    event.listen(read, "begin", _begin)
    for engine in (write, read):
        event.listen(engine, "commit", _commit)
        _guard(engine, watch)
    event.listen(write, "commit", lambda _: watch.confirm())
    return Engines(write, read)


def _guard(engine: Engine, watch: FileWatch) -> None:
    """Let no transaction of an engine begin or end on a file that is no longer there."""
    # connecting to a name without a file would make an empty one
    event.listen(engine, "do_connect", lambda *_: watch.check())
    event.listen(engine, "do_connect", lambda *_: make_private(watch.path))
    event.listen(engine, "begin", lambda _: watch.check(), insert=True)
    event.listen(engine, "commit", lambda _: watch.check())


def _prepare(busy_s: float, connection: Any, _record: object) -> None:
    connection.isolation_level = None
    connection.execute(f"PRAGMA busy_timeout={round(1000 * busy_s)}")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")


def _forbid_writing(connection: Any, _record: object) -> None:
    connection.execute("PRAGMA query_only=ON")


def _begin(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN")


def _begin_immediate(connection: Connection) -> None:
    # the write lock comes first: a reader that turns writer could only fail, never wait
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _commit(connection: Connection) -> None:
    # the driver's commit() succeeds silently when the database has rolled back by itself (disk full); COMMIT fails
    try:
        connection.exec_driver_sql("COMMIT")
    except DBAPIError:
        # a refused COMMIT leaves the transaction open, where it would stop every later one
        connection.connection.rollback()
        raise
