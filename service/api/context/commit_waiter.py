"""Waiting for what another thread carries out: writes that are committed together wake the event loop once.

``asyncio.wrap_future`` wakes it for each, by a call of the system that gives up the interpreter's lock in the middle of
the writer's work.
"""

import asyncio
from collections import deque
from concurrent.futures import Future
from threading import Lock
from typing import TypeVar

Result = TypeVar("Result")
_Waiter = asyncio.Future[None]


class CommitWaiter:
    """Waiters of one event loop for commits of the writer's thread."""

    def __init__(self) -> None:
        self._landed: deque[_Waiter] = deque()
        self._lock = Lock()
        self._is_woken = False

    async def of(self, future: Future[Result]) -> Result:
        """Return the result of a future of another thread or raise its error; a cancelled waiter does not cancel it."""
        if not future.done():
            loop = asyncio.get_running_loop()
            waiter: _Waiter = loop.create_future()
            future.add_done_callback(lambda _: self._land(loop, waiter))
            await waiter
        return future.result()

    def _land(self, loop: asyncio.AbstractEventLoop, waiter: _Waiter) -> None:
        """Note that something is done, on the thread that did it."""
        with self._lock:
            self._landed.append(waiter)
            if self._is_woken or loop.is_closed():
                return
            self._is_woken = True
        loop.call_soon_threadsafe(self._report)

    def _report(self) -> None:
        """Let all go on whose work is done."""
        with self._lock:
            landed, self._landed = self._landed, deque()
            self._is_woken = False
        for waiter in landed:
            if not waiter.done():
                waiter.set_result(None)
