"""Access log: one line a request, written when it has ended, and its figures.

The line names the route by its template, so that ids of things do not make lines of their own kind, the key by its id,
and never a query: it could hold what somebody took for a harmless place to put a key.
"""

import logging
import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.records.levels.measurement import BatchReceipt, RowRefusal

#: upper bounds of the classes of durations, s
DURATION_BOUNDS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


@dataclass(slots=True)
class DurationHistogram:
    """Histogram of the durations of one route's requests."""

    #: requests in each class of duration, the last one above all bounds
    counts: list[int] = field(default_factory=lambda: [0] * (len(DURATION_BOUNDS_S) + 1))
    total_s: float = 0.0

    def add(self, duration_s: float) -> None:
        """Count one request."""
        self.counts[bisect_left(DURATION_BOUNDS_S, duration_s)] += 1
        self.total_s += duration_s


@dataclass(slots=True)
class RequestMetrics:
    """Counts since the start of the process."""

    #: by (method, route, status)
    requests: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    #: by route; live streams are left out, for they last as long as their clients like
    durations: dict[str, DurationHistogram] = field(default_factory=dict)
    in_progress: int = 0
    #: rows by what became of them: accepted, duplicates, late (which are accepted too)
    rows: Counter[tuple[str, str]] = field(default_factory=Counter)
    #: rows refused, by (spacecraft, code)
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add_request(self, method: str, route: str, status: int, duration_s: float, *, is_stream: bool) -> None:
        """Count one request that has ended."""
        self.requests[method if method in _METHODS else "other", route, status] += 1
        if not is_stream:
            self.durations.setdefault(route, DurationHistogram()).add(duration_s)

    def add_receipt(self, spacecraft_id: str, receipt: BatchReceipt, screened: Sequence[RowRefusal]) -> None:
        """Count the rows of one batch of measurements."""
        for outcome in ("accepted", "duplicates", "late"):
            self.rows[spacecraft_id, outcome] += getattr(receipt, outcome)
        for refusal in (*screened, *receipt.refused):
            self.refused[spacecraft_id, refusal.code] += 1


_LOG = logging.getLogger("soo.access")
#: what is served without a route of its own
_PLAIN_PATHS = frozenset({"/openapi.json"})
_EVENT_STREAM = b"text/event-stream"
#: status that is told of a request whose client left before there was one
_CLIENT_LEFT = 499


class RequestLog:
    """ASGI middleware that counts requests and logs one line for each.

    Parameters
    ----------
    app : ASGIApp
        Application inside.
    statistics : RequestMetrics
        Counters of requests.
    base_path : str
        Prefix of the route templates.
    is_writing : bool
        True where lines are logged; requests are counted either way.
    """

    def __init__(self, app: ASGIApp, statistics: RequestMetrics, base_path: str, *, is_writing: bool = True) -> None:
        self._app = app
        self._statistics = statistics
        self._base_path = base_path
        self._is_writing = is_writing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = _Answer()

        async def send_seen(message: Message) -> None:
            answer.on_message(message)
            await send(message)

        began_s = time.perf_counter()
        self._statistics.in_progress += 1
        try:
            await self._app(scope, receive, send_seen)
        except Exception:
            answer.status = answer.status or 500
            raise
        finally:
            self._statistics.in_progress -= 1
            self._report(scope, answer, time.perf_counter() - began_s)

    def _report(self, scope: Scope, answer: "_Answer", duration_s: float) -> None:
        """Count a request and write its line."""
        route, method, status = self._route(scope), scope["method"], answer.status or _CLIENT_LEFT
        self._statistics.add_request(method, route, status, duration_s, is_stream=answer.is_stream)
        if self._is_writing and _LOG.isEnabledFor(logging.INFO):
            fields: dict[str, Any] = {
                "method": method,
                "route": route,
                "status": status,
                "duration_ms": round(1e3 * duration_s, 3),
                "bytes": answer.size_bytes,
                "key": _key_id(scope),
                "client": (scope.get("client") or ("",))[0],
            }
            _LOG.info("request", extra={"fields": fields})

    def _route(self, scope: Scope) -> str:
        """Return the template of the route that served a request."""
        template = getattr(scope.get("route"), "path", None)
        path = str(scope["path"])
        if template is None:
            return path if path in _PLAIN_PATHS else "unmatched"
        is_below = path.startswith(self._base_path) and not template.startswith(self._base_path)
        return f"{self._base_path}{template}" if is_below else str(template)


class _Answer:
    """Status and size of an answer, updated as its messages are sent."""

    def __init__(self) -> None:
        self.status: int | None = None
        self.is_stream = False
        self.size_bytes = 0

    def on_message(self, message: Message) -> None:
        """Update status and size by one message."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            self.is_stream = any(
                name == b"content-type" and value.startswith(_EVENT_STREAM) for name, value in message["headers"]
            )
        else:
            self.size_bytes += len(message.get("body", b""))


def _key_id(scope: Scope) -> str | None:
    """Return the id of the key that a request came with, None without a valid one."""
    principal = scope.get("state", {}).get("principal")
    if principal is None:
        return None
    return str(getattr(principal, "key_id", "") or getattr(principal, "name", "")) or None
