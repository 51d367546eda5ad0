"""Authentication and authorisation: keys (Bearer, or by the cookie of a session), permissions of the roles, rates."""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from hashlib import sha256
from http import HTTPStatus
from typing import Annotated, Any, Protocol
from urllib.parse import urlsplit

from fastapi import Depends, Request, Response
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.limits.rate_limits import Allowance, RateLimits, class_of
from service.api.problems.problems import RequestProblemError, request_id_of
from service.records.operations.access import (
    DONE,
    AuditContext,
    AuditEvent,
    BrowserSession,
    DataKind,
    Role,
    without_secrets,
)

_METHODS = ("GET", "HEAD")
#: headers of answers that a page may read besides those that every page may
_EXPOSED = ("ETag", "RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset", "Retry-After", "X-Request-ID")
#: as browsers send it: lower case, no default port, no path
_ORIGIN = re.compile(r"(?!http:.*:80$|https:.*:443$)https?://(?:[a-z0-9_.-]+|\[[0-9a-f:]+\])(?::[0-9]{1,5})?", re.ASCII)


def origins_of(text: str | None) -> tuple[str, ...]:
    """Return the origins of a list by commas; ValueError for a part that no browser sends as ``Origin``."""
    origins = tuple(part.strip() for part in (text or "").split(",") if part.strip())
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            message = (
                f"{origin!r} is not an origin as browsers send it; write scheme, host in lower case and the port "
                "unless it is the default one, without a path: https://grafana.example or http://localhost:3000"
            )
            raise ValueError(message)
    return origins


class CrossOriginReading:
    """Let pages of listed origins read; the outermost layer, so that 401, 429 and 500 are readable too.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    origins : sequence of str
        Origins as `origins_of` returns them; none: nothing is admitted.
    """

    def __init__(self, app: ASGIApp, origins: Sequence[str]) -> None:
        self._app = app
        self._origins = frozenset(origins)
        # a GET may carry any header: what a header may do is decided by its reader
        self._admitting = CORSMiddleware(
            app, allow_origins=origins, allow_methods=_METHODS, allow_headers=("*",), expose_headers=_EXPOSED
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        is_admitted = scope["type"] == "http" and self._is_admitted(scope["method"], Headers(scope=scope))
        await (self._admitting if is_admitted else self._app)(scope, receive, send)

    def _is_admitted(self, method: str, headers: Headers) -> bool:
        """Return whether a request reads, or asks whether it may, from a listed origin."""
        asked = headers.get("access-control-request-method", "") if method == "OPTIONS" else method
        return headers.get("origin") in self._origins and asked in _METHODS


class Permission(StrEnum):
    """One thing that a key may do."""

    READ = "read"
    #: send measurements, references, telemetry
    SEND = "send"
    #: catalogue, operations, calibrate, align, prepare torques, acknowledge alarms
    OPERATE = "operate"
    #: confirm torques, engage
    APPROVE = "approve"
    #: read the audit log
    INSPECT = "inspect"
    #: keys
    ADMINISTER = "administer"


_OF_VIEWER = frozenset({Permission.READ})
_OF_STATION = _OF_VIEWER | {Permission.SEND}
_OF_OPERATOR = _OF_STATION | {Permission.OPERATE}
_OF_APPROVER = _OF_OPERATOR | {Permission.APPROVE, Permission.INSPECT}

PERMISSIONS: dict[Role, frozenset[Permission]] = {
    Role.VIEWER: _OF_VIEWER,
    Role.STATION: _OF_STATION,
    Role.OPERATOR: _OF_OPERATOR,
    Role.APPROVER: _OF_APPROVER,
    Role.ADMIN: frozenset(Permission),
}


@dataclass(frozen=True, slots=True)
class Principal:
    """Holder of a key."""

    name: str
    role: Role
    #: id of the key, which says more than its name: names may repeat
    key_id: str = ""
    #: of the key, microseconds UTC; None = it is valid until it is revoked
    expires_at_us: int | None = None
    #: by whose cookie the request came; None = it came with the key
    session: BrowserSession | None = None
    #: of a key of role station, with what it is bound to; nothing named: everything
    station: str | None = None
    spacecraft: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()

    def may(self, permission: Permission) -> bool:
        """Return whether the role carries a permission."""
        return permission in PERMISSIONS[self.role]


BASE_PATH = "/api/v1"
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
#: longest target kept; ids in paths are shorter
_TARGET_LENGTH = 200


def note_of(scope: Scope) -> AuditContext:
    """Return the note that the access layer gave a request."""
    note: AuditContext = scope["state"].setdefault("audit_note", AuditContext())
    return note


def digest_body(scope: Scope, body: bytes) -> None:
    """Put the digest of a request's body into its note; called before the body is acted upon."""
    note = note_of(scope)
    if note.audit_event is not None:
        note.audit_event = replace(note.audit_event, body_sha256=sha256(body).hexdigest())


def note_choice(scope: Scope, choice: str) -> None:
    """Put a choice that overrides a check into the target of a request's audit entry, as a query."""
    note = note_of(scope)
    if note.audit_event is not None:
        note.audit_event = replace(note.audit_event, target=f"{note.audit_event.target.rstrip('/')}?{choice}")


def audit_event_of(scope: Scope, at_us: int, outcome: str = DONE) -> AuditEvent:
    """Return the audit event of a request, also of a refused one.

    Parameters
    ----------
    scope : Scope
        Of the request; ``state.principal`` tells who asks.
    at_us : int
        The present, microseconds UTC.
    outcome : str
        ``done``, or the status of the refusal.
    """
    state = scope["state"]
    principal: Principal | None = state.get("principal")
    return AuditEvent(
        at_us=at_us,
        who=principal.name if principal else "anonymous",
        key_id=principal.key_id if principal else "",
        role=str(principal.role) if principal else "",
        address=address_of(scope),
        action=getattr(scope.get("route"), "name", None) or scope["method"],
        target=_target(scope),
        outcome=outcome,
        request_id=str(state.get("request_id", "")),
    )


def address_of(scope: Scope) -> str:
    """Return the address that a request came from; that behind a proxy only when the proxy is trusted."""
    client = scope.get("client")
    return str(client[0])[:64] if client else ""


def _target(scope: Scope) -> str:
    """Return the path below the base; one that ends with a slash takes the id of what is made."""
    path = without_secrets(scope["path"]).removeprefix(BASE_PATH).encode("ascii", "backslashreplace").decode("ascii")
    target = "".join(letter if letter.isprintable() else "?" for letter in path)[:_TARGET_LENGTH].rstrip("/")
    is_collection = scope["method"] in {"POST", "PUT"} and ":" not in target.rpartition("/")[2]
    return f"{target}/" if is_collection else target


def cookie_name_of(request: Request) -> str:
    """Return the name of the cookie of a session: one for each service of a host, and one that TLS alone may set."""
    prefix = "__Host-" if request.url.scheme == "https" else ""
    return f"{prefix}soo-{request.app.state.service_id}"


def has_credentials(request: Request) -> bool:
    """Return whether a request comes with a key or with the cookie of a session, whatever they are worth."""
    return "authorization" in request.headers or cookie_name_of(request) in request.cookies


def require_same_origin(request: Request) -> None:
    """Raise problem 403 for a change by cookie that does not come from a page of this service."""
    if request.method in SAFE_METHODS:
        return
    if request.headers.get("origin", "") != _origin_of(request):
        detail = "a session may change something only from a page of this service, whose address Origin states"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "session.origin", detail)


