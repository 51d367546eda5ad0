"""Level L0: one trace of the analyzer with its settings, and the traces that are stored as evidence."""

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import FloatArray


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Settings as the analyzer states them after it was set, not as they were asked for."""

    start_hz: float
    stop_hz: float
    points: int
    #: 3 dB width of the resolution filter, Hz
    rbw_hz: float
    #: noise bandwidth of the resolution filter, Hz
    enbw_hz: float
    vbw_hz: float
    #: time of one sweep, s
    sweep_time_s: float
    #: RMS, POS, NEG, SAMP or AVER
    detector: str
    #: sweeps averaged by the analyzer
    count: int = 1

    @property
    def step_hz(self) -> float:
        """Distance of neighbouring points, Hz."""
        return (self.stop_hz - self.start_hz) / max(self.points - 1, 1)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One trace."""

    #: name of the sweep in the measurement task
    sweep_id: str
    #: microseconds UTC, middle of the dwell
    epoch_us: int
    settings: SweepSettings
    #: (B,) mW behind the resolution filter, NaN = the analyzer gave no number
    power_mw: NDArray[np.float64]
    #: the analyzer reported an overload
    is_overrange: bool = False
    #: the analyzer reported an uncalibrated sweep
    is_uncalibrated: bool = False
    #: the analyzer's reference oscillator is not locked
    is_reference_unlocked: bool = False
    #: the trace repeats the previous one
    is_stale: bool = False
    #: settings changed under the front end's hands or were not taken
    is_setting_mismatch: bool = False


#: fields that say what is wrong with a trace
SWEEP_FLAGS = tuple(field.name for field in fields(Sweep) if field.name.startswith("is_"))


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
