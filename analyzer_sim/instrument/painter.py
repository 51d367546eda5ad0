"""Emission and settings -> one displayed trace, dBm: mean trace, statistics, instrument errors, overload.

Order of the signal path: input, attenuator and own noise, resolution filter, detector, gain errors, clipping.

A detected trace: by the statistics of each point, or from the envelope of the filter output.
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import lru_cache, partial, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import digamma, gammainccinv, gammaincinv, polygamma

from analyzer_sim.emission import Emission
from analyzer_sim.instrument import spectrum
from analyzer_sim.instrument.imperfections import Imperfections, LevelErrors
from analyzer_sim.instrument.instrument_settings import Settings
from analyzer_sim.streams import FloatArray, stream

IntArray = NDArray[np.int64]

#: below this part of the noise a line does not change the statistics of a point
_LINE_MATTERS = 1e-3
#: longest kernel kept, points to one side
_MAX_KERNEL_REACH = 64
#: independent maxima and minima over the freedom of the mean of a long dwell (fitted to the envelope method)
_PEAKS_PER_FREEDOM = 1.84
_NULLS_PER_FREEDOM = 2.62
#: what a video filter adds to the freedom as the depth of minima shows it (fitted to the envelope method)
_FREEDOM_OF_MINIMA = 1.5


class Dwell(NamedTuple):
    """Observation time and density of points; the key of the kernel cache."""

    rbw_hz: float
    #: time on one point, s
    time_s: float
    #: distance of points, Hz
    spacing_hz: float
    #: all points share one capture
    is_fft: bool
    vbw_hz: float = math.inf

    @property
    def enbw_hz(self) -> float:
        """Noise bandwidth of the resolution filter."""
        return spectrum.ENBW_PER_RBW * self.rbw_hz


def dwell_variance(enbw_hz: float, time_s: float) -> float:
    """Return the relative variance 1/N of the mean noise power over one dwell.

    Examples
    --------
    >>> round(1 / dwell_variance(1.0645 * 30e3, 1e-4), 1)
    4.9
    """
    x = math.sqrt(2.0 * math.pi) * enbw_hz * time_s
    if x < 1e-3:
        return 1.0 - x * x / 6.0
    return math.sqrt(math.pi) * math.erf(x) / x + math.expm1(-x * x) / x**2


def video_variance(rbw_hz: float, vbw_hz: float) -> float:
    """Return the relative variance 1/N_v of the noise power behind the video filter.

    Examples
    --------
    >>> video_variance(30e3, math.inf), round(1 / video_variance(30e3, 300.0), 1)
    (1.0, 48.6)
    """
    if vbw_hz >= spectrum.VIDEO_MATTERS_BELOW * rbw_hz:
        return 1.0
    ratio = 0.5 * vbw_hz * spectrum.RBW_PER_DEVIATION / rbw_hz
    return math.sqrt(math.pi) * ratio * math.exp(ratio**2) * math.erfc(ratio)


@lru_cache(maxsize=64)
def correlation_kernel(dwell: Dwell) -> tuple[float, FloatArray]:
    """Return the shape parameter of the independent draws and the smoothing kernel of odd length and unit sum."""
    reach = np.arange(_MAX_KERNEL_REACH + 1)
    if dwell.is_fft:
        deviation_hz = dwell.rbw_hz / spectrum.RBW_PER_DEVIATION
        covariance = dwell_variance(dwell.enbw_hz, dwell.time_s) * np.exp(
            -np.square(reach * dwell.spacing_hz / (2.0 * deviation_hz))
        )
    else:
        scaled = np.array([k * k * dwell_variance(dwell.enbw_hz, k * dwell.time_s) for k in range(len(reach) + 1)])
        covariance = 0.5 * (scaled[1:] - 2.0 * scaled[:-1] + np.abs(np.append(scaled[1], scaled[:-2])))
    return _factor(np.maximum(covariance, 0.0))


def _factor(covariance: FloatArray) -> tuple[float, FloatArray]:
    """Split a covariance at lags >= 0 into the variance of the draws and a kernel, by the root of its spectrum."""
    circular = np.concatenate([covariance, covariance[:0:-1]])
    root = np.fft.irfft(np.sqrt(np.maximum(np.fft.rfft(circular).real, 0.0)), len(circular))
    kernel = np.maximum(np.roll(root, len(covariance) - 1), 0.0)
    kernel[kernel < 1e-4 * kernel.max()] = 0.0
    variance = float(covariance[0] + 2.0 * covariance[1:].sum())
    used = np.flatnonzero(kernel)
    kernel = kernel[used[0] : used[-1] + 1]
    return 1.0 / variance, kernel / kernel.sum()


def draw_rms(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator, sweeps: int = 1) -> FloatArray:
    """Return the mean of some traces of the RMS detector, mW, shape (B,); Gamma draws add up exactly."""
    points = len(mean.noise_mw)
    single_shape, kernel = correlation_kernel(dwell)
    shape = single_shape * sweeps
    draws = rng.standard_gamma(shape, points + len(kernel) - 1) / shape
    smoothed = draws if len(kernel) == 1 else np.convolve(draws, kernel, mode="valid")
    trace: FloatArray = mean.noise_mw * smoothed
    if len(mean.lines_mw):
        _put_lines(trace, mean, dwell, rng, sweeps)
    return trace


def _put_lines(
    trace: FloatArray, mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator, sweeps: int
) -> None:
    """Replace the points near lines by non-central draws: mean n + L, variance n^2 / N(t) + 2 n L / N(t / sqrt 2).

    The beat of line and noise is correlated for sqrt(2) times as long as the noise power.
    """
    power_variance = dwell_variance(dwell.enbw_hz, dwell.time_s)
    beat_variance = dwell_variance(dwell.enbw_hz, dwell.time_s / math.sqrt(2.0))
    line_mw = mean.lines_mw.sum(axis=0)
    near = np.flatnonzero(line_mw > _LINE_MATTERS * mean.noise_mw)
    noise_mw = mean.noise_mw[near]
    ratio = np.minimum(line_mw[near] / noise_mw, 1e12)
    freedom = sweeps * (1.0 + 2.0 * ratio) / (power_variance + 2.0 * ratio * beat_variance)
    draws = rng.noncentral_chisquare(2.0 * freedom, 2.0 * freedom * ratio)
    trace[near] = noise_mw * draws / (2.0 * freedom)


def _video_freedom(dwell: Dwell) -> float:
    return 1.0 / video_variance(dwell.rbw_hz, dwell.vbw_hz)


def _values_of_dwell(dwell: Dwell) -> float:
    """Return how many independent values behind the video filter a dwell holds, as far as its mean is concerned."""
    return math.sqrt(2.0) * dwell.enbw_hz * dwell.time_s / _video_freedom(dwell)


def _draw_sample(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Return one value at every point; non-central near lines."""
    freedom = _video_freedom(dwell)
    ratio = np.minimum(mean.lines_mw.sum(axis=0) / mean.noise_mw, 1e12)
    return np.asarray(mean.noise_mw * rng.noncentral_chisquare(2.0 * freedom, 2.0 * freedom * ratio) / (2.0 * freedom))


