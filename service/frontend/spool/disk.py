"""Disk of the spool: one owner, free space, what is saved of a damaged file, warnings."""

import errno
import fcntl
import json
import logging
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from service.frontend.spool import row as spool_row
from service.frontend.spool.file import Owner, SpoolFile, WaitingRow
from service.records.epoch import format_epoch

#: numbers given between two writes of the mark
MARK_STEP = 1000


class SpoolInUseError(spool_row.SpoolError):
    """Another process owns the spool."""


class SpoolLock:
    """Own a spool until `release`.

    Parameters
    ----------
    path : Path
        The spool's file; the lock lies beside it.

    Raises
    ------
    SpoolInUseError
        Another process owns it.
    OSError
        The folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path.with_name(path.name + ".lock")
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = self._read().get("pid", "?")
            os.close(self._file)
            message = f"spool {path} is in use by process {holder}; one process owns a spool"
            raise SpoolInUseError(message) from error
        said = self._read().get("numbers_to", 0)
        #: no number above this one was ever given
        self.numbers_to = said if isinstance(said, int) else 0
        self._write(self.numbers_to)

    def mark(self, seq: int) -> None:
        """Note that a number is given; writes when it exceeds what was noted."""
        if seq > self.numbers_to:
            self._write(seq + MARK_STEP)

    def release(self) -> None:
        """Give the spool up."""
        os.close(self._file)

    def _read(self) -> dict[str, object]:
        """Return the content of the lock file, nothing when it is empty or damaged."""
        try:
            said = json.loads(os.pread(self._file, 4096, 0))
        except (OSError, ValueError):
            return {}
        return said if isinstance(said, dict) else {}

    def _write(self, numbers_to: int) -> None:
        """Write owner and mark through to the disk, in place: its length never shrinks to nothing."""
        text = json.dumps({"pid": os.getpid(), "numbers_to": numbers_to}).ljust(128).encode()
        os.pwrite(self._file, text, 0)
        os.fsync(self._file)
        self.numbers_to = numbers_to


#: what SQLite keeps beside a file
_COMPANIONS = ("", "-wal", "-shm")
_COLUMNS = f"seq, epoch_us, task_key, kept_at_us, {', '.join(spool_row.ARRAYS)}"


def set_aside(path: Path, now_us: int) -> Path:
    """Rename a file and what SQLite keeps beside it; return the new name."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=now_us)
    stem = f"{path.name}.damaged-{moment:%Y%m%dT%H%M%SZ}"
    name, number = stem, 1
    while path.with_name(name).exists():
        number += 1
        name = f"{stem}-{number}"
    for suffix in _COMPANIONS:
        with suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(path.with_name(name + suffix))
    return path.with_name(name)


class DamagedSpool:
    """Damaged spool file, read as far as it is readable.

    Parameters
    ----------
    connection : sqlite3.Connection
        Connection to the file; its opener closes it.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def last_seq(self) -> int | None:
        """Return the greatest number ever given, None when it cannot be read."""
        with suppress(sqlite3.Error, TypeError):
            return int(
                self._connection.execute("SELECT seq FROM sqlite_sequence WHERE name = 'measured'").fetchone()[0]
            )
        return None

    def rows(self) -> Iterator[tuple[int, WaitingRow]]:
        """Yield the rows that can be read, with their numbers: upwards until the damage, then downwards to it."""
        try:
            tasks = {
                key: spool_row.SpooledTask(sha256, tuple(json.loads(ids)))
                for key, sha256, ids in self._connection.execute("SELECT task_key, sha256, carrier_ids FROM task")
            }
        except (sqlite3.Error, ValueError, TypeError):
            return
        reached = 0
        for seq, row in self._read("ORDER BY seq", tasks):
            reached = seq
            yield seq, row
        for seq, row in self._read("ORDER BY seq DESC", tasks):
            if seq <= reached:
                return
            yield seq, row

    def _read(self, order: str, tasks: dict[int, spool_row.SpooledTask]) -> Iterator[tuple[int, WaitingRow]]:
        """Yield rows in an order until the file cannot be read any further; rows that make no sense are left out."""
        with suppress(sqlite3.Error):
            query = f"SELECT {_COLUMNS} FROM measured {order}"  # noqa: S608 own text
            for seq, epoch_us, task_key, kept_at_us, *blobs in self._connection.execute(query):
                with suppress(KeyError, ValueError, TypeError):
                    spool_row.decode_row(int(epoch_us), blobs)
                    yield int(seq), WaitingRow(int(epoch_us), tasks[task_key], int(kept_at_us), tuple(blobs))


logger = logging.getLogger("service.frontend.spool.spool")

FULL = "spool.full"
AGED = "spool.aged"
DISK_FULL = "spool.disk_full"
UNWRITABLE = "spool.unwritable"
CORRUPT = "spool.corrupt"


class SpoolWarning(NamedTuple):
    """One thing that is not as it should be."""

    #: spool.full, spool.aged, spool.disk_full, spool.unwritable or spool.corrupt
    code: str
    detail: str
    #: microseconds UTC
    since_us: int

    def as_json(self) -> dict[str, str]:
        """Return the warning as reports tell it."""
        return {"code": self.code, "detail": self.detail, "since": format_epoch(self.since_us)}


class WarningBoard:
    """Warnings that stand."""

    def __init__(self) -> None:
        self._standing: dict[str, SpoolWarning] = {}

    def standing(self) -> list[SpoolWarning]:
        """Return the warnings, oldest first."""
        return sorted(self._standing.values(), key=lambda each: each.since_us)

    def put_up(self, code: str, detail: str, now_us: int) -> None:
        """Warn, or update the text of an active warning."""
        before = self._standing.get(code)
        if before is None:
            logger.error("spool warning %s: %s", code, detail)
        self._standing[code] = SpoolWarning(code, detail, now_us if before is None else before.since_us)

    def withdraw(self, *codes: str) -> None:
        """End warnings."""
        for code in codes:
            if self._standing.pop(code, None) is not None:
                logger.info("spool warning %s has ended", code)


#: what may come of any use of the disk
DISK_FAULTS = (sqlite3.Error, OSError, spool_row.SpoolError)
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
                self._board.put_up(CORRUPT, detail, self._now_us())
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
        code = DISK_FULL if _is_no_room(error) else UNWRITABLE
        self._board.put_up(code, f"{self._path}: {error}; {consequence}", self._now_us())
        if not (isinstance(error, sqlite3.Error) and spool_row.leaves_connection_good(error)):
            self._drop_file()
        return False

    def close(self) -> None:
        """Give file and lock up."""
        self._drop_file()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _consume(self, file: SpoolFile) -> SpoolFile:
        found = self._path.stat()
        self._inode = (found.st_dev, found.st_ino)
        self.last_seq = max(self.last_seq, file.last_seq)
        self.file = file
        return file

    def _open(self) -> SpoolFile:
        """Open the file; a spoiled one is set aside."""
        try:
            return SpoolFile(self._path, self._owner)
        except (spool_row.SpoolDamagedError, sqlite3.Error) as error:
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
        self._board.put_up(CORRUPT, detail, self._now_us())
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
    return isinstance(error, spool_row.SpoolDamagedError) or (
        isinstance(error, sqlite3.Error) and spool_row.is_damage(error)
    )


def _is_no_room(error: Exception) -> bool:
    """Return whether an error means that the disk is full."""
    if isinstance(error, sqlite3.Error):
        return spool_row.primary_code(error) == sqlite3.SQLITE_FULL
    return isinstance(error, OSError) and error.errno in _NO_ROOM
