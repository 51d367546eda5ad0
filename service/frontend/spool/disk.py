"""The place of a spool on the disk: lock, file, and what is done when the file is spoiled, removed or out of reach."""

import errno
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from service.frontend.spool import warnings as codes
from service.frontend.spool.file import Owner, SpoolFile, WaitingRow
from service.frontend.spool.lock import SpoolLock
from service.frontend.spool.salvage import DamagedSpool, set_aside
from service.frontend.spool.schema import (
    SpoolDamagedError,
    SpoolError,
    is_damage,
    leaves_connection_good,
    primary_code,
)
from service.frontend.spool.warnings import WarningBoard

#: what may come of any use of the disk
DISK_FAULTS = (sqlite3.Error, OSError, SpoolError)
_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class SpoolDisk:
    """Lock and file of one spool; nothing is opened before `ready`.

    Parameters
    ----------
    path : Path
        The file.
    owner : Owner
        Whose rows it holds.
    board : WarningBoard
        Where it is said what happened.
    now_us : callable
        Present, microseconds UTC.
    """

    def __init__(self, path: Path, owner: Owner, board: WarningBoard, now_us: Callable[[], int]) -> None:
        self.file: SpoolFile | None = None
        #: greatest number known to have been given
        self.last_seq = 0
        self._path = path
        self._owner = owner
        self._board = board
        self._now_us = now_us
        self._lock: SpoolLock | None = None
        self._inode: tuple[int, int] | None = None

    def ready(self) -> SpoolFile:
        """Return the file, opened or begun when it must be; any of `DISK_FAULTS` when that is not possible now."""
        carried: list[tuple[int, WaitingRow]] | None = None
        if self.file is not None and self._is_removed():
            carried = list(DamagedSpool(self.file.connection).rows())
            self.close()
        if self.file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            if self._lock is None:
                self._lock = SpoolLock(self._path)
            file = self._open()
            if carried is not None:
                file.restore(carried, self.last_seq, 0)
                detail = f"the file was removed while in use; its {len(carried)} rows were carried over to a new one"
                self._board.put_up(codes.CORRUPT, detail, self._now_us())
            return self._consume(file)
        return self.file

    def mark(self, seq: int) -> None:
        """Note that numbers up to this one are about to be given."""
        if self._lock is not None:
            self._lock.mark(seq)

    def face(self, error: Exception, consequence: str) -> bool:
        """Act on a fault, and warn of it in these words; True when a new file stands in the place of a spoiled one."""
        if _is_spoiled(error):
            waiting = self.file.waiting if self.file else None
            self._drop_file()
            try:
                self._consume(self._start_over(str(error), waiting))
            except DISK_FAULTS as further:
                error = further
            else:
                return True
        code = codes.DISK_FULL if _is_no_room(error) else codes.UNWRITABLE
        self._board.put_up(code, f"{self._path}: {error}; {consequence}", self._now_us())
        if not (isinstance(error, sqlite3.Error) and leaves_connection_good(error)):
            self._drop_file()
        return False

    def close(self) -> None:
        """Give file and lock up."""
        self._drop_file()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _consume(self, file: SpoolFile) -> SpoolFile:
        """Make a file the one in use."""
        found = self._path.stat()
        self._inode = (found.st_dev, found.st_ino)
        self.last_seq = max(self.last_seq, file.last_seq)
        self.file = file
        return file

    def _open(self) -> SpoolFile:
        """Open the file; a spoiled one is set aside."""
        try:
            return SpoolFile(self._path, self._owner)
        except (SpoolDamagedError, sqlite3.Error) as error:
            if not _is_spoiled(error):
                raise
            return self._start_over(str(error), None)

    def _start_over(self, reason: str, waiting: int | None) -> SpoolFile:
        """Set the spoiled file aside and begin a new one with what can be read of it."""
        aside = set_aside(self._path, self._now_us())
        file = SpoolFile(self._path, self._owner)
        with closing(sqlite3.connect(aside)) as connection:
            damaged = DamagedSpool(connection)
            marked = self.last_seq or (self._lock.numbers_to if self._lock is not None else 0)
            said = damaged.last_seq()
            file.restore(damaged.rows(), marked if said is None else max(said, self.last_seq), 0)
        carried, lost = file.waiting, None if waiting is None else waiting - file.waiting
        file.restore((), 0, lost or 0)
        words = "an unknown number" if lost is None else str(lost)
        detail = f"{reason}; set aside as {aside.name}, {carried} rows carried over, {words} lost"
        self._board.put_up(codes.CORRUPT, detail, self._now_us())
        return file

    def _is_removed(self) -> bool:
        """Return whether the file was replaced or removed."""
        try:
            found = self._path.stat()
        except FileNotFoundError:
            return True
        return (found.st_dev, found.st_ino) != self._inode

    def _drop_file(self) -> None:
        """Close the file, whatever state it is in."""
        file, self.file = self.file, None
        if file is not None:
            file.close()


def _is_spoiled(error: Exception) -> bool:
    """Return whether an error means that the file is damaged."""
    return isinstance(error, SpoolDamagedError) or (isinstance(error, sqlite3.Error) and is_damage(error))


def _is_no_room(error: Exception) -> bool:
    """Return whether an error means that the disk is full."""
    if isinstance(error, sqlite3.Error):
        return primary_code(error) == sqlite3.SQLITE_FULL
    return isinstance(error, OSError) and error.errno in _NO_ROOM
