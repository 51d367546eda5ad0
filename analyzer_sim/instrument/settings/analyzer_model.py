"""Model of one make of analyzer, as data: ranges of its settings and their start-up values; no command, no coupling.

Law of this file: a figure by which two makes differ is a field here and stands nowhere else. The makes themselves are
in ``models.py``; the couplings that use the figures are in ``instrument_settings.py``.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

#: sweeps combined into one trace; fewer than real instruments take, so that no trace costs more than seconds to draw
MAX_SWEEPS = 1000


class Limits(NamedTuple):
    """Legal range of a setting and its value after ``*RST``."""

    low: float
    high: float
    default: float


def decade_steps(mantissas: tuple[float, ...], low_hz: float, high_hz: float) -> tuple[float, ...]:
    """Return the filter steps between two bandwidths, Hz, ascending: each mantissa in each decade.

    Examples
    --------
    >>> decade_steps((1, 3), 10.0, 1000.0)
    (10.0, 30.0, 100.0, 300.0, 1000.0)
    """
    decades = range(math.floor(math.log10(low_hz)), math.floor(math.log10(high_hz)) + 1)
    steps = (round(mantissa * 10.0**decade, 9) for decade in decades for mantissa in mantissas)
    return tuple(step for step in steps if low_hz <= step <= high_hz)


@dataclass(frozen=True, slots=True)
class FilterSteps:
    """Bandwidths a filter can take."""

    #: ascending, Hz
    steps_hz: tuple[float, ...]
    #: the nearest step is taken on a linear scale and, half way, upwards; else on a logarithmic scale
    is_linear: bool = False

    @property
    def limits(self) -> Limits:
        """Narrowest and widest step; the default is the step nearest to 3 MHz."""
        return Limits(self.steps_hz[0], self.steps_hz[-1], self.legal(3e6))

    def legal(self, value_hz: float) -> float:
        """Return the step the filter takes for a wanted bandwidth.

        Examples
        --------
        >>> FilterSteps((30e3, 100e3)).legal(60e3), FilterSteps((30e3, 100e3), is_linear=True).legal(60e3)
        (100000.0, 30000.0)
        """
        clamped = min(max(value_hz, self.steps_hz[0]), self.steps_hz[-1])
        if self.is_linear:
            return min(self.steps_hz, key=lambda step: (abs(step - clamped), -step))
        return min(self.steps_hz, key=lambda step: abs(math.log(step / clamped)))

    def neighbour(self, step_hz: float, direction: int) -> float:
        """Return the next wider (+1) or narrower (-1) step; the outermost ones are their own neighbours."""
        at = self.steps_hz.index(self.legal(step_hz)) + direction
        return self.steps_hz[min(max(at, 0), len(self.steps_hz) - 1)]


@dataclass(frozen=True, slots=True)
class AnalyzerModel:
    """Figures of one make: ranges, steps, the state after a reset, how it reports errors."""

    max_frequency_hz: float
    rbw: FilterSteps
    vbw: FilterSteps
    points: Limits
    #: duration of one sweep, s
    sweep_time_s: Limits
    reference_dbm: Limits
    #: gain or loss before the input that levels can be corrected by
    level_offset_db: Limits
    attenuation_db: Limits
    #: step of the attenuator by hand, and when it follows the reference level
    attenuation_step_db: float
    attenuation_coupled_step_db: float
    #: sweeps of an average; the largest is bounded by ``MAX_SWEEPS``
    average_count: Limits
    #: width of the channel whose power is measured; 0 = as wide as the span
    channel_width_hz: Limits
    #: ``*RST`` leaves the instrument sweeping without end
    is_continuous_after_reset: bool
    #: ``SYSTem:PRESet`` leaves the instrument sweeping without end
    is_continuous_after_preset: bool
    min_span_hz: float = 10.0
    #: couplings: the span by the resolution bandwidth, the video by the resolution bandwidth
    span_per_rbw: float = 100.0
    vbw_per_rbw: float = 1.0
    #: detector after ``*RST``, a word of ``Settings.detector``
    detector: str = "APE"
    #: average type after ``*RST``, a word of ``Settings.average_type``
    average_type: str = "VID"
    #: the number of points is accepted and ignored, as some firmware does
    are_points_fixed: bool = False
    #: REAL and INT blocks after ``*RST``
    is_big_endian: bool = False
    #: bit of QUEStionable:CONDition that tells of a sweep faster than the filter settles: 8 CALibration, 9 INTegrity
    uncalibrated_bit: int = 8
    #: answer of an empty error queue
    no_error: str = '0,"No error"'
    #: entries the error queue holds
    error_queue_depth: int = 30
    #: each session has an error queue of its own
    is_error_queue_per_session: bool = False
