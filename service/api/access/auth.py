"""Authentication and authorisation: keys (Bearer, or by the cookie of a session), permissions, rates.

Keys are compared as digests in constant time and never logged. Without a valid key 401, without the permission 403,
above the rate 429. Each permitted change is committed together with its audit event.
"""

import logging
from http import HTTPStatus
from typing import Annotated, Protocol

from fastapi import Depends, Request

from service.api.access.audit_context import SAFE_METHODS, address_of, audit_event_of, note_of
from service.api.access.principals import Permission, Principal
from service.api.access.session_cookie import OfferedKey, offered_key, require_same_origin
from service.api.limits.rate_limits import Allowance, RateLimits, class_of
from service.api.problems.problems import RequestProblemError, request_id_of
from service.records.operations.access_key import without_secrets

_LOG = logging.getLogger(__name__)
#: what is audited one by one; data that stations send is not: its journal and receipts tell of it
_AUDITED = frozenset({Permission.OPERATE, Permission.APPROVE, Permission.ADMINISTER})


class KeyRing(Protocol):
    """Port of the known keys."""

    async def principal(self, key: str) -> Principal | None:
        """Return the holder of a valid key, None for any other text."""


async def authenticated(request: Request) -> Principal:
    """Return the holder of the request's key; looked up and counted once a request."""
    known: Principal | None = getattr(request.state, "principal", None)
    if known is None:
        known = request.state.principal = await _holder(request)
        _count(request, known)
    return known


async def known_or_counted(request: Request) -> Principal | None:
    """Return the holder of the Bearer key or of the session's; without a valid one None, counted by the address."""
    principal, offered = None, offered_key(request)
    if offered is not None and not _is_over(request, offered):
        principal = await holder_of(request, offered.text)
    if principal is None:
        limits: RateLimits = request.app.state.rate_limits
        refuse_above(limits.consume_anonymous(address_of(request.scope)))
    elif offered is not None and offered.ends_at_us is not None:
        require_same_origin(request)
        request.state.session_ends_at_us = offered.ends_at_us
    return principal


async def holder_of(request: Request, key: str) -> Principal | None:
    """Return the holder of a valid key, None for any other text."""
    ring: KeyRing = request.app.state.key_ring
    return await ring.principal(key)


def _is_over(request: Request, offered: OfferedKey) -> bool:
    """Return whether a key came by the cookie of a session that has ended."""
    now_us = request.app.state.context.clock.system_us()
    return offered.ends_at_us is not None and bool(offered.ends_at_us <= now_us)


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


MAY_READ = Depends(Requires(Permission.READ))
MAY_SEND = Depends(Requires(Permission.SEND))
MAY_OPERATE = Depends(Requires(Permission.OPERATE))
MAY_APPROVE = Depends(Requires(Permission.APPROVE))
MAY_INSPECT = Depends(Requires(Permission.INSPECT))
MAY_ADMINISTER = Depends(Requires(Permission.ADMINISTER))
