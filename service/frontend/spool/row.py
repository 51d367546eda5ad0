"""Rows and traces of the spool, and the tables of its file."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from service.core.radio.levels import dbm_from_mw
from service.frontend.acquisition.evaluation import MeasuredRow
from service.records.levels.measurement import Sweep

#: array of a row -> how its numbers are written; the names are those of the columns
ARRAYS = {
    "power_dbm": "<f8",
    "flags": "<i4",
    "sigma_db": "<f4",
    "c_n0_db_hz": "<f4",
    "occupied_bandwidth_hz": "<f4",
    "centroid_offset_hz": "<f4",
}
#: bytes of a row beside its arrays: numbers, keys, index
ROW_OVERHEAD = 64


class SpooledTask(NamedTuple):
    """Task of a spooled row: hash, and carriers of its arrays."""

    sha256: str
    #: carriers of the arrays, in their order
    carrier_ids: tuple[str, ...]


class SpooledRow(NamedTuple):
    """A row that waits for the service."""

    #: for ever increasing; None while the row has not been on the disk
    seq: int | None
    task: SpooledTask
    row: MeasuredRow


class SpooledTrace(NamedTuple):
    """A sweep kept as evidence."""

    key: int
    epoch_us: int
    sweep: str
    start_hz: float
    step_hz: float
    rbw_hz: float
    enbw_hz: float
    sweep_time_s: float
    #: (B,) dBm as float32 bytes
    power_dbm: bytes


def encode_row(row: MeasuredRow) -> tuple[bytes, ...]:
    """Return the arrays of a row as bytes, in the order of `ARRAYS`.

    Raises
    ------
    ValueError
        Arrays of different lengths.
    """
    if len({len(getattr(row, name)) for name in ARRAYS}) != 1:
        message = f"the arrays of the row of {row.epoch_us} us have different lengths"
        raise ValueError(message)
    return tuple(np.asarray(getattr(row, name)).astype(kind).tobytes() for name, kind in ARRAYS.items())


def decode_row(epoch_us: int, blobs: Sequence[bytes]) -> MeasuredRow:
    """Return the row that `encode_row` wrote.

    Raises
    ------
    ValueError
        The bytes are not those of arrays of one length.
    """
    arrays: Mapping[str, Any] = {
        name: np.frombuffer(blob, dtype=kind).astype(np.int64 if name == "flags" else np.float64)
        for (name, kind), blob in zip(ARRAYS.items(), blobs, strict=True)
    }
    if len({len(array) for array in arrays.values()}) != 1:
        message = f"the arrays of the row of {epoch_us} us have different lengths"
        raise ValueError(message)
    return MeasuredRow(epoch_us, **arrays)


def size_of(blobs: Sequence[bytes]) -> int:
    """Return the size of a row for the bound of the spool, bytes."""
    return ROW_OVERHEAD + sum(map(len, blobs))


def trace_of(sweep: Sweep) -> tuple[Any, ...]:
    """Return the columns of a trace, those of `SpooledTrace` without the key."""
    settings = sweep.settings
    return (
        sweep.epoch_us,
        sweep.sweep_id,
        settings.start_hz,
        settings.step_hz,
        settings.rbw_hz,
        settings.enbw_hz,
        settings.sweep_time_s,
        dbm_from_mw(sweep.power_mw).astype("<f4").tobytes(),
    )


#: how long another program may hold the file up, s
_BUSY_S = 5.0
#: the log is cut back to this size, bytes
_LOG_BYTES = 16 << 20

_ROW_ARRAYS = """
    power_dbm BLOB NOT NULL,
    flags BLOB NOT NULL,
    sigma_db BLOB NOT NULL,
    c_n0_db_hz BLOB NOT NULL,
    occupied_bandwidth_hz BLOB NOT NULL,
    centroid_offset_hz BLOB NOT NULL
