"""Keys in memory, refused requests on their way to the audit log, and what is written down now and then."""

import asyncio
import contextlib
import hmac
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from threading import Lock

from starlette.concurrency import run_in_threadpool

from service.api.access.auth import Principal
from service.errors import StorageError
from service.ports.storage import Audit, Keys
from service.records.epoch import US_PER_S
from service.records.inputs import JournalHead
from service.records.operations import access

#: age from which what was read is read again
REFRESH_S = 2.0
#: age from which a key that is not known is looked for again
RECHECK_S = 0.5
#: age beyond which what was read no longer holds
HOLDS_S = 10.0
LIFE_OF_SESSION_S = 12 * 3600
_LOG = logging.getLogger(__name__)


class StoredKeys:
    """The key ring of the service: the bootstrap key and those of the archive.

    Parameters
    ----------
    keys : Keys
        Where keys are stored.
    bootstrap_key : str or None
        An administrator's key that needs no archive; None or empty = there is none.
    system_us : callable
        The present, for expiry and last use.
    service_id : str
        Id of the service, for which alone its sessions hold.
    """

    def __init__(
        self, keys: Keys, bootstrap_key: str | None, system_us: Callable[[], int], service_id: str = ""
    ) -> None:
        self._keys = keys
        self._service_id = service_id
        self._bootstrap = access.digest_of(bootstrap_key.encode("utf-8", "surrogateescape")) if bootstrap_key else None
        access.hide(bootstrap_key or "")
        self._system_us = system_us
        self._known: dict[str, access.StoredKey] = {}
        self._sessions: dict[bytes, access.BrowserSession] = {}
        self._loaded_s = -math.inf
        #: when keys could not be read last, and why
        self._failed_s = -math.inf
        self._fault: StorageError | None = None
        self._changes = 0
        self._lock = asyncio.Lock()
        self._used_us: dict[str, int] = {}
        #: requests note their use on the loop, another thread takes the notes away
        self._used_lock = Lock()

    async def principal(self, key: str) -> Principal | None:
        """Return the holder of a valid key, None for any other text."""
        # headers reach us decoded as Latin-1; this gives back the bytes that were sent
        offered = access.digest_of(key.encode("latin-1", "replace"))
        if self._bootstrap is not None and hmac.compare_digest(offered, self._bootstrap):
            return self._holder(access.BOOTSTRAP_ID)
        key_id = access.id_of(key)
        if key_id is None:
            return None
        await self._refresh(REFRESH_S if key_id in self._known else RECHECK_S)
        stored = self._known.get(key_id)
        if stored is None or not hmac.compare_digest(offered, stored.digest):
            return None
        return self._holder(key_id)

    def _holder(self, key_id: str) -> Principal | None:
        """Return the holder of a key that was offered, by itself or by a session; None unless it is valid."""
        if key_id == access.BOOTSTRAP_ID:
            return Principal("bootstrap", access.Role.ADMIN, access.BOOTSTRAP_ID)
        now_us, stored = self._system_us(), self._known[key_id]
        if not stored.key.is_valid(now_us):
            return None
        with self._used_lock:
            self._used_us[key_id] = now_us
        held = stored.key
        return Principal(
            held.name,
            held.role,
            key_id,
            held.expires_at_us,
            station=held.station,
            spacecraft=held.spacecraft,
            kinds=held.kinds,
        )

    async def session_holder(self, token: str) -> Principal | None:
        """Return the holder of the key of an open session, None for any other text."""
        key_id = access.key_id_of_session(token)
        await self._refresh(REFRESH_S)
        if (digest := self._session_digest(token, key_id)) not in self._sessions:
            # another process may have opened it just now, and its page comes here next
            await self._refresh(0.0)
            digest = self._session_digest(token, key_id)
        session = self._sessions.get(digest)
        if session is None or session.ends_at_us <= self._system_us():
            return None
        principal = self._holder(key_id)
        return None if principal is None else replace(principal, session=session)

    def open_session(self, principal: Principal) -> tuple[str, access.BrowserSession]:
        """Store a session of the holder of a key; return its token, which is not kept, and the session."""
        now_us, token = self._system_us(), access.new_session_token(principal.key_id)
        ends_at_us = now_us + LIFE_OF_SESSION_S * US_PER_S
        ends_at_us = min(ends_at_us, principal.expires_at_us or ends_at_us)
        digest = self._session_digest(token, principal.key_id)
        session = access.BrowserSession(digest, principal.key_id, ends_at_us)
        self._keys.open_session(session, now_us)
        self.forget()
        return token, session

    def end_session(self, session: access.BrowserSession) -> None:
        """End a session: at once in this process, within seconds in every other."""
        self._keys.end_session(session.digest)
        self.forget()

    def _session_digest(self, token: str, key_id: str) -> bytes:
        """Return the digest of a token; empty, which no session has, for a key that is not known."""
        known = self._known.get(key_id)
        key_digest = self._bootstrap if key_id == access.BOOTSTRAP_ID else known and known.digest
        return access.session_digest(token, key_digest, self._service_id) if key_digest else b""

    async def still_holds(self, principal: Principal) -> bool:
        """Return whether a key that was valid is so still, and its session open, for answers that take long."""
        session = principal.session
        if principal.key_id not in self._known and session is None:
            return True
        await self._refresh(REFRESH_S)
        now_us, stored = self._system_us(), self._known.get(principal.key_id)
        if session is not None and (session.digest not in self._sessions or session.ends_at_us <= now_us):
            return False
        return principal.key_id == access.BOOTSTRAP_ID or (stored is not None and stored.key.is_valid(now_us))

    def forget(self) -> None:
        """Read all keys again before the next one is judged; called after each change."""
        self._changes += 1
        self._loaded_s = -math.inf

    def last_used_us(self, key_id: str, stored_us: int | None) -> int | None:
        """Return when a key was last used, as this process knows it."""
        return max(filter(None, (stored_us, self._used_us.get(key_id))), default=None)

    def write_down_used(self) -> None:
        """Store when keys were last used; called once a minute, never by a request."""
        with self._used_lock:
            used_us, self._used_us = self._used_us, {}
        if not used_us:
            return
        try:
            self._keys.note_used(used_us)
        except StorageError as error:
            with self._used_lock:
                self._used_us = used_us | self._used_us
            _LOG.warning("times of last use of keys could not be stored, will retry: %s", error)

    async def _refresh(self, oldest_s: float) -> None:
        """Read all keys when what was read is older than so many seconds."""
        age_s = time.monotonic() - self._loaded_s
        # one request reads, the others go on with what is known
        if age_s <= oldest_s or (oldest_s and age_s <= HOLDS_S and self._lock.locked()):
            return
        asked_s = time.monotonic()
        async with self._lock:
            if time.monotonic() - self._loaded_s <= oldest_s or self._loaded_s >= asked_s:
                return
            if self._failed_s >= asked_s and self._fault is not None:
                # an archive that does not answer is waited for together, not by one request after another
                self._fail(self._fault, asked_s)
                return
            changes, began_s = self._changes, time.monotonic()
            try:
                stored, sessions = await run_in_threadpool(lambda: (self._keys.all(), self._keys.sessions()))
            except StorageError as error:
                self._failed_s, self._fault = time.monotonic(), error
                self._fail(error, began_s)
                return
            self._known, self._sessions = {each.key.id: each for each in stored}, sessions
            # a key that changed meanwhile may be missing in what was read
            self._loaded_s = began_s if changes == self._changes else -math.inf

    def _fail(self, error: StorageError, at_s: float) -> None:
        """Raise what kept the keys from being read unless those known hold on."""
        if at_s - self._loaded_s > HOLDS_S:
            raise StorageError(error.code, error.detail) from error
        _LOG.warning("keys could not be read; those read last stay valid up to %g s: %s", HOLDS_S, error)


