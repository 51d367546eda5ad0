"""Engines of SQLite and PostgreSQL, and the identity of an archive in a file."""

import contextlib
import errno
import hashlib
import math
import os
import shutil
import sqlite3
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from psycopg import Connection as PsycopgConnection
from psycopg import OperationalError
from psycopg.errors import ConnectionTimeout
from sqlalchemy import Connection, Engine, NullPool, create_engine, event, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError

from db.tables import LAYOUT, layout_of
from service.errors import StorageError

#: the server speaks first: an answer that says why is better than a closed connection, s
_GRACE_S = 1.0
#: least time that the driver waits for a connection, s
_LEAST_CONNECT_S = 2
#: any number, the same in every process
_WRITERS_LOCK = 5_210_120
_WAIT_FOR_LOCK = text("SELECT pg_advisory_xact_lock(:lock)").bindparams(lock=_WRITERS_LOCK)
_SHARE_LOCK = text("SELECT pg_advisory_xact_lock_shared(:lock)").bindparams(lock=_WRITERS_LOCK)
_LOCK_HEADS = text(
    "SELECT spacecraft_key FROM head WHERE spacecraft_key = ANY(:keys) ORDER BY spacecraft_key FOR UPDATE"
)
#: a client that was stopped keeps the locks of its transaction for so long at most: less than a lease, s
_LONGEST_IDLE_S = 10.0
_WRITER = "soo writer"
#: amid a series of statements a transaction is neither idle nor at work for the server, whose limits spare it; what it
#: says of such a session is the state before the last part of the series that came
_END_STOPPED = text(
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = :writer AND state <> 'idle' "
    "AND datname = current_database() AND wait_event_type = 'Client' "
    "AND state_change < clock_timestamp() - make_interval(secs => :idle_s)"
)

_Ready = Any
_Answer = TypeVar("_Answer")


class NoAnswerError(OperationalError):
    """The server did not answer in time."""

    #: looked for by ``db.connection.writer``, which knows no driver
    is_wait_ended = True


class BoundedConnection(PsycopgConnection[Any]):
    """A connection that gives up when the server does not answer in time.

    Attributes
    ----------
    limit_s : float
        Longest wait for an answer, s; infinite until it is set.
    """

    limit_s = math.inf

    def wait(self, gen: Generator[_Ready, _Ready, _Answer], *args: Any, **options: Any) -> _Answer:
        """Return the result of an exchange with the server; OperationalError when it takes too long."""
        try:
            answer: _Answer = super().wait(_bounded(gen, self.limit_s), *args, **options)
        except NoAnswerError:
            # what the connection would say next belongs to the statement that was given up
            self.pgconn.finish()
            raise
        return answer


def postgresql_engines(target: URL, readers: int, limit_s: float | None) -> tuple[Engine, Engine]:
    """Return the engine of the writer and that of readers.

    Parameters
    ----------
    target : URL
        The database.
    readers : int
        Connections kept for reading; as many more are made when they are wanted.
    limit_s : float or None
        Longest wait for an answer; None = as long as it takes, for work that nobody waits for.
    """
    write = create_engine(target, pool_size=1, max_overflow=1, pool_pre_ping=True)
    read = create_engine(target, pool_size=readers, max_overflow=readers, pool_pre_ping=True).execution_options(
        isolation_level="REPEATABLE READ", postgresql_readonly=True
    )
    event.listen(write, "begin", _wait_for_turn)
    if limit_s is not None:
        idle_ms = round(1000 * _longest_idle_s(limit_s))
        _bound(write, limit_s, _WRITER, f" -c idle_in_transaction_session_timeout={idle_ms}")
        _bound(read, limit_s, "soo reader")
    return write, read


def end_stopped_writers(session: Connection, limit_s: float) -> int:
    """End the sessions of writers that were stopped between the statements of a series; return how many."""
    ended = session.execute(_END_STOPPED, {"writer": _WRITER, "idle_s": _longest_idle_s(limit_s)})
    return len(ended.all())


def session_engine(target: URL, limit_s: float) -> Engine:
    """Return an engine each of whose connections is a session of its own, outside any transaction."""
    engine = create_engine(target, poolclass=NullPool, isolation_level="AUTOCOMMIT")
    _bound(engine, limit_s, "soo session")
    return engine


def _longest_idle_s(limit_s: float) -> float:
    return min(limit_s, _LONGEST_IDLE_S)


def _wait_for_turn(connection: Connection) -> None:
    """Let one transaction write a spacecraft at a time, and one alone where it does not say which it writes."""
    keys = connection.get_execution_options().get("written_keys")
    if keys:
        connection.execute(_SHARE_LOCK)
        connection.execute(_LOCK_HEADS, {"keys": sorted(keys)})
    else:
        connection.execute(_WAIT_FOR_LOCK)


