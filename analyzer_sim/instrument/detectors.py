"""Statistics of a detected trace, drawn per point: the fast method.

The noise-like part of the filter output is a complex Gaussian process whose power has the correlation
``exp(-4 pi^2 s^2 tau^2)`` in time, s = RBW / sqrt(8 ln 2). The mean of that power over a dwell of t seconds has the
relative variance::

    1/N(t) = sqrt(pi) erf(x)/x - (1 - exp(-x^2))/x^2,     x = sqrt(2 pi) ENBW t

so a point of the RMS detector is Gamma(N, 1/N) times its mean. Neighbouring dwells touch, hence are correlated: with
``V(t) = 1/N(t)`` the covariance at lag k is the second difference ``[(k+1)^2 V((k+1)t) - 2 k^2 V(kt) + (k-1)^2
V((k-1)t)] / 2``. Independent Gamma draws of the long-dwell shape ``N0 = sqrt(2) ENBW t``, smoothed by a kernel of unit
sum whose autocorrelation is that covariance, give every point its N and every integrated carrier its
``N_c = 1.505 RBW T B / span``. An FFT analyzer keeps all points for the whole capture; there the correlation runs
along frequency, ``exp(-(k df)^2 / (4 s^2))``.

The other detectors look at the power behind the video filter, one pole at VBW. A value there is Gamma distributed::

    1/N_v = w sqrt(pi)/(2 c) exp(w^2 / (4 c^2)) erfc(w / (2 c)),     w = 2 pi VBW,  c = 2 pi s

N_v = 1 without it. They serve where the envelope would be too long: dwells then hold many values, of which a peak, a
minimum and a mean of decibels are taken as of independent ones. Behind a video filter peaks and samples are within 1 dB
of the envelope method, minima within 2.5 dB: a Gamma variable reaches deeper than a filtered power, which must be small
for as long as the filter remembers.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, gammainccinv, gammaincinv, polygamma

from analyzer_sim.instrument.spectrum import ENBW_PER_RBW, RBW_PER_DEVIATION, VIDEO_MATTERS_BELOW, MeanTrace

FloatArray = NDArray[np.float64]

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
        return ENBW_PER_RBW * self.rbw_hz


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
    if vbw_hz >= VIDEO_MATTERS_BELOW * rbw_hz:
        return 1.0
    ratio = 0.5 * vbw_hz * RBW_PER_DEVIATION / rbw_hz
    return math.sqrt(math.pi) * ratio * math.exp(ratio**2) * math.erfc(ratio)


@lru_cache(maxsize=64)
def correlation_kernel(dwell: Dwell) -> tuple[float, FloatArray]:
    """Return the shape parameter of the independent draws and the smoothing kernel of odd length and unit sum."""
    reach = np.arange(_MAX_KERNEL_REACH + 1)
    if dwell.is_fft:
        deviation_hz = dwell.rbw_hz / RBW_PER_DEVIATION
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


def draw_rms(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator, sweeps: int = 1) -> FloatArray:
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


def _put_lines(trace: FloatArray, mean: MeanTrace, dwell: Dwell, rng: np.random.Generator, sweeps: int) -> None:
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


def _draw_sample(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Return one value at every point; non-central near lines."""
    freedom = _video_freedom(dwell)
    ratio = np.minimum(mean.lines_mw.sum(axis=0) / mean.noise_mw, 1e12)
    return np.asarray(mean.noise_mw * rng.noncentral_chisquare(2.0 * freedom, 2.0 * freedom * ratio) / (2.0 * freedom))


def _draw_peak(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    count = 1.0 + _PEAKS_PER_FREEDOM * _values_of_dwell(dwell)
    above = -np.expm1(np.log(rng.random(len(mean.noise_mw))) / count)
    freedom = _video_freedom(dwell)
    return _line_skirts(mean, np.asarray(gammainccinv(freedom, above) / freedom, np.float64), +1.0)


def _draw_minimum(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    count = 1.0 + _NULLS_PER_FREEDOM * _values_of_dwell(dwell)
    below = -np.expm1(np.log(rng.random(len(mean.noise_mw))) / count)
    freedom = _video_freedom(dwell)
    freedom += _FREEDOM_OF_MINIMA if freedom > 1.0 else 0.0
    return _line_skirts(mean, np.asarray(gammaincinv(freedom, below) / freedom, np.float64), -1.0)


def _line_skirts(mean: MeanTrace, relative: FloatArray, sign: float) -> FloatArray:
    """Add the amplitude of lines to that of the noise, in phase for a peak, in opposition for a minimum."""
    noise = np.sqrt(mean.noise_mw * relative)
    return np.asarray(np.square(np.sqrt(mean.lines_mw.sum(axis=0)) + sign * noise))


def _values_averaged(dwell: Dwell) -> float:
    """Return how many independent values the mean of a dwell is taken of, one at least."""
    return max(1.0 / (dwell_variance(dwell.enbw_hz, dwell.time_s) * _video_freedom(dwell)), 1.0)


def _draw_log_mean(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Average nepers: their mean is the digamma function of the freedom less its logarithm."""
    freedom = _video_freedom(dwell)
    nepers = float(digamma(freedom)) - math.log(freedom)
    sigma = math.sqrt(float(polygamma(1, freedom)) / _values_averaged(dwell))
    relative = np.exp(nepers + sigma * rng.standard_normal(len(mean.noise_mw)))
    return np.asarray(mean.noise_mw * relative + mean.lines_mw.sum(axis=0))


def _draw_volt_mean(mean: MeanTrace, dwell: Dwell, rng: np.random.Generator) -> FloatArray:
    """Average volts: the root of a Gamma variable."""
    freedom = _video_freedom(dwell)
    power = math.exp(2.0 * (math.lgamma(freedom + 0.5) - math.lgamma(freedom))) / freedom
    sigma = math.sqrt((1.0 / power - 1.0) / _values_averaged(dwell))
    volts = 1.0 + sigma * rng.standard_normal(len(mean.noise_mw))
    return np.asarray(mean.noise_mw * power * np.square(volts) + mean.lines_mw.sum(axis=0))


#: detector -> draw of one trace
FAST_DRAWS: dict[str, Callable[[MeanTrace, Dwell, np.random.Generator], FloatArray]] = {
    "RMS": draw_rms,
    "SAMP": _draw_sample,
    "POS": _draw_peak,
    "APE": _draw_peak,
    "QPE": _draw_peak,
    "NEG": _draw_minimum,
    "AVER": _draw_log_mean,
    "LIN": _draw_volt_mean,
}
