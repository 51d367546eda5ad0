"""Occupied bandwidth of carriers: the width that holds 99 % of the power left after the noise is taken off.

With c(f) the noise-subtracted power below f over the carrier's whole power, inside its integration band,

    OBW = f(c = 0.995) - f(c = 0.005)

c is known at the edges of the buckets and straight between them. Noise makes it fall here and there; the mean of its
running maximum from below and its running minimum from above rises everywhere, and lies on neither side.
"""

import numpy as np

from service.core.radio.band_weights import BandWeights
from service.core.radio.decibel import FloatArray

#: part of the power that is left out on either side
OUTSIDE_PART = 0.005


def occupied_bandwidth_hz(power_mw: FloatArray, noise_bin_mw: FloatArray, weights: BandWeights) -> FloatArray:
    """Return the occupied bandwidth of every carrier of a trace.

    Parameters
    ----------
    power_mw : ndarray, shape (B,), mW
        RMS trace.
    noise_bin_mw : ndarray, shape (N,), mW
        Noise in one bin, by carrier.
    weights : BandWeights
        Of the settings under which the trace was taken.

    Returns
    -------
    ndarray, shape (N,), Hz
        NaN where no power is left above the noise, and for lines, whose width is the filter's.

    Notes
    -----
    The resolution filter widens a carrier by less than one RBW; nothing outside of the integration band counts.
    Within 1.5 % of the raised-cosine shape's own figure for RBW up to 3 % of the symbol rate and C/N from 10 dB
    (``tests/unit/service/core/radio/test_carrier_power.py``).
    """
    bands = weights.bands
    return np.array(
        [
            np.nan if bands.is_line[k] else _width_hz(power_mw, float(noise_bin_mw[k]), weights, k)
            for k in range(bands.center_hz.size)
        ]
    )


def _width_hz(power_mw: FloatArray, noise_bin_mw: float, weights: BandWeights, carrier: int) -> float:
    """Return the occupied bandwidth of one carrier, Hz."""
    grid, bands = weights.grid, weights.bands
    half_hz = bands.integration_bw_hz[carrier] / 2.0
    low_hz, high_hz = bands.center_hz[carrier] - half_hz, bands.center_hz[carrier] + half_hz
    first = max(int(np.floor((low_hz - grid.start_hz) / grid.step_hz + 0.5)), 0)
    stop = min(int(np.ceil((high_hz - grid.start_hz) / grid.step_hz + 0.5)), grid.points)
    edges_hz = np.clip(grid.start_hz + grid.step_hz * (np.arange(first, stop + 1) - 0.5), low_hz, high_hz)
    inside_mw = (power_mw[first:stop] - noise_bin_mw) * np.diff(edges_hz)
    below = np.concatenate([[0.0], np.cumsum(inside_mw)])
    if not below[-1] > 0.0:
        return np.nan
    from_below = np.maximum.accumulate(below)
    from_above = np.minimum.accumulate(below[::-1])[::-1]
    rising = (from_below + from_above) / (2.0 * below[-1])
    lower_hz, upper_hz = np.interp([OUTSIDE_PART, 1.0 - OUTSIDE_PART], rising, edges_hz)
    return float(upper_hz - lower_hz)
