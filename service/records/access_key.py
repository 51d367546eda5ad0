"""Access keys: who may speak to the service, as the archive remembers them.

A key reads ``soo_<id>_<secret>``: the id names the key in lists and in the audit log, the secret is 256 random bits. Of
the secret only a digest is kept. One round of SHA-256 is enough for it: slow, salted hashes protect words that people
choose, and 256 random bits cannot be guessed however fast a guess is.
"""

import re
import secrets
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256

PREFIX = "soo"
_ID_LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
_ID_LENGTH = 10
_SECRET_BYTES = 32
#: secrets of no known form; shorter ones are words that stand in any text
_HIDDEN: set[str] = set()
_LEAST_HIDDEN = 8
_WHOLE_KEY = re.compile(rf"({PREFIX}_[a-z0-9]+_)[\w-]+", re.ASCII)


class Role(StrEnum):
    """What a key was made for."""

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

    def is_valid(self, at_us: int) -> bool:
        """Whether the key opens anything at an instant."""
        return self.revoked_at_us is None and (self.expires_at_us is None or at_us < self.expires_at_us)


@dataclass(frozen=True, slots=True)
class StoredKey:
    """A key and the digest that its bearer is checked against."""

    key: AccessKey
    digest: bytes


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
    """Return what is kept of a key."""
    return sha256(text).digest()


def hide(secret: str) -> None:
    """Leave a secret out of every text from now on that `without_secrets` returns."""
    if len(secret) >= _LEAST_HIDDEN:
        _HIDDEN.add(secret)


def without_secrets(text: str) -> str:
    """Return a text in which no key stands, for logs: whoever puts one into a path shall not find it there.

    Examples
    --------
    >>> without_secrets("/api/v1/keys/soo_abc_secret")
    '/api/v1/keys/soo_abc_...'
    """
    for secret in _HIDDEN:
        text = text.replace(secret, "...")
    return _WHOLE_KEY.sub(r"\1...", text)
