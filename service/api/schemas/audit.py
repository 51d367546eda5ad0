"""Documents of the audit log."""

from typing import Self

from service.api.schemas.base import Answer, WindowAnswer
from service.api.schemas.record_answers import members_of
from service.records.operations.audit import AuditEntry, AuditEvent, AuditHead


class AuditEntryAnswer(members_of(AuditEvent), Answer):
    """One deed or refusal."""

    number: int
    previous_hash: str
    hash: str

    @classmethod
    def of(cls, entry: AuditEntry) -> Self:
        """Return the answer for an entry."""
        chain = {"number": entry.number, "previous_hash": entry.previous_hash, "hash": entry.hash}
        return super().of(entry.audit_event, **chain)


class AuditHeadAnswer(members_of(AuditHead), Answer):
    """Newest entry of the log; number 0 = it is empty."""


class AuditPage(Answer):
    """Entries in order of number."""

    range: WindowAnswer
    head: AuditHeadAnswer
    rows: list[AuditEntryAnswer]
    next: str | None
