"""The audit log as it is told."""

from typing import Self

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.records.operations.audit import AuditEntry, AuditHead


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
    """How many equal refusals this entry stands for; the last of them is the one told."""
    previous_hash: str
    hash: str

    @classmethod
    def of(cls, entry: AuditEntry) -> Self:
        """Return the answer that tells an entry."""
        audit_event = entry.audit_event
        return cls.model_validate(
            {
                "number": entry.number,
                "at": audit_event.at_us,
                "who": audit_event.who,
                "key_id": audit_event.key_id,
                "role": audit_event.role,
                "address": audit_event.address,
                "action": audit_event.action,
                "target": audit_event.target,
                "outcome": audit_event.outcome,
                "request_id": audit_event.request_id,
                "body_sha256": audit_event.body_sha256,
                "times": audit_event.times,
                "previous_hash": entry.previous_hash,
                "hash": entry.hash,
            }
        )


class AuditHeadAnswer(Answer):
    """Newest entry of the log; number 0 = it is empty."""

    number: int
    hash: str

    @classmethod
    def of(cls, head: AuditHead) -> Self:
        """Return the answer that tells a head."""
        return cls(number=head.number, hash=head.hash)


class AuditPage(Answer):
    """Entries in order of number."""

    range: WindowAnswer
    head: AuditHeadAnswer
    rows: list[AuditEntryAnswer]
    next: str | None
