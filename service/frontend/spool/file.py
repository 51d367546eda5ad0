"""The file of a spool: rows in, batches out, settled rows away, each in one transaction; whatever fails is raised.

Law of this file: it knows SQLite and no thread, no clock, no policy. Sequence numbers have no gap but those of rows
that were given up: a row that is there already takes none, and a number that is given up is used up.
"""

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

from service.frontend.spool import row as spool_row
from service.records.epoch import US_PER_S

_ARRAYS = ", ".join(spool_row.ARRAYS)
_MARKS = ", ".join("?" * len(spool_row.ARRAYS))
_INSERT_ROW = (
    f"INSERT INTO measured (seq, epoch_us, task_key, kept_at_us, size_bytes, {_ARRAYS}) "  # noqa: S608 own names
    f"VALUES (?, ?, ?, ?, ?, {_MARKS})"
)
_INSERT_REFUSED = (
    f"INSERT INTO refused (seq, epoch_us, task_key, refused_at_us, code, detail, {_ARRAYS}) "  # noqa: S608 own names
    f"VALUES (?, ?, ?, ?, ?, ?, {_MARKS})"
)
_SELECT_ROWS = (
    f"SELECT seq, epoch_us, task_key, {_ARRAYS} FROM measured "  # noqa: S608 own names
    "WHERE seq >= ? AND epoch_us NOT IN (SELECT epoch_us FROM gone) ORDER BY seq LIMIT ?"
)
_TRACE_COLUMNS = "epoch_us, sweep, start_hz, step_hz, rbw_hz, enbw_hz, sweep_time_s, power_dbm"
_INSERT_TRACE = f"INSERT OR IGNORE INTO trace ({_TRACE_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608 own names
_SELECT_TRACES = f"SELECT trace_key, {_TRACE_COLUMNS} FROM trace ORDER BY trace_key LIMIT ?"  # noqa: S608 own names
#: of all but the newest traces, as many and as large as may be kept
_DELETE_TRACES = """
DELETE FROM trace WHERE trace_key IN (
    SELECT trace_key FROM (
        SELECT trace_key, row_number() OVER newest AS place, sum(length(power_dbm)) OVER newest AS size_bytes
        FROM trace WINDOW newest AS (ORDER BY trace_key DESC)
    ) WHERE place > ? OR size_bytes > ?
)
"""
#: rows looked at at once when room is made
_CHUNK = 256


class UploadLane(Enum):
    """Lane of a request: live rows or backfill."""

    #: younger than the limit of lateness
    LIVE = ">="
    #: older
    BACKFILL = "<"


class Owner(NamedTuple):
    """Whose rows a spool holds."""

    spacecraft_id: str
    source: str


class WaitingRow(NamedTuple):
    """A row on its way into the file."""

    epoch_us: int
    task: spool_row.SpooledTask
    kept_at_us: int
    #: in the order of `ARRAYS`
    blobs: tuple[bytes, ...]


class RefusedRow(NamedTuple):
    """A row that the service refused by name."""

    seq: int | None
    row: WaitingRow
    code: str
    detail: str


class Bounds(NamedTuple):
    """Limits of a spool; beyond them the oldest waiting rows are given up."""

    rows_bytes: int = 1 << 30
    age_s: float = 30 * 86_400.0
    #: rows in memory while the disk takes nothing
    held_rows: int = 10_000
    traces: int = 1000
    traces_bytes: int = 64 << 20
    #: refused rows kept for inspection
    refused_rows: int = 1000


