"""Memory of the alarm engine beside open alarms, so that a restart neither forgets nor repeats a notice."""

import math
from dataclasses import dataclass, field


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
