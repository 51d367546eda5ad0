"""Setting: its value in force, its default, its meaning with its unit, and where each of them comes from."""

from dataclasses import field
from typing import Literal, NamedTuple, TypeVar

#: units by the end of a name, those that end like another one first
_UNITS = {
    "_db_per_deg2": "dB/deg2",
    "_db_per_deg": "dB/deg",
    "_db_per_day": "dB/day",
    "_db_sqrt_h": "dB/sqrt(h)",
    "_db_hz": "dB Hz",
    "_n_m_s": "N m s",
    "_n_m": "N m",
    "_kg_m2": "kg m2",
    "_rad_s2": "rad/s2",
    "_rad_s": "rad/s",
    "_rad": "rad",
    "_rpm": "rpm",
    "_mm_h": "mm/h",
    "_per_s": "1/s",
    "_deg_h": "deg/h",
    "_deg_s": "deg/s",
    "_deg": "deg",
    "_dbm": "dBm",
    "_db": "dB",
    "_hz": "Hz",
    "_days": "days",
    "_bytes": "bytes",
    "_mb": "MB",
    "_h": "h",
    "_s": "s",
    "_m": "m",
}


def unit_of(name: str) -> str | None:
    """Return the unit that a name in small letters ends with; None for counts, shares and words.

    Examples
    --------
    >>> unit_of("yaw_rates_deg_s"), unit_of("carriers_used")
    ('deg/s', None)
    """
    return next((unit for end, unit in _UNITS.items() if name.endswith(end)), None)


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
