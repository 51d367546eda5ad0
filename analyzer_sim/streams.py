"""Named seeded streams, from which every random quantity of the world is drawn, and noise made of them.

A generator depends on the seed and on the name alone, so adding a fault, a carrier or a day never changes a number that
was drawn elsewhere. A longer series begins with the shorter one. Noise of levels has white, first-order autoregressive,
slow and periodic parts:

x[k+1] = exp(-dt / tau) x[k] + sigma sqrt(1 - exp(-2 dt / tau)) n[k],     x[0] = sigma n[0]
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def stream(seed: int, *names: str) -> np.random.Generator:
    """Return the generator that belongs to `names` under `seed`.

    Examples
    --------
    >>> bool(stream(1, "white", "c00").normal() == stream(1, "white", "c00").normal())
    True
    >>> bool(stream(1, "white", "c00").normal() == stream(1, "white", "c01").normal())
    False
    """
    digest = hashlib.sha256("/".join(names).encode()).digest()
    words = np.frombuffer(digest[:16], dtype="<u4")
    return np.random.default_rng(np.random.SeedSequence([seed, *(int(word) for word in words)]))


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
