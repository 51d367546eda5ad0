"""Open connections: how many there may be, of one address and in all; what is refused is counted and logged."""

import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from ipaddress import ip_address, ip_network

from service.api.limits.rate_limits import network_of

#: between two log lines on refused connections, s
_LOG_PERIOD_S = 10.0
_LOG = logging.getLogger(__name__)


class Connections:
    """The connections of one process; used inside the server's event loop.

    Parameters
    ----------
    limit, limit_per_address : int
        Most connections at once.
    exempt : str
        Addresses or networks, by commas, that the second limit does not hold for: proxies speak for many.
    monotonic_s : callable
        Gives the time.
    """

    def __init__(
        self, limit: int, limit_per_address: int, exempt: str, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._limit = limit
        self._limit_per_address = limit_per_address
        self._exempt = [ip_network(part.strip(), strict=False) for part in exempt.split(",") if part.strip()]
        self._monotonic_s = monotonic_s
        self._open: Counter[str] = Counter()
        self._logged_s = -math.inf
        self._unlogged = 0
        #: connections that are open
        self.count = 0
        #: connections that were refused or ended, by reason: address, total, slow
        self.refused: Counter[str] = Counter()

    def admit(self, address: str) -> str | None:
        """Count a connection, or return why there may be no more."""
        name = network_of(address)
        if self.count >= self._limit:
            reason = f"the service keeps {self._limit} connections open (SOO_MAX_CONNECTIONS)"
            self.refuse("total", address, reason)
            return reason
        if self._open[name] >= self._limit_per_address and not self._is_exempt(address):
            reason = (
                f"{self._limit_per_address} connections of one address are open (SOO_MAX_CONNECTIONS_PER_ADDRESS); "
                "close one, or use those that are open for several requests"
            )
            self.refuse("address", address, reason)
            return reason
        self._open[name] += 1
        self.count += 1
        return None

    def leave(self, address: str) -> None:
        """Forget a connection that was admitted."""
        name = network_of(address)
        self.count -= 1
        self._open[name] -= 1
        if self._open[name] <= 0:
            del self._open[name]

    def refuse(self, kind: str, address: str, reason: str) -> None:
        """Count a connection that is refused or ended; log the newest one of ten seconds with their number."""
        self.refused[kind] += 1
        self._unlogged += 1
        now_s = self._monotonic_s()
        if now_s - self._logged_s >= _LOG_PERIOD_S:
            _LOG.warning(
                "connections refused or closed: %d; the newest from %s: %s",
                self._unlogged,
                address,
                reason,
            )
            self._logged_s, self._unlogged = now_s, 0

    def _is_exempt(self, address: str) -> bool:
        try:
            return any(ip_address(address) in network for network in self._exempt)
        except ValueError:
            return False