def set_cookie(request: Request, response: Response, token: str, life_s: int) -> None:
    """Set the cookie of a session for so long; 0 takes it away."""
    response.set_cookie(
        cookie_name_of(request),
        token,
        max_age=life_s,
        path="/",
        secure=request.url.scheme == "https",
        httponly=True,
        samesite="strict",
    )


def _origin_of(request: Request) -> str:
    """Return the origin of the service's own pages, as the request names its host."""
    address = urlsplit(str(request.base_url))
    return f"{address.scheme}://{address.netloc}"


_LOG = logging.getLogger(__name__)
#: what is audited one by one; data that stations send is not: its journal and receipts tell of it
_AUDITED = frozenset({Permission.OPERATE, Permission.APPROVE, Permission.ADMINISTER})


class KeyRing(Protocol):
    """Port of the known keys."""

    async def principal(self, key: str) -> Principal | None:
        """Return the holder of a valid key, None for any other text."""

    async def session_holder(self, token: str) -> Principal | None:
        """Return the holder of the key of an open session, None for any other text."""


async def authenticated(request: Request) -> Principal:
    """Return the holder of the request's key; looked up and counted once a request."""
    known: Principal | None = getattr(request.state, "principal", None)
    if known is None:
        known = request.state.principal = await _holder(request)
        _count(request, known)
    return known


async def known_or_counted(request: Request) -> Principal | None:
    """Return the holder of the Bearer key or of the session's; without a valid one None, counted by the address."""
    principal = await _offered(request)
    if principal is None:
        limits: RateLimits = request.app.state.rate_limits
        refuse_above(limits.consume_anonymous(address_of(request.scope)))
    elif principal.session is not None:
        require_same_origin(request)
    return principal


