"""Alarms: states, changes, limits and memory of the engine; notes of the shift log."""

import math
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Annotated


class Severity(IntEnum):
    """Severity of an alarm, in the words of mission control."""

    WATCH = 1
    WARNING = 2
    DISTRESS = 3
    CRITICAL = 4
    SEVERE = 5

    @property
    def word(self) -> str:
        """The severity as it is told."""
        return self.name.lower()


class Process(StrEnum):
    """Process state of an alarm between its condition and the operator."""

    #: the condition is gone and nothing is left to be seen; the alarm is closed
    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    #: the condition is gone, nobody has acknowledged that it was there
    RETURNED = "returned"
    #: the condition is gone and was acknowledged; the alarm stays until it is cleared
    LATCHED = "latched"


class Cover(StrEnum):
    """Reason for which an alarm sends no notices."""

    NONE = "none"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed"


class ChangeKind(StrEnum):
    """Kind of a change of an alarm."""

    RAISED = "raised"
    ESCALATED = "escalated"
    RETURNED = "returned"
    REPEATED = "repeated"
    ACKNOWLEDGED = "acknowledged"
    SHELVED = "shelved"
    UNSHELVED = "unshelved"
    SUPPRESSED = "suppressed"
    RELEASED = "released"
    CLEARED = "cleared"


@dataclass(frozen=True, slots=True)
class Handling:
    """Action of an operator on an alarm: name, time and comment."""

    by: str
    at_us: int
    comment: str = ""


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm from its raising to its closing; figures are NaN where the condition has none."""

    #: global; 0 until it is stored
    id: int
    spacecraft_id: Annotated[str | None, "Null: it concerns the service as a whole."]
    #: name of the condition
    condition: str
    thing: Annotated[str, "Which carrier, axis, link .. it is about."]
    process: Process
    cover: Cover
    severity: Annotated[Severity, "Worst since it was raised."]
    #: when the condition was first seen, microseconds UTC of the spacecraft's clock
    since_us: int
    raised_at_us: int
    changed_at_us: int
    value: Annotated[float, "Value that raised it, or made it worse."]
    #: that it passed
    limit: float
    unit: str
    #: what happened, in words
    detail: str
    value_at_us: Annotated[int, "Epoch of that value."] = 0
    cause: Annotated[
        tuple[str, str] | None,
        "Condition and thing of the alarm that explains this one: it is neither counted nor told. Null: its own alarm.",
    ] = None
    #: 1 = once
    count: Annotated[int, "How often the condition came back before the alarm was closed."] = 1
    #: when somebody was last told, and how often it was repeated because nobody acted
    announced_at_us: int | None = None
    repeats: int = 0
    returned_at_us: int | None = None
    acknowledged: Handling | None = None
    shelved: Handling | None = None
    shelved_until_us: int | None = None
    cleared: Handling | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Condition and thing; there is one open alarm of each."""
        return self.condition, self.thing

    @property
    def is_open(self) -> bool:
        """Return whether the alarm still stands, be it under a cover."""
        return self.process is not Process.NORMAL or self.cover is not Cover.NONE

    @property
    def is_active(self) -> bool:
        """Return whether the condition stands."""
        return self.process in (Process.UNACKNOWLEDGED, Process.ACKNOWLEDGED)

    @property
    def ended_us(self) -> int | None:
        """When the condition went, or an operator closed the alarm before; None while it stands."""
        if self.returned_at_us is None and not self.is_active:
            return self.changed_at_us
        return self.returned_at_us

    @property
    def state(self) -> str:
        """The state as it is told: that of the cover where there is one."""
        return self.process.value if self.cover is Cover.NONE else self.cover.value


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """One change of one alarm; ``alarm`` is what it was after it."""

    kind: ChangeKind
    alarm: Alarm
    at_us: int
    #: whether somebody is to be told
    is_told: bool
    handling: Handling | None = None
    #: global and ascending; 0 until it is stored
    sequence: int = 0


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


@dataclass(slots=True)
class ValueMemory:
    """Memory of one value that is not, or not yet again, as it should be."""

    #: severity that was alarmed, 0 = none
    level: int = 0
    #: when the condition was first seen; for what lasts, when it began
    since_us: int | None = None
    #: least severity above ``level`` since ``pending_us``, which is alarmed when it has stood for its time
    pending_level: int = 0
    pending_us: int | None = None
    #: since when it has been gone
    gone_us: int | None = None
    #: condition and thing of the alarm that explains the value; since when another one does, or none
    cause: tuple[str, str] | None = None
    other_us: int | None = None
    #: newest value; not compared: NaN, by which it is stored, is not equal to itself
    value: float = field(default=math.nan, compare=False)
    newest_us: int = -(1 << 62)

    @property
    def is_idle(self) -> bool:
        """Return whether there is nothing to remember."""
        return self.level == 0 and self.pending_us is None and self.since_us is None


@dataclass(frozen=True, slots=True)
class WatchMemory:
    """Memory of one condition of one subject."""

    condition: str
    thing: str
    watch: ValueMemory


@dataclass(frozen=True, slots=True)
class EngineMemory:
    """Memory of the alarm engine of one spacecraft."""

    watches: tuple[WatchMemory, ...] = ()
    #: epoch of the newest row that was read, and the period of the rows
    newest_row_us: int | None = None
    row_period_s: float | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """One note."""

    #: global; 0 until it is stored
    id: int
    #: None: it concerns no spacecraft or all
    spacecraft_id: str | None
    #: instant that it is about, microseconds UTC
    epoch_us: int
    written_at_us: int
    author: str
    text: str
    tags: tuple[str, ...] = ()
    #: the note that this one corrects
    corrects: int | None = None
