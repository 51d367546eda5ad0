"""Access: keys as the archive stores them, and the audit log, a chain in which an entry vouches for the one before."""

import json
import re
import secrets
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import astuple, dataclass, replace
from enum import StrEnum
from hashlib import sha256
from typing import Annotated

PREFIX = "soo"
_ID_LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
_ID_LENGTH = 10
_SECRET_BYTES = 32
_NAME_LENGTH = 64
#: who acts without a key of the archive
RESERVED_NAMES = frozenset({"anonymous", "bootstrap", "service"})
#: fillers, variation selectors, the joiner of graphemes and the empty pattern of Braille
_BLANK = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef]")
#: key id of the administrator's key that the settings give
BOOTSTRAP_ID = "bootstrap"
#: secrets of no known form; shorter ones are words that stand in any text
_HIDDEN: set[str] = set()
_LEAST_HIDDEN = 8
_WHOLE_KEY = re.compile(rf"({PREFIX}_[a-z0-9]+_)[\w-]+", re.ASCII)


class DataKind(StrEnum):
    """DataKind of data that a station sends."""

    POWERS = "powers"
    TELEMETRY = "telemetry"
    CORRECTIONS = "corrections"
    REFERENCES = "references"
    WEATHER = "weather"
    POLARIZATION = "polarization"


class Role(StrEnum):
    """Role of a key; it decides the permissions."""

    VIEWER = "viewer"
    STATION = "station"
    OPERATOR = "operator"
    APPROVER = "approver"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessKey:
    """One key without its secret."""

    id: str
    name: str
    role: Role
    created_at_us: int
    created_by: str
    #: instant from which it is no longer valid; None = never
    expires_at_us: int | None = None
    last_used_us: int | None = None
    revoked_at_us: int | None = None
    station: Annotated[str | None, "Station whose sources it sends; null: a key of a person."] = None
    spacecraft: Annotated[tuple[str, ...], "What its station may send for; empty: any."] = ()
    kinds: Annotated[tuple[str, ...], "Kinds of data that its station may send; empty: every one."] = ()

    def is_valid(self, at_us: int) -> bool:
        """Return whether the key opens anything at an instant."""
        return self.revoked_at_us is None and (self.expires_at_us is None or at_us < self.expires_at_us)


@dataclass(frozen=True, slots=True)
class StoredKey:
    """A key and the digest that its bearer is checked against."""

    key: AccessKey
    digest: bytes


@dataclass(frozen=True, slots=True)
class BrowserSession:
    """A session of a browser; its token is never stored."""

    #: of the token together with the service and the key, so that it holds for no other
    digest: bytes
    key_id: str
    ends_at_us: int


def plain_name(text: str) -> str:
    """Return a name as it is kept: in normal form KC, trimmed, with single spaces.

    Raises
    ------
    ValueError
        Says why nobody may be called so: nothing or too much is left, a character cannot be seen, or the name stands
        in the audit log for somebody who has no key.

    Examples
    --------
    >>> plain_name("  Olga\u00a0 B. ")
    'Olga B.'
    """
    name = re.sub(" +", " ", unicodedata.normalize("NFKC", text).strip())
    if not 1 <= len(name) <= _NAME_LENGTH:
        message = f"a name has 1 to {_NAME_LENGTH} characters"
        raise ValueError(message)
    hidden = next((each for each in name if _is_invisible(each)), None)
    if hidden is not None:
        message = f"the character U+{ord(hidden):04X} cannot be seen; leave it out"
        raise ValueError(message)
    if name_key(name) in RESERVED_NAMES:
        message = "the audit log calls others so; choose another name"
        raise ValueError(message)
    return name


def name_key(name: str) -> str:
    """Return the form of a name that must be unique."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold()).strip()


def _is_invisible(letter: str) -> bool:
    """Return whether a character is invisible: controls, formats, separators but the space, fillers and selectors."""
    category = unicodedata.category(letter)
    return (category[0] in "CZ" and letter != " ") or _BLANK.match(letter) is not None


def new_key() -> tuple[str, str]:
    """Return the id of a fresh key and its whole text, which is never kept."""
    key_id = "".join(secrets.choice(_ID_LETTERS) for _ in range(_ID_LENGTH))
    return key_id, f"{PREFIX}_{key_id}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def id_of(text: str) -> str | None:
    """Return the id that the text of a key names; None for a text of another form.

    Examples
    --------
    >>> id_of("soo_abc_x_y"), id_of("password")
    ('abc', None)
    """
    prefix, _, rest = text.partition("_")
    key_id, separator, _ = rest.partition("_")
    return key_id if prefix == PREFIX and separator and key_id else None


def digest_of(text: bytes) -> bytes:
    """Return the digest of a key, which is stored in its place."""
    return sha256(text).digest()


def new_session_token(key_id: str) -> str:
    """Return the token of a fresh session of a key; it is never kept."""
    return f"{key_id}.{secrets.token_urlsafe(_SECRET_BYTES)}"


def key_id_of_session(token: str) -> str:
    """Return the id of the key that the token of a session names."""
    return token.partition(".")[0]


def session_digest(token: str, key_digest: bytes, service_id: str) -> bytes:
    """Return the digest of a session's token, which holds for one key of one service."""
    return sha256(key_digest + f"{service_id} {token}".encode("utf-8", "surrogateescape")).digest()


def hide(secret: str) -> None:
    """Leave a secret out of every text from now on that `without_secrets` returns."""
    if len(secret) >= _LEAST_HIDDEN:
        _HIDDEN.add(secret)


def without_secrets(text: str) -> str:
    """Return a text with its keys masked, for logs: a key that a client puts into a path is not logged.

    Examples
    --------
    >>> without_secrets("/api/v1/keys/soo_abc_secret")
    '/api/v1/keys/soo_abc_...'
    """
    for secret in _HIDDEN:
        text = text.replace(secret, "...")
    return _WHOLE_KEY.sub(r"\1...", text)


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
    if entry.number != former.number + 1:
        yield ChainFinding(former.number + 1, "missing", f"after number {former.number} comes {entry.number}")
    elif entry.previous_hash != former.hash:
        yield ChainFinding(entry.number, "changed", "the entry does not follow the one before it")
    if entry_hash(entry.number, entry.audit_event, entry.previous_hash) != entry.hash:
        yield ChainFinding(entry.number, "changed", "the fields do not give the hash")
