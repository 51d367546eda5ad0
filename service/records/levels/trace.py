"""Evidence traces: sweeps that a front end took, kept for a while so that a level can be looked into."""

from dataclasses import dataclass
from typing import Annotated

from service.records.levels.attitude import FloatArray


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """Under which settings a trace was really taken."""

    #: frequency of the first point, Hz
    start_hz: float
    #: distance of neighbouring points, Hz
    step_hz: float
    #: 3 dB width of the resolution filter, Hz
    rbw_hz: float
    #: noise bandwidth of the resolution filter, Hz
    enbw_hz: float
    #: time of one sweep, s
    sweep_time_s: float


@dataclass(frozen=True, slots=True)
class Trace:
    """One trace as a front end sends it."""

    epoch_us: int
    #: name of the sweep in the measurement task
    sweep: str
    settings: TraceSettings
    #: (B,) dBm behind the resolution filter, NaN = the analyzer gave no number
    power_dbm: FloatArray


@dataclass(frozen=True, slots=True)
class TraceHead:
    """A kept trace without its points."""

    #: order of receipt
    number: int
    source: str
    epoch_us: int
    sweep: str
    settings: TraceSettings
    points: int
    received_at_us: int
    size_bytes: Annotated[int, "Size of its points in the archive."]


@dataclass(frozen=True, slots=True)
class KeptTrace:
    """A kept trace."""

    head: TraceHead
    #: (B,) dBm as stored (float32 widened), NaN = the analyzer gave no number
    power_dbm: FloatArray


@dataclass(frozen=True, slots=True)
class Ring:
    """Bounds of the traces kept of one source; beyond them the oldest epochs are dropped."""

    traces: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class TraceReceipt:
    """Receipt of traces; given only after the commit."""

    accepted: int
    #: source, sweep and epoch were known; the first one stays
    duplicates: int
    dropped: Annotated[int, "Traces, new or old, that the ring of the source had no place for."]
