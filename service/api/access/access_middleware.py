"""Access layer: what every request gets beside its answer.

It gives the request a note for the audit log, adds the headers of its rate, sees that a change is in the audit log
before its 2xx leaves and that refusals get there, ends long answers whose key no longer holds, and stops what needs no
look at a route: floods without a key, thousands of query parameters.
"""

import logging
from http import HTTPStatus

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.access.auth import BASE_PATH, Principal, address_of, audit_event_of, has_credentials, refuse_above
from service.api.access.housekeeping import Refusals, StoredKeys
from service.api.context import ApiContext
from service.api.limits.rate_limits import Allowance, RateClass, RateLimits
from service.api.problems.problems import RequestProblemError, from_soo_error, render
from service.errors import StorageError
from service.records.operations.access import CURRENT_NOTE, AuditContext, AuditEvent, naming_result

MAX_QUERY_PARAMETERS = 100
_REFUSED = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
#: counted by their routes, or not at all: a supervisor restarts a process that does not answer here
_UNCOUNTED = frozenset({"/healthz", "/readyz", "/metrics"})
#: comes without a key; counted before its body is read
_OPENING = ("POST", f"{BASE_PATH}/session")
#: asked by every page before anybody has signed in
_ASKING = ("GET", f"{BASE_PATH}/session")
#: files of the console
_STATIC_PATH = "/console"
_LOG = logging.getLogger(__name__)


class _KeyEndedError(Exception):
    """A long answer whose key no longer holds."""


class AccessLayer:
    """Notes, rates and refusals of every request.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            _check_outside(scope)
        except RequestProblemError as problem:
            await render(HTTPConnection(scope), problem)(scope, receive, send)
            return
        answer = _Answer(scope, receive, send)
        token = CURRENT_NOTE.set(answer.note)
        try:
            await self._app(scope, receive, answer.send)
        except _KeyEndedError:
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            CURRENT_NOTE.reset(token)


class _Answer:
    """One answer on its way out."""

    def __init__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.note = scope.setdefault("state", {})["audit_note"] = AuditContext()
        self._scope = scope
        self._receive = receive
        self._send = send
        self._is_replaced = False

    async def send(self, message: Message) -> None:
        """Pass a message on."""
        if self._is_replaced:
            return
        if message["type"] == "http.response.start":
            try:
                await self._write_down(message["status"])
            except StorageError as error:
                self._is_replaced = True
                answer = render(HTTPConnection(self._scope), from_soo_error(error))
                await answer(self._scope, self._receive, self._send)
                return
            message = {**message, "headers": [*message["headers"], *_rate_headers(self._scope)]}
        elif message.get("more_body", False):
            await self._end_without_key()
        await self._send(message)

    async def _write_down(self, status: int) -> None:
        """Bring to the audit log what is to be there when the answer leaves."""
        if status in _REFUSED:
            await self._write_refusal(status)
        audit_event = self.note.audit_event
        if audit_event is None or (status < HTTPStatus.BAD_REQUEST) == (self.note.entry is not None):
            return
        if status < HTTPStatus.BAD_REQUEST:
            # a change that no write took along: it changed nothing that is stored, or not at once
            audit = _context(self._scope).storage.audit
            self.note.entry = await run_in_threadpool(audit.append, naming_result(audit_event, None))
            return
        # a part was committed with the entry, then the request failed all the same: both stand in the log
        await self._append_or_log(status)

    async def _write_refusal(self, status: int) -> None:
        """Write a refusal down, or count it."""
        if (self._scope["method"], self._scope["path"]) == _ASKING and not has_credentials(Request(self._scope)):
            return
        refusals: Refusals = self._scope["app"].state.refusals
        if refusals.admit(_refusal(self._scope, status)):
            await self._append_or_log(status)

    async def _append_or_log(self, status: int) -> None:
        """Write a refusal or failure down; the answer is the same whether that can be done or not."""
        try:
            await run_in_threadpool(_context(self._scope).storage.audit.append, _refusal(self._scope, status))
        except StorageError as error:
            _LOG.warning("refusal with status %d could not be written to the audit log: %s", status, error)

    async def _end_without_key(self) -> None:
        """End an answer that takes long once its key is revoked or has expired, or its session has ended."""
        principal: Principal | None = self._scope["state"].get("principal")
        ring = self._scope["app"].state.key_ring
        if principal is None or not isinstance(ring, StoredKeys):
            return
        try:
            holds = await ring.still_holds(principal)
        except StorageError:
            holds = False
        if not holds:
            _LOG.info("answer to %s was cut off: the key expired or was revoked, or the session ended", principal.name)
            raise _KeyEndedError


def _check_outside(scope: Scope) -> None:
    """Refuse what needs no look at a route."""
    if scope["query_string"].count(b"&") >= MAX_QUERY_PARAMETERS:
        detail = f"more than {MAX_QUERY_PARAMETERS} query parameters; no path takes so many"
        raise RequestProblemError(HTTPStatus.BAD_REQUEST, "query.too_many", detail)
    path = scope["path"]
    is_counted_inside = path.startswith(f"{BASE_PATH}/") and (scope["method"], path) != _OPENING
    if not is_counted_inside and path not in _UNCOUNTED:
        limits: RateLimits = scope["app"].state.rate_limits
        is_static = path == "/" or path.startswith(_STATIC_PATH)
        refuse_above(
            limits.consume_anonymous(address_of(scope), RateClass.STATIC if is_static else RateClass.ANONYMOUS)
        )


def _refusal(scope: Scope, status: int) -> AuditEvent:
    """Return the deed that was refused, or that failed."""
    return naming_result(audit_event_of(scope, _context(scope).clock.system_us(), str(status)), None)


def _context(scope: Scope) -> ApiContext:
    context: ApiContext = scope["app"].state.context
    return context


def _rate_headers(scope: Scope) -> list[tuple[bytes, bytes]]:
    allowance: Allowance | None = scope["state"].get("allowance")
    if allowance is None:
        return []
    return [
        (b"ratelimit-limit", b"%d" % allowance.limit),
        (b"ratelimit-remaining", b"%d" % allowance.remaining),
        (b"ratelimit-reset", b"%d" % allowance.reset_s),
    ]
