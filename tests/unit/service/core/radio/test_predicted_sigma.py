"""Predicted scatter against published figures and against a simulated envelope."""

import math

import numpy as np
import pytest

from service.core.radio.predicted_sigma import (
    GAUSSIAN_ENBW_RATIO,
    carrier_sigma_db,
    degrees_of_freedom,
    line_sigma_db,
)


@pytest.mark.parametrize(
    ("rbw_hz", "sweep_time_s", "width_hz", "sigma_db"),
    [
        (10e3, 1.0, 0.25e6, 0.43),
        (10e3, 1.0, 1e6, 0.21),
        (30e3, 1.0, 1e6, 0.12),
        (30e3, 1.0, 9e6, 0.041),
        (30e3, 5.0, 4.5e6, 0.026),
        (30e3, 10.0, 36e6, 0.006),
    ],
)
def test_the_table_of_the_front_end_study(rbw_hz: float, sweep_time_s: float, width_hz: float, sigma_db: float) -> None:
    dof = degrees_of_freedom(rbw_hz * GAUSSIAN_ENBW_RATIO, sweep_time_s * width_hz / 36e6)
    # half of the last printed digit, and 2% for the short-dwell term of the exact formula
    assert float(carrier_sigma_db(0.0, dof, 1e12, 1e12)) == pytest.approx(sigma_db, rel=0.02, abs=0.005)


def test_noise_bandwidth_of_a_gaussian_filter() -> None:
    offset = np.linspace(-5, 5, 20001)
    area = float(np.sum(np.exp2(-np.square(2 * offset))) * (offset[1] - offset[0]))
    assert pytest.approx(area, abs=1e-9) == GAUSSIAN_ENBW_RATIO  # trapezoid of a Gaussian is exact to rounding


def envelope(rng: np.random.Generator, rbw_hz: float, rate_hz: float, samples: int) -> np.ndarray:
    """Return unit complex noise behind a Gaussian filter."""
    axis = np.fft.fftfreq(samples, 1 / rate_hz)
    white = rng.standard_normal(samples) + 1j * rng.standard_normal(samples)
    shaped = np.fft.ifft(np.fft.fft(white) * np.exp2(-np.square(2 * axis / rbw_hz) / 2))
    unit: np.ndarray = shaped / np.sqrt(np.mean(np.abs(shaped) ** 2))
    return unit


def test_degrees_of_freedom_of_a_simulated_envelope() -> None:
    rng = np.random.default_rng(3)
    rbw_hz, rate_hz, bucket = 10e3, 80e3, 32
    power = np.abs(envelope(rng, rbw_hz, rate_hz, 1 << 19)) ** 2
    means = power[: power.size // bucket * bucket].reshape(-1, bucket).mean(axis=1)
    predicted = float(degrees_of_freedom(rbw_hz * GAUSSIAN_ENBW_RATIO, bucket / rate_hz))
    # 16 384 buckets: the variance estimate has a standard error near 2%
    assert 1 / float(means.var()) == pytest.approx(predicted, rel=0.06)


def test_scatter_of_a_swept_line() -> None:
    """A line under a swept filter scatters by the noise beside it, as the closed form says."""
    rng = np.random.default_rng(5)
    rbw_hz, rate_hz, cnr_db, seconds = 10e3, 40e3, 20.0, 0.02
    enbw_hz = rbw_hz * GAUSSIAN_ENBW_RATIO
    samples = 8192
    time = (np.arange(samples) - samples / 2) / rate_hz
    swept_hz = time * enbw_hz / seconds
    line = 10 ** (cnr_db / 20) * np.exp2(-np.square(2 * swept_hz / rbw_hz) / 2)
    is_band = np.abs(swept_hz) < 3 * rbw_hz
    sums = []
    for _ in range(300):
        noise = envelope(rng, rbw_hz, rate_hz, samples)
        sums.append(np.sum(np.abs(line + noise)[is_band] ** 2) - is_band.sum())
    predicted = line_sigma_db(
        6 * rbw_hz / enbw_hz / 10 ** (cnr_db / 10),
        enbw_hz * seconds,
        6 * rbw_hz / enbw_hz,
        degrees_of_freedom(enbw_hz, 6 * rbw_hz * seconds / enbw_hz),
        1e12,
    )
    values = 10 * np.log10(sums)
    # 15%: the bound asked of every sigma; 300 draws give a standard error of 4%
    assert float(values.std()) == pytest.approx(float(predicted), rel=0.15)
    assert math.isfinite(float(predicted))
