"""Level L0: one trace of the analyzer with the settings under which it was really taken."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


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