def _draw_peak(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    count = 1.0 + _PEAKS_PER_FREEDOM * _values_of_dwell(dwell)
    above = -np.expm1(np.log(rng.random(len(mean.noise_mw))) / count)
    freedom = _video_freedom(dwell)
    return _line_skirts(mean, np.asarray(gammainccinv(freedom, above) / freedom, np.float64), +1.0)


def _draw_minimum(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    count = 1.0 + _NULLS_PER_FREEDOM * _values_of_dwell(dwell)
    below = -np.expm1(np.log(rng.random(len(mean.noise_mw))) / count)
    freedom = _video_freedom(dwell)
    freedom += _FREEDOM_OF_MINIMA if freedom > 1.0 else 0.0
    return _line_skirts(mean, np.asarray(gammaincinv(freedom, below) / freedom, np.float64), -1.0)


def _line_skirts(mean: spectrum.MeanTrace, relative: FloatArray, sign: float) -> FloatArray:
    """Add the amplitude of lines to that of the noise, in phase for a peak, in opposition for a minimum."""
    noise = np.sqrt(mean.noise_mw * relative)
    return np.asarray(np.square(np.sqrt(mean.lines_mw.sum(axis=0)) + sign * noise))


def _values_averaged(dwell: Dwell) -> float:
    """Return how many independent values the mean of a dwell is taken of, one at least."""
    return max(1.0 / (dwell_variance(dwell.enbw_hz, dwell.time_s) * _video_freedom(dwell)), 1.0)


def _draw_log_mean(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Average nepers: their mean is the digamma function of the freedom less its logarithm."""
    freedom = _video_freedom(dwell)
    nepers = float(digamma(freedom)) - math.log(freedom)
    sigma = math.sqrt(float(polygamma(1, freedom)) / _values_averaged(dwell))
    relative = np.exp(nepers + sigma * rng.standard_normal(len(mean.noise_mw)))
    return np.asarray(mean.noise_mw * relative + mean.lines_mw.sum(axis=0))


def _draw_volt_mean(mean: spectrum.MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Average volts: the root of a Gamma variable."""
    freedom = _video_freedom(dwell)
    power = math.exp(2.0 * (math.lgamma(freedom + 0.5) - math.lgamma(freedom))) / freedom
    sigma = math.sqrt((1.0 / power - 1.0) / _values_averaged(dwell))
    volts = 1.0 + sigma * rng.standard_normal(len(mean.noise_mw))
    return np.asarray(mean.noise_mw * power * np.square(volts) + mean.lines_mw.sum(axis=0))


#: detector -> draw of one trace
FAST_DRAWS: dict[str, Callable[[spectrum.MeanTrace, Dwell, np.random.Generator], FloatArray]] = {
    "RMS": draw_rms,
    "SAMP": _draw_sample,
    "POS": _draw_peak,
    "APE": _draw_peak,
    "QPE": _draw_peak,
    "NEG": _draw_minimum,
    "AVER": _draw_log_mean,
    "LIN": _draw_volt_mean,
}


SAMPLES_PER_RBW_SECOND = 4.0
#: longest envelope drawn for one sweep and for all sweeps of a trace; beyond, the fast method serves
MAX_SAMPLES = 1_000_000
MAX_SAMPLES_ALL_SWEEPS = 10 * MAX_SAMPLES
#: time constants after which a filter has forgotten how it started
_SETTLED_AFTER = 8.0


def sample_count(grid: spectrum.SweepGrid, time_s: float) -> int:
    """Return the samples one sweep takes: never fewer than one a point."""
    return max(math.ceil(SAMPLES_PER_RBW_SECOND * grid.rbw_hz * time_s), grid.points)


def draw_envelope(
    mean: spectrum.MeanTrace,
    grid: spectrum.SweepGrid,
    time_s: float,
    detector: str,
    vbw_hz: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return one detected trace, mW, shape (B,)."""
    count = sample_count(grid, time_s)
    position = (np.arange(count) + 0.5) * (grid.points / count) - 0.5
    seconds = (np.arange(count) + 0.5) * (time_s / count)
    noise_mw = np.interp(position, np.arange(grid.points), mean.noise_mw)
    field = np.sqrt(noise_mw) * _filtered_noise(count, grid.rbw_hz * time_s / count, rng)
    swept_hz = grid.start_hz + position * grid.spacing_hz
    for line_hz, peak_mw in zip(mean.line_hz.tolist(), mean.line_peak_mw.tolist(), strict=True):
        amplitude = np.sqrt(peak_mw * spectrum.filter_response(swept_hz - line_hz, grid.rbw_hz))
        turns = rng.random() + ((line_hz - swept_hz[0]) - 0.5 * (swept_hz - swept_hz[0])) * seconds
        field += amplitude * np.exp(2j * math.pi * turns)
    power_mw = np.square(field.real) + np.square(field.imag)
    if detector != "RMS" and vbw_hz < spectrum.VIDEO_MATTERS_BELOW * grid.rbw_hz:
        power_mw = _video_filtered(power_mw, vbw_hz * time_s / count)
    starts = (np.arange(grid.points) * count) // grid.points
    return BUCKET_DETECTORS[detector](power_mw, starts)


def _fast_length(count: int) -> int:
    """Return a length a fast Fourier transform likes: 2^k, 3 * 2^k or 5 * 2^k, not below ``count``."""
    power = 1 << max(count - 1, 1).bit_length()
    return min(length for length in (power, 3 * power // 4, 5 * power // 8) if length >= count)


def _filtered_noise(count: int, rbw_per_rate: float, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Return unit-power complex Gaussian noise seen through the resolution filter, shape (count,)."""
    length = _fast_length(count)
    weight = np.exp(-np.square(np.fft.fftfreq(length) * (spectrum.RBW_PER_DEVIATION / rbw_per_rate)) / 4.0)
    weight *= length / math.sqrt(2.0 * float(np.square(weight).sum()))
    drawn = rng.standard_normal((2, length))
    return np.fft.ifft((drawn[0] + 1j * drawn[1]) * weight)[:count]


def _video_filtered(power_mw: FloatArray, vbw_per_rate: float) -> FloatArray:
    """Return the power behind one pole at VBW, taken as linear between samples: no weight is negative, no power is.

    The filter is run in on the first part of the power, backwards, so that it starts settled.
    """
    angle = 2.0 * math.pi * vbw_per_rate
    keep = math.exp(-angle)
    newest = 1.0 - (1.0 - keep) / angle
    run_in = power_mw[: min(math.ceil(_SETTLED_AFTER / angle), len(power_mw))][::-1]
    filtered = lfilter([newest, 1.0 - keep - newest], [1.0, -keep], np.concatenate([run_in, power_mw]))
    return np.asarray(filtered[len(run_in) :], dtype=np.float64)


def _bucket_mean(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    counts = np.diff(np.append(starts, len(power_mw)))
    return np.asarray(np.add.reduceat(power_mw, starts) / counts)


def _bucket_last(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    return np.asarray(power_mw[np.append(starts[1:], len(power_mw)) - 1])


def _bucket_largest(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    return np.asarray(np.maximum.reduceat(power_mw, starts))


def _bucket_smallest(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    return np.asarray(np.minimum.reduceat(power_mw, starts))


def _bucket_log_mean(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    return np.asarray(np.exp(_bucket_mean(np.log(np.maximum(power_mw, _LEAST_MW)), starts)))


def _bucket_volt_mean(power_mw: FloatArray, starts: IntArray) -> FloatArray:
    return np.square(_bucket_mean(np.sqrt(power_mw), starts))


#: detector -> reduction of the samples of each bucket
BUCKET_DETECTORS: dict[str, Callable[[FloatArray, IntArray], FloatArray]] = {
    "RMS": _bucket_mean,
    "SAMP": _bucket_last,
    "POS": _bucket_largest,
    "APE": _bucket_largest,
    "QPE": _bucket_largest,
    "NEG": _bucket_smallest,
    "AVER": _bucket_log_mean,
    "LIN": _bucket_volt_mean,
}


#: level at the mixer above which it is overloaded, dBm
MIXER_OVERLOAD_DBM = -10.0
#: the input may exceed the reference level by this much, dB
HEADROOM_DB = 10.0
#: bits of QUEStionable:POWer
RF_OVERLOAD = 1 << 0
IF_OVERLOAD = 1 << 2
_LEAST_MW = 1e-30


class Detail(Enum):
    """Detail of the statistics of a trace."""

    #: Gamma draws for the RMS detector, the envelope for the others
    FAST = "fast"
    #: the envelope for every detector
    ENVELOPE = "envelope"


class Trace(NamedTuple):
    """One displayed trace."""

    #: shape (B,), dBm, the level offset included
    level_dbm: FloatArray
    #: bits of QUEStionable:POWer
    overload: int
    epoch_us: int
    #: where it was taken and with which filter
    grid: spectrum.SweepGrid


class TracePainter:
    """Draws traces of emissions as one instrument shows them.

    Parameters
    ----------
    seed : int
        Seed of statistics and instrument errors.
    imperfections : Imperfections, optional
        Figures of the instrument.
    detail : Detail
        Method of the statistics.
    """

    def __init__(self, seed: int, imperfections: Imperfections | None = None, detail: Detail = Detail.FAST) -> None:
        self._errors = LevelErrors(imperfections or Imperfections(), seed)
        self._rng = stream(seed, "analyzer", "trace statistics")
        self._detail = detail
        self._ripple_gain = lru_cache(maxsize=8)(self._compute_ripple_gain)

    def paint(self, emission: Emission, settings: Settings) -> Trace:
        """Return the trace of one measurement; ``settings.sweeps`` sweeps are combined."""
        grid = spectrum.SweepGrid(settings.start_hz, settings.stop_hz, settings.points, settings.rbw_hz)
        attenuation_db = settings.attenuation_db
        own_noise = self._errors.own_noise_dbm_hz(attenuation_db, is_preamplifier_on=settings.is_preamplifier_on)
        loss = (
            1.0 if settings.is_fft else spectrum.too_fast_line_loss(settings.span_hz, settings.rbw_hz, settings.time_s)
        )
        mean = spectrum.mean_trace(emission, grid, own_noise, loss)
        power_mw = self._statistics(mean, grid, settings)
        overload = Overload.of(emission, settings)
        error_db = self._errors.sweep_error_db(emission.epoch_us, settings.rbw_hz, attenuation_db)
        power_mw *= self._ripple_gain(grid) * spectrum.milliwatts(error_db - overload.compression_db)
        level_dbm = 10.0 * np.log10(np.maximum(power_mw, _LEAST_MW))
        np.minimum(level_dbm, settings.reference_dbm + HEADROOM_DB, out=level_dbm)
        level_dbm += settings.level_offset_db
        return Trace(level_dbm, overload.bits, emission.epoch_us, grid)

    def _statistics(self, mean: spectrum.MeanTrace, grid: spectrum.SweepGrid, settings: Settings) -> FloatArray:
        """Draw the sweeps of one measurement and combine them, mW."""
        dwell = _dwell(grid, settings)
        if self._wants_envelope(grid, settings):
            figures = settings.time_s, settings.detector, settings.vbw_hz
            return _combined(partial(draw_envelope, mean, grid, *figures, self._rng), settings)
        if settings.combination == "POW" and settings.detector == "RMS":
            return draw_rms(mean, dwell, self._rng, settings.sweeps)
        return _combined(partial(FAST_DRAWS[settings.detector], mean, dwell, self._rng), settings)

    def _wants_envelope(self, grid: spectrum.SweepGrid, settings: Settings) -> bool:
        """Tell whether statistics are drawn in time: wanted or needed, and not beyond the longest envelope."""
        samples = sample_count(grid, settings.time_s)
        if settings.is_fft or samples > MAX_SAMPLES or samples * settings.sweeps > MAX_SAMPLES_ALL_SWEEPS:
            return False
        return self._detail is Detail.ENVELOPE or settings.detector != "RMS"

    def _compute_ripple_gain(self, grid: spectrum.SweepGrid) -> FloatArray:
        return np.asarray(10.0 ** (0.1 * self._errors.ripple_db(grid.frequency_hz)))


def _combined(draw: Callable[[], FloatArray], settings: Settings) -> FloatArray:
    """Draw the sweeps and combine them by the average type or the hold."""
    if settings.sweeps == 1:
        return draw()
    if settings.combination in HOLDS:
        return reduce(HOLDS[settings.combination], (draw() for _ in range(settings.sweeps)))
    to_scale, from_scale = COMBINATIONS[settings.combination]
    total = to_scale(draw())
    for _ in range(settings.sweeps - 1):
        total = total + to_scale(draw())
    return from_scale(total / settings.sweeps)


def _dwell(grid: spectrum.SweepGrid, settings: Settings) -> Dwell:
    dwell_s = settings.time_s if settings.is_fft else settings.time_s / grid.points
    return Dwell(grid.rbw_hz, dwell_s, grid.spacing_hz, settings.is_fft, settings.vbw_hz)


class Overload(NamedTuple):
    """Overload of the mixer or of the reference level by too strong an input."""

    #: bits of QUEStionable:POWer
    bits: int
    #: how much the whole trace is too low, dB
    compression_db: float

    @classmethod
    def of(cls, emission: Emission, settings: Settings) -> "Overload":
        """Compare the sum of all signals with the mixer and with the reference level.

        A mixer driven beyond its limit passes that power and no more, so that all levels fall together.
        """
        total_mw = sum(spectrum.milliwatts(signal.power_dbm) for signal in emission.signals)
        total_dbm = 10.0 * math.log10(max(total_mw, _LEAST_MW))
        excess_db = max(total_dbm - settings.attenuation_db - MIXER_OVERLOAD_DBM, 0.0)
        bits = RF_OVERLOAD if excess_db > 0.0 else 0
        if total_dbm > settings.reference_dbm + HEADROOM_DB:
            bits |= IF_OVERLOAD
        return cls(bits, excess_db)


def _decibels(power_mw: FloatArray) -> FloatArray:
    return np.log(np.maximum(power_mw, _LEAST_MW))


#: average type -> the scale on which sweeps are averaged, and back
COMBINATIONS: dict[str, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]] = {
    "POW": (np.asarray, np.asarray),
    "LIN": (np.sqrt, np.square),
    "VID": (_decibels, np.exp),
}

#: hold -> what it keeps of two sweeps
HOLDS: dict[str, np.ufunc] = {"MAXH": np.maximum, "MINH": np.minimum}