def _bound(engine: Engine, limit_s: float, name: str, more: str = "") -> None:
    """Give every connection of an engine its limits, and the name that the server lists it by."""
    limits = " ".join(f"-c {name}={round(1000 * limit_s)}" for name in ("statement_timeout", "lock_timeout")) + more

    def connect(_dialect: Any, _record: Any, arguments: list[Any], options: dict[str, Any]) -> BoundedConnection:
        options["options"] = f"{options.get('options', '')} {limits}".strip()
        options["application_name"] = name
        options.setdefault("connect_timeout", max(_LEAST_CONNECT_S, math.ceil(limit_s / 2)))
        try:
            connection = BoundedConnection.connect(*arguments, **options)
        except ConnectionTimeout as fault:
            message = f"the server has made no connection within {options['connect_timeout']} s"
            raise NoAnswerError(message) from fault
        connection.limit_s = limit_s + _GRACE_S
        return connection

    event.listen(engine, "do_connect", connect)


def _bounded(gen: Generator[_Ready, _Ready, _Answer], limit_s: float) -> Generator[_Ready, _Ready, _Answer]:
    """Pass an exchange on until it ends or has taken too long; the driver looks in several times a second."""
    until_s = time.monotonic() + limit_s
    try:
        wanted = next(gen)
        while True:
            ready = yield wanted
            if time.monotonic() > until_s:
                message = f"the server has not answered for {limit_s:g} s"
                raise NoAnswerError(message)
            wanted = gen.send(ready)
    except StopIteration as end:
        answer: _Answer = end.value
        return answer


_CHUNK = 4 << 20
#: files that SQLite keeps beside the one with the name
COMPANIONS = ("-wal", "-shm", "-journal")

#: told the share that is done, 0 to 1
Progress = Callable[[float], None]


def sqlite_path(url: str) -> Path | None:
    """Return the file of a SQLite URL, None for another database."""
    target = make_url(url)
    return Path(target.database or "") if target.get_backend_name() == "sqlite" else None


def absolute_url(url: str) -> str:
    """Return a URL that names the same SQLite file in every working directory; URLs of servers as they are."""
    target, path = make_url(url), sqlite_path(url)
    return url if path is None else target.set(database=str(path.resolve())).render_as_string(hide_password=False)


def make_private(path: Path) -> None:
    """Make a file that only its owner can read unless there is one; SQLite gives its companions the same rights."""
    # never one that is there: closing it would drop the locks that SQLite holds on it in this process
    with contextlib.suppress(OSError):
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))


def reading_engine(path: Path, *, is_settled: bool = False) -> Engine:
    """Return an engine that only reads a file.

    Parameters
    ----------
    path : Path
        The file.
    is_settled : bool
        Nobody writes it: not even a lock is taken, so that a copy on a read-only medium can be read.
    """
    options = "mode=ro&immutable=1" if is_settled else "mode=ro"
    address = f"{path.resolve().as_uri()}?{options}"
    return create_engine("sqlite://", creator=lambda: _opened(address), poolclass=NullPool)


def settle(path: Path) -> None:
    """Make a closed archive one file that is on the disk as a whole."""
    # who holds it for longer uses it
    connection = sqlite3.connect(path, timeout=0.5)
    try:
        connection.execute("PRAGMA journal_mode=DELETE")
    finally:
        connection.close()
    flush(path)


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _chunks(path: Path, progress: Progress) -> Iterator[bytes]:
    size, done = path.stat().st_size or 1, 0
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk
            done += len(chunk)
            progress(done / size)


def sha256_of(path: Path, progress: Progress) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    digest = hashlib.sha256()
    for chunk in _chunks(path, progress):
        digest.update(chunk)
    return digest.hexdigest()


def copy_file(source: Path, target: Path, progress: Progress) -> None:
    """Copy the bytes of a file into a new one that only its owner can read."""
    with target.open("xb") as writing:
        target.chmod(0o600)
        writing.writelines(_chunks(source, progress))


