"""Live streams that are open: how many there may be, and their end when the server stops.

A stream never ends by itself, so a server that stops ends them first.
"""

from collections import Counter
from http import HTTPStatus

from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError
from service.runtime.live.live_feed import Subscription


class OpenStreams:
    """Subscriptions being read; used inside the server's event loop.

    Parameters
    ----------
    limit : int
        Most streams at once.
    """

    def __init__(self, limit: int = 500) -> None:
        self._subscriptions: set[Subscription] = set()
        #: streams that are open or about to be
        self._positions = 0
        self._limit = limit
        self._is_closed = False
        #: events sent since the start of the process, by kind
        self.sent: Counter[str] = Counter()
        #: events that clients were too slow for
        self.dropped = 0

    @property
    def is_closed(self) -> bool:
        """Return whether streams are to end."""
        return self._is_closed

    @property
    def count(self) -> int:
        """How many streams are open."""
        return self._positions

    def acquire(self) -> None:
        """Count a stream that is about to open, or raise the 503 that refuses one too many."""
        if self.count >= self._limit:
            detail = f"{self.count} streams are open, the service gives {self._limit}"
            headers = {"Retry-After": str(RETRY_AFTER_S)}
            raise RequestProblemError(HTTPStatus.SERVICE_UNAVAILABLE, "stream.too_many", detail, headers=headers)
        self._positions += 1

    def leave(self) -> None:
        """Give a place back."""
        self._positions -= 1

    def add(self, subscription: Subscription) -> None:
        """Remember a subscription, to wake its stream at the end."""
        self._subscriptions.add(subscription)

    def discard(self, subscription: Subscription) -> None:
        """Forget a subscription whose stream has ended."""
        self._subscriptions.discard(subscription)

    def close(self) -> None:
        """End all streams; each wakes up and sees it."""
        self._is_closed = True
        for subscription in tuple(self._subscriptions):
            subscription.wake()
