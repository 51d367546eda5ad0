"""The spool: every measured row is on this machine's disk before it counts as measured, until the service has it.

Law of this file: measuring never stops for the disk. A row that the disk does not take is held in memory, sent from
there, and written when the disk is back; rows that had to be given up are counted, warned of, and leave a gap in the
numbers. A file that is spoiled is set aside under a new name, what can be read of it is carried over, and the numbers
go on. Safe from any thread; one process owns a spool.
"""

import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.spool import disk as codes
from service.frontend.spool.disk import DISK_FAULTS, SpoolDisk, SpoolWarning, WarningBoard
from service.frontend.spool.file import Bounds, Owner, RefusedRow, SpoolFile, UploadLane, WaitingRow
from service.frontend.spool.row import (
    SpooledRow,
    SpooledTask,
    SpooledTrace,
    SpoolError,
    decode_row,
    encode_row,
    trace_of,
)
from service.records.levels.measurement import Sweep

T = TypeVar("T")

#: wait between two attempts to write to a disk that failed, s
_RETRY_S = 1.0
#: traces on their way to the disk
_TRACES_HELD = 16
#: idle bytes in the file above which pages go back to the disk when it is empty
_IDLE_BYTES = 16 << 20


class SpoolState(NamedTuple):
    """State of a spool: rows that wait, and counters since its file was begun."""

    #: rows that the service has not accepted, those in memory included
    waiting: int
    #: rows in memory, because the disk cannot be written
    held: int
    rows_bytes: int
    #: greatest number ever given
    last_seq: int
    #: rows that the service refused by name
    refused: int
    #: rows given up by reason: aged, full, memory, corrupt
    dropped: dict[str, int]
    traces_waiting: int
    traces_dropped: int


class _Settlement(NamedTuple):
    """Rows to be taken off the file."""

    epochs_us: tuple[int, ...]
    refused: tuple[RefusedRow, ...]


def spool_path(folder: Path, spacecraft_id: str, source: str) -> Path:
    """Return the file of a source in a folder; signs that a file system may not take are written as numbers."""
    name = "@".join(
        "".join(sign if sign.isascii() and (sign.isalnum() or sign in "-_.") else f"%{ord(sign):x}" for sign in word)
        for word in (source, spacecraft_id)
    )
    return folder / f"{name}.spool"


