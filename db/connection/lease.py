"""Leases: of the processes on one archive one at a time has each. Those of a file; `server_leases` has the others."""

import fcntl
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from sqlalchemy import Connection

from db.tables import LEASE_US
from service.errors import StorageError
from service.ports.storage import LeaseLoan, Leases, Term
from service.records.epoch import US_PER_S

if TYPE_CHECKING:
    from db.connection.writer import Writer


Result = TypeVar("Result")
_log = logging.getLogger(__name__)


class SqlLeases(Leases, Protocol):
    """Leases as the repositories use them."""

    @property
    def member(self) -> int | None:
        """Number of this process among those of a server; None for a file, and before the first poll."""

    def under(self, work: Callable[[Connection], Result], name: str) -> Callable[[Connection], Result]:
        """Return a write that is refused where leases were asked for and that of a name is not ours."""

    def require_sessions(self) -> None:
        """Raise ValueError where a pooler gives the transactions of one connection to several sessions."""

    def announce(self, spacecraft_ids: Iterable[str]) -> None:
        """Tell other processes of committed changes; one that is lost is found by their polls."""


def lost(name: str) -> StorageError:
    """Return the error of a write under a lease that is another's."""
    detail = f"Another process may lead {name or 'the archive'} now; it computes and stores these results."
    return StorageError("lease.lost", detail)


def none_held(_name: str) -> int:
    """Return 0: no term is held."""
    return 0


class FileLeases:
    """One lock on a file beside a SQLite archive, for all spacecraft; the file's time is its holder's sign of life.

    Parameters
    ----------
    path : Path
        The archive.
    writer : Writer
        Of the archive; a transaction of its own waits for those of the last holder.
    """

    #: processes on one file are not numbered
    member: int | None = None

    def __init__(self, path: Path, writer: "Writer") -> None:
        # a file of its own: closing one that SQLite has open would end SQLite's locks
        self._path = path.with_name(f"{path.name}-lease")
        self._writer = writer
        self._file: int | None = None
        self._terms = 0
        #: file and time of the newest sign of life, and when it was seen by the clock that no suspension moves
        self._sign: tuple[int, int] | None = None
        self._seen_s = time.monotonic()
        #: programs that only look at an archive, or repair it, ask for no lease and need none
        self._is_wanted = False

    def poll(self, *, is_estimator: bool) -> Term:
        """Lock the file unless another process has it, and give a sign of life; return the term of everything."""
        self._is_wanted = True
        if not is_estimator:
            self._look()
            return none_held
        if not self._is_ours():
            self.give_back()
            if not self._is_acquired():
                return none_held
            self._terms += 1
        if self._file is not None:
            os.utime(self._file)
        self._look()
        term = self._terms
        return lambda _: term

    def wait(self, limit_s: float) -> frozenset[str]:
        """Wait for the whole time: processes on one file announce nothing."""
        time.sleep(limit_s)
        return frozenset()

    def leaders(self) -> dict[str, str]:
        """Return nothing: a lock does not say whose it is."""
        return {}

    def silent_s(self) -> float:
        """Return the time since the last sign of life that a poll found."""
        return time.monotonic() - self._seen_s

    def ended(self) -> int:
        """Return 0: what a process has left is found by the next that leads."""
        return 0

    def require_sessions(self) -> None:
        """Do nothing: a file has no pooler."""

    def announce(self, spacecraft_ids: Iterable[str]) -> None:
        """Announce nothing."""

    def lend(self) -> LeaseLoan | None:
        """Return None: a process of ours ends with this one, and with it the lock."""
        return None

    def borrow(self, loan: LeaseLoan | None) -> None:
        """Do nothing, as nothing is lent."""

    def give_back(self) -> None:
        """Let another process have it."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def under(self, work: Callable[[Connection], Result], name: str) -> Callable[[Connection], Result]:
        """Return a write that is refused where the lease was asked for and is not ours."""

        def write(connection: Connection) -> Result:
            if self._is_wanted and not self._is_ours():
                raise lost(name)
            return work(connection)

        return write

    def _is_acquired(self) -> bool:
        """Lock the file, and wait for the transactions of its last holder; return whether it is ours."""
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            self._look()
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
            # a holder that was stopped within a transaction would be waited for in vain
            if self.silent_s() <= LEASE_US / US_PER_S or not self._is_writable():
                return False
            file = self._successor()
        self._file = file
        if not self._is_writable():
            self.give_back()
            return False
        return True

    def _successor(self) -> int:
        """Return a locked file that has replaced the one of a stopped holder, whose writes are refused from now on."""
        file, name = tempfile.mkstemp(dir=self._path.parent, prefix=f"{self._path.name}-")
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        Path(name).replace(self._path)
        _log.warning("the service that led has given no sign of life for %.0f s, this one leads", self.silent_s())
        return file

    def _is_writable(self) -> bool:
        """Return whether an empty transaction ends, which waits for those of another process."""
        try:
            self._writer.submit(lambda _: None).result()
        except StorageError:
            return False
        return True

    def _look(self) -> None:
        """Look for a new sign of life."""
        try:
            state = self._path.stat()
        except OSError:
            return
        sign = (state.st_ino, state.st_mtime_ns)
        if sign != self._sign:
            self._sign, self._seen_s = sign, time.monotonic()

    def _is_ours(self) -> bool:
        """Return whether the locked file stands under its name: one that was taken away keeps nobody out."""
        file = self._file
        try:
            # asked at every commit of results
            return file is not None and os.path.samestat(os.fstat(file), os.stat(self._path))  # noqa: PTH116
        except OSError:
            return False
