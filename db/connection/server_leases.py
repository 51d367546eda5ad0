"""Leases of the spacecraft of an archive on a server: members share them out, and announce changes to each other."""

import logging
import math
import os
import socket
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any

from psycopg import Error as DriverError
from sqlalchemy import Connection, Row, delete, select, text, update
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from db.connection.engines import translated_faults
from db.connection.lease import Result, lost, none_held
from db.connection.server_engines import end_stopped_writers, session_engine
from db.tables import MEMBERS_LOCK, SERVER_NOW_US, lease, live_member, member
from service.ports.storage import ARCHIVE, LeaseLoan, Term

_log = logging.getLogger(__name__)

_JOIN = member.insert().values(is_estimator=False, seen_at_us=SERVER_NOW_US).returning(member.c.member_id)
_FORGET = delete(member).where(
    member.c.seen_at_us < SERVER_NOW_US - 86_400_000_000, member.c.member_id.not_in(select(live_member.c.member_id))
)
_LOCKED = text("SELECT pg_try_advisory_lock(:locks, :member)").bindparams(locks=MEMBERS_LOCK)
_PROCESS = text("SELECT pg_backend_pid()")
_LIVE = select(live_member.c.member_id, live_member.c.is_estimator)
_LEASES = text(
    # other: of no spacecraft, but of the archive, or of one that was deleted; holder and term are null before the first
    "SELECT coalesce(spacecraft.id, lease.name) AS name, holder, term, spacecraft.id IS NULL AS is_other "
    "FROM lease FULL JOIN spacecraft ON spacecraft.id = lease.name ORDER BY 1"
)
_MAKE = text(
    "INSERT INTO lease (name, holder, term) SELECT unnest(CAST(:names AS text[])), 0, 0 ON CONFLICT DO NOTHING"
)
_ACQUIRE = text(
    "UPDATE lease SET holder = :member, term = lease.term + 1 FROM (SELECT name FROM lease JOIN "
    "unnest(CAST(:names AS text[]), CAST(:terms AS bigint[])) AS free (name, term) USING (name, term) "
    "FOR UPDATE OF lease SKIP LOCKED) AS free WHERE lease.name = free.name RETURNING lease.name, lease.term"
)
_GIVE_BACK = text(
    "UPDATE lease SET holder = 0 WHERE name IN (SELECT name FROM lease WHERE name = ANY(:names) AND holder = :member "
    "FOR UPDATE SKIP LOCKED)"
)
_IS_OURS = text("SELECT 1 FROM lease WHERE name = :name AND holder = :member AND term = :term FOR SHARE")
_LEADERS = select(lease.c.name, live_member.c.name).join(live_member, live_member.c.member_id == lease.c.holder)
#: with the two queries before at most five: the driver prepares the sixth, whose name another session has already
_LATER_QUERIES = 3
_NO_SESSION = (
    "the database's URL leads to a pooler that changes the server's session between transactions, in which locks and "
    "notifications do not hold: let the pooler run in session mode, or connect to the server itself"
)


