"""Locks of the instrument as HiSLIP grants them (IVI-6.1, 6.5; VPP-4.3, 3.6). No socket, no waiting.

Who may run while locks are held::

    exclusive lock   shared lock     runs
    none             none            everybody
    none             held            those who share it
    held             none or held    its holder alone

An exclusive lock is granted when nobody else holds any lock, or to one of those who share. A shared lock is granted
when there is none, or to a client that knows its key. Sessions of the raw socket can hold no lock and are held back by
those of others: the lock is of the instrument.
"""

from collections.abc import Hashable
from enum import IntEnum


class LockAnswer(IntEnum):
    """Control code of AsyncLockResponse."""

    #: no lock could be had in time
    FAILURE = 0
    #: a lock was granted, or an exclusive one released
    SUCCESS = 1
    #: a shared lock was released
    SUCCESS_SHARED = 2
    #: the client holds such a lock already, or none to release
    INVALID = 3


class LockTable:
    """Holders of the exclusive lock and of the shared lock; a client is any hashable object.

    Examples
    --------
    >>> table = LockTable()
    >>> table.request("a", ""), table.request("b", ""), table.may_run("b")
    (<LockAnswer.SUCCESS: 1>, None, False)
    """

    def __init__(self) -> None:
        self._exclusive: Hashable | None = None
        self._shared: set[Hashable] = set()
        self._key = ""

    @property
    def is_exclusive(self) -> bool:
        """Return whether an exclusive lock is held."""
        return self._exclusive is not None

    @property
    def holders(self) -> int:
        """Clients that hold a lock of either kind."""
        return len(self._shared | ({self._exclusive} if self.is_exclusive else set()))

    def may_run(self, client: Hashable) -> bool:
        """Tell whether a client's messages are executed now."""
        if self.is_exclusive:
            return self._exclusive == client
        return not self._shared or client in self._shared

    def request(self, client: Hashable, key: str) -> LockAnswer | None:
        """Ask for a lock, the exclusive one when the key is empty; ``None`` = it must be waited for."""
        if client == self._exclusive if not key else client in self._shared:
            return LockAnswer.INVALID
        if self.is_exclusive and self._exclusive != client:
            return None
        return self._share(client, key) if key else self._exclude(client)

    def _exclude(self, client: Hashable) -> LockAnswer | None:
        if self._shared and client not in self._shared:
            return None
        self._exclusive = client
        return LockAnswer.SUCCESS

    def _share(self, client: Hashable, key: str) -> LockAnswer | None:
        if self._shared and key != self._key:
            return None
        self._key = key
        self._shared.add(client)
        return LockAnswer.SUCCESS

    def release(self, client: Hashable) -> LockAnswer:
        """Give back the exclusive lock, or else the shared one."""
        if self.is_exclusive and self._exclusive == client:
            self._exclusive = None
            return LockAnswer.SUCCESS
        if client in self._shared:
            self._shared.discard(client)
            return LockAnswer.SUCCESS_SHARED
        return LockAnswer.INVALID

    def drop(self, client: Hashable) -> None:
        """Give back all a client holds: it has left."""
        if self._exclusive == client:
            self._exclusive = None
        self._shared.discard(client)