async def _offered(request: Request) -> Principal | None:
    """Return the holder of the key of the Authorization header, else of the session of the cookie, None without.

    A header that holds no valid key is not passed over in favour of the cookie: a second person's key at the same desk
    must not become the first one's.
    """
    ring: KeyRing = request.app.state.key_ring
    header = request.headers.get("authorization")
    if header is not None:
        scheme, _, key = header.partition(" ")
        return await ring.principal(key.strip()) if scheme.lower() == "bearer" else None
    token = request.cookies.get(cookie_name_of(request))
    return None if token is None else await ring.session_holder(token)


async def _holder(request: Request) -> Principal:
    """Return the holder of the request's key; problem 401 without a valid one."""
    principal = await known_or_counted(request)
    if principal is None:
        _LOG.warning("request %s %s refused: no valid key", request_id_of(request), without_secrets(request.url.path))
        raise refusal_of_key("the key is missing, unknown, expired or revoked")
    return principal


def refusal_of_key(detail: str) -> RequestProblemError:
    """Return problem 401."""
    headers = {"WWW-Authenticate": "Bearer"}
    return RequestProblemError(HTTPStatus.UNAUTHORIZED, "key.invalid", detail, headers=headers)


def _count(request: Request, principal: Principal) -> None:
    """Count a request of a key; problem 429 when there were too many."""
    limits: RateLimits = request.app.state.rate_limits
    allowance = limits.consume(principal.key_id, class_of(request.method, request.url.path))
    request.state.allowance = allowance
    refuse_above(allowance)


def refuse_above(allowance: Allowance | None) -> None:
    """Raise problem 429 unless a request is within its rate."""
    if allowance is not None and not allowance.is_allowed:
        detail = f"too many requests; the next one is accepted after {allowance.reset_s} s"
        headers = {"Retry-After": str(allowance.reset_s)}
        raise RequestProblemError(HTTPStatus.TOO_MANY_REQUESTS, "rate.limited", detail, headers=headers)


#: holder of the key of the present request
CurrentPrincipal = Annotated[Principal, Depends(authenticated)]


class Requires:
    """A dependency that lets only holders of a permission pass.

    Parameters
    ----------
    permission : Permission
        What the route needs.
    """

    def __init__(self, permission: Permission) -> None:
        self.permission = permission

    async def __call__(self, request: Request) -> None:
        """Raise 401 without a valid key, 403 unless its holder has the permission."""
        principal = await authenticated(request)
        if not principal.may(self.permission):
            _LOG.warning(
                "request %s refused: key of %s lacks permission %s",
                request_id_of(request),
                principal.name,
                self.permission,
            )
            detail = f"a key of role {principal.role} may not {self.permission}"
            raise RequestProblemError(HTTPStatus.FORBIDDEN, "key.forbidden", detail)
        if self.permission in _AUDITED and request.method not in SAFE_METHODS:
            note_of(request.scope).audit_event = audit_event_of(
                request.scope, request.app.state.context.clock.system_us()
            )


class SendsKind(Requires):
    """A dependency that lets only holders pass who may send a kind of data for the spacecraft of the path.

    Parameters
    ----------
    kind : DataKind
        What the route takes.
    """

    def __init__(self, kind: DataKind) -> None:
        super().__init__(Permission.SEND)
        self._kind = kind

    async def __call__(self, request: Request) -> None:
        """Raise 401 or 403 as `Requires`, and 403 for what the station of a key is not bound to."""
        await super().__call__(request)
        principal, spacecraft_id = await authenticated(request), request.path_params["spacecraft_id"]
        for bound, asked in ((principal.spacecraft, spacecraft_id), (principal.kinds, self._kind.value)):
            if bound and asked not in bound:
                detail = f"station {principal.station!r} is bound to {', '.join(bound)}, not to {asked[:64]}"
                raise RequestProblemError(HTTPStatus.FORBIDDEN, "station.not_bound", detail)


def may_send(kind: DataKind) -> Any:
    """Return the dependency of a route that takes a kind of data."""
    return Depends(SendsKind(kind))


MAY_READ = Depends(Requires(Permission.READ))
MAY_SEND = Depends(Requires(Permission.SEND))
MAY_OPERATE = Depends(Requires(Permission.OPERATE))
MAY_APPROVE = Depends(Requires(Permission.APPROVE))
MAY_INSPECT = Depends(Requires(Permission.INSPECT))
MAY_ADMINISTER = Depends(Requires(Permission.ADMINISTER))
