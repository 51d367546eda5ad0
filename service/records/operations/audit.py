"""Audit: who did what, as a chain in which each entry vouches for the one before.

The hash of an entry covers its number, all its fields and the hash before it, so an entry that was changed, taken out
or put in breaks the chain at its place. A chain whose end was cut off is a good chain: only a head that is kept
elsewhere tells, therefore the newest number and hash also stand in a table of their own, in the answers of the
interface and in the log.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import astuple, dataclass, replace
from hashlib import sha256
from typing import Annotated

#: hash before the first entry
GENESIS = "0" * 64
#: what a deed that took place is called; refusals and failures name their status
DONE = "done"


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEvent:
    """Something that was done, or refused."""

    at_us: int
    who: Annotated[str, "Name of the key; anonymous without a valid one."]
    key_id: str
    role: str
    #: network address that the request came from
    address: str
    #: in the OpenAPI document, without its path
    action: Annotated[str, "Name of the operation."]
    target: Annotated[str, "Path below the base, with the id of what was made."]
    outcome: Annotated[str, "done, or the status of the refusal or failure."]
    request_id: str
    body_sha256: Annotated[str | None, "Of the body after unpacking, hexadecimal."] = None
    times: Annotated[int, "Number of equal refusals in this entry, which shows the last of them."] = 1


@dataclass(frozen=True, slots=True)
class AuditHead:
    """Newest entry of a chain; number 0 = an empty chain."""

    number: int
    hash: str


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One link of the chain."""

    number: int
    audit_event: AuditEvent
    previous_hash: str
    hash: str

    @property
    def head(self) -> AuditHead:
        """Return the head of a chain that ends here."""
        return AuditHead(self.number, self.hash)


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditFilter:
    """Filter of audit entries; None = any."""

    start_us: int
    stop_us: int
    who: str | None = None
    role: str | None = None
    action: str | None = None
    outcome: str | None = None
    target_prefix: str | None = None


@dataclass(frozen=True, slots=True)
class ChainFinding:
    """One inconsistency of a chain."""

    number: int
    #: changed | missing | truncated | beyond_head | announced
    kind: str
    detail: str


@dataclass
class AuditContext:
    """Audit entry that one request writes with its change.

    Attributes
    ----------
    audit_event : AuditEvent or None
        Set once caller and action are known; the first write then stores it.
    entry : AuditEntry or None
        The entry, once it is committed.
    """

    audit_event: AuditEvent | None = None
    entry: AuditEntry | None = None

    @property
    def due(self) -> AuditEvent | None:
        """Return the event that the next write has to store."""
        return self.audit_event if self.entry is None else None


#: note of the request in progress; empty outside of requests and in requests that change nothing
CURRENT_NOTE: ContextVar[AuditContext | None] = ContextVar("audit_note", default=None)


@contextmanager
def apart_from_request() -> Iterator[None]:
    """Keep what is written meanwhile apart from the request in progress: it is not what was asked for."""
    token = CURRENT_NOTE.set(None)
    try:
        yield
    finally:
        CURRENT_NOTE.reset(token)


def next_entry(head: AuditHead, audit_event: AuditEvent) -> AuditEntry:
    """Return the entry that follows a head."""
    number = head.number + 1
    return AuditEntry(number, audit_event, head.hash, entry_hash(number, audit_event, head.hash))


def entry_hash(number: int, audit_event: AuditEvent, previous_hash: str) -> str:
    """Return the hash of an entry: SHA-256 over the JSON list of previous hash, number and all fields in order."""
    content = json.dumps([previous_hash, number, *astuple(audit_event)], separators=(",", ":"), ensure_ascii=True)
    return sha256(content.encode("ascii")).hexdigest()


def naming_result(audit_event: AuditEvent, result: object) -> AuditEvent:
    """Return the deed with the id of what it made, when its target is a collection."""
    made = getattr(result, "id", None)
    if not audit_event.target.endswith("/") or not isinstance(made, int | str):
        return replace(audit_event, target=audit_event.target.rstrip("/"))
    return replace(audit_event, target=f"{audit_event.target}{made}")


def findings(
    entries: Iterable[AuditEntry],
    head: AuditHead,
    announced: Mapping[int, str] | None = None,
    head_after: Callable[[], AuditHead] | None = None,
) -> Iterator[ChainFinding]:
    """Yield every place where a chain is broken.

    Parameters
    ----------
    entries : iterable of AuditEntry
        All stored entries in order of their numbers.
    head : AuditHead
        The head that was kept beside them, read before them.
    announced : mapping, optional
        Hashes by number that were written down elsewhere, for example in the log.
    head_after : callable, optional
        Gives the head once the entries have been read, for a log that grows meanwhile; ``head`` by default.
    """
    last = AuditHead(0, GENESIS)
    unseen = dict(announced or {})
    for entry in entries:
        yield from _against_former(entry, last)
        if unseen.pop(entry.number, entry.hash) != entry.hash:
            yield ChainFinding(entry.number, "announced", "the hash is not the one that was announced")
        if entry.number == head.number and entry.hash != head.hash:
            yield ChainFinding(entry.number, "changed", "the hash is not that of the head")
        # go on from what is stored: one fault is told once, not at every later entry
        last = entry.head
    if last.number < head.number:
        yield ChainFinding(last.number + 1, "truncated", f"entries {last.number + 1} to {head.number} are gone")
    newest = head_after() if head_after else head
    if last.number > newest.number:
        yield ChainFinding(newest.number + 1, "beyond_head", f"the head was left at number {newest.number}")
    for number in unseen:
        yield ChainFinding(number, "announced", "an announced entry is gone")


def _against_former(entry: AuditEntry, former: AuditHead) -> Iterator[ChainFinding]:
    """Yield the faults of one entry."""
    if entry.number != former.number + 1:
        yield ChainFinding(former.number + 1, "missing", f"after number {former.number} comes {entry.number}")
    elif entry.previous_hash != former.hash:
        yield ChainFinding(entry.number, "changed", "the entry does not follow the one before it")
    if entry_hash(entry.number, entry.audit_event, entry.previous_hash) != entry.hash:
        yield ChainFinding(entry.number, "changed", "the fields do not give the hash")
