"""HTTP connections with bounds: their number, the size of a head, the time for a head and for a whole request."""

import asyncio
import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from http import HTTPStatus
from ipaddress import ip_address, ip_network
from typing import Any

from starlette.requests import HTTPConnection
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.api.limits.rate_limits import network_of
from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError, render

#: between two log lines on refused connections, s
_LOG_PERIOD_S = 10.0
#: places of an address beyond its limit, for one request each that comes at once with a key, or asks for health
SPARE_PLACES = 8
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
        if self._open[name] >= self._limit_per_address + SPARE_PLACES and not self._is_exempt(address):
            return self.refuse_above_limit(address)
        self._open[name] += 1
        self.count += 1
        return None

    def is_spare(self, address: str) -> bool:
        """Return whether the connection that was admitted last has one of the places beyond the limit."""
        return self._open[network_of(address)] > self._limit_per_address and not self._is_exempt(address)

    def refuse_above_limit(self, address: str) -> str:
        """Count a connection that an address has too many, and return why."""
        reason = (
            f"{self._limit_per_address} connections of one address are open (SOO_MAX_CONNECTIONS_PER_ADDRESS); "
            "close one, or use those that are open for several requests"
        )
        self.refuse("address", address, reason)
        return reason

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


#: request line and headers together; a bearer key and a long list of parameters take two of them
MAX_HEAD_BYTES = 32 * 1024
REQUEST_TIMEOUT_S = 60.0
#: a connection without a whole head by then is closed; slow networks and people at a terminal need less
HEAD_TIMEOUT_S = 10.0
#: the same of a spare place
_SPARE_HEAD_TIMEOUT_S = 1.0
_HEALTH_PATHS = (b"/healthz", b"/readyz")
_KEY_HEADERS = (b"authorization", b"cookie")


class _HeadTooLargeError(Exception):
    """Raised inside the parser to make it stop."""


class _NoPlaceError(Exception):
    """Raised inside the parser: a spare place is not for this request."""


class BoundedProtocol(HttpToolsProtocol):
    """One connection; what stands in the class holds for all of them."""

    request_timeout_s = REQUEST_TIMEOUT_S
    connections_open: Connections

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        #: of the present request: bytes of its head that were understood, and that came before its head was whole
        self._head_bytes = 0
        self._unread_bytes = 0
        self._is_head_open = True
        self._is_message_open = False
        self._deadline: asyncio.TimerHandle | None = None
        self._address = ""
        self._is_admitted = False
        self._is_spare = False
        self._has_place = True

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as in uvicorn
        """Begin, where there is room; a connection that says nothing ends at the deadline of a first head."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else ""
        reason = self.connections_open.admit(self._address)
        self._is_admitted = reason is None
        if reason is not None:
            self._refuse(_too_many(reason))
            return
        self._is_spare = self.connections_open.is_spare(self._address)
        self._arm()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._disarm()
        if self._is_admitted:
            self.connections_open.leave(self._address)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read a piece."""
        if not self._is_admitted:
            return
        super().data_received(data)
        if self.transport.is_closing() or not self._is_message_open:
            self._disarm()
            return
        if self._is_head_open:
            self._unread_bytes += len(data)
        if self._unread_bytes > MAX_HEAD_BYTES:
            self._refuse(_head_too_large())
        elif self._deadline is None:
            # nearly all requests come in one piece and need no timer
            self._arm()

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        self._head_bytes, self._unread_bytes = 0, 0
        self._is_head_open, self._is_message_open = True, True

    def on_url(self, url: bytes) -> None:
        """Take a piece of the path."""
        super().on_url(url)
        self._count(len(url))

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header."""
        super().on_header(name, value)
        self._count(len(name) + len(value))

    def on_headers_complete(self) -> None:
        """Take the end of the head."""
        self._is_head_open, self._unread_bytes = False, 0
        self._disarm()
        if self._is_spare:
            is_health = self.url.partition(b"?")[0] in _HEALTH_PATHS
            self._has_place = is_health or any(name in _KEY_HEADERS for name, _ in self.headers)
            if not self._has_place:
                raise _NoPlaceError
        super().on_headers_complete()
        if self._is_spare:
            # the next connection gets the place
            self.cycle.keep_alive = False

    def on_message_complete(self) -> None:
        """Take the end of a request."""
        self._is_message_open = False
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - uvicorn's words, ours are better
        """Answer what the parser could not read."""
        if self._head_bytes > MAX_HEAD_BYTES:
            self._refuse(_head_too_large())
            return
        if not self._has_place:
            self._refuse(_too_many(self.connections_open.refuse_above_limit(self._address)))
            return
        detail = "the request is not valid HTTP/1.1 (RFC 9112)"
        self._refuse(RequestProblemError(HTTPStatus.BAD_REQUEST, "http.malformed", detail))

    def _count(self, size: int) -> None:
        self._head_bytes += size
        if self._head_bytes > MAX_HEAD_BYTES:
            raise _HeadTooLargeError

    def _arm(self) -> None:
        """Begin the time for a head, or for what follows it."""
        timeout_s = self.request_timeout_s
        if self._is_head_open or self._is_spare:
            head_s = _SPARE_HEAD_TIMEOUT_S if self._is_spare and self._is_head_open else HEAD_TIMEOUT_S
            timeout_s = min(head_s, timeout_s)
        self._deadline = self.loop.call_later(timeout_s, self._on_deadline, timeout_s)

    def _disarm(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _on_deadline(self, timeout_s: float) -> None:
        """End a connection whose request did not come whole in time."""
        self._deadline = None
        if self.transport.is_closing():
            return
        part = "head of a request" if self._is_head_open else "request"
        reason = f"the {part} was incomplete after {timeout_s:g} s"
        self.connections_open.refuse("slow", self._address, reason)
        # while a head is open the cycle, if any, is that of the request before
        is_answered = not self._is_head_open and self.cycle.response_started
        if not self._is_message_open or is_answered:
            self.transport.close()
            return
        self._refuse(RequestProblemError(HTTPStatus.REQUEST_TIMEOUT, "request.too_slow", reason))

    def _refuse(self, problem: RequestProblemError) -> None:
        """Answer with a problem outside of the application and close the connection."""
        self._disarm()
        answer = render(HTTPConnection({"type": "http", "headers": [], "state": {}}), problem)
        head = b"HTTP/1.1 %d %b\r\n" % (problem.status, HTTPStatus(problem.status).phrase.encode())
        headers = (*self.server_state.default_headers, *answer.raw_headers)
        head += b"".join(b"%b: %b\r\n" % header for header in headers)
        self.transport.write(head + b"connection: close\r\n\r\n" + bytes(answer.body))
        self.transport.close()


def _too_many(reason: str) -> RequestProblemError:
    headers = {"Retry-After": str(RETRY_AFTER_S)}
    return RequestProblemError(HTTPStatus.TOO_MANY_REQUESTS, "connection.too_many", reason, headers=headers)


def _head_too_large() -> RequestProblemError:
    """Return the problem of a head above the limit."""
    detail = f"request line and headers exceed {MAX_HEAD_BYTES} bytes"
    return RequestProblemError(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "head.too_large", detail)
