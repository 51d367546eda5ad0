"""Engines on PostgreSQL: one writer at a time over all processes, and no wait without an end.

The server ends statements and lock waits that take too long, and transactions whose client has stopped. A server that
has stopped itself ends nothing, and its kernel still takes what is sent: so the client, too, gives up waiting for an
answer, a moment later, and closes the connection. What was under way may be committed after all; natural keys make
sending it again harmless.
"""

import math
import time
from collections.abc import Generator
from typing import Any, TypeVar

from psycopg import Connection as PsycopgConnection
from psycopg import OperationalError
from psycopg.errors import ConnectionTimeout
from sqlalchemy import Connection, Engine, NullPool, create_engine, event, text
from sqlalchemy.engine import URL

#: the server speaks first: an answer that says why is better than a closed connection, s
_GRACE_S = 1.0
#: least time that the driver waits for a connection, s
_LEAST_CONNECT_S = 2
#: any number, the same in every process; another one than that of the migrations
_WRITERS_LOCK = 5_210_120
_WAIT_FOR_LOCK = text("SELECT pg_advisory_xact_lock(:lock)").bindparams(lock=_WRITERS_LOCK)

_Ready = Any
_Answer = TypeVar("_Answer")


class NoAnswerError(OperationalError):
    """The server did not answer in time."""

    #: looked for by ``db.connection.retryable_errors``, which knows no driver
    is_wait_ended = True


class BoundedConnection(PsycopgConnection[Any]):
    """A connection that gives up when the server does not answer in time.

    Attributes
    ----------
    limit_s : float
        Longest wait for an answer, s; infinite until it is set.
    """

    limit_s = math.inf

    def wait(self, gen: Generator[_Ready, _Ready, _Answer], *args: Any, **options: Any) -> _Answer:
        """Return the result of an exchange with the server; OperationalError when it takes too long."""
        try:
            answer: _Answer = super().wait(_bounded(gen, self.limit_s), *args, **options)
        except NoAnswerError:
            # what the connection would say next belongs to the statement that was given up
            self.pgconn.finish()
            raise
        return answer


def postgresql_engines(target: URL, readers: int, limit_s: float | None) -> tuple[Engine, Engine]:
    """Return the engine of the writer and that of readers.

    Parameters
    ----------
    target : URL
        The database.
    readers : int
        Connections kept for reading; as many more are made when they are wanted.
    limit_s : float or None
        Longest wait for an answer; None = as long as it takes, for work that nobody waits for.
    """
    write = create_engine(target, pool_size=1, max_overflow=1, pool_pre_ping=True)
    read = create_engine(target, pool_size=readers, max_overflow=readers, pool_pre_ping=True).execution_options(
        isolation_level="REPEATABLE READ", postgresql_readonly=True
    )
    event.listen(write, "begin", _wait_for_turn)
    if limit_s is not None:
        _bound(write, limit_s, {"idle_in_transaction_session_timeout"})
        _bound(read, limit_s, frozenset())
    return write, read


def lease_engine(target: URL, limit_s: float) -> Engine:
    """Return an engine whose one connection holds a lock for as long as it is open, outside any transaction."""
    engine = create_engine(target, poolclass=NullPool, isolation_level="AUTOCOMMIT")
    _bound(engine, limit_s, frozenset())
    return engine


def _wait_for_turn(connection: Connection) -> None:
    """Let one transaction write at a time, as SQLite does: groups of two services never wait for each other's rows."""
    connection.execute(_WAIT_FOR_LOCK)


def _bound(engine: Engine, limit_s: float, more: set[str] | frozenset[str]) -> None:
    """Give every connection of an engine its limits."""
    limits = " ".join(f"-c {name}={round(1000 * limit_s)}" for name in ("statement_timeout", "lock_timeout", *more))

    def connect(_dialect: Any, _record: Any, arguments: list[Any], options: dict[str, Any]) -> BoundedConnection:
        options["options"] = f"{options.get('options', '')} {limits}".strip()
        options.setdefault("connect_timeout", max(_LEAST_CONNECT_S, math.ceil(limit_s / 2)))
        try:
            connection = BoundedConnection.connect(*arguments, **options)
        except ConnectionTimeout as fault:
            message = f"the server has made no connection within {options['connect_timeout']} s"
            raise NoAnswerError(message) from fault
        connection.limit_s = limit_s + _GRACE_S
        return connection

    event.listen(engine, "do_connect", connect)


def _bounded(gen: Generator[_Ready, _Ready, _Answer], limit_s: float) -> Generator[_Ready, _Ready, _Answer]:
    """Pass an exchange on until it ends or has taken too long; the driver looks in several times a second."""
    until_s = time.monotonic() + limit_s
    try:
        wanted = next(gen)
        while True:
            ready = yield wanted
            if time.monotonic() > until_s:
                message = f"the server has not answered for {limit_s:g} s"
                raise NoAnswerError(message)
            wanted = gen.send(ready)
    except StopIteration as end:
        answer: _Answer = end.value
        return answer