class Spool:
    """Rows and traces of one source.

    Parameters
    ----------
    path : Path
        File of the spool; made with its folder when there is none.
    owner : Owner
        Spacecraft and source of the rows.
    task : SpooledTask
        What the arrays of the rows to come stand for.
    now_us : callable
        Present, microseconds UTC; read once at the start, then steps of the clock age no row.
    bounds : Bounds
        What it may hold.
    trace_period_s : float
        Least time between two kept traces of the same sweep, s; 0 keeps every one, infinity none.
    elapsed_s : callable
        Clock that only runs forward, s.

    Raises
    ------
    SpoolInUseError
        Another process owns it.
    SpoolFileError
        The file is of another spacecraft or source, or of another layout.
    """

    def __init__(
        self,
        path: Path,
        owner: Owner,
        task: SpooledTask,
        now_us: Callable[[], int],
        bounds: Bounds | None = None,
        *,
        trace_period_s: float = 10.0,
        elapsed_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._task = task
        self._bounds = bounds or Bounds()
        self._trace_period_s = trace_period_s
        self._elapsed_s = elapsed_s
        self._started_us = now_us() - round(1e6 * elapsed_s())
        self._changed = threading.Condition(threading.RLock())
        self._is_awake = False
        self._board = WarningBoard()
        self._disk = SpoolDisk(path, owner, self._board, self._now_us)
        self._known: SpoolFile | None = None
        self._retry_at_s = float("-inf")
        #: rows and traces that the disk has not taken, and what it has not let go
        self._held: dict[int, WaitingRow] = {}
        self._given_up = 0
        self._traces: list[tuple[Any, ...]] = []
        self._traces_lost = 0
        self._traced_at_s: dict[str, float] = {}
        self._overdue: list[_Settlement] = []
        self._in_flight: frozenset[int] = frozenset()
        self._tallies: dict[str, int] = {}
        try:
            self._ready()
        except SpoolError:
            self._disk.close()
            raise
        except (sqlite3.Error, OSError) as error:
            self._note(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write what is held, if the disk takes it, and give the spool up."""
        with self._changed:
            self._retry_at_s = float("-inf")
            if self._held or self._traces or self._overdue:
                self._attempt(self._write)
            self._disk.close()

    # What is measured comes in

    def append(self, row: MeasuredRow) -> bool:
        """Take a row; True when it is on the disk, False while it is only in memory."""
        waiting = WaitingRow(row.epoch_us, self._task, self._now_us(), encode_row(row))
        with self._changed:
            self._hold(waiting)
            is_kept = self._attempt(self._write) is not None
            self._changed.notify_all()
        return is_kept

    def append_trace(self, sweep: Sweep) -> None:
        """Take a sweep as evidence, unless one of its name was taken lately; it is written with the next row."""
        with self._changed:
            now_s = self._elapsed_s()
            if now_s - self._traced_at_s.get(sweep.sweep_id, float("-inf")) < self._trace_period_s:
                return
            self._traced_at_s[sweep.sweep_id] = now_s
            self._traces.append(trace_of(sweep))
            if len(self._traces) > _TRACES_HELD:
                self._traces_lost += 1
                del self._traces[0]

    # What the service takes goes out

    def batch(self, lane: UploadLane, cutoff_us: int, limit: int) -> list[SpooledRow]:
        """Return the oldest rows of a lane: of one task, their numbers without a gap; none has a number in memory.

        Parameters
        ----------
        lane : UploadLane
            Rows younger than the limit of lateness, or the others.
        cutoff_us : int
            Oldest epoch of the live lane, microseconds UTC.
        limit : int
            Rows at most.
        """
        with self._changed:
            none: list[SpooledRow] = []
            rows = self._read(lambda file: file.batch(lane, cutoff_us, limit), none)
            if not rows:
                held = (
                    each for each in self._held.values() if (each.epoch_us >= cutoff_us) == (lane is UploadLane.LIVE)
                )
                first = next(held, None)
                if first is not None:
                    alike = (each for each in held if each.task == first.task)
                    rows = [
                        SpooledRow(None, each.task, decode_row(each.epoch_us, each.blobs))
                        for each in (first, *islice(alike, limit - 1))
                    ]
            self._in_flight = frozenset(each.row.epoch_us for each in rows)
        return rows

    def settle(self, rows: Sequence[SpooledRow], refusals: Mapping[int, tuple[str, str]] | None = None) -> None:
        """Let rows go that the service has accounted for; places, codes and words of refused ones are kept."""
        refused = tuple(
            RefusedRow(
                rows[position].seq,
                WaitingRow(
                    rows[position].row.epoch_us, rows[position].task, self._now_us(), encode_row(rows[position].row)
                ),
                *said,
            )
            for position, said in (refusals or {}).items()
        )
        with self._changed:
            self._in_flight = frozenset()
            kept = tuple(each.row.epoch_us for each in rows if self._held.pop(each.row.epoch_us, None) is None)
            if kept or refused:
                self._overdue.append(_Settlement(kept, refused))
                if self._attempt(self._write) is None and self._disk.file is not None:
                    self._read(lambda file: file.hide(kept), None)
            if not self.waiting:
                self._board.withdraw(codes.FULL, codes.AGED)
                self._read(lambda file: file.shrink(_IDLE_BYTES), None)

    def traces(self, limit: int) -> list[SpooledTrace]:
        """Return the oldest traces."""
        with self._changed:
            none: list[SpooledTrace] = []
            return self._read(lambda file: file.traces(limit), none)

    def settle_traces(self, traces: Iterable[SpooledTrace]) -> None:
        """Let traces go."""
        keys = [each.key for each in traces]
        with self._changed:
            self._read(lambda file: file.settle_traces(keys), None)

    def plan_of(self, task: SpooledTask) -> int | None:
        """Return the carrier plan under which rows of a task were last sent, by this process or the one before."""
        with self._changed:
            none: int | None = None
            return self._read(lambda file: file.plan_of(task), none)

    def keep_plan(self, task: SpooledTask, plan_id: int) -> None:
        """Keep the carrier plan under which rows of a task are sent: what is sent again goes under the same one."""
        with self._changed:
            self._read(lambda file: file.keep_plan(task, plan_id), None)

    def await_rows(self, rows: int, timeout_s: float | None) -> None:
        """Wait until this many rows wait, somebody calls `wake`, or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_awake or self.waiting >= rows, timeout_s)

    def wake(self) -> None:
        """End every wait in `await_rows`, now and from now on."""
        with self._changed:
            self._is_awake = True
            self._changed.notify_all()

    # What is told of it

    @property
    def waiting(self) -> int:
        """Rows that the service has not taken."""
        with self._changed:
            hidden = sum(len(each.epochs_us) for each in self._overdue)
            return (self._disk.file.waiting - hidden if self._disk.file else 0) + len(self._held)

    @property
    def traces_waiting(self) -> int:
        """Traces that the service has not taken."""
        with self._changed:
            return self._read(lambda file: file.traces_waiting, 0) if self._disk.file else 0

    @property
    def warnings(self) -> list[SpoolWarning]:
        """Return the active warnings, oldest first."""
        with self._changed:
            return self._board.standing()

    @property
    def state(self) -> SpoolState:
        """Return rows that wait and counters of the others."""
        with self._changed:
            self._tallies = self._read(lambda file: file.tallies(), self._tallies)
            dropped = {
                name.removeprefix("dropped_"): rows
                for name, rows in self._tallies.items()
                if name.startswith("dropped_")
            }
            if self._given_up:
                dropped["memory"] = dropped.get("memory", 0) + self._given_up
            return SpoolState(
                waiting=self.waiting,
                held=len(self._held),
                rows_bytes=self._disk.file.rows_bytes if self._disk.file else 0,
                last_seq=self._disk.last_seq,
                refused=self._tallies.get("refused", 0) + sum(len(each.refused) for each in self._overdue),
                dropped=dropped,
                traces_waiting=self.traces_waiting,
                traces_dropped=self._tallies.get("traces_dropped", 0) + self._traces_lost,
            )

    # The disk

    def _now_us(self) -> int:
        """Return the present, free of the steps of the system's clock."""
        return self._started_us + round(1e6 * self._elapsed_s())

    def _hold(self, row: WaitingRow) -> None:
        """Keep a row in memory until the disk has it; the oldest one that is not being sent makes room."""
        self._held.setdefault(row.epoch_us, row)
        if len(self._held) <= self._bounds.held_rows:
            return
        oldest = next((epoch_us for epoch_us in self._held if epoch_us not in self._in_flight), row.epoch_us)
        del self._held[oldest]
        self._given_up += 1
        detail = f"more than {self._bounds.held_rows} rows in memory while the disk cannot be written"
        self._board.put_up(codes.FULL, f"{detail}: {self._given_up} given up", self._now_us())

    def _attempt(self, work: Callable[[SpoolFile], T]) -> T | None:
        """Do something with the file; None when the disk does not let it, or did not a moment ago."""
        if self._elapsed_s() < self._retry_at_s:
            return None
        for _ in range(2):
            try:
                return work(self._ready())
            except DISK_FAULTS as error:
                if not self._note(error):
                    break
        return None

    def _read(self, work: Callable[[SpoolFile], T], otherwise: T) -> T:
        """Do something that a disk without room allows too."""
        if self._disk.file is None:
            found = self._attempt(work)
            return otherwise if found is None else found
        try:
            return work(self._disk.file)
        except DISK_FAULTS as error:
            self._note(error)
            return otherwise

    def _note(self, error: Exception) -> bool:
        """Warn of a fault of the disk and let it rest; True when the file was spoiled and a new one is in its place."""
        if self._disk.face(error, f"{len(self._held)} rows are held in memory"):
            return True
        self._retry_at_s = self._elapsed_s() + _RETRY_S
        return False

    def _write(self, file: SpoolFile) -> bool:
        """Carry out on the file all that is overdue."""
        while self._overdue:
            file.settle(*self._overdue[0], self._bounds, self._now_us())
            del self._overdue[0]
        file.unhide()
        if self._held or self._traces:
            self._disk.mark(file.last_seq + self._given_up + len(self._held))
            dropped = file.store(
                self._held.values(),
                self._traces,
                self._bounds,
                now_us=self._now_us(),
                given_up=self._given_up,
                in_flight=self._in_flight,
            )
            self._held.clear()
            self._traces.clear()
            self._given_up = 0
            self._disk.last_seq = file.last_seq
            self._warn_of(dropped)
        self._board.withdraw(codes.DISK_FULL, codes.UNWRITABLE)
        return True

    def _warn_of(self, dropped: Mapping[str, int]) -> None:
        """Warn of rows that were given up for room."""
        if not dropped:
            return
        totals = self.state.dropped
        if "full" in dropped:
            detail = f"{totals['full']} rows given up beyond {self._bounds.rows_bytes} bytes, the oldest first"
            self._board.put_up(codes.FULL, detail, self._now_us())
        if "aged" in dropped:
            days = self._bounds.age_s / 86_400.0
            self._board.put_up(codes.AGED, f"{totals['aged']} rows given up after {days:g} days", self._now_us())

    def _ready(self) -> SpoolFile:
        """Return the file; in one that was opened again, what is overdue is hidden again."""
        file = self._disk.ready()
        if file is not self._known:
            file.hide(epoch_us for each in self._overdue for epoch_us in each.epochs_us)
            self._known = file
        return file
