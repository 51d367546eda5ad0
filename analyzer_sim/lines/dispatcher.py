"""Runs program messages of many sessions on one instrument, one at a time, and wakes those who wait. No transport.

A message waits where its session is locked out, and a session is held where a unit needs the pending sweep; the others
are served meanwhile. Everything happens on one event loop, so a turn of a session is never interrupted.
"""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.lines.lock_table import LockTable
from analyzer_sim.lines.session import Session, command_tree
from analyzer_sim.scpi.framing import ProgramMessage

#: how often a permission that nobody announces is asked for, s
_PERMISSION_POLL_S = 0.005


async def poll_permission() -> None:
    """Return when it is worth asking again, for a permission that nobody announces."""
    await asyncio.sleep(_PERMISSION_POLL_S)


class Dispatcher:
    """Command execution and locks of one instrument, shared by all its transports.

    Parameters
    ----------
    instrument : Instrument
        Shared by all sessions.
    dialect : Dialect
        The language spoken.
    permission : callable
        Returns when it is worth asking again whether the next row may be swept.

    Attributes
    ----------
    locks : LockTable
        Who may run; a client is its session.
    watchers : set of callables
        Called after every change a client could be told of.
    """

    def __init__(
        self,
        instrument: Instrument,
        dialect: Dialect,
        permission: Callable[[], Awaitable[None]] = poll_permission,
    ) -> None:
        self.locks = LockTable()
        self.watchers: set[Callable[[], None]] = set()
        self.instrument = instrument
        self._dialect = dialect
        self._tree = command_tree(dialect)
        self._permission = permission
        self._changed = asyncio.Event()
        self._changes_seen = 0
        self._changes_settled = 0
        self._sessions: Counter[str] = Counter()
        self._pump: asyncio.Task[None] | None = None

    def new_session(self, transport: str) -> Session:
        """Return the parser and output of a new client."""
        self._sessions[transport] += 1
        return Session(self.instrument, self._dialect, self._tree, f"{transport} {self._sessions[transport]}")

    async def execute(self, session: Session, message: ProgramMessage) -> bytes | None:
        """Run one message to its end, waiting where the session is locked out or held; return its response."""
        while not self.locks.may_run(session):
            await self.change()
        session.submit(message)
        while True:
            response = session.run()
            self.poll()
            if session.is_held:
                await self.change()
            elif session.is_busy:
                await asyncio.sleep(0)
            else:
                return response

    async def change(self) -> None:
        """Return after the next change of sweep or locks."""
        await self._changed.wait()

    def announce(self) -> None:
        """Wake everybody who waits for a change."""
        self._changed.set()
        self._changed = asyncio.Event()

    def leave(self, session: Session) -> None:
        """Take the locks of a client that has left."""
        self.locks.drop(session)
        self.announce()

    def poll(self) -> None:
        """Act on what a turn, or time, may have changed."""
        self.instrument.keep_continuous()
        if self._changes_seen != self.instrument.changes:
            self._changes_seen = self.instrument.changes
            self.announce()
            if self._pump is None:
                self._pump = asyncio.create_task(self._keep_time())
        for watcher in tuple(self.watchers):
            watcher()

    async def _keep_time(self) -> None:
        """Let pending sweeps begin when they are allowed and end when their time is over."""
        while True:
            self.instrument.complete_pending()
            self.poll()
            remaining_s = self.instrument.remaining_s
            if remaining_s is None and self._changes_settled != self.instrument.changes:
                # the first of endless sweeps is over: no change of state, yet somebody may wait for it
                self._changes_settled = self.instrument.changes
                self.announce()
            if self.instrument.is_waiting:
                await self._permission_or_change()
            else:
                with suppress(TimeoutError):
                    async with asyncio.timeout(remaining_s):
                        await self.change()

    async def _permission_or_change(self) -> None:
        """Return when it is worth asking again, or when there is nothing to ask for any more."""
        tasks = [asyncio.ensure_future(wait) for wait in (self._permission(), self.change())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def close(self) -> None:
        """End what runs in the background."""
        if self._pump is not None:
            self._pump.cancel()
            await asyncio.gather(self._pump, return_exceptions=True)