def disk_of(engine: Engine) -> tuple[int | None, bool | None]:
    """Return free bytes beside a database's file and whether it can be written; None for one behind a server."""
    name = engine.url.database
    if engine.dialect.name != "sqlite" or name is None:
        return None, None
    path = Path(name).absolute()
    try:
        free_bytes = shutil.disk_usage(path.parent).free
    except OSError:
        return 0, False
    return free_bytes, os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def _opened(address: str) -> sqlite3.Connection:
    """Return a connection whose transactions are opened by statements only."""
    connection = sqlite3.connect(address, uri=True, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA query_only=ON")
    # one state for all that is read
    connection.execute("BEGIN")
    return connection


#: an attribute that no file has
_NO_ATTRIBUTE = "user.soo.none"
_GIVEN_UP = (errno.EROFS, errno.EIO)
#: device and number of a file
_Identity = tuple[int, int]


class FileWatch:
    """Identity of a database's file, from its first opening on.

    Parameters
    ----------
    path : Path
        Name of the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._names = (path, path.with_name(f"{path.name}-wal"))
        self._seen: dict[Path, _Identity] = {}
        self._lock = Lock()

    def note(self) -> None:
        """Remember what stands under the names now; a file that was seen before stays the one."""
        with self._lock:
            for name in self._names:
                identity = _identity_of(name)
                if identity is not None:
                    self._seen.setdefault(name, identity)

    def check(self) -> None:
        """Raise StorageError ``storage.gone`` or ``storage.replaced`` unless the files are those that were opened."""
        if len(self._seen) < len(self._names):
            # the log appears with the first transaction
            self.note()
        for name, seen in tuple(self._seen.items()):
            identity = _identity_of(name)
            if identity == seen:
                continue
            if identity is None:
                detail = f"The archive file {name.name} was removed; rows are not stored until it is back."
                raise StorageError("storage.gone", detail)
            detail = f"The archive file {name.name} was replaced; the service opens the new file if it is an archive."
            raise StorageError("storage.replaced", detail)

    def confirm(self) -> None:
        """Raise StorageError ``storage.unavailable`` where the file system has given up its journal.

        On ext4 the ``fsync`` of a COMMIT can end well although the journal was given up meanwhile, and nothing of it is
        on the disk: 9 of 132 trials on Linux 6.18 lost a batch, with this none of 69. Every change is refused from that
        moment on, so one that changes nothing is asked for, 20 us without access to the disk.
        """
        if sys.platform != "linux":
            return
        try:
            os.removexattr(self._names[1], _NO_ATTRIBUTE)
        except OSError as fault:
            if fault.errno in _GIVEN_UP:
                detail = (
                    f"The file system of the archive cannot be written: {fault.strerror}. Nothing was acknowledged."
                )
                raise StorageError("storage.unavailable", detail) from fault

    def is_to_be_reopened(self) -> bool:
        """Return whether another file that is an archive stands under the name, or the log alone was taken away.

        Of a file that was replaced the log is put aside first: SQLite would take it for one of the new file. A log that
        was taken away is taken into the file when the last connection closes.
        """
        path, log = self._names
        identity = _identity_of(path)
        if identity == self._seen.get(path):
            return log in self._seen and _identity_of(log) is None
        if identity is None:
            return False
        if _identity_of(log) == self._seen.get(log, (0, 0)):
            log.replace(log.with_name(f"{log.name}.of-replaced"))
            path.with_name(f"{path.name}-shm").unlink(missing_ok=True)
        return _holds_archive(path)


def _holds_archive(path: Path) -> bool:
    """Return whether a file is an archive of this layout; it is only read."""
    engine = reading_engine(path)
    try:
        with engine.connect() as connection:
            return layout_of(connection) == LAYOUT
    except SQLAlchemyError:
        return False
    finally:
        engine.dispose()


def _identity_of(path: Path) -> _Identity | None:
    try:
        state = os.stat(path)  # noqa: PTH116 - a third of the time of Path.stat, at every commit
    except OSError:
        return None
    return state.st_dev, state.st_ino


#: wait for a lock where no other is wanted, s
BUSY_TIMEOUT_S = 10.0
READERS = 8
_LOG_RETRY_S = 0.01


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
    watch = FileWatch(Path(target.database or ""))
    # the write lock comes first: a reader that turns writer could only fail, never wait
    for engine, begin in ((write, "BEGIN IMMEDIATE"), (read, "BEGIN")):
        # connecting to a name without a file would make an empty one
        event.listen(engine, "do_connect", lambda *_: watch.check())
        event.listen(engine, "do_connect", lambda *_: make_private(watch.path))
        event.listen(engine, "connect", partial(_prepare, busy_s))
        event.listen(engine, "connect", lambda *_: watch.note())
        # no transaction begins or ends on a file that is no longer there
        event.listen(engine, "begin", lambda _: watch.check())
        event.listen(engine, "begin", partial(Connection.exec_driver_sql, statement=begin))
        event.listen(engine, "commit", _commit)
        event.listen(engine, "commit", lambda _: watch.check())
    event.listen(read, "connect", lambda connection, _: connection.execute("PRAGMA query_only=ON"))
    event.listen(write, "commit", lambda _: watch.confirm())
    return Engines(write, read)


def _prepare(busy_s: float, connection: Any, _record: object) -> None:
    connection.isolation_level = None
    connection.execute(f"PRAGMA busy_timeout={round(1000 * busy_s)}")
    _use_wal(connection, busy_s)
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")


def _use_wal(connection: sqlite3.Connection, busy_s: float) -> None:
    # the busy timeout does not hold while another connection gives a new file its log: SQLite refuses at once
    deadline = time.monotonic() + busy_s
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as fault:
            if fault.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(_LOG_RETRY_S)
        else:
            return


def _commit(connection: Connection) -> None:
    # the driver's commit() succeeds silently when the database has rolled back by itself (disk full); COMMIT fails
    try:
        connection.exec_driver_sql("COMMIT")
    except DBAPIError:
        # a refused COMMIT leaves the transaction open, where it would stop every later one
        connection.connection.rollback()
        raise
