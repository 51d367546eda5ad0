"""SQLite files as files: where a URL points, reading without a trace, one file in place of three."""

import contextlib
import hashlib
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Engine, NullPool, create_engine
from sqlalchemy.engine import make_url

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


def sha256_of(path: Path, progress: Progress) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    digest, size = hashlib.sha256(), path.stat().st_size or 1
    done = 0
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
            done += len(chunk)
            progress(done / size)
    return digest.hexdigest()


def copy_file(source: Path, target: Path, progress: Progress) -> None:
    """Copy the bytes of a file into a new one that only its owner can read."""
    size = source.stat().st_size or 1
    done = 0
    with source.open("rb") as reading, target.open("xb") as writing:
        target.chmod(0o600)
        while chunk := reading.read(_CHUNK):
            writing.write(chunk)
            done += len(chunk)
            progress(done / size)


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
