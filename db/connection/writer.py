"""The writer: one thread that commits what callers wait for, with the statements that it prepares."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from functools import lru_cache
from itertools import groupby
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar

from sqlalchemy import Boolean, Column, Connection, Engine, LargeBinary, Table
from sqlalchemy.engine import Dialect
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from db.columns import checksums_of
from db.connection.engines import storage_error
from service.errors import StorageError

#: serialization_failure, deadlock_detected: one of two transactions was ended, the other went on
_PASSING = frozenset({"40001", "40P01"})
#: lock_not_available, query_canceled, idle_in_transaction_session_timeout
_WAIT_ENDED = frozenset({"55P03", "57014", "25P03"})
_BUSY = "SQLITE_BUSY"


def is_passing(fault: BaseException) -> bool:
    """Return whether a transaction was ended so that another could go on: it may run again at once."""
    return _state_of(fault) in _PASSING


def is_wait_ended(fault: BaseException) -> bool:
    """Return whether a lock, or an answer of the server, was waited for too long."""
    if not isinstance(fault, DBAPIError):
        return False
    is_busy = getattr(fault.orig, "sqlite_errorname", "").startswith(_BUSY)
    return is_busy or getattr(fault.orig, "is_wait_ended", False) or _state_of(fault) in _WAIT_ENDED


def _state_of(fault: BaseException) -> str | None:
    """Return the code that PostgreSQL gives a fault."""
    found = getattr(fault.orig, "sqlstate", None) if isinstance(fault, DBAPIError) else None
    return None if found is None else str(found)


def insert_new(
    connection: Connection, table: Table, columns: Mapping[str, Sequence[Any]], *, may_exist: bool = True
) -> int:
    """Insert rows by columns; return how many were new: those whose primary key exists stay as they are.

    Where none may exist, one that does is an error.
    """
    if not len(next(iter(columns.values()))):
        return 0
    if "checksum" in table.c:
        columns = {**columns, "checksum": checksums_of(table, columns)}
    text, converters = _insertion(connection.dialect, table, tuple(columns), may_exist)
    pairs = zip(columns.values(), converters, strict=True)
    stored = (column if convert is None else map(convert, column) for column, convert in pairs)
    rows = list(zip(*stored, strict=True))
    return connection.exec_driver_sql(text, rows, execution_options={"preserve_rowcount": True}).rowcount


@lru_cache(maxsize=64)
def _insertion(
    dialect: Dialect,
    table: Table,
    names: tuple[str, ...],
    may_exist: bool,  # noqa: FBT001 - a key of the cache
) -> tuple[str, tuple[Callable[[Any], Any] | None, ...]]:
    """Return the statement that gives values to some columns, and what makes of each value that of the driver."""
    marks = ", ".join(["?" if dialect.positional else "%s"] * len(names))
    text = f"INSERT INTO {table.name} ({', '.join(names)}) VALUES ({marks})"  # noqa: S608 - names of the schema
    converters = tuple(_converter(dialect, table.c[name]) for name in names)
    return f"{text} ON CONFLICT DO NOTHING" if may_exist else text, converters


def _converter(dialect: Dialect, column: Column[Any]) -> Callable[[Any], Any] | None:
    """Return what makes of a value that of the driver; None where the driver takes it as it is."""
    if isinstance(column.type, LargeBinary):
        return None
    if isinstance(column.type, Boolean) and not column.nullable:
        # SQLAlchemy asks of each what it is
        return bool
    return column.type.dialect_impl(dialect).bind_processor(dialect)


Result = TypeVar("Result")
GROUP_LIMIT = 64
#: a group that the server ended in favour of another transaction runs so often
ATTEMPTS = 5

_log = logging.getLogger(__name__)


class _Task(Generic[Result]):
    """One function on its way through the queue."""

    def __init__(
        self, work: Callable[[Connection], Result], reported: Callable[[Result], None] | None, key: int | None
    ) -> None:
        self.work = work
        #: of the spacecraft that alone is written; None = any
        self.key = key
        self._reported = reported
        self.future: Future[Result] = Future()
        self.result: Result | None = None
        self.fault: BaseException | None = None

    def settle(self) -> None:
        """Resolve the caller's future with the result or the error."""
        if self.fault is not None:
            self.future.set_exception(_reported(self.fault))
            return
        try:
            if self._reported is not None:
                self._reported(self.result)  # type: ignore[arg-type]  # set by the work
        except Exception:  # noqa: BLE001 the rows are stored, also where a subscriber fails
            _log.exception("publishing stored rows failed; they are in the archive and are published from its journal")
        self.future.set_result(self.result)  # type: ignore[arg-type]


