"""HTTP connections with bounds: their number, the size of a head, the time for a head and for a whole request.

uvicorn bounds none of them. What it cannot read is answered here as a problem, like every other refusal. The class
leans on names that uvicorn does not promise: its version is bounded, and ``test_uvicorn_names.py`` names each of them.
"""

import asyncio
from http import HTTPStatus
from typing import Any

from starlette.requests import HTTPConnection
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.api.limits.connections import Connections
from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError, render

#: request line and headers together; a bearer key and a long list of parameters take two of them
MAX_HEAD_BYTES = 32 * 1024
REQUEST_TIMEOUT_S = 60.0
#: a connection without a whole head by then is closed; slow networks and people at a terminal need less
HEAD_TIMEOUT_S = 10.0


class _HeadTooLargeError(Exception):
    """Raised inside the parser to make it stop."""


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

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as in uvicorn
        """Begin, where there is room; a connection that says nothing ends at the deadline of a first head."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else ""
        reason = self.connections_open.admit(self._address)
        self._is_admitted = reason is None
        if reason is not None:
            headers = {"Retry-After": str(RETRY_AFTER_S)}
            self._refuse(
                RequestProblemError(HTTPStatus.TOO_MANY_REQUESTS, "connection.too_many", reason, headers=headers)
            )
            return
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
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Take the end of a request."""
        self._is_message_open = False
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - uvicorn's words, ours are better
        """Answer what the parser could not read."""
        if self._head_bytes > MAX_HEAD_BYTES:
            self._refuse(_head_too_large())
            return
        detail = "the request is not valid HTTP/1.1 (RFC 9112)"
        self._refuse(RequestProblemError(HTTPStatus.BAD_REQUEST, "http.malformed", detail))

    def _count(self, size: int) -> None:
        """Count a part of the head."""
        self._head_bytes += size
        if self._head_bytes > MAX_HEAD_BYTES:
            raise _HeadTooLargeError

    def _arm(self) -> None:
        """Begin the time for a head, or for what follows it."""
        timeout_s = min(HEAD_TIMEOUT_S, self.request_timeout_s) if self._is_head_open else self.request_timeout_s
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
        head += b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
        self.transport.write(head + b"connection: close\r\n\r\n" + bytes(answer.body))
        self.transport.close()


def _head_too_large() -> RequestProblemError:
    """Return the problem of a head above the limit."""
    detail = f"request line and headers exceed {MAX_HEAD_BYTES} bytes"
    return RequestProblemError(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "head.too_large", detail)
