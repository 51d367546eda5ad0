"""Engines of PostgreSQL, whose connections give up when the server does not answer in time."""

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
#: any number, the same in every process
_WRITERS_LOCK = 5_210_120
_WAIT_FOR_LOCK = text("SELECT pg_advisory_xact_lock(:lock)").bindparams(lock=_WRITERS_LOCK)
_SHARE_LOCK = text("SELECT pg_advisory_xact_lock_shared(:lock)").bindparams(lock=_WRITERS_LOCK)
_LOCK_HEADS = text(
    "SELECT spacecraft_key FROM head WHERE spacecraft_key = ANY(:keys) ORDER BY spacecraft_key FOR UPDATE"
)
#: a client that was stopped keeps the locks of its transaction for so long at most: less than a lease, s
_LONGEST_IDLE_S = 10.0
_WRITER = "soo writer"
#: amid a series of statements a transaction is neither idle nor at work for the server, whose limits spare it; what it
#: says of such a session is the state before the last part of the series that came
_END_STOPPED = text(
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = :writer AND state <> 'idle' "
    "AND datname = current_database() AND wait_event_type = 'Client' "
    "AND state_change < clock_timestamp() - make_interval(secs => :idle_s)"
)

_Ready = Any
_Answer = TypeVar("_Answer")


class NoAnswerError(OperationalError):
    """The server did not answer in time."""

    #: looked for by ``db.connection.writer``, which knows no driver
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
        idle_ms = round(1000 * _longest_idle_s(limit_s))
        _bound(write, limit_s, _WRITER, f" -c idle_in_transaction_session_timeout={idle_ms}")
        _bound(read, limit_s, "soo reader")
    return write, read


def end_stopped_writers(session: Connection, limit_s: float) -> int:
    """End the sessions of writers that were stopped between the statements of a series; return how many."""
    ended = session.execute(_END_STOPPED, {"writer": _WRITER, "idle_s": _longest_idle_s(limit_s)})
    return len(ended.all())


def session_engine(target: URL, limit_s: float) -> Engine:
    """Return an engine each of whose connections is a session of its own, outside any transaction."""
    engine = create_engine(target, poolclass=NullPool, isolation_level="AUTOCOMMIT")
    _bound(engine, limit_s, "soo session")
    return engine


def _longest_idle_s(limit_s: float) -> float:
    return min(limit_s, _LONGEST_IDLE_S)


def _wait_for_turn(connection: Connection) -> None:
    """Let one transaction write a spacecraft at a time, and one alone where it does not say which it writes."""
    keys = connection.get_execution_options().get("written_keys")
    if keys:
        connection.execute(_SHARE_LOCK)
        connection.execute(_LOCK_HEADS, {"keys": sorted(keys)})
    else:
        connection.execute(_WAIT_FOR_LOCK)


def _bound(engine: Engine, limit_s: float, name: str, more: str = "") -> None:
    """Give every connection of an engine its limits, and the name that the server lists it by."""
    limits = " ".join(f"-c {name}={round(1000 * limit_s)}" for name in ("statement_timeout", "lock_timeout")) + more

    def connect(_dialect: Any, _record: Any, arguments: list[Any], options: dict[str, Any]) -> BoundedConnection:
        options["options"] = f"{options.get('options', '')} {limits}".strip()
        options["application_name"] = name
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
