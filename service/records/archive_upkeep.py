"""What the archive does with its own rows: sealing closed days, checking them, dropping what is older than is kept."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SealedPart:
    """Rows that one transaction moved into a segment."""

    source: str
    plan_id: int
    #: microseconds UTC
    first_epoch_us: int
    last_epoch_us: int
    #: rows moved
    rows: int
    #: rows of the segments that were written, those that were sealed before included
    rows_of_segments: int


@dataclass(frozen=True, slots=True)
class SegmentState:
    """One sealed segment and whether it can be read."""

    segment_id: int
    source_key: int
    plan_id: int
    #: midnight with which its day begins, microseconds UTC
    day_start_us: int
    rows: int
    #: why it cannot be read; None when it can
    fault: str | None


@dataclass(frozen=True, slots=True)
class Dropped:
    """Rows that one transaction of retention took away."""

    #: measurements, attitude, torques or traces
    series: str
    rows: int
    #: nothing older is kept now, microseconds UTC
    kept_from_us: int
