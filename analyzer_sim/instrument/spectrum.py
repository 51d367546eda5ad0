"""Mean trace of an emission: power spectral density seen through a Gaussian resolution filter.

Model, f in Hz, powers in mW at the input::

    |H(f)|^2 = 2^-(2 f / RBW)^2 = exp(-f^2 / (2 s^2)),   s = RBW / sqrt(8 ln 2),   ENBW = s sqrt(2 pi) = 1.0645 RBW
    modulated carrier  S(f) = P * raised cosine of symbol rate Rs and roll-off a, unit area, height 1/Rs
    unmodulated line   S(f) = P * Dirac(f - fc)
    hump of noise      S(f) = N_k 2^-(2 (f - f_k) / w_k)^2
    trace point        P_i  = integral S(f) |H(f - f_i)|^2 df  +  (N_input + N_analyzer) ENBW

The shape of a carrier of unit power is computed once per setting (a convolution on a fine grid, tabulated over the
offset from the carrier's centre) and kept; a trace is then one matrix product.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analyzer_sim.emission import Emission, NoiseHump, Signal
from analyzer_sim.streams import FloatArray

#: noise bandwidth of the Gaussian filter over its 3 dB bandwidth
ENBW_PER_RBW = math.sqrt(math.pi / (4.0 * math.log(2.0)))
#: 3 dB bandwidth of the Gaussian filter over the deviation of its power response
RBW_PER_DEVIATION = math.sqrt(8.0 * math.log(2.0))
#: a video filter this much wider than the resolution filter does nothing
VIDEO_MATTERS_BELOW = 10.0
#: the response is followed to where it is 1e-14 of its peak
_REACH_DEVIATIONS = 8.0
#: tabulation step in deviations of the filter; interpolation errs by less than 5e-4 of the plateau
_STEP_DEVIATIONS = 0.125
_MAX_TABLE_POINTS = 1 << 18
#: shapes kept per setting; beyond, a drifting carrier would fill the memory
_SHAPES_KEPT = 256


class SweepGrid(NamedTuple):
    """Frequency grid of a trace; the key of every cache."""

    start_hz: float
    stop_hz: float
    points: int
    rbw_hz: float

    @property
    def frequency_hz(self) -> FloatArray:
        """Frequencies of the points, shape (B,), Hz."""
        return np.linspace(self.start_hz, self.stop_hz, self.points)

    @property
    def enbw_hz(self) -> float:
        """Noise bandwidth of the resolution filter."""
        return ENBW_PER_RBW * self.rbw_hz

    @property
    def spacing_hz(self) -> float:
        """Distance of neighbouring points."""
        return (self.stop_hz - self.start_hz) / max(self.points - 1, 1)


class MeanTrace(NamedTuple):
    """Mean power of each trace point, split by statistics; mW, shape (B,)."""

    #: noise and modulated carriers: exponential in one sample
    noise_mw: FloatArray
    #: unmodulated lines, one row each, shape (L, B): steady
    lines_mw: FloatArray
    #: their frequencies, shape (L,), Hz, and powers at the top of the filter, shape (L,)
    line_hz: FloatArray
    line_peak_mw: FloatArray

    @property
    def total_mw(self) -> FloatArray:
        """Sum of all parts."""
        return np.asarray(self.noise_mw + self.lines_mw.sum(axis=0))


def filter_response(offset_hz: FloatArray, rbw_hz: float) -> FloatArray:
    """Return the power response of the resolution filter at offsets from its centre.

    Examples
    --------
    >>> filter_response(np.array([0.0, 15e3]), 30e3)
    array([1. , 0.5])
    """
    return np.asarray(np.exp2(-np.square(2.0 * offset_hz / rbw_hz)))


def raised_cosine(offset_hz: FloatArray, symbol_rate_hz: float, rolloff: float) -> FloatArray:
    """Return the spectral density of a carrier of unit power, 1/Hz: flat, then half a cosine down to zero.

    Examples
    --------
    >>> raised_cosine(np.array([0.0, 0.5e6, 0.7e6]), 1e6, 0.25) * 1e6
    array([1. , 0.5, 0. ])
    """
    distance = np.abs(offset_hz) / symbol_rate_hz
    if rolloff <= 0.0:
        return np.asarray((distance <= 0.5) / symbol_rate_hz)
    phase = np.clip((distance - 0.5 * (1.0 - rolloff)) / rolloff, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(math.pi * phase)) / symbol_rate_hz)


@lru_cache(maxsize=256)
def _shape_table(symbol_rate_hz: float, rolloff: float, rbw_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return offsets >= 0 and the filtered shape of a unit-power modulated carrier at them."""
    deviation_hz = rbw_hz / RBW_PER_DEVIATION
    reach_hz = 0.5 * (1.0 + rolloff) * symbol_rate_hz + _REACH_DEVIATIONS * deviation_hz
    half = min(math.ceil(reach_hz / (_STEP_DEVIATIONS * deviation_hz)), _MAX_TABLE_POINTS // 2)
    step_hz = reach_hz / half
    offset_hz = np.asarray(np.arange(-half, half) * step_hz, dtype=np.float64)
    density = raised_cosine(offset_hz, symbol_rate_hz, rolloff)
    density /= density.sum() * step_hz
    delay_s = np.fft.rfftfreq(2 * half, step_hz)
    # transform of |H|^2 about its centre; the period leaves room for both skirts
    smoothing = ENBW_PER_RBW * rbw_hz * np.exp(-2.0 * np.square(math.pi * deviation_hz * delay_s))
    shape = np.asarray(np.fft.irfft(np.fft.rfft(density) * smoothing, 2 * half), dtype=np.float64)
    return offset_hz[half:], np.maximum(shape[half:], 0.0)


@lru_cache(maxsize=_SHAPES_KEPT)
def _unit_shape(center_hz: float, symbol_rate_hz: float, rolloff: float, grid: SweepGrid) -> FloatArray:
    """Return the trace of one carrier of 1 mW, shape (B,), read-only."""
    offset_hz = np.abs(grid.frequency_hz - center_hz)
    if symbol_rate_hz <= 0.0:
        shape = filter_response(offset_hz, grid.rbw_hz)
    else:
        table_hz, table = _shape_table(symbol_rate_hz, rolloff, grid.rbw_hz)
        shape = np.interp(offset_hz, table_hz, table, right=0.0)
    shape.setflags(write=False)
    return shape


@lru_cache(maxsize=4)
def _shape_matrix(keys: tuple[tuple[float, float, float], ...], grid: SweepGrid) -> FloatArray:
    """Return the unit shapes of several carriers, shape (N, B)."""
    rows = [_unit_shape(*key, grid) for key in keys]
    return np.array(rows).reshape(len(rows), grid.points)


def mean_trace(emission: Emission, grid: SweepGrid, own_noise_dbm_hz: float, line_loss: float = 1.0) -> MeanTrace:
    """Return the mean power of every trace point.

    Parameters
    ----------
    emission : Emission
        What reaches the input.
    grid : SweepGrid
        Points and resolution filter.
    own_noise_dbm_hz : float
        Noise density the analyzer adds, referred to the input.
    line_loss : float
        Factor on unmodulated lines, 0..1: what a sweep too fast for the filter loses.

    Returns
    -------
    MeanTrace
        mW, shapes (B,) and (L, B).

    Notes
    -----
    The integral of a modulated carrier over the trace, times spacing over ENBW, equals its power within 1e-4
    (``tests/unit/analyzer_sim/test_traces.py``).
    """
    modulated = [signal for signal in emission.signals if signal.symbol_rate_hz > 0.0]
    lines = [signal for signal in emission.signals if signal.symbol_rate_hz <= 0.0]
    floor_mw_hz = milliwatts(emission.noise_dbm_hz) + milliwatts(own_noise_dbm_hz)
    noise_mw = np.full(grid.points, floor_mw_hz * grid.enbw_hz)
    for hump in emission.humps:
        noise_mw += _hump_mw(hump, emission.frequency_offset_hz, grid)
    shift_hz = emission.frequency_offset_hz
    if modulated:
        noise_mw += _powers_mw(modulated) @ _shape_matrix(_keys(modulated, shift_hz), grid)
    line_peak_mw = _powers_mw(lines) * line_loss
    lines_mw = line_peak_mw[:, np.newaxis] * _shape_matrix(_keys(lines, shift_hz), grid)
    line_hz = np.array([signal.center_hz + shift_hz for signal in lines], dtype=np.float64)
    return MeanTrace(noise_mw, lines_mw, line_hz, line_peak_mw)


def _hump_mw(hump: NoiseHump, shift_hz: float, grid: SweepGrid) -> FloatArray:
    """Return a hump seen through the filter: two Gaussians make a wider and lower one."""
    seen_hz = math.hypot(hump.width_hz, grid.rbw_hz)
    power_mw = milliwatts(hump.peak_dbm_hz) * grid.enbw_hz * hump.width_hz / seen_hz
    return power_mw * filter_response(grid.frequency_hz - hump.center_hz - shift_hz, seen_hz)


def _keys(signals: list[Signal], shift_hz: float) -> tuple[tuple[float, float, float], ...]:
    return tuple((signal.center_hz + shift_hz, signal.symbol_rate_hz, signal.rolloff) for signal in signals)


def _powers_mw(signals: list[Signal]) -> FloatArray:
    return np.array([milliwatts(signal.power_dbm) for signal in signals], dtype=np.float64)


def milliwatts(level_dbm: float) -> float:
    """Return a power in mW.

    Examples
    --------
    >>> milliwatts(-30.0)
    0.001
    """
    return float(10.0 ** (level_dbm / 10.0))


def too_fast_line_loss(span_hz: float, rbw_hz: float, time_s: float) -> float:
    """Return what is left of a line's peak power when the sweep outruns the Gaussian filter, 0..1.

    Source: HP application note 150: amplitude falls as ``(1 + (2 ln2/pi)^2 x^2)^(-1/4)``, ``x = span / (T RBW^2)``.
    Noise-like signals keep their mean power.
    """
    ratio = span_hz / (time_s * rbw_hz**2)
    return 1.0 / math.sqrt(1.0 + (2.0 * math.log(2.0) / math.pi * ratio) ** 2)
