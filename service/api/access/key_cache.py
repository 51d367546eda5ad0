"""Keys in memory: a request costs no query, a revocation holds at once in this process and within seconds elsewhere.

All keys are read together, at most every two seconds and only while requests come; a flood of invented keys therefore
costs the database nothing. When the database does not answer, what was read last holds for ten seconds more.
"""

import asyncio
import hmac
import logging
import math
import time
from collections.abc import Callable
from threading import Lock

from starlette.concurrency import run_in_threadpool

from service.api.access.principals import Principal
from service.errors import StorageError
from service.ports import Keys
from service.records.operations.access_key import Role, StoredKey, digest_of, hide, id_of

#: age from which what was read is read again
REFRESH_S = 2.0
#: age from which a key that is not known is looked for again
RECHECK_S = 0.5
#: age beyond which what was read no longer holds
HOLDS_S = 10.0
BOOTSTRAP_ID = "bootstrap"
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
    """

    def __init__(self, keys: Keys, bootstrap_key: str | None, system_us: Callable[[], int]) -> None:
        self._keys = keys
        self._bootstrap = digest_of(bootstrap_key.encode("utf-8", "surrogateescape")) if bootstrap_key else None
        hide(bootstrap_key or "")
        self._system_us = system_us
        self._known: dict[str, StoredKey] = {}
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
        offered = digest_of(key.encode("latin-1", "replace"))
        if self._bootstrap is not None and hmac.compare_digest(offered, self._bootstrap):
            return Principal("bootstrap", Role.ADMIN, BOOTSTRAP_ID)
        key_id = id_of(key)
        if key_id is None:
            return None
        await self._refresh(REFRESH_S if key_id in self._known else RECHECK_S)
        stored = self._known.get(key_id)
        if stored is None or not hmac.compare_digest(offered, stored.digest):
            return None
        now_us = self._system_us()
        if not stored.key.is_valid(now_us):
            return None
        with self._used_lock:
            self._used_us[key_id] = now_us
        return Principal(stored.key.name, stored.key.role, key_id, stored.key.expires_at_us)

    async def still_holds(self, principal: Principal) -> bool:
        """Return whether a key that was valid is so still, for answers that take long."""
        if principal.key_id not in self._known:
            return True
        await self._refresh(REFRESH_S)
        stored = self._known.get(principal.key_id)
        return stored is not None and stored.key.is_valid(self._system_us())

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
        if age_s <= oldest_s or (age_s <= HOLDS_S and self._lock.locked()):
            return
        asked_s = time.monotonic()
        async with self._lock:
            if time.monotonic() - self._loaded_s <= oldest_s:
                return
            if self._failed_s >= asked_s and self._fault is not None:
                # an archive that does not answer is waited for together, not by one request after another
                self._fail(self._fault, asked_s)
                return
            changes, began_s = self._changes, time.monotonic()
            try:
                stored = await run_in_threadpool(self._keys.all)
            except StorageError as error:
                self._failed_s, self._fault = time.monotonic(), error
                self._fail(error, began_s)
                return
            self._known = {each.key.id: each for each in stored}
            # a key that changed meanwhile may be missing in what was read
            self._loaded_s = began_s if changes == self._changes else -math.inf

    def _fail(self, error: StorageError, at_s: float) -> None:
        """Raise what kept the keys from being read unless those known hold on."""
        if at_s - self._loaded_s > HOLDS_S:
            raise StorageError(error.code, error.detail) from error
        _LOG.warning("keys could not be read; those read last stay valid up to %g s: %s", HOLDS_S, error)
