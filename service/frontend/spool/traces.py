"""The ring of evidence traces in a spool's file: bounded by count and bytes, the oldest go first.

Law of this file: it runs inside the transactions of `service.frontend.spool.file`; its counts are those of the file
only as long as these are committed, so a caller that rolls back recounts.
"""

import sqlite3
from collections.abc import Iterable
from typing import Any

from service.frontend.spool.row import SpooledTrace

_COLUMNS = "epoch_us, sweep, start_hz, step_hz, rbw_hz, enbw_hz, sweep_time_s, power_dbm"
_INSERT = f"INSERT OR IGNORE INTO trace ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608 own names
_SELECT = f"SELECT trace_key, {_COLUMNS} FROM trace ORDER BY trace_key LIMIT ?"  # noqa: S608 own names


class TraceRing:
    """Traces of one file.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of the spool's file.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self.waiting = 0
        self.size_bytes = 0
        self.recount()

    def recount(self) -> None:
        """Ask the file how many there are."""
        query = "SELECT count(*), coalesce(sum(length(power_dbm)), 0) FROM trace"
        self.waiting, self.size_bytes = self._connection.execute(query).fetchone()

    def insert(self, trace: tuple[Any, ...], most: int, most_bytes: int) -> int:
        """Write one trace, as `trace_of` gives it; return how many old ones went for it."""
        if self._connection.execute(_INSERT, trace).rowcount:
            self.waiting, self.size_bytes = self.waiting + 1, self.size_bytes + len(trace[-1])
        before = self.waiting
        while self.waiting and (self.waiting > most or self.size_bytes > most_bytes):
            self.delete(each.key for each in self.oldest(1))
        return before - self.waiting

    def oldest(self, limit: int) -> list[SpooledTrace]:
        """Return the oldest traces; they stay."""
        return [SpooledTrace(*columns) for columns in self._connection.execute(_SELECT, (limit,))]

    def delete(self, keys: Iterable[int]) -> None:
        """Take traces away; those that are gone already do not matter."""
        query = "DELETE FROM trace WHERE trace_key = ? RETURNING length(power_dbm)"
        for key in keys:
            for (size,) in self._connection.execute(query, (key,)).fetchall():
                self.waiting, self.size_bytes = self.waiting - 1, self.size_bytes - size
