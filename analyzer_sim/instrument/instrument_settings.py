"""Settings of the analyzer with their couplings, and the models of the makes: ranges and start-up values."""

import math
from dataclasses import dataclass, field
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


#: a sweep faster than this part of the automatic time is not calibrated
UNCALIBRATED_BELOW = 0.8
_MIXER_LIMIT_DBM = -10.0


@dataclass(slots=True)
class Settings:
    """State of the instrument that ``*RST`` resets; SI units, dBm, frequencies at the input."""

    model: AnalyzerModel
    stop_hz: float
    points: int
    average_count: int
    #: VID (mean of dB), LIN (mean of volts) or POW (mean of mW)
    average_type: str
    #: RMS POS NEG SAMP APE AVER (mean of dB) LIN (mean of volts) QPE
    detector: str
    #: an INIT sweeps without end
    is_continuous: bool
    #: order of the bytes in binary traces
    is_big_endian: bool
    start_hz: float = 0.0
    offset_hz: float = 0.0
    #: what UP and DOWN move the centre by; ``None`` = a tenth of the span
    step_chosen_hz: float | None = None
    #: span before the last change of it
    previous_span_hz: float | None = None
    #: couplings: span by resolution bandwidth, video by resolution bandwidth
    span_per_rbw: float = 100.0
    vbw_per_rbw: float = 1.0
    #: resolution bandwidth shown by the one at 3 dB: 1 unless the filter is told by another of its widths
    filter_ratio: float = 1.0
    rbw_chosen_hz: float = 3e6
    is_rbw_auto: bool = True
    vbw_chosen_hz: float = 3e6
    is_vbw_auto: bool = True
    time_chosen_s: float = 1.0
    is_time_auto: bool = True
    #: SWE, FFT or AUTO (taken as SWE)
    sweep_type: str = "AUTO"
    count: int = 0
    #: a trace is made from several sweeps, by their average or by ``hold``
    is_averaging: bool = False
    #: MAXH or MINH: the highest or lowest of the sweeps; empty = their average
    hold: str = ""
    is_detector_auto: bool = True
    reference_dbm: float = 0.0
    #: what is added to all levels shown: gain or loss before the input
    level_offset_db: float = 0.0
    attenuation_chosen_db: float = 10.0
    is_attenuation_auto: bool = True
    is_preamplifier_on: bool = False
    unit: str = "DBM"
    #: ASC or a key of ``levels.ENCODERS``
    data_format: str = "ASC"
    #: settings that are remembered and answered, but change nothing
    inert: dict[str, str] = field(default_factory=dict)

    @property
    def center_hz(self) -> float:
        """Middle of the span."""
        return 0.5 * (self.start_hz + self.stop_hz)

    @property
    def span_hz(self) -> float:
        """Width of the sweep; 0 = zero span."""
        return self.stop_hz - self.start_hz

    @property
    def step_hz(self) -> float:
        """Return the step by which UP and DOWN move the centre."""
        return self.span_hz / 10.0 if self.step_chosen_hz is None else self.step_chosen_hz

    @property
    def rbw_shown_hz(self) -> float:
        """Resolution bandwidth as the instrument tells it."""
        if not self.is_rbw_auto:
            return self.rbw_chosen_hz
        return self.model.rbw.legal(self.span_hz / self.span_per_rbw) if self.span_hz else self.rbw_chosen_hz

    @property
    def rbw_hz(self) -> float:
        """Resolution bandwidth (3 dB) in force."""
        return self.rbw_shown_hz / self.filter_ratio

    @property
    def vbw_hz(self) -> float:
        """Video bandwidth in force."""
        return self.model.vbw.legal(self.vbw_per_rbw * self.rbw_shown_hz) if self.is_vbw_auto else self.vbw_chosen_hz

    @property
    def time_s(self) -> float:
        """Duration of the sweep in force."""
        return self.time_auto_s if self.is_time_auto else self.time_chosen_s

    @property
    def time_auto_s(self) -> float:
        """Shortest sweep that the filters follow."""
        slowing = 1.0 if self.detector == "RMS" else max(1.0, self.rbw_hz / self.vbw_hz)
        time_s = 2.5 * self.span_hz / self.rbw_hz**2 * slowing
        return min(max(time_s, self.model.sweep_time_s.low), self.model.sweep_time_s.high)

    @property
    def attenuation_db(self) -> float:
        """Attenuation in force."""
        if not self.is_attenuation_auto:
            return self.attenuation_chosen_db
        step_db = self.model.attenuation_coupled_step_db
        wanted = step_db * math.ceil((self.reference_dbm - _MIXER_LIMIT_DBM) / step_db)
        return min(max(wanted, 0.0), self.model.attenuation_db.high)

    @property
    def is_uncalibrated(self) -> bool:
        """Return whether the sweep is faster than the resolution filter settles."""
        return not self.is_fft and self.time_s < UNCALIBRATED_BELOW * 2.5 * self.span_hz / self.rbw_hz**2

    @property
    def is_fft(self) -> bool:
        """Return whether one capture of the whole sweep time serves all points."""
        return self.sweep_type == "FFT"

    @property
    def sweeps(self) -> int:
        """Sweeps combined into one trace."""
        return max(1, self.average_count if self.is_averaging and not self.count else self.count)

    @property
    def combination(self) -> str:
        """How sweeps are combined: by the hold or the average type when that is on, else by the mean of mW."""
        return (self.hold or self.average_type) if self.is_averaging else "POW"


def reset_state(model: AnalyzerModel, *, is_preset: bool = False) -> Settings:
    """Return the settings after ``*RST``, or after ``SYSTem:PRESet``."""
    return Settings(
        model=model,
        stop_hz=model.max_frequency_hz,
        points=round(model.points.default),
        average_count=round(model.average_count.default),
        average_type=model.average_type,
        detector=model.detector,
        is_continuous=model.is_continuous_after_preset if is_preset else model.is_continuous_after_reset,
        is_big_endian=model.is_big_endian,
        rbw_chosen_hz=model.rbw.limits.default,
        vbw_chosen_hz=model.vbw.limits.default,
        span_per_rbw=model.span_per_rbw,
        vbw_per_rbw=model.vbw_per_rbw,
    )
