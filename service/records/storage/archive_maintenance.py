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
class RetiredRows:
    """Rows that one transaction of retention took away."""

    #: measurements, attitude, torques or traces
    series: str
    rows: int
    #: nothing older is kept now, microseconds UTC
    kept_from_us: int


@dataclass(frozen=True, slots=True)
class SealingConfig:
    """When closed days are packed."""

    #: after midnight, and after the last row of a day came in, s
    quiet_s: float = 900.0
    #: between two looks for days to seal and rows to drop, s
    period_s: float = 60.0
    #: between two transactions, so that rows come in between them, s
    pause_s: float = 0.05


@dataclass(frozen=True, slots=True)
class RetentionConfig:
    """How long series are kept: 0 = for ever, and without limit of size."""

    measurements_days: float = 0.0
    attitude_days: float = 0.0
    torques_days: float = 0.0
    traces_days: float = 0.0
    #: alarms that are closed, with what happened to them, by the instant they were raised at
    alarms_days: float = 0.0
    #: entries of the shift log, by the instant they are about
    notes_days: float = 0.0
    #: of each spacecraft
    measurements_bytes: int = 0
    attitude_bytes: int = 0
    torques_bytes: int = 0

    def days(self, series: str) -> float:
        """Return how many days of a series are kept, 0 = all."""
        return float(getattr(self, f"{series}_days"))

    def size_bytes(self, series: str) -> int:
        """Return how many bytes of a series are kept, 0 = all."""
        return int(getattr(self, f"{series}_bytes", 0))


#: what retention knows of each spacecraft
SERIES = ("measurements", "attitude", "torques", "traces")
#: what it knows of each spacecraft and of the service as a whole
LOGS = ("alarms", "notes")
