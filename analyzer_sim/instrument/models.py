"""Models of the makes: ranges of their settings and start-up values. No command, no coupling.

Law of this file: a figure by which two makes differ is a field of ``AnalyzerModel`` and stands nowhere else; the
couplings that use the figures are in ``instrument_settings.py``. [M] is in a maker's manual, the others are engineering
defaults.

Deviations from the real instruments, on purpose: all have one resolution filter shape (Gaussian); the counts of sweeps
end at ``MAX_SWEEPS``.
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


_RS_STEPS = FilterSteps(decade_steps((1, 2, 3, 5), 1.0, 10e6))
_E24 = (
    *(1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0),
    *(3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1),
)
_WIDE_STEPS = (4e6, 5e6, 6e6, 8e6)
_ONE_THREE = (1.0, 3.0)

#: Rohde & Schwarz FSW-26
FSW_26 = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=_RS_STEPS,
    vbw=_RS_STEPS,
    points=Limits(101, 100001, 1001),
    sweep_time_s=Limits(1e-3, 16000.0, 1.0),
    reference_dbm=Limits(-130.0, 30.0, 0.0),
    level_offset_db=Limits(-200.0, 200.0, 0.0),
    attenuation_db=Limits(0.0, 79.0, 10.0),
    attenuation_step_db=1.0,
    attenuation_coupled_step_db=5.0,
    average_count=Limits(0, MAX_SWEEPS, 0),
    channel_width_hz=Limits(100.0, 1e9, 14e3),
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
)

#: Keysight N9020B with option 526; E24 filter steps up to 3 MHz, then 4 5 6 8 MHz [M]
N9020B = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=FilterSteps((*decade_steps(_E24, 1.0, 3e6), *_WIDE_STEPS)),
    vbw=FilterSteps((*decade_steps(_E24, 1.0, 3e6), *_WIDE_STEPS, 50e6)),
    points=Limits(1, 100001, 1001),
    sweep_time_s=Limits(1e-3, 4000.0, 1.0),
    reference_dbm=Limits(-170.0, 30.0, 0.0),
    level_offset_db=Limits(-327.6, 327.6, 0.0),
    attenuation_db=Limits(0.0, 70.0, 10.0),
    attenuation_step_db=2.0,
    attenuation_coupled_step_db=2.0,
    average_count=Limits(1, MAX_SWEEPS, 100),
    channel_width_hz=Limits(1e3, 1e9, 2e6),
    span_per_rbw=106.0,
    is_continuous_after_reset=False,
    is_continuous_after_preset=True,
    is_big_endian=True,
    uncalibrated_bit=9,
    no_error='+0,"No error"',
)

#: Siglent SSA3032X; 751 points whatever is asked; filters nearest on a linear scale, rounding up [M]
SSA3032X = AnalyzerModel(
    max_frequency_hz=3.2e9,
    min_span_hz=100.0,
    rbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 1e6), is_linear=True),
    vbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 3e6), is_linear=True),
    points=Limits(751, 751, 751),
    sweep_time_s=Limits(917e-6, 1000.0, 1.0),
    reference_dbm=Limits(-100.0, 30.0, 0.0),
    level_offset_db=Limits(-300.0, 300.0, 0.0),
    attenuation_db=Limits(0.0, 51.0, 10.0),
    attenuation_step_db=1.0,
    attenuation_coupled_step_db=1.0,
    average_count=Limits(1, 999, 100),
    channel_width_hz=Limits(100.0, 3.2e9, 2e6),
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
    detector="POS",
    are_points_fixed=True,
    error_queue_depth=20,
)

#: Anritsu MS2090A with option 0726; couplings span/RBW 300, VBW/RBW 0.33, averages 2 to 65535 as its kin have [M]
MS2090A = AnalyzerModel(
    max_frequency_hz=26.5e9,
    rbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 10e6)),
    vbw=FilterSteps(decade_steps(_ONE_THREE, 1.0, 10e6)),
    points=Limits(10, 20001, 501),
    sweep_time_s=Limits(10e-6, 600.0, 1.0),
    reference_dbm=Limits(-150.0, 30.0, 0.0),
    level_offset_db=Limits(-100.0, 100.0, 0.0),
    attenuation_db=Limits(0.0, 65.0, 10.0),
    attenuation_step_db=5.0,
    attenuation_coupled_step_db=5.0,
    average_count=Limits(2, MAX_SWEEPS, 10),
    channel_width_hz=Limits(0.0, 26.5e9, 0.0),
    span_per_rbw=300.0,
    vbw_per_rbw=0.33,
    is_continuous_after_reset=True,
    is_continuous_after_preset=True,
    detector="POS",
    error_queue_depth=20,
)