WINDOW_S = 600.0
MAX_GROUPS = 20
_OTHERS = ("", "", "")


@dataclass
class _Group:
    """Refusals counted, but not written."""

    last: access.AuditEvent
    times: int = 0


class Refusals:
    """Counters of the requests refused lately, one audit entry a group.

    Parameters
    ----------
    monotonic_s : callable
        Gives the time.
    """

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._groups: dict[tuple[str, str, str], _Group] = {}
        self._until_s = monotonic_s() + WINDOW_S
        #: requests come on the loop, another thread takes away what was counted
        self._lock = Lock()

    def admit(self, audit_event: access.AuditEvent) -> bool:
        """Return whether a refusal is to be written now; the others are counted."""
        with self._lock:
            return self._is_first(audit_event)

    def settled(self, *, is_last: bool = False) -> list[access.AuditEvent]:
        """Return the counted refusals at the end of their window or of the service, and clear the counters."""
        now_s = self._monotonic_s()
        if now_s < self._until_s and not is_last:
            return []
        with self._lock:
            groups, self._groups, self._until_s = self._groups, {}, now_s + WINDOW_S
        return [replace(group.last, times=group.times) for group in groups.values() if group.times]

    def _is_first(self, audit_event: access.AuditEvent) -> bool:
        name = (audit_event.outcome, audit_event.key_id, audit_event.address)
        group = self._groups.get(name)
        is_new = group is None
        if group is None:
            name = name if len(self._groups) < MAX_GROUPS else _OTHERS
            is_new = name not in self._groups
            group = self._groups.setdefault(name, _Group(audit_event))
        if is_new:
            return True
        group.last, group.times = audit_event, group.times + 1
        return False


