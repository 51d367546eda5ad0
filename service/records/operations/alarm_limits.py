"""Limits of alarms: per spacecraft, in sets of which declared operations and rain choose; versions are kept."""

from dataclasses import dataclass, field
from typing import Annotated

#: fields that a set states for a condition; a threshold of None is switched off
Statement = dict[str, float | bool | None]


@dataclass(frozen=True, slots=True)
class ConditionLimits:
    """Limits and delays of one alarm condition."""

    #: what the value must pass for each severity, in the condition's unit; None = never
    watch: float | None = None
    warning: float | None = None
    distress: float | None = None
    critical: float | None = None
    severe: float | None = None
    #: so far back inside the least limit the value must come before the condition counts as gone
    deadband: float = 0.0
    #: time that it must stand before it alarms, and be gone before it returns, s
    on_s: float = 0.0
    off_s: float = 0.0
    #: an active alarm that nobody acknowledged is told again after this; None = never
    repeat_s: float | None = 1800.0
    #: whether it stays after it was acknowledged and is gone, until it is cleared
    latching: bool = False
    #: whether its alarms are kept quiet while this set is in force
    suppressed: bool = False
    enabled: bool = True

    @property
    def thresholds(self) -> tuple[float | None, ...]:
        """The limits in ascending severity."""
        return self.watch, self.warning, self.distress, self.critical, self.severe


@dataclass(frozen=True, slots=True)
class AlarmLimits:
    """One version of a spacecraft's limits: what it states beyond the defaults."""

    version: Annotated[int, "0 = the defaults, nothing was stated."] = 0
    created_at_us: int = 0
    created_by: str = ""
    comment: str = ""
    #: by set, by condition
    sets: dict[str, dict[str, Statement]] = field(default_factory=dict)
    #: level of a carrier while nothing better is expected of it, dBm
    nominal_dbm: dict[str, float] = field(default_factory=dict)
