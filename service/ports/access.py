"""The ports of who may do what, and who did it."""

from collections.abc import Iterator, Mapping
from typing import Protocol

from service.records.operations.access_key import AccessKey, StoredKey
from service.records.operations.audit import AuditEntry, AuditEvent, AuditFilter, AuditHead


class Keys(Protocol):
    """Access keys; only digests of them are ever stored."""

    def add(self, stored: StoredKey) -> AccessKey:
        """Store a new key; ConflictError ``key.exists`` when one in force has the name, whatever its case."""

    def all(self) -> tuple[StoredKey, ...]:
        """Return every key, revoked ones too, in order of creation."""

    def revoke(self, key_id: str, at_us: int) -> AccessKey:
        """Make a key worthless from now on; NotFoundError ``key.unknown`` also when it was revoked before."""

    def note_used(self, used_us: Mapping[str, int]) -> None:
        """Store when keys were last used, by id."""

    def add_first_administrator(self, stored: StoredKey, audit_event: AuditEvent) -> bool:
        """Store an administrator's key with its audit entry unless one is in force; return whether it was stored."""


class Audit(Protocol):
    """The audit log: entries are added, never changed."""

    def append(self, audit_event: AuditEvent) -> AuditEntry:
        """Add a deed and wait for its commit."""

    def entries(
        self, wanted: AuditFilter, limit: int, after: int | None, *, newest_first: bool = False
    ) -> list[AuditEntry]:
        """Return entries with numbers above ``after``, in order, or those below it in the reverse order."""

    def head(self) -> AuditHead:
        """Return the newest entry's number and hash as they stand beside the entries."""

    def chain(self) -> Iterator[AuditEntry]:
        """Yield every entry in order of number."""
