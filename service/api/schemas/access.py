"""Documents of the service itself: version, keys, sessions, audit log, jobs."""

from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, StringConstraints
from pydantic_core import PydanticCustomError

from service.api.access.auth import Permission, Principal
from service.api.schemas.base import (
    NAME_PATTERN,
    Answer,
    Document,
    Epoch,
    EpochAnswer,
    RowList,
    WindowAnswer,
    members_of,
)
from service.records.operations.access import AccessKey, AuditEntry, AuditEvent, AuditHead, DataKind, Role, plain_name
from service.records.operations.work import Job
from service.records.setting import SettingSource


class ClockAnswer(Answer):
    """Clock of the service."""

    now: EpochAnswer
    """The present of the service's system."""
    kind: Literal["system", "data"]
    """`data`: the present of a simulated spacecraft is the newest epoch that it sent."""


class SettingAnswer(Answer):
    """Setting in force; of a secret and of what a URL may hide only that it is set."""

    name: str
    """Environment variable."""
    value: str
    default: str
    unit: str | None
    meaning: str
    origin: str
    """Where the default comes from."""
    source: SettingSource
    """Where the value was read."""


class ShippedAnswer(Answer):
    """Installed distribution."""

    name: str
    version: str
    licence: str | None
    """As its metadata state it; null where they do not."""


class AboutAnswer(Answer):
    """The service that answers."""

    version: str
    python: str
    clock: ClockAnswer
    settings: list[SettingAnswer]
    shipped: list[ShippedAnswer]
    """The program, then what is installed with it."""


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


class JobAnswer(members_of(Job, number=float), Answer):
    """One piece of long work."""


def _name(text: str) -> str:
    try:
        return plain_name(text)
    except ValueError as error:
        code, reason = "key.name", str(error)
        raise PydanticCustomError(code, "{reason}", {"reason": reason}) from error


class KeyState(StrEnum):
    """Validity of a key."""

    VALID = "valid"
    EXPIRED = "expired"
    REVOKED = "revoked"


HolderName = Annotated[
    str, StringConstraints(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$"), AfterValidator(_name)
]


class KeyDocument(Document):
    """Request for a new key."""

    name: HolderName
    """Holder of the key, as the audit log names it. Kept trimmed and in Unicode's normal form KC, without characters
    that cannot be seen; keys in force differ in more than case, and none is `bootstrap`, `anonymous` or `service`."""
    role: Annotated[Role, Field(strict=False)]
    expires_at: Epoch | None = None
    """Instant from which it is no longer valid; null = never."""
    station: HolderName | None = None
    """Only of role station: the station whose sources it sends, by default the name of the key. Another key of the same
    station replaces it."""
    spacecraft: (
        Annotated[list[Annotated[str, StringConstraints(pattern=NAME_PATTERN)]], Field(max_length=100)] | None
    ) = None
    """Spacecraft that the station may send for; empty: any. Null: as a valid key of the station states, else any."""
    kinds: Annotated[list[Annotated[DataKind, Field(strict=False)]], Field(max_length=10)] | None = None
    """Kinds of data that the station may send; empty: every one. Null: as a valid key of the station states."""


class KeyAnswer(members_of(AccessKey, without=("last_used_us",)), Answer):
    """A key without its secret."""

    state: KeyState
    last_used_at: EpochAnswer | None
    """Stored once a minute."""

    @classmethod
    def of(cls, key: AccessKey, now_us: int, last_used_us: int | None) -> Self:
        """Return the answer for a key."""
        state = KeyState.VALID if key.is_valid(now_us) else KeyState.EXPIRED
        state = KeyState.REVOKED if key.revoked_at_us is not None else state
        return super().of(key, state=state, last_used_at=last_used_us)


class NewKeyAnswer(Answer):
    """New key with its secret, which cannot be read again."""

    id: str
    key: str
    """Send it as Authorization: Bearer."""
    name: str
    role: Role
    expires_at: EpochAnswer | None


class KeyList(RowList[KeyAnswer]):
    """Keys in order of creation."""


class SessionDocument(Document):
    """Request for a session."""

    key: Annotated[str, StringConstraints(min_length=1, max_length=256, pattern=r"^[!-~]+$"), Field(repr=False)]
    """Key of the person at the desk."""


class SessionAnswer(Answer):
    """Holder of the key that a request came with."""

    name: str
    role: Role
    permissions: list[Permission]
    """In alphabetical order."""
    key_expires_at: EpochAnswer | None
    """Instant from which the key is no longer valid; null = never."""
    session_ends_at: EpochAnswer | None
    """Instant at which the session asks for the key again; null where the key came as Authorization: Bearer."""

    @classmethod
    def of(cls, principal: Principal) -> Self:
        """Return the answer for the holder of a key."""
        content = {
            "name": principal.name,
            "role": principal.role,
            "permissions": sorted(each for each in Permission if principal.may(each)),
            "key_expires_at": principal.expires_at_us,
            "session_ends_at": None if principal.session is None else principal.session.ends_at_us,
        }
        return cls.model_validate(content)
