"""Documents of access keys; the key itself is in one answer only."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import AfterValidator, Field, StringConstraints
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, Document, Epoch, EpochAnswer, RowList
from service.api.schemas.record_answers import members_of
from service.records.operations.access_key import AccessKey, Role, plain_name


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


class KeyDocument(Document):
    """Request for a new key."""

    name: Annotated[
        str, StringConstraints(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*$"), AfterValidator(_name)
    ]
    """Holder of the key, as the audit log names it. Kept trimmed and in Unicode's normal form KC, without characters
    that cannot be seen; keys in force differ in more than case, and none is `bootstrap`, `anonymous` or `service`."""
    role: Annotated[Role, Field(strict=False)]
    expires_at: Epoch | None = None
    """Instant from which it is no longer valid; null = never."""


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


class KeyList(RowList):
    """Keys in order of creation."""

    rows: list[KeyAnswer]
