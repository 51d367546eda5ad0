"""Principals: the holder of a key, and the permissions of each role.

A role is a set of permissions; no code outside this file asks for a role by name.
"""

from dataclasses import dataclass
from enum import StrEnum

from service.records.operations.access_key import Role


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

    def may(self, permission: Permission) -> bool:
        """Return whether the role carries a permission."""
        return permission in PERMISSIONS[self.role]
