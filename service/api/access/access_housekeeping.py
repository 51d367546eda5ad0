"""Access keeping: what has to be written down now and then, beside the requests.

Times of last use once a minute, counted refusals when their time is over, and the heads of the audit log and of the
journals to the log of the service: a head kept apart from the entries shows that the newest of them were cut off.
"""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator

from service.api.access.key_cache import StoredKeys
from service.api.access.refusal_audit import Refusals
from service.errors import StorageError
from service.ports import Audit
from service.records.journal import JournalHead

PERIOD_S = 60.0
#: heads are announced this often while they move
ANNOUNCE_S, ANNOUNCE_JOURNALS_S = 3600.0, 600.0
_LOG = logging.getLogger("soo.audit")


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
            _LOG.info(line)
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
            _LOG.warning("audit log and its heads could not be written, retried every minute: %s", error)

    async def _run(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self.keep)
            except Exception:  # noqa: BLE001 - the keeper must live on
                # whatever it was, the next minute shall be tried: an audit log nobody keeps would go unnoticed
                _LOG.exception("housekeeping of keys and audit log failed; it is retried")
            await asyncio.sleep(PERIOD_S)

    def _audit_lines(self) -> Iterator[str]:
        """Yield the log lines that `soo audit verify --log` reads."""
        head = self._audit.head()
        yield f"audit head {head.number} {head.hash}"

    def _journal_lines(self) -> Iterator[str]:
        """Yield the log lines that `soo doctor --log` reads."""
        for head in self._journal_heads():
            yield f"journal head {head.spacecraft_id} {head.number} {head.digest}"
