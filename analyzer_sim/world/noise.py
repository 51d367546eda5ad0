"""Noise of levels: white, first-order autoregressive, slow and periodic parts, each from its own stream.

x[k+1] = exp(-dt / tau) x[k] + sigma sqrt(1 - exp(-2 dt / tau)) n[k],     x[0] = sigma n[0]
"""

import numpy as np

from analyzer_sim.streams import FloatArray


def first_order(rng: np.random.Generator, count: int, row_period_s: float, sigma: float, tau_s: float) -> FloatArray:
    """Return a stationary first-order series (count,) of this sigma and correlation time."""
    shocks = rng.normal(size=count)
    if sigma == 0.0 or count == 0:
        return np.zeros(count)
    keep = float(np.exp(-row_period_s / tau_s))
    scale = sigma * float(np.sqrt(1.0 - keep**2))
    series, value = [], sigma * float(shocks[0]) / scale
    for shock in shocks.tolist():
        series.append(value)
        value = keep * value + shock
    return np.asarray(series) * scale


def daily_wave(rng: np.random.Generator, seconds: FloatArray, amplitude: float) -> FloatArray:
    """Return a wave (T,) of the solar day with a drawn phase."""
    return np.asarray(amplitude * np.cos(2.0 * np.pi * seconds / 86_400.0 + rng.uniform(0.0, 2.0 * np.pi)))
