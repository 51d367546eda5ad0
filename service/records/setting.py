"""Setting: its value in force, its default, its meaning with its unit, and where each of them comes from."""

from dataclasses import field
from typing import Literal, NamedTuple, TypeVar

from service.records.units import unit_of

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
SettingSource = Literal["default", "environment", "file", "option"]


class SettingEntry(NamedTuple):
    """One setting as it is documented and shown."""

    #: environment variable
    name: str
    default: str
    meaning: str
    origin: str
    #: value in force, secrets hidden
    value: str
    #: where the value in force was read: a variable, a file of `SOO_SECRETS_DIR`, or an option of the command line
    source: SettingSource = "default"

    @property
    def unit(self) -> str | None:
        """Unit of the value, from its name; None for counts, shares and words."""
        return unit_of(self.name.lower())


def setting(default: _Value, meaning: str, origin: str) -> _Value:
    """Return the field of a frozen dataclass; the reference of settings reads meaning and origin from it."""
    return field(default=default, metadata={"meaning": meaning, "origin": origin})