class SpoolFile:
    """Open or create the file of a spool.

    Parameters
    ----------
    path : Path
        The file.
    owner : Owner
        Whose rows it holds; written into a new file, compared with an old one's.

    Raises
    ------
    SpoolFileError
        The file is good but not for this.
    SpoolDamagedError, sqlite3.Error
        The file is spoiled; or the disk does not give or take.
    """

    def __init__(self, path: Path, owner: Owner) -> None:
        self.connection = spool_row.connect(path)
        try:
            spool_row.check(self.connection)
            spool_row.prepare(self.connection, path)
            self._claim(path, owner)
            self._tasks = {
                key: spool_row.SpooledTask(sha256, tuple(json.loads(ids)))
                for key, sha256, ids in self.connection.execute("SELECT task_key, sha256, carrier_ids FROM task")
            }
            self.waiting, self.rows_bytes = self._one("SELECT count(*), coalesce(sum(size_bytes), 0) FROM measured")
        except BaseException:
            self.connection.close()
            raise

    def close(self) -> None:
        """Close the file; the log is folded into it."""
        self.connection.close()

    @property
    def last_seq(self) -> int:
        """Greatest number ever given, 0 before the first."""
        found = self.connection.execute("SELECT seq FROM sqlite_sequence WHERE name = 'measured'").fetchone()
        return int(found[0]) if found else 0

    def tallies(self) -> dict[str, int]:
        """Return the counters since the file was begun."""
        return dict(self.connection.execute("SELECT name, count FROM tally"))

    def store(
        self,
        rows: Collection[WaitingRow],
        traces: Iterable[tuple[Any, ...]],
        bounds: Bounds,
        *,
        now_us: int,
        given_up: int = 0,
        in_flight: frozenset[int] = frozenset(),
    ) -> dict[str, int]:
        """Write rows and traces, after making room for them.

        Parameters
        ----------
        rows : collection of WaitingRow
            Those whose epoch is there already are left out.
        traces : iterable
            As `trace_of` gives them.
        bounds : Bounds
            What the file may hold.
        now_us : int
            Present, microseconds UTC.
        given_up : int
            Rows before these that never came to the disk: their numbers are used up.
        in_flight : frozenset of int
            Epochs of rows that are being sent: room is not made at their cost.

        Returns
        -------
        dict
            Rows given up for room, by reason: aged, full.
        """
        with self._atomic():
            self.number_from(self.last_seq + given_up)
            self.count("dropped_memory", given_up)
            dropped = self._make_room(sum(spool_row.size_of(row.blobs) for row in rows), bounds, now_us, in_flight)
            for row in rows:
                self._insert(row)
            for trace in traces:
                self.connection.execute(_INSERT_TRACE, trace)
                dropped_traces = self.connection.execute(_DELETE_TRACES, (bounds.traces, bounds.traces_bytes))
                self.count("traces_dropped", dropped_traces.rowcount)
        return dropped

    def batch(self, lane: UploadLane, cutoff_us: int, limit: int) -> list[spool_row.SpooledRow]:
        """Return the oldest rows of a lane, of one task and without a gap in their numbers; they stay in the file."""
        first = self.connection.execute(
            f"SELECT seq FROM measured WHERE epoch_us {lane.value} ? "  # noqa: S608 one of two signs
            "AND epoch_us NOT IN (SELECT epoch_us FROM gone) ORDER BY epoch_us LIMIT 1",
            (cutoff_us,),
        ).fetchone()
        rows: list[spool_row.SpooledRow] = []
        if first is None:
            return rows
        for seq, epoch_us, task_key, *blobs in self.connection.execute(_SELECT_ROWS, (first[0], limit)):
            task, is_live = self._tasks[task_key], epoch_us >= cutoff_us
            if is_live != (lane is UploadLane.LIVE) or (rows and (seq != first[0] + len(rows) or task != rows[0].task)):
                break
            rows.append(spool_row.SpooledRow(seq, task, _decoded(epoch_us, blobs)))
        return rows

    def settle(self, epochs_us: Iterable[int], refused: Sequence[RefusedRow], bounds: Bounds, now_us: int) -> None:
        """Take rows off that the service has accounted for; refused ones are kept apart, the oldest of them go."""
        before = self.waiting
        with self._atomic():
            for row in refused:
                columns = (row.seq, row.row.epoch_us, self._task_key(row.row.task), now_us, row.code, row.detail)
                self.connection.execute(_INSERT_REFUSED, (*columns, *row.row.blobs))
            for epoch_us in epochs_us:
                query = "DELETE FROM measured WHERE epoch_us = ? RETURNING size_bytes"
                for (size_bytes,) in self.connection.execute(query, (epoch_us,)).fetchall():
                    self.waiting, self.rows_bytes = self.waiting - 1, self.rows_bytes - size_bytes
            self.count("settled", before - self.waiting)
            self.count("refused", len(refused))
            if refused:
                limit = "SELECT max(refused_key) FROM refused"
                query = f"DELETE FROM refused WHERE refused_key <= ({limit}) - ?"  # noqa: S608 own text
                self.connection.execute(query, (bounds.refused_rows,))

    def hide(self, epochs_us: Iterable[int]) -> None:
        """Leave rows out of batches although the disk lets none be deleted."""
        self.connection.executemany("INSERT OR IGNORE INTO gone VALUES (?)", ((each,) for each in epochs_us))

    def unhide(self) -> None:
        """Forget what was hidden."""
        self.connection.execute("DELETE FROM gone")

    @property
    def traces_waiting(self) -> int:
        """Traces that the service has not taken."""
        return self._one("SELECT count(*) FROM trace")[0]

    def traces(self, limit: int) -> list[spool_row.SpooledTrace]:
        """Return the oldest traces; they stay."""
        return [spool_row.SpooledTrace(*columns) for columns in self.connection.execute(_SELECT_TRACES, (limit,))]

    def settle_traces(self, keys: Iterable[int]) -> None:
        """Take traces off; those that are gone already do not matter."""
        with self._atomic():
            self.connection.executemany("DELETE FROM trace WHERE trace_key = ?", ((key,) for key in keys))

    def plan_of(self, task: spool_row.SpooledTask) -> int | None:
        """Return the carrier plan under which rows of a task were last sent."""
        query = "SELECT plan_id FROM task WHERE task_key = ?"
        found = [key for key, known in self._tasks.items() if known == task]
        return next((row[0] for key in found for row in self.connection.execute(query, (key,))), None)

    def keep_plan(self, task: spool_row.SpooledTask, plan_id: int) -> None:
        """Keep the carrier plan under which rows of a task are sent from now on."""
        with self._atomic():
            query = "UPDATE task SET plan_id = ? WHERE task_key = ?"
            self.connection.execute(query, (plan_id, self._task_key(task)))

    def shrink(self, free_bytes: int) -> None:
        """Give pages back to the disk when more than this lie idle."""
        pages, size_bytes = self._one("PRAGMA freelist_count")[0], self._one("PRAGMA page_size")[0]
        if pages * size_bytes > free_bytes:
            # one page a step: `execute` would take the first step only
            self.connection.executescript("PRAGMA incremental_vacuum")

    def number_from(self, last_seq: int) -> None:
        """Let the next row have the number after this one, unless it has a greater one already."""
        if last_seq > self.last_seq:
            self.connection.execute("DELETE FROM sqlite_sequence WHERE name = 'measured'")
            self.connection.execute("INSERT INTO sqlite_sequence (name, seq) VALUES ('measured', ?)", (last_seq,))

    def count(self, name: str, more: int) -> None:
        """Add to a tally, inside a transaction."""
        if more:
            self.connection.execute(
                "INSERT INTO tally VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET count = count + excluded.count",
                (name, more),
            )

    def restore(self, rows: Iterable[tuple[int, WaitingRow]], last_seq: int, lost: int) -> None:
        """Write rows under the numbers they had in a spoiled file; the next one gets a number above the last."""
        with self._atomic():
            for seq, row in rows:
                self._insert(row, seq)
            self.number_from(last_seq)
            self.count("dropped_corrupt", lost)

    def _insert(self, row: WaitingRow, seq: int | None = None) -> None:
        """Write one row, unless its epoch is there."""
        if self.connection.execute("SELECT 1 FROM measured WHERE epoch_us = ?", (row.epoch_us,)).fetchone():
            return
        size_bytes = spool_row.size_of(row.blobs)
        columns = (seq, row.epoch_us, self._task_key(row.task), row.kept_at_us, size_bytes)
        self.connection.execute(_INSERT_ROW, (*columns, *row.blobs))
        self.waiting, self.rows_bytes = self.waiting + 1, self.rows_bytes + size_bytes

    def _make_room(self, needed: int, bounds: Bounds, now_us: int, in_flight: frozenset[int]) -> dict[str, int]:
        """Give up the oldest rows until age and size are kept; return how many, by reason."""
        aged_us = now_us - round(bounds.age_s * US_PER_S)
        dropped: dict[str, int] = {}
        for seq, epoch_us, size_bytes, kept_at_us in self._oldest_first():
            is_aged = kept_at_us < aged_us
            if not is_aged and self.rows_bytes + needed <= bounds.rows_bytes:
                break
            if epoch_us not in in_flight:
                self.connection.execute("DELETE FROM measured WHERE seq = ?", (seq,))
                self.waiting, self.rows_bytes = self.waiting - 1, self.rows_bytes - size_bytes
                reason = "aged" if is_aged else "full"
                dropped[reason] = dropped.get(reason, 0) + 1
        for reason, rows in dropped.items():
            self.count(f"dropped_{reason}", rows)
        return dropped

    def _oldest_first(self) -> Iterator[tuple[int, int, int, int]]:
        """Yield rows by number, a few at a time; those hidden have been sent and are no loss."""
        query = (
            "SELECT seq, epoch_us, size_bytes, kept_at_us FROM measured "
            "WHERE seq > ? AND epoch_us NOT IN (SELECT epoch_us FROM gone) ORDER BY seq LIMIT ?"
        )
        after, limit = 0, 1  # mostly one look says that nothing must go
        while chunk := self.connection.execute(query, (after, limit)).fetchall():
            yield from chunk
            after, limit = chunk[-1][0], _CHUNK

    def _task_key(self, task: spool_row.SpooledTask) -> int:
        """Return the key of a task, written at its first row."""
        found = next((key for key, known in self._tasks.items() if known == task), None)
        if found is None:
            text = json.dumps(task.carrier_ids)
            self.connection.execute(
                "INSERT OR IGNORE INTO task (sha256, carrier_ids) VALUES (?, ?)", (task.sha256, text)
            )
            query = "SELECT task_key FROM task WHERE sha256 = ? AND carrier_ids = ?"
            found = int(self.connection.execute(query, (task.sha256, text)).fetchone()[0])
            self._tasks[found] = task
        return found

    def _claim(self, path: Path, owner: Owner) -> None:
        """Write whose file this is, or refuse another one's."""
        holder = self.connection.execute("SELECT spacecraft_id, source FROM owner").fetchone()
        if holder is None:
            with spool_row.transaction(self.connection):
                self.connection.execute("INSERT INTO owner VALUES (?, ?)", owner)
        elif Owner(*holder) != owner:
            message = f"spool {path} holds rows of {holder[0]}, source {holder[1]}; name another file"
            raise spool_row.SpoolFileError(message)

    @contextmanager
    def _atomic(self) -> Iterator[None]:
        """Commit what is done inside, or nothing, what this object knows of the file included."""
        before = (self.waiting, self.rows_bytes, dict(self._tasks))
        try:
            with spool_row.transaction(self.connection):
                yield
        except BaseException:
            self.waiting, self.rows_bytes, self._tasks = before
            raise

    def _one(self, query: str) -> tuple[int, ...]:
        """Return the only row of a query."""
        found: tuple[int, ...] = self.connection.execute(query).fetchone()
        return found


def _decoded(epoch_us: int, blobs: Sequence[bytes]) -> Any:
    """Return the arrays of a row; bytes that are no arrays are damage."""
    try:
        return spool_row.decode_row(epoch_us, blobs)
    except ValueError as error:
        raise spool_row.SpoolDamagedError(str(error)) from error
