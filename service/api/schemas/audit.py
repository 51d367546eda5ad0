"""Documents of the audit log."""

from typing import Self

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.records.operations.audit import AuditEntry


class AuditEntryAnswer(Answer):
    """One deed or refusal."""

    number: int
    at: EpochAnswer
    who: str
    """Name of the key; anonymous without a valid one."""
    key_id: str
    role: str
    address: str
    action: str
    """Name of the operation."""
    target: str
    """Path below the base, with the id of what was made."""
    outcome: str
    """done, or the status of the refusal or failure."""
    request_id: str
    body_sha256: str | None
    """Of the body after unpacking, hexadecimal."""
    times: int
    """Number of equal refusals in this entry, which shows the last of them."""
    previous_hash: str
    hash: str

    @classmethod
    def of(cls, entry: AuditEntry) -> Self:
        """Return the answer for an entry."""
        chain = {"number": entry.number, "previous_hash": entry.previous_hash, "hash": entry.hash}
        return super().of(entry.audit_event, **chain)


class AuditHeadAnswer(Answer):
    """Newest entry of the log; number 0 = it is empty."""

    number: int
    hash: str


class AuditPage(Answer):
    """Entries in order of number."""

    range: WindowAnswer
    head: AuditHeadAnswer
    rows: list[AuditEntryAnswer]
    next: str | None
