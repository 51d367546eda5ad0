"""Settings of the analyzer and their couplings; no command, no spectrum.

Law of this file: a numeric setting has one row in ``QUANTITIES`` (limits, what storing it does); nothing else clamps or
couples. Frequencies are stored as they are at the input; the frequency offset is added where they are shown.

Couplings (all [K], as R&S analyzers have them)::

    RBW auto   span / 100, nearest legal step (1-2-3-5-10)        VBW auto   equal to the RBW
    time auto  2.5 span / RBW^2, times RBW/VBW when VBW < RBW      attenuation auto  the mixer sees at most -10 dBm at
    zero span  every point stands at the centre                    the reference level
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

#: highest frequency at the input, Hz (a 26.5 GHz instrument)
MAX_FREQUENCY_HZ = 26.5e9
MIN_SPAN_HZ = 10.0
#: steps of the resolution and the video filter, Hz
FILTER_STEPS_HZ = (*tuple(m * 10.0**e for e in range(7) for m in (1, 2, 3, 5)), 10000000.0)
#: sweeps combined into one trace; fewer than real instruments take, so that no trace costs more than seconds to draw
MAX_SWEEPS = 1000
#: a sweep faster than this part of the automatic time is not calibrated
UNCALIBRATED_BELOW = 0.8
_MIXER_LIMIT_DBM = -10.0


class Limits(NamedTuple):
    """Legal range of a setting and its value after ``*RST``."""

    low: float
    high: float
    default: float


@dataclass(slots=True)
class Settings:
    """State of the instrument that ``*RST`` resets; SI units, dBm, frequencies at the input."""

    start_hz: float = 0.0
    stop_hz: float = MAX_FREQUENCY_HZ
    offset_hz: float = 0.0
    rbw_chosen_hz: float = 3e6
    is_rbw_auto: bool = True
    vbw_chosen_hz: float = 3e6
    is_vbw_auto: bool = True
    points: int = 1001
    time_chosen_s: float = 1.0
    is_time_auto: bool = True
    #: SWE, FFT or AUTO (taken as SWE)
    sweep_type: str = "AUTO"
    count: int = 0
    average_count: int = 0
    is_averaging: bool = False
    #: VID (mean of dB), LIN (mean of volts) or POW (mean of mW)
    average_type: str = "VID"
    #: RMS POS NEG SAMP APE AVER
    detector: str = "APE"
    is_detector_auto: bool = True
    reference_dbm: float = 0.0
    attenuation_chosen_db: float = 10.0
    is_attenuation_auto: bool = True
    is_preamplifier_on: bool = False
    unit: str = "DBM"
    #: ASC or REAL
    data_format: str = "ASC"
    is_continuous: bool = True
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
    def rbw_hz(self) -> float:
        """Resolution bandwidth (3 dB) in force."""
        if not self.is_rbw_auto:
            return self.rbw_chosen_hz
        return nearest_step(self.span_hz / 100.0) if self.span_hz else self.rbw_chosen_hz

    @property
    def vbw_hz(self) -> float:
        """Video bandwidth in force."""
        return self.rbw_hz if self.is_vbw_auto else self.vbw_chosen_hz

    @property
    def time_s(self) -> float:
        """Duration of the sweep in force."""
        return self.time_auto_s if self.is_time_auto else self.time_chosen_s

    @property
    def time_auto_s(self) -> float:
        """Shortest sweep that the filters follow."""
        slowing = 1.0 if self.detector == "RMS" else max(1.0, self.rbw_hz / self.vbw_hz)
        time_s = 2.5 * self.span_hz / self.rbw_hz**2 * slowing
        return min(max(time_s, QUANTITIES["time_s"].limits(self).low), QUANTITIES["time_s"].limits(self).high)

    @property
    def attenuation_db(self) -> float:
        """Attenuation in force."""
        if not self.is_attenuation_auto:
            return self.attenuation_chosen_db
        wanted = 5.0 * math.ceil((self.reference_dbm - _MIXER_LIMIT_DBM) / 5.0)
        return min(max(wanted, 0.0), QUANTITIES["attenuation_db"].limits(self).high)

    @property
    def is_uncalibrated(self) -> bool:
        """Whether the sweep is faster than the resolution filter settles."""
        return not self.is_fft and self.time_s < UNCALIBRATED_BELOW * 2.5 * self.span_hz / self.rbw_hz**2

    @property
    def is_fft(self) -> bool:
        """Whether one capture of the whole sweep time serves all points."""
        return self.sweep_type == "FFT"

    @property
    def sweeps(self) -> int:
        """Sweeps combined into one trace."""
        return max(1, self.average_count if self.is_averaging and not self.count else self.count)

    @property
    def combination(self) -> str:
        """How sweeps are combined: the average type when averaging is on, else the mean of mW."""
        return self.average_type if self.is_averaging else "POW"


def nearest_step(value_hz: float) -> float:
    """Return the legal filter step nearest on a logarithmic scale.

    Examples
    --------
    >>> nearest_step(29e3), nearest_step(1e12), nearest_step(0.0)
    (30000.0, 10000000.0, 1.0)
    """
    clamped = min(max(value_hz, FILTER_STEPS_HZ[0]), FILTER_STEPS_HZ[-1])
    return min(FILTER_STEPS_HZ, key=lambda step: abs(math.log(step / clamped)))


def _store_window(settings: Settings, center_hz: float, span_hz: float) -> None:
    """Place the sweep; a span that leaves the band is narrowed about its centre."""
    half = min(0.5 * span_hz, center_hz, MAX_FREQUENCY_HZ - center_hz)
    settings.start_hz, settings.stop_hz = center_hz - half, center_hz + half


def _store_start(settings: Settings, start_hz: float) -> None:
    settings.start_hz = start_hz
    settings.stop_hz = max(settings.stop_hz, start_hz + MIN_SPAN_HZ)


def _store_stop(settings: Settings, stop_hz: float) -> None:
    settings.stop_hz = stop_hz
    settings.start_hz = min(settings.start_hz, stop_hz - MIN_SPAN_HZ)


def _store_span(settings: Settings, span_hz: float) -> None:
    legal_hz = 0.0 if span_hz < 0.5 * MIN_SPAN_HZ else max(span_hz, MIN_SPAN_HZ)
    if not legal_hz and settings.is_rbw_auto:
        settings.rbw_chosen_hz = settings.rbw_hz
    center_hz = min(max(settings.center_hz, 0.5 * legal_hz), MAX_FREQUENCY_HZ - 0.5 * legal_hz)
    _store_window(settings, center_hz, legal_hz)


def _store_rbw(settings: Settings, rbw_hz: float) -> None:
    settings.rbw_chosen_hz, settings.is_rbw_auto = nearest_step(rbw_hz), False


def _store_vbw(settings: Settings, vbw_hz: float) -> None:
    settings.vbw_chosen_hz, settings.is_vbw_auto = nearest_step(vbw_hz), False


def _store_time(settings: Settings, time_s: float) -> None:
    settings.time_chosen_s, settings.is_time_auto = time_s, False


def _store_attenuation(settings: Settings, attenuation_db: float) -> None:
    settings.attenuation_chosen_db, settings.is_attenuation_auto = float(round(attenuation_db)), False


def _store_points(settings: Settings, points: float) -> None:
    settings.points = round(points)


def _store_count(settings: Settings, count: float) -> None:
    settings.count = round(count)


def _store_average_count(settings: Settings, count: float) -> None:
    settings.average_count = round(count)


def _store_reference(settings: Settings, reference_dbm: float) -> None:
    settings.reference_dbm = reference_dbm


def _store_offset(settings: Settings, offset_hz: float) -> None:
    settings.offset_hz = offset_hz


@dataclass(frozen=True, slots=True)
class Quantity:
    """One numeric setting; frequencies on the axis of the display have ``is_shifted``."""

    limits: Callable[[Settings], Limits]
    load: Callable[[Settings], float]
    store: Callable[[Settings, float], None]
    #: value after UP and DOWN
    step: Callable[[Settings], float]
    is_shifted: bool = False
    is_integer: bool = False


def _fixed(low: float, high: float, default: float) -> Callable[[Settings], Limits]:
    limits = Limits(low, high, default)
    return lambda _settings: limits


def _axis_step(settings: Settings) -> float:
    return max(settings.span_hz, MIN_SPAN_HZ) / 10.0


_FILTER_LIMITS = _fixed(FILTER_STEPS_HZ[0], FILTER_STEPS_HZ[-1], 3e6)

QUANTITIES: dict[str, Quantity] = {
    "center_hz": Quantity(
        _fixed(0.5 * MIN_SPAN_HZ, MAX_FREQUENCY_HZ - 0.5 * MIN_SPAN_HZ, 0.5 * MAX_FREQUENCY_HZ),
        lambda s: s.center_hz,
        lambda s, value: _store_window(s, value, s.span_hz),
        _axis_step,
        is_shifted=True,
    ),
    "span_hz": Quantity(
        _fixed(0.0, MAX_FREQUENCY_HZ, MAX_FREQUENCY_HZ), lambda s: s.span_hz, _store_span, lambda s: 0.5 * s.span_hz
    ),
    "start_hz": Quantity(
        _fixed(0.0, MAX_FREQUENCY_HZ - MIN_SPAN_HZ, 0.0),
        lambda s: s.start_hz,
        _store_start,
        _axis_step,
        is_shifted=True,
    ),
    "stop_hz": Quantity(
        _fixed(MIN_SPAN_HZ, MAX_FREQUENCY_HZ, MAX_FREQUENCY_HZ),
        lambda s: s.stop_hz,
        _store_stop,
        _axis_step,
        is_shifted=True,
    ),
    "offset_hz": Quantity(_fixed(-1e12, 1e12, 0.0), lambda s: s.offset_hz, _store_offset, lambda _s: 1e6),
    "rbw_hz": Quantity(_FILTER_LIMITS, lambda s: s.rbw_hz, _store_rbw, lambda s: 0.6 * s.rbw_hz),
    "vbw_hz": Quantity(_FILTER_LIMITS, lambda s: s.vbw_hz, _store_vbw, lambda s: 0.6 * s.vbw_hz),
    "points": Quantity(
        _fixed(101, 100001, 1001), lambda s: s.points, _store_points, lambda s: 0.5 * s.points, is_integer=True
    ),
    "time_s": Quantity(_fixed(1e-3, 16000.0, 1.0), lambda s: s.time_s, _store_time, lambda s: 0.5 * s.time_s),
    "count": Quantity(_fixed(0, MAX_SWEEPS, 0), lambda s: s.count, _store_count, lambda _s: 1.0, is_integer=True),
    "average_count": Quantity(
        _fixed(0, MAX_SWEEPS, 0), lambda s: s.average_count, _store_average_count, lambda _s: 1.0, is_integer=True
    ),
    "reference_dbm": Quantity(_fixed(-130.0, 30.0, 0.0), lambda s: s.reference_dbm, _store_reference, lambda _s: 10.0),
    "attenuation_db": Quantity(
        _fixed(0.0, 79.0, 10.0), lambda s: s.attenuation_db, _store_attenuation, lambda _s: 5.0, is_integer=True
    ),
}


def shown_limits(settings: Settings, name: str) -> Limits:
    """Return the limits of a setting as they are shown, the frequency offset included."""
    quantity = QUANTITIES[name]
    limits = quantity.limits(settings)
    if not quantity.is_shifted:
        return limits
    return Limits(*(value + settings.offset_hz for value in limits))


def load(settings: Settings, name: str) -> float:
    """Return the value of a numeric setting as it is shown."""
    quantity = QUANTITIES[name]
    return quantity.load(settings) + (settings.offset_hz if quantity.is_shifted else 0.0)


def store(settings: Settings, name: str, value: float) -> bool:
    """Store a value as shown; return whether it had to be clamped to its limits."""
    quantity = QUANTITIES[name]
    limits = quantity.limits(settings)
    inner = value - (settings.offset_hz if quantity.is_shifted else 0.0)
    clamped = min(max(inner, limits.low), limits.high)
    quantity.store(settings, clamped)
    return clamped != inner
