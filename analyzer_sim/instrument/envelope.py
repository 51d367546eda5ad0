"""A trace from the envelope of the filter output, sampled in time: the thorough method, true for every detector.

Unit complex Gaussian noise g(t) with the power spectrum of the resolution filter is drawn at about four samples per
RBW and second for the whole sweep. With f(t) the frequency swept at t, L(f) the lines and n(f) the noise seen there::

    p(t) = |sqrt(n(f(t))) g(t) + sum_k sqrt(L_k(f(t))) exp(j phi_k(t))|^2,   d phi_k / dt = 2 pi (f_k - f(t))

is low-passed by the video filter (one pole, on power; not with the RMS detector) and cut into one bucket per point:
RMS = mean, SAMP = last, POS = largest, NEG = smallest, AVER = mean of the level in dB.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from analyzer_sim.instrument.spectrum import (
    RBW_PER_DEVIATION,
    VIDEO_MATTERS_BELOW,
    MeanTrace,
    SweepGrid,
    filter_response,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAMPLES_PER_RBW_SECOND = 4.0
#: longest envelope drawn for one sweep and for all sweeps of a trace; beyond, the fast method serves
MAX_SAMPLES = 1_000_000
MAX_SAMPLES_ALL_SWEEPS = 10 * MAX_SAMPLES
_LEAST_MW = 1e-30
#: time constants after which a filter has forgotten how it started
_SETTLED_AFTER = 8.0


def sample_count(grid: SweepGrid, time_s: float) -> int:
    """Return the samples one sweep takes: never fewer than one a point."""
    return max(math.ceil(SAMPLES_PER_RBW_SECOND * grid.rbw_hz * time_s), grid.points)


def draw_envelope(
    mean: MeanTrace,
    grid: SweepGrid,
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
        amplitude = np.sqrt(peak_mw * filter_response(swept_hz - line_hz, grid.rbw_hz))
        turns = rng.random() + ((line_hz - swept_hz[0]) - 0.5 * (swept_hz - swept_hz[0])) * seconds
        field += amplitude * np.exp(2j * math.pi * turns)
    power_mw = np.square(field.real) + np.square(field.imag)
    if detector != "RMS" and vbw_hz < VIDEO_MATTERS_BELOW * grid.rbw_hz:
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
    weight = np.exp(-np.square(np.fft.fftfreq(length) * (RBW_PER_DEVIATION / rbw_per_rate)) / 4.0)
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
