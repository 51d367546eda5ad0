"""Live streams that are open: a server that stops ends them first, for they would never end by themselves."""

from service.runtime.live_feed import Subscription


class OpenStreams:
    """Subscriptions being read; used inside the server's event loop."""

    def __init__(self) -> None:
        self._subscriptions: set[Subscription] = set()
        self._is_closed = False

    @property
    def is_closed(self) -> bool:
        """Whether streams are to end."""
        return self._is_closed

    def add(self, subscription: Subscription) -> None:
        """Remember a subscription while its stream is open."""
        self._subscriptions.add(subscription)

    def discard(self, subscription: Subscription) -> None:
        """Forget a subscription whose stream has ended."""
        self._subscriptions.discard(subscription)

    def close(self) -> None:
        """End all streams; each wakes up and sees it."""
        self._is_closed = True
        for subscription in tuple(self._subscriptions):
            subscription.offer(())
