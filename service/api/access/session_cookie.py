"""Sessions of browsers: a cookie that carries a key, so that no script has to keep one, and no state on the server.

The cookie is HttpOnly and SameSite=Strict, and Secure under TLS. Its value is the instant at which the session ends and
the key; the instant bounds the session and protects nothing, for who holds the cookie holds the key.
"""

import re
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import urlsplit

from fastapi import Request, Response

from service.api.access.audit_context import SAFE_METHODS
from service.api.access.principals import Principal
from service.api.problems.problems import RequestProblemError
from service.records.epoch import US_PER_S

COOKIE = "soo_session"
LIFE_S = 12 * 3600
_VALUE = re.compile(r"([0-9]{1,17})\.(\S+)", re.ASCII)


class OfferedKey(NamedTuple):
    """Key that a request offers."""

    text: str
    #: when the session ends whose cookie carried it, microseconds UTC; None = it came as a Bearer key
    ends_at_us: int | None = None


def offered_key(request: Request) -> OfferedKey | None:
    """Return the key of the Authorization header, else that of the session's cookie; None where there is neither.

    A header that holds no valid key is not passed over in favour of the cookie: a second person's key at the same desk
    must not become the first one's.
    """
    header = request.headers.get("authorization")
    if header is not None:
        scheme, _, key = header.partition(" ")
        return OfferedKey(key.strip()) if scheme.lower() == "bearer" else None
    found = _VALUE.fullmatch(request.cookies.get(COOKIE, ""))
    return None if found is None else OfferedKey(found[2], int(found[1]))


def require_same_origin(request: Request) -> None:
    """Raise problem 403 for a change by cookie that does not come from a page of this service."""
    if request.method in SAFE_METHODS:
        return
    if request.headers.get("origin", "") != _origin_of(request):
        detail = "a session may change something only from a page of this service, whose address Origin states"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "session.origin", detail)


def open_session(request: Request, response: Response, principal: Principal, key: str, now_us: int) -> int:
    """Set the cookie of a session and return when it ends, microseconds UTC: after its life, or with its key."""
    ends_at_us = min(now_us + LIFE_S * US_PER_S, principal.expires_at_us or now_us + LIFE_S * US_PER_S)
    _set(request, response, f"{ends_at_us}.{key}", (ends_at_us - now_us) // US_PER_S)
    return ends_at_us


def close_session(request: Request, response: Response) -> None:
    """Take the cookie of a session away."""
    _set(request, response, "", 0)


def _set(request: Request, response: Response, value: str, max_age_s: int) -> None:
    """Set the cookie for so long."""
    response.set_cookie(
        COOKIE,
        value,
        max_age=max_age_s,
        path="/",
        secure=request.url.scheme == "https",
        httponly=True,
        samesite="strict",
    )


def _origin_of(request: Request) -> str:
    """Return the origin of the service's own pages, as the request names its host."""
    address = urlsplit(str(request.base_url))
    return f"{address.scheme}://{address.netloc}"