class ServerLeases:
    """Leases of the spacecraft of an archive on a server.

    Parameters
    ----------
    url : str
        The archive.
    limit_s : float
        Longest wait for an answer.
    read : callable
        Opens a read transaction.
    """

    def __init__(self, url: str, limit_s: float, read: Callable[[], AbstractContextManager[Connection]]) -> None:
        self._read = read
        self._target, self._limit_s = make_url(url), limit_s
        self.name = f"{socket.gethostname()}:{os.getpid()}"
        self.member: int | None = None
        self._session: Connection | None = None
        self._pid = 0
        self._terms: dict[str, int] = {}
        self._live: frozenset[int] = frozenset()
        self._led_s = time.monotonic()
        self._ended = 0
        self._announcer: Connection | None = None
        self._announcer_pid = 0
        #: programs that only look at an archive, or repair it, ask for no lease and need none
        self._is_wanted = False
        self._is_refused = False

    def require_sessions(self) -> None:
        """Raise ValueError where a pooler gives the transactions of one connection to several sessions."""
        with translated_faults(), self._connected() as first, self._connected() as second:
            require_own_session(first, second)

    def poll(self, *, is_estimator: bool) -> Term:
        """Renew, acquire and give back leases; return the terms that are held."""
        self._is_wanted = True
        try:
            session = self._session or self._join()
            self._terms = self._shared_out(session, is_estimator=is_estimator)
            if ended := end_stopped_writers(session, self._limit_s):
                _log.warning("ended %d transactions of processes that were stopped within them", ended)
        except (SQLAlchemyError, ValueError) as fault:
            if self._terms or not self._is_refused:
                _log.warning("the archive gives no leases, this process leads nothing until it does: %s", fault)
            self._is_refused = True
            self._leave()
            return none_held
        self._is_refused = False
        terms = self._terms
        return lambda name: terms.get(name, 0)

    def silent_s(self) -> float:
        """Return the time since a poll found the lease of the archive with a member that lives."""
        return time.monotonic() - self._led_s

    def wait(self, limit_s: float) -> frozenset[str]:
        """Wait for announcements of other processes."""
        if self._session is None:
            time.sleep(limit_s)
            return frozenset()
        try:
            driver: Any = self._session.connection.driver_connection
            heard = [each for each in driver.notifies(timeout=limit_s, stop_after=1) if each.pid != self._announcer_pid]
        except (DriverError, SQLAlchemyError):
            # the next poll joins again, and until then nothing is led
            self._leave()
            return frozenset()
        return frozenset(name for each in heard for name in each.payload.split())

    def leaders(self) -> dict[str, str]:
        """Return the names of the members that lead."""
        with self._read() as connection:
            return leaders_of(connection)

    def ended(self) -> int:
        """Return how many members have ended since the first poll."""
        return self._ended

    def announce(self, spacecraft_ids: Iterable[str]) -> None:
        """Notify other members; after the commit, since notifications of transactions wait for each other's commits."""
        if self.member is None:
            return
        try:
            if self._announcer is None:
                self._announcer = self._connected()
                self._announcer.execute(text("SET synchronous_commit = off"))
                self._announcer_pid = int(self._announcer.scalar(_PROCESS) or 0)
            announced = {"names": " ".join(spacecraft_ids)}
            self._announcer.execute(text("SELECT pg_notify('soo_changes', :names)"), announced)
        except SQLAlchemyError as fault:
            _log.info("changes were not announced, other processes find them by their polls: %s", fault)
            _close(self._announcer)
            self._announcer = None

    def lend(self) -> LeaseLoan | None:
        """Return number and terms of this process."""
        return (self.member, dict(self._terms)) if self._is_wanted else None

    def borrow(self, loan: LeaseLoan | None) -> None:
        """Take over number and terms of another process; the server compares them at every write."""
        if loan is not None:
            self._is_wanted, (self.member, terms) = True, loan
            self._terms = dict(terms)

    def give_back(self) -> None:
        """End the session, and all leases with it."""
        if self._session is not None and self._terms:
            try:
                self._session.execute(_GIVE_BACK, {"names": list(self._terms), "member": self.member})
            except SQLAlchemyError:
                _log.info("leases end with the session")
        self._leave()
        _close(self._announcer)
        self._announcer = None

    def under(self, work: Callable[[Connection], Result], name: str) -> Callable[[Connection], Result]:
        """Return a write that is refused where leases were asked for and that of a name is not ours."""

        def write(connection: Connection) -> Result:
            if self._is_wanted:
                wanted = {"name": name, "member": self.member or 0, "term": self._terms.get(name, 0)}
                if connection.execute(_IS_OURS, wanted).first() is None:
                    raise lost(name)
            return work(connection)

        return write

    def _join(self) -> Connection:
        """Open the session of this process: its number, the lock of that number, and the channel of changes."""
        session = self._connected()
        try:
            with self._connected() as second:
                require_own_session(session, second)
            # under the same number again where only the connection was lost: jobs and leases are still its own
            if self.member is None or not session.scalar(_LOCKED, {"member": self.member}):
                self.member = int(session.scalar(_JOIN.values(name=self.name)) or 0)
                session.execute(_LOCKED, {"member": self.member})
            session.execute(_FORGET)
            session.execute(text("LISTEN soo_changes"))
            self._pid = int(session.scalar(_PROCESS) or 0)
        except (SQLAlchemyError, ValueError):
            _close(session)
            raise
        self._session = session
        return session

    def _shared_out(self, session: Connection, *, is_estimator: bool) -> dict[str, int]:
        """Renew, and return the terms of the leases that are held after this poll."""
        if session.scalar(_PROCESS) != self._pid:
            raise ValueError(_NO_SESSION)
        renewed = update(member).where(member.c.member_id == self.member)
        if not session.execute(renewed.values(seen_at_us=SERVER_NOW_US, is_estimator=is_estimator)).rowcount:
            # stopped for a day
            self.member = None
            message = "this process was silent for long, it joins again"
            raise ValueError(message)
        live = {each.member_id: each.is_estimator for each in session.execute(_LIVE)}
        if self._live - set(live):
            self._ended += 1
        self._live = frozenset(live)
        leases = session.execute(_LEASES).all()
        missing = [each.name for each in leases if each.term is None]
        if missing or ARCHIVE not in {each.name for each in leases}:
            session.execute(_MAKE, {"names": [ARCHIVE, *missing]})
            leases = session.execute(_LEASES).all()
        held = self._acquired(session, leases, live) if is_estimator else self._given_back(session, leases)
        if ARCHIVE in held or any(each.name == ARCHIVE and each.holder in live for each in leases):
            self._led_s = time.monotonic()
        return held

    def _acquired(self, session: Connection, leases: Sequence[Row[Any]], live: dict[int, bool]) -> dict[str, int]:
        """Acquire leases that are free up to the share of this process, and give back those above it."""
        held = {each.name: each.term or 0 for each in leases if each.holder == self.member}
        spacecraft = [each for each in leases if not each.is_other]
        share = math.ceil(len(spacecraft) / max(1, sum(live.values())))
        own = [each for each in spacecraft if each.name in held]
        free = [each for each in spacecraft if each.holder not in live][: max(0, share - len(own))]
        free += [each for each in leases if each.name == ARCHIVE and each.holder not in live]
        if free:
            wanted = {"names": [each.name for each in free], "terms": [each.term for each in free]}
            held |= {row[0]: row[1] for row in session.execute(_ACQUIRE, {**wanted, "member": self.member})}
        above = [each.name for each in own[share:]]
        if above:
            # no write begins under a lease that goes
            self._terms = {name: term for name, term in self._terms.items() if name not in above}
            session.execute(_GIVE_BACK, {"names": above, "member": self.member})
        return {name: term for name, term in held.items() if name not in above}

    def _given_back(self, session: Connection, leases: Sequence[Row[Any]]) -> dict[str, int]:
        """Give back every lease: this process is no estimator."""
        held = [each.name for each in leases if each.holder == self.member]
        if held:
            session.execute(_GIVE_BACK, {"names": held, "member": self.member})
        return {}

    def _leave(self) -> None:
        """Hold nothing; the lock of this member ends with its session."""
        session, self._session, self._terms = self._session, None, {}
        _close(session)

    def _connected(self) -> Connection:
        return session_engine(self._target, self._limit_s).connect()


def leaders_of(connection: Connection) -> dict[str, str]:
    """Return the name of the live member that leads each spacecraft, and the archive."""
    return {row[0]: row[1] for row in connection.execute(_LEADERS)}


def require_own_session(first: Connection, second: Connection) -> None:
    """Raise ValueError unless two connections have a session each, and keep it.

    A pooler in transaction mode gives the next transaction the session that was used last, or another each time; it
    may take one back only after its answer was passed on, so the session is asked for again at the end.
    """
    before = first.scalar(_PROCESS)
    second.execute(text("BEGIN"))
    try:
        other = second.scalar(_PROCESS)
        own = {first.scalar(_PROCESS)}
    finally:
        second.execute(text("ROLLBACK"))
    own |= {first.scalar(_PROCESS) for _ in range(_LATER_QUERIES)}
    if own != {before} or other == before:
        raise ValueError(_NO_SESSION)


def _close(connection: Connection | None) -> None:
    """Close a connection; one that is broken is closed already."""
    try:
        if connection is not None:
            # no pool: the session ends
            connection.close()
    except (DriverError, SQLAlchemyError):
        _log.debug("a broken connection could not be closed")
