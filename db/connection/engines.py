"""Engines of an archive, and the identity of one in a file."""

import contextlib
import errno
import hashlib
import os
import shutil
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

from sqlalchemy import Connection, Engine, NullPool, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError

from db.tables import LAYOUT, layout_of
from service.errors import StorageError

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
        # the driver takes 45 ms of a start, which a file does not need
        from db.connection.server_engines import postgresql_engines

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
