"""Who may do what: bearer keys, roles, permissions.

Keys are compared as digests in constant time and never logged. Without a valid key 401, without the permission 403.
A role is a set of permissions; no code outside this file asks for a role by name.
"""

import hmac
import logging
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from http import HTTPStatus
from typing import Annotated, Protocol

from fastapi import Depends, Request

from service.api.problems import ProblemError, request_id_of

_LOG = logging.getLogger(__name__)


class Role(StrEnum):
    """What a key was made for."""

    VIEWER = "viewer"
    STATION = "station"
    OPERATOR = "operator"
    APPROVER = "approver"
    ADMIN = "admin"


class Permission(StrEnum):
    """One thing that a key may do."""

    READ = "read"
    #: send measurements, references, telemetry
    SEND = "send"
    #: catalogue, operations, calibrate, align, prepare torques, acknowledge alarms
    OPERATE = "operate"
    #: confirm torques, engage
    APPROVE = "approve"
    #: keys
    ADMINISTER = "administer"


PERMISSIONS: dict[Role, frozenset[Permission]] = {
    Role.VIEWER: frozenset({Permission.READ}),
    Role.STATION: frozenset({Permission.READ, Permission.SEND}),
    Role.OPERATOR: frozenset({Permission.READ, Permission.SEND, Permission.OPERATE}),
    Role.APPROVER: frozenset({Permission.READ, Permission.SEND, Permission.OPERATE, Permission.APPROVE}),
    Role.ADMIN: frozenset(Permission),
}


@dataclass(frozen=True, slots=True)
class Principal:
    """Holder of a key."""

    name: str
    role: Role

    def may(self, permission: Permission) -> bool:
        """Whether the role carries a permission."""
        return permission in PERMISSIONS[self.role]


class KeyRing(Protocol):
    """Where keys are known."""

    def principal(self, key: str) -> Principal | None:
        """Return the holder of a valid key, None for any other text."""
        ...


class BootstrapKey:
    """The one key that the environment gives; its holder is an administrator.

    Parameters
    ----------
    key : str or None
        None or empty: no key is valid.
    """

    def __init__(self, key: str | None) -> None:
        self._digest = sha256(key.encode("utf-8", "surrogateescape")).digest() if key else None

    def principal(self, key: str) -> Principal | None:
        """Return the administrator when the key is the one."""
        # headers reach us decoded as Latin-1; this gives back the bytes that were sent
        offered = sha256(key.encode("latin-1", "replace")).digest()
        is_same = hmac.compare_digest(offered, self._digest or b"")
        return Principal("bootstrap", Role.ADMIN) if self._digest and is_same else None


async def authenticated(request: Request) -> Principal:
    """Return the holder of the request's key; looked up once a request."""
    known: Principal | None = getattr(request.state, "principal", None)
    if known is None:
        known = request.state.principal = _holder(request)
    return known


def _holder(request: Request) -> Principal:
    """Return the holder of the key in the Authorization header; problem 401 without a valid one."""
    ring: KeyRing = request.app.state.key_ring
    scheme, _, key = request.headers.get("authorization", "").partition(" ")
    principal = ring.principal(key.strip()) if scheme.lower() == "bearer" else None
    if principal is None:
        _LOG.warning("request %s %s: no valid key", request_id_of(request), request.url.path)
        detail = "send a valid key as Authorization: Bearer <key>"
        raise ProblemError(HTTPStatus.UNAUTHORIZED, "key.invalid", detail, headers={"WWW-Authenticate": "Bearer"})
    return principal


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
        self._permission = permission

    async def __call__(self, request: Request) -> None:
        """Raise 401 without a valid key, 403 unless its holder has the permission."""
        principal = await authenticated(request)
        if not principal.may(self._permission):
            _LOG.warning("request %s: %s lacks %s", request_id_of(request), principal.name, self._permission)
            detail = f"a key of role {principal.role} may not {self._permission}; ask an administrator for another key"
            raise ProblemError(HTTPStatus.FORBIDDEN, "key.forbidden", detail)


MAY_READ = Depends(Requires(Permission.READ))
MAY_SEND = Depends(Requires(Permission.SEND))
MAY_OPERATE = Depends(Requires(Permission.OPERATE))
MAY_APPROVE = Depends(Requires(Permission.APPROVE))
MAY_ADMINISTER = Depends(Requires(Permission.ADMINISTER))
