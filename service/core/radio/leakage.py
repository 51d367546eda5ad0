"""Leakage of a neighbour's power into a carrier's band by the skirt of the resolution filter.

A raised-cosine carrier of unit power, density S(f), is seen through the Gaussian filter as ``S * |H|^2 / ENBW``; the
part of it that falls into the integration band of carrier i is

    L_ij = integral over band i of (S_j * |H|^2) / ENBW = integral of S_j(f) Phi_i(f) df

Phi_i(f) the part of the filter's area, centred at f, that lies in band i - two error functions.
"""

import math

import numpy as np
from scipy.special import erf

from service.core.radio.band_weights import CarrierBands
from service.core.radio.decibel import FloatArray

#: nodes of the midpoint rule over a carrier's occupied band; the integrand is smooth
NODES = 400


def leakage(bands: CarrierBands, rolloff: FloatArray, rbw_hz: float) -> FloatArray:
    """Return the part of every carrier's power that is measured in every band.

    Parameters
    ----------
    bands : CarrierBands
        N carriers.
    rolloff : ndarray, shape (N,)
        Of the raised-cosine shapes, 0..1; not used for lines.
    rbw_hz : float
        3 dB width of the Gaussian resolution filter.

    Returns
    -------
    ndarray, shape (N, N)
        Row: band, column: carrier. The diagonal is the part of its own power that a carrier's band catches.

    Examples
    --------
    >>> wide = CarrierBands(np.zeros(1), np.array([1.25e6]), np.array([1e6]), np.zeros(1, np.bool_), ())
    >>> bool(abs(leakage(wide, np.array([0.25]), 3e4)[0, 0] - 1.0) < 1e-3)
    True
    """
    edge = np.where(bands.is_line, 0.0, (1.0 + rolloff) / 2.0)
    positions = (np.arange(NODES) + 0.5) / NODES * 2.0 - 1.0
    relative = positions[np.newaxis, :] * edge[:, np.newaxis]
    density = _raised_cosine(np.abs(relative), rolloff[:, np.newaxis])
    density = density / density.sum(axis=1, keepdims=True)
    frequency = bands.center_hz[:, np.newaxis] + relative * bands.symbol_rate_hz[:, np.newaxis]
    low = (bands.center_hz - bands.integration_bw_hz / 2.0)[:, np.newaxis, np.newaxis]
    high = (bands.center_hz + bands.integration_bw_hz / 2.0)[:, np.newaxis, np.newaxis]
    # |H|^2 = 2^-(2 f / RBW)^2 is a normal density of this standard deviation times sqrt(2)
    width_hz = rbw_hz / (2.0 * math.sqrt(math.log(2.0)))
    caught = 0.5 * (erf((high - frequency) / width_hz) - erf((low - frequency) / width_hz))
    return np.asarray(np.einsum("ijk,jk->ij", caught, density), dtype=np.float64)


def leaked_ratio(share: FloatArray, power_mw: FloatArray) -> FloatArray:
    """Return the leakage into every band over the carrier's own power.

    Parameters
    ----------
    share : ndarray, shape (N, N)
        From `leakage`.
    power_mw : ndarray, shape (N,), mW
        Carrier powers; NaN = absent, leaks nothing.

    Returns
    -------
    ndarray, shape (N,)
        NaN where the carrier itself is absent.
    """
    present = np.where(np.isnan(power_mw), 0.0, power_mw)
    foreign = share @ present - np.diagonal(share) * present
    with np.errstate(invalid="ignore"):
        return np.asarray(foreign / power_mw, dtype=np.float64)


def _raised_cosine(offset: FloatArray, rolloff: FloatArray) -> FloatArray:
    """Return the relative density at offsets in symbol rates."""
    low, high = (1.0 - rolloff) / 2.0, (1.0 + rolloff) / 2.0
    slope = (np.clip(offset, low, high) - low) / np.maximum(rolloff, 1e-9)
    return np.asarray(0.5 * (1.0 + np.cos(math.pi * slope)), dtype=np.float64)
