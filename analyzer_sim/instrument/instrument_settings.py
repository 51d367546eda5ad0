"""Settings of the analyzer and their couplings; no command, no spectrum, no limit (``quantities.py`` has those).

Law of this file: a coupled value is computed when it is asked for, never stored. Frequencies are stored as they are at
the input.

Couplings (all [K], as R&S analyzers have them)::

    RBW auto   span / ratio of the model, legal step            VBW auto   RBW times ratio of the model, legal step
    time auto  2.5 span / RBW^2, times RBW/VBW when VBW < RBW      attenuation auto  the mixer sees at most -10 dBm at
    zero span  every point stands at the centre                    the reference level
"""

import math
from dataclasses import dataclass, field

from analyzer_sim.instrument.models import AnalyzerModel

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
