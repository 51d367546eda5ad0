"""Lease: implements ``service.ports.Lease``, by a lock that ends with its holder.

PostgreSQL: an advisory lock of a connection of its own; where the connection ends, so does the lock. SQLite: a lock of
the operating system on a file beside the archive; it ends with the process. Neither needs a clock, and a holder that
was stopped keeps the lease until it ends. A holder that does not know yet that its connection is gone cannot write:
its transactions ask the server whether the lock is theirs, and a new holder waits for those that had asked before.
"""

import fcntl
import logging
import os
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Protocol, TypeVar

from sqlalchemy import Connection, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from db.connection.sqlite_files import sqlite_path
from service.errors import StorageError

if TYPE_CHECKING:
    from db.connection.writer import Writer

Result = TypeVar("Result")
_log = logging.getLogger(__name__)

#: any number, the same in every process; another one than those of writers and migrations
_LOCK = 5_210_121
_ACQUIRE = text("SELECT pg_try_advisory_lock(:lock), pg_backend_pid()").bindparams(lock=_LOCK)
_IS_OURS = text(
    "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND classid = 0 AND objid = :lock AND objsubid = 1 "
    "AND granted AND pid = :pid AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
).bindparams(lock=_LOCK)


class _Hold(Protocol):
    """A lock that can be had once."""

    def acquire(self) -> bool: ...

    def is_held(self) -> bool: ...

    def demand(self, connection: Connection) -> None:
        """Raise StorageError ``lease.lost`` inside a transaction unless the lock is ours."""

    def give_back(self) -> None: ...


class SqlLease:
    """The lease of one archive.

    Parameters
    ----------
    url : str
        The archive.
    limit_s : float
        Longest wait for an answer of a server.
    writer : Writer
        Of the archive; a transaction of its own waits for those of the last holder.
    """

    def __init__(self, url: str, limit_s: float, writer: "Writer") -> None:
        path = sqlite_path(url)
        self._hold: _Hold = _ServerHold(url, limit_s) if path is None else _FileHold(path)
        self._writer = writer
        self._lock = Lock()
        #: programs that only look at an archive, or repair it, ask for no lease and need none
        self._is_wanted = False

    def acquire(self) -> bool:
        """Take the lease unless another service has it; return whether it is ours."""
        with self._lock:
            self._is_wanted = True
            if not self._hold.acquire():
                return False
            try:
                self._writer.submit(lambda _: None).result()
            except StorageError:
                self._hold.give_back()
                return False
            return True

    def is_held(self) -> bool:
        """Return whether it is ours still, as the archive knows it."""
        with self._lock:
            return self._hold.is_held()

    def give_back(self) -> None:
        """Let another service have it."""
        with self._lock:
            self._hold.give_back()

    def under(self, work: Callable[[Connection], Result]) -> Callable[[Connection], Result]:
        """Return a write that is refused where the lease was taken and is ours no more."""

        def write(connection: Connection) -> Result:
            if self._is_wanted:
                self._hold.demand(connection)
            return work(connection)

        return write


def _lost() -> StorageError:
    detail = "Another service of this archive may lead now; it computes and stores these results."
    return StorageError("lease.lost", detail)


class _FileHold:
    """A lock on a file beside a SQLite archive."""

    def __init__(self, path: Path) -> None:
        # a file of its own: closing one that SQLite has open would end SQLite's locks
        self._path = path.with_name(f"{path.name}-lease")
        self._file: int | None = None

    def acquire(self) -> bool:
        if self.is_held():
            return True
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as fault:
            _log.warning(
                "lease file %s cannot be opened, this service does not lead: %s; check the folder's permissions",
                self._path,
                fault,
            )
            return False
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            return False
        self._file = file
        return True

    def is_held(self) -> bool:
        if not self._is_ours():
            self.give_back()
            return False
        return True

    def demand(self, connection: Connection) -> None:  # noqa: ARG002 - the protocol's signature
        if not self._is_ours():
            raise _lost()

    def _is_ours(self) -> bool:
        """Return whether the locked file stands under its name: one that was taken away keeps nobody out."""
        file = self._file
        try:
            # asked at every commit of results
            return file is not None and os.path.samestat(os.fstat(file), os.stat(self._path))  # noqa: PTH116
        except OSError:
            return False

    def give_back(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


class _ServerHold:
    """An advisory lock of a connection to a PostgreSQL server."""

    def __init__(self, url: str, limit_s: float) -> None:
        self._url, self._limit_s = url, limit_s
        self._connection: Connection | None = None
        self._pid = 0

    def acquire(self) -> bool:
        if self._connection is not None and self.is_held():
            return True
        # the driver costs time and memory that a file does not need
        from db.connection.postgresql_engines import lease_engine

        try:
            connection = lease_engine(make_url(self._url), self._limit_s).connect()
        except SQLAlchemyError:
            return False
        try:
            is_ours, pid = connection.execute(_ACQUIRE).one()
        except SQLAlchemyError:
            is_ours, pid = False, 0
        if not is_ours:
            connection.close()
            return False
        self._connection, self._pid = connection, int(pid)
        return True

    def is_held(self) -> bool:
        if self._connection is None:
            return False
        try:
            self._connection.execute(text("SELECT 1"))
        except SQLAlchemyError:
            self.give_back()
            return False
        return True

    def demand(self, connection: Connection) -> None:
        if not connection.execute(_IS_OURS, {"pid": self._pid}).scalar():
            raise _lost()

    def give_back(self) -> None:
        connection, self._connection, self._pid = self._connection, None, 0
        if connection is not None:
            # no pool: the session ends, and the lock with it
            connection.close()
