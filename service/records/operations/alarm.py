"""Alarms: what demands an operator, the states it goes through and the changes between them.

The words are those of ISA-18.2. An alarm has a process state, which the condition and the operator move, and may lie
under a cover: shelved by an operator until an instant, or suppressed by a declared operation. Under a cover nobody is
told anything.
"""

from dataclasses import dataclass
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
