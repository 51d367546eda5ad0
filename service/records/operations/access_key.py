"""Access keys: who may speak to the service, as the archive remembers them.

A key reads ``soo_<id>_<secret>``: the id names the key in lists and in the audit log, the secret is 256 random bits. Of
the secret only a digest is kept. One round of SHA-256 is enough for it: slow, salted hashes protect words that people
choose, and 256 random bits cannot be guessed however fast a guess is.
"""

import re
import secrets
import unicodedata
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256

PREFIX = "soo"
_ID_LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
_ID_LENGTH = 10
_SECRET_BYTES = 32
_NAME_LENGTH = 64
#: who acts without a key of the archive
RESERVED_NAMES = frozenset({"anonymous", "bootstrap", "service"})
#: fillers, variation selectors, the joiner of graphemes and the empty pattern of Braille
_BLANK = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef]")
#: secrets of no known form; shorter ones are words that stand in any text
_HIDDEN: set[str] = set()
_LEAST_HIDDEN = 8
_WHOLE_KEY = re.compile(rf"({PREFIX}_[a-z0-9]+_)[\w-]+", re.ASCII)


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

    def is_valid(self, at_us: int) -> bool:
        """Return whether the key opens anything at an instant."""
        return self.revoked_at_us is None and (self.expires_at_us is None or at_us < self.expires_at_us)


@dataclass(frozen=True, slots=True)
class StoredKey:
    """A key and the digest that its bearer is checked against."""

    key: AccessKey
    digest: bytes


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


def is_plain_name(text: str) -> bool:
    """Return whether a new key could be called so."""
    try:
        return plain_name(text) == text
    except ValueError:
        return False


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