"""

#: number of the layout that this program makes and reads; a change of a table raises it
LAYOUT = 2
_TABLES = f"""
CREATE TABLE owner (spacecraft_id TEXT NOT NULL, source TEXT NOT NULL);
CREATE TABLE task (
    task_key INTEGER PRIMARY KEY,
    sha256 TEXT NOT NULL,
    carrier_ids TEXT NOT NULL,
    plan_id INTEGER,
    UNIQUE (sha256, carrier_ids)
);
CREATE TABLE measured (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    epoch_us INTEGER NOT NULL UNIQUE,
    task_key INTEGER NOT NULL REFERENCES task,
    kept_at_us INTEGER NOT NULL,
    size_bytes INTEGER NOT NULL,
    {_ROW_ARRAYS}
);
CREATE TABLE refused (
    refused_key INTEGER PRIMARY KEY AUTOINCREMENT,
    seq INTEGER,
    epoch_us INTEGER NOT NULL,
    task_key INTEGER NOT NULL REFERENCES task,
    refused_at_us INTEGER NOT NULL,
    code TEXT NOT NULL,
    detail TEXT NOT NULL,
    {_ROW_ARRAYS}
);
CREATE TABLE trace (
    trace_key INTEGER PRIMARY KEY AUTOINCREMENT,
    epoch_us INTEGER NOT NULL,
    sweep TEXT NOT NULL,
    start_hz REAL NOT NULL,
    step_hz REAL NOT NULL,
    rbw_hz REAL NOT NULL,
    enbw_hz REAL NOT NULL,
    sweep_time_s REAL NOT NULL,
    power_dbm BLOB NOT NULL,
    UNIQUE (epoch_us, sweep)
);
CREATE TABLE tally (name TEXT PRIMARY KEY, count INTEGER NOT NULL) WITHOUT ROWID;
"""

#: the file is not what it was; nothing of it can be relied on
_DAMAGED = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
#: the connection is as good as before, only the disk does not take anything
_UNHARMED = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED})
#: the same of errors of input and output; after a failed fsync nobody knows what the disk holds
_UNHARMED_FURTHER = frozenset({sqlite3.SQLITE_IOERR_WRITE, sqlite3.SQLITE_IOERR_TRUNCATE})


class SpoolError(Exception):
    """A spool cannot be used as asked."""


class SpoolFileError(SpoolError):
    """The file is good, but not for this: of another layout, spacecraft or source."""


class SpoolDamagedError(SpoolError):
    """The file is no database, or its content contradicts itself."""


def primary_code(error: sqlite3.Error) -> int:
    """Return SQLite's primary result code of an error, 0 when it has none."""
    return (getattr(error, "sqlite_errorcode", 0) or 0) & 0xFF


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether an error means that the file is damaged."""
    return primary_code(error) in _DAMAGED


def leaves_connection_good(error: sqlite3.Error) -> bool:
    """Return whether the connection can still be used after an error."""
    return primary_code(error) in _UNHARMED or getattr(error, "sqlite_errorcode", 0) in _UNHARMED_FURTHER


def connect(path: Path) -> sqlite3.Connection:
    """Return a connection for any thread, one at a time; a commit that returned survives a loss of power."""
    with contextlib.suppress(OSError):
        # only its owner may read it; never one that is there: closing it would drop the locks of SQLite
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
    try:
        connection.execute("PRAGMA auto_vacuum=INCREMENTAL")
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute(f"PRAGMA journal_size_limit={_LOG_BYTES}")
        connection.execute("PRAGMA temp_store=MEMORY")
        # rows that are settled while the disk takes nothing; it lives and dies with the connection
        connection.execute("CREATE TEMP TABLE gone (epoch_us INTEGER PRIMARY KEY)")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def check(connection: sqlite3.Connection) -> None:
    """Raise SpoolDamagedError when the file contradicts itself; a hundred megabytes take a quarter of a second."""
    said = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if said != "ok":
        raise SpoolDamagedError(said)


def prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Make the tables in a new file; SpoolFileError for a file of another layout."""
    layout = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if layout not in (0, LAYOUT):
        message = (
            f"spool {path} has layout {layout}, this program uses layout {LAYOUT}: let the version of SOO that made it "
            "send the rows that wait in it, or name another file"
        )
        raise SpoolFileError(message)
    if layout == 0:
        with transaction(connection):
            for statement in _TABLES.split(";"):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version={LAYOUT}")


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Commit what is done inside, or leave nothing of it."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise
