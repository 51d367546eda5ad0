"""Paths of one spacecraft, and batches of rows that are sent to it."""

from collections.abc import Mapping, Sequence
from typing import Any

from service.client.call import Call

Rows = Sequence[Mapping[str, Any]]
#: rows a page when nothing else is said: the most that the service gives
PAGE_ROWS = 10_000


def below(spacecraft_id: str, path: str = "") -> str:
    """Return a path of one spacecraft."""
    return f"/spacecraft/{spacecraft_id}{path}"


def batch(spacecraft_id: str, kind: str, body: Mapping[str, Any]) -> Call[Any]:
    """Return a batch of rows; the service keys them by content, so repeating it is safe."""
    return Call("POST", below(spacecraft_id, f"/{kind}:batch"), body, is_keyed=True)
