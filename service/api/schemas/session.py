"""Documents of a browser's session; no answer contains the key."""

from typing import Annotated, Self

from pydantic import Field, StringConstraints

from service.api.access.principals import Permission, Principal
from service.api.schemas.base import Answer, Document, EpochAnswer
from service.records.operations.access_key import Role


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
    def of(cls, principal: Principal, session_ends_at_us: int | None) -> Self:
        """Return the answer for the holder of a key."""
        content = {
            "name": principal.name,
            "role": principal.role,
            "permissions": sorted(each for each in Permission if principal.may(each)),
            "key_expires_at": principal.expires_at_us,
            "session_ends_at": session_ends_at_us,
        }
        return cls.model_validate(content)