class Writer:
    """Thread that owns all writing to one database.

    Parameters
    ----------
    engine : Engine
        Engine that opens write transactions.
    committed : callable, optional
        Gets the keys of the spacecraft that a group has written, after its commit; must be quick.
    """

    def __init__(self, engine: Engine, committed: Callable[[frozenset[int]], None] = lambda _: None) -> None:
        self._engine = engine
        self._committed = committed
        self._queue: SimpleQueue[_Task[Any] | None] = SimpleQueue()
        self._lock = Lock()
        self._is_closed = False
        self._thread = Thread(target=self._serve, name="storage-writer", daemon=True)
        self._thread.start()

    def submit(
        self,
        work: Callable[[Connection], Result],
        reported: Callable[[Result], None] | None = None,
        key: int | None = None,
    ) -> Future[Result]:
        """Queue a function; its future resolves after the commit.

        ``reported`` gets the result between commit and future, in the order of the commits; it must be quick. A
        function that writes one spacecraft, under the lock of its head, names it by its key: writers of others, in
        other processes, do not wait for it.
        """
        task = _Task(work, reported, key)
        with self._lock:
            if self._is_closed:
                raise StorageError("storage.closed", "The archive is closing.")
            self._queue.put(task)
        return task.future

    @property
    def waiting(self) -> int:
        """How many functions wait for their turn."""
        return self._queue.qsize()

    def close(self) -> None:
        """Run what is queued, commit it and stop."""
        with self._lock:
            if not self._is_closed:
                self._is_closed = True
                self._queue.put(None)
        self._thread.join()

    def _serve(self) -> None:
        is_open = True
        while is_open:
            group, is_open = self._next_group()
            running = [task for task in group if task.future.set_running_or_notify_cancel()]
            if running:
                self._run(running)

    def _next_group(self) -> tuple[list[_Task[Any]], bool]:
        """Wait for a first function, take along what else waits already."""
        task = self._queue.get()
        group: list[_Task[Any]] = []
        while task is not None:
            group.append(task)
            if len(group) == GROUP_LIMIT:
                return group, True
            try:
                task = self._queue.get_nowait()
            except Empty:
                return group, True
        return group, False

    def _run(self, group: list[_Task[Any]]) -> None:
        """Run a group, commit it, tell the callers."""
        try:
            self._carry_out(group)
        except Exception as fault:  # noqa: BLE001 - every fault belongs to the callers, the thread must live on
            if is_wait_ended(fault):
                group += self._taken_away()
            _log.warning(
                "%d writes were rolled back and are reported as failed to their callers: %s", len(group), fault
            )
            for task in group:
                task.fault = task.fault or fault
        for task in group:
            task.settle()
        keys = frozenset(task.key for task in group if task.key is not None and task.fault is None)
        if keys:
            self._committed(keys)

    def _carry_out(self, group: list[_Task[Any]]) -> None:
        """Run a group and commit it, again where the server ended it in favour of another transaction."""
        for attempt in range(1, ATTEMPTS + 1):
            for task in group:
                task.fault = None
            try:
                with self._engine.connect().execution_options(written_keys=_keys_of(group)) as connection:
                    if not _is_run_together(connection, group):
                        with connection.begin():
                            for task in group:
                                _attempt(connection, task)
            except SQLAlchemyError as fault:
                if attempt == ATTEMPTS or not is_passing(fault):
                    raise
                _log.info("%d writes are retried: %s", len(group), fault)
                time.sleep(0.01 * attempt)
            else:
                return

    def _taken_away(self) -> list[_Task[Any]]:
        taken: list[_Task[Any]] = []
        for _ in range(self._queue.qsize()):
            task = self._queue.get()
            if task is None:
                # the end stays the last
                self._queue.put(None)
                break
            if task.future.set_running_or_notify_cancel():
                taken.append(task)
        return taken


def _keys_of(group: list[_Task[Any]]) -> frozenset[int]:
    """Return the keys of the spacecraft that a group writes; none where one of it may write any."""
    keys = frozenset(task.key for task in group)
    return frozenset() if None in keys else frozenset(key for key in keys if key is not None)


def _is_run_together(connection: Connection, group: list[_Task[Any]]) -> bool:
    """Run a group without savepoints and commit it; False, with nothing changed, when a function fails.

    Nearly always nothing fails, and two statements a function are saved.
    """
    transaction = connection.begin()
    try:
        _run_in_turn(connection, group)
    except Exception as fault:
        transaction.rollback()
        if is_passing(fault) or is_wait_ended(fault):
            raise
        if len(group) > 1:
            return False
        group[0].fault = fault
        return True
    transaction.commit()
    return True


def _run_in_turn(connection: Connection, group: list[_Task[Any]]) -> None:
    """Run a group; neighbours of a kind that can work together do."""
    for kind, neighbours in groupby(group, key=lambda task: type(task.work)):
        tasks = list(neighbours)
        together: Callable[..., list[Any]] | None = getattr(kind, "together", None)
        if together is None or len(tasks) == 1:
            for task in tasks:
                task.result = task.work(connection)
        else:
            results = together(connection, [task.work for task in tasks])
            for task, result in zip(tasks, results, strict=True):
                task.result = result


def _attempt(connection: Connection, task: _Task[Any]) -> None:
    """Run one function inside the transaction of its group, with a savepoint around it."""
    savepoint = connection.begin_nested()
    try:
        task.result = task.work(connection)
    except Exception as fault:
        # raises when the transaction went with the fault: then nothing of the group may pass for stored
        savepoint.rollback()
        if connection.invalidated or is_passing(fault) or is_wait_ended(fault):
            raise
        task.fault = fault
    else:
        savepoint.commit()


def _reported(fault: BaseException) -> BaseException:
    """Return a fault as the caller shall see it."""
    return storage_error(fault) if isinstance(fault, SQLAlchemyError) else fault
