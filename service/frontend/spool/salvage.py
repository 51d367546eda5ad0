"""Salvage of a damaged spool file: it is set aside, never deleted, and read from both ends."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from service.frontend.spool.file import WaitingRow
from service.frontend.spool.row import ARRAYS, SpooledTask, decode_row

#: what SQLite keeps beside a file
_COMPANIONS = ("", "-wal", "-shm")
_COLUMNS = f"seq, epoch_us, task_key, kept_at_us, {', '.join(ARRAYS)}"


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
                key: SpooledTask(sha256, tuple(json.loads(ids)))
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

    def _read(self, order: str, tasks: dict[int, SpooledTask]) -> Iterator[tuple[int, WaitingRow]]:
        """Yield rows in an order until the file cannot be read any further; rows that make no sense are left out."""
        with suppress(sqlite3.Error):
            query = f"SELECT {_COLUMNS} FROM measured {order}"  # noqa: S608 own text
            for seq, epoch_us, task_key, kept_at_us, *blobs in self._connection.execute(query):
                with suppress(KeyError, ValueError, TypeError):
                    decode_row(int(epoch_us), blobs)
                    yield int(seq), WaitingRow(int(epoch_us), tasks[task_key], int(kept_at_us), tuple(blobs))
