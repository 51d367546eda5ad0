"""Access keeping: what has to be written down now and then, beside the requests.

Times of last use once a minute, counted refusals when their time is over, and the head of the audit log to the log of
the service: a head kept apart from the entries is what shows that the newest of them were cut off.
"""

import asyncio
import contextlib
import logging
import time

from service.api.refusals import Refusals
from service.api.stored_keys import StoredKeys
from service.errors import StorageError
from service.ports import Audit
from service.records.audit import AuditHead

PERIOD_S = 60.0
#: the head is announced this often while it moves
ANNOUNCE_S = 3600.0
#: lines "audit head NUMBER HASH"; `soo audit verify --log` reads them
_LOG = logging.getLogger("soo.audit")


class AccessKeeping:
    """The keeper of keys' use, refusals and announced heads.

    Parameters
    ----------
    keys : StoredKeys
        Knows when keys were used.
    refusals : Refusals
        Knows what was refused.
    audit : Audit
        Where entries go.
    """

    def __init__(self, keys: StoredKeys, refusals: Refusals, audit: Audit) -> None:
        self._keys = keys
        self._refusals = refusals
        self._audit = audit
        self._announced: AuditHead | None = None
        self._announced_s = 0.0
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
            for deed in self._refusals.settled(is_last=is_last):
                self._audit.append(deed)
            self._announce(is_last=is_last)
        except StorageError as error:
            _LOG.warning("the audit log could not be kept: %s", error)

    async def _run(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self.keep)
            except Exception:  # noqa: BLE001 - the keeper must live on
                # whatever it was, the next minute shall be tried: an audit log nobody keeps would go unnoticed
                _LOG.exception("keys and audit log were not kept this time")
            await asyncio.sleep(PERIOD_S)

    def _announce(self, *, is_last: bool) -> None:
        """Say where the chain ends, when it has moved and its time has come."""
        is_due = self._announced is None or is_last or time.monotonic() - self._announced_s >= ANNOUNCE_S
        if not is_due:
            return
        head = self._audit.head()
        if head != self._announced:
            _LOG.info("audit head %d %s", head.number, head.hash)
        self._announced, self._announced_s = head, time.monotonic()
