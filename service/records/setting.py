"""Setting inside a stage's configuration: its default, its meaning with its unit, and where the default comes from."""

from dataclasses import field
from typing import TypeVar

PUBLISHED = "publication"
TUNED = "simulated truth"
CHOSEN = "operation"

#: meaning of each origin
ORIGINS: dict[str, str] = {
    PUBLISHED: "stated in the publication of the method (Sevast'yanov 2013)",
    TUNED: "the publication gives no number; tuned on the simulator's truth",
    CHOSEN: "a matter of running the service; no figure of the estimate depends on it",
}

_Value = TypeVar("_Value")


def setting(default: _Value, meaning: str, origin: str) -> _Value:
    """Return the field of a frozen dataclass; the reference of settings reads meaning and origin from it."""
    return field(default=default, metadata={"meaning": meaning, "origin": origin})
