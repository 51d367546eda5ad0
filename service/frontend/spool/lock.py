"""One process owns a spool: a lock on a small file beside it, which also remembers how far numbers may have been given.

The operating system gives the lock back when the process ends, however it ends. The mark is written every thousand
numbers, so that a spool that was spoiled beyond reading is followed by one whose numbers go on and never start again.
"""

import fcntl
import json
import os
from pathlib import Path

from service.frontend.spool.schema import SpoolError

#: numbers given between two writes of the mark
MARK_STEP = 1000


class SpoolInUseError(SpoolError):
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