PERIOD_S = 60.0
#: heads are announced this often while they move
ANNOUNCE_S, ANNOUNCE_JOURNALS_S = 3600.0, 600.0
_AUDIT_LOG = logging.getLogger("soo.audit")


class _Announcer:
    """Lines that are logged first, now and then while they change, and last."""

    def __init__(self, period_s: float, lines: Callable[[], Iterable[str]]) -> None:
        self._period_s = period_s
        self._lines = lines
        self._said: set[str] = set()
        self._due_s = -math.inf

    def announce(self, *, is_last: bool) -> None:
        """Log the lines that are new, when their time has come."""
        if not is_last and time.monotonic() < self._due_s:
            return
        lines = set(self._lines())
        for line in sorted(lines - self._said):
            _AUDIT_LOG.info(line)
        self._said, self._due_s = lines, time.monotonic() + self._period_s


class AccessHousekeeping:
    """The keeper of keys' use, refusals and announced heads.

    Parameters
    ----------
    keys : StoredKeys
        Knows when keys were used.
    refusals : Refusals
        Knows what was refused.
    audit : Audit
        Where entries go.
    journal_heads : callable
        Gives the newest entry of every journal.
    """

    def __init__(
        self,
        keys: StoredKeys,
        refusals: Refusals,
        audit: Audit,
        journal_heads: Callable[[], Iterable[JournalHead]] = tuple,
    ) -> None:
        self._keys = keys
        self._refusals = refusals
        self._audit = audit
        self._journal_heads = journal_heads
        self._announcers = (
            _Announcer(ANNOUNCE_S, self._audit_lines),
            _Announcer(ANNOUNCE_JOURNALS_S, self._journal_lines),
        )
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; called inside the server's event loop."""
        self._task = asyncio.create_task(self._run())

    async def stop(self) -> None:
        """End, and write down what is left."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        await asyncio.to_thread(self.keep, is_last=True)

    def keep(self, *, is_last: bool = False) -> None:
        """Write down what is due."""
        self._keys.write_down_used()
        try:
            for audit_event in self._refusals.settled(is_last=is_last):
                self._audit.append(audit_event)
            for announcer in self._announcers:
                announcer.announce(is_last=is_last)
        except StorageError as error:
            _AUDIT_LOG.warning("audit log and its heads could not be written, retried every minute: %s", error)

    async def _run(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self.keep)
            except Exception:  # noqa: BLE001 - the keeper must live on
                # whatever it was, the next minute shall be tried: an audit log nobody keeps would go unnoticed
                _AUDIT_LOG.exception("housekeeping of keys and audit log failed; it is retried")
            await asyncio.sleep(PERIOD_S)

    def _audit_lines(self) -> Iterator[str]:
        """Yield the log lines that `soo audit verify --log` reads."""
        head = self._audit.head()
        yield f"audit head {head.number} {head.hash}"

    def _journal_lines(self) -> Iterator[str]:
        """Yield the log lines that `soo doctor --log` reads."""
        for head in self._journal_heads():
            yield f"journal head {head.spacecraft_id} {head.number} {head.digest}"
