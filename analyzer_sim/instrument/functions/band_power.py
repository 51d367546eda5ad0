"""Power in bands of a shown trace: channel, neighbours, carrier to noise, densities. Arrays in, numbers out.

A point of a trace at spacing ``df`` stands for the bin ``f +- df/2`` and shows the density times the noise bandwidth of
the resolution filter. The power of a band is therefore, always in mW::

    P = sum of (share of the bin inside the band) * p * df / ENBW

A band that is not wholly inside the trace has no power: a part of it would be a wrong number.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.instrument.spectrum import SweepGrid

FloatArray = NDArray[np.float64]

#: what averaging the decibels of noise loses: 10 lg e times Euler's constant, dB
LOG_MEAN_LOSS_DB = 10.0 / math.log(10.0) * 0.5772156649015329
#: what averaging its volts loses: the mean of a Rayleigh variable squared is pi/4 of its power, dB
VOLT_MEAN_LOSS_DB = 10.0 * math.log10(4.0 / math.pi)
#: detector -> what its kind of mean loses on noise, dB; other detectors are read as they are
_PUT_BACK_DB = {"AVER": LOG_MEAN_LOSS_DB, "LIN": VOLT_MEAN_LOSS_DB}
#: part of the trace on which a noise marker averages, on both sides together
_NOISE_MARKER_SHARE = 0.05
_EDGE_TOLERANCE = 1e-6


class Band(NamedTuple):
    """A band in frequency, Hz."""

    center_hz: float
    width_hz: float

    @property
    def low_hz(self) -> float:
        """Lower edge."""
        return self.center_hz - 0.5 * self.width_hz

    @property
    def high_hz(self) -> float:
        """Upper edge."""
        return self.center_hz + 0.5 * self.width_hz


def milliwatts_of(level_dbm: FloatArray) -> FloatArray:
    """Return the points of a trace in mW, shape (B,)."""
    return np.asarray(10.0 ** (0.1 * level_dbm))


def decibels(value: float) -> float:
    """Return 10 lg of a power or of a ratio; NaN when it is not positive.

    Examples
    --------
    >>> decibels(0.001), decibels(0.0)
    (-30.0, nan)
    """
    return 10.0 * math.log10(value) if value > 0.0 else math.nan


def bin_shares(grid: SweepGrid, band: Band) -> FloatArray:
    """Return which part of the bin of each point lies inside the band, shape (B,), 0..1."""
    edges_hz = grid.start_hz + (np.arange(grid.points + 1) - 0.5) * grid.spacing_hz
    inside_hz = np.minimum(edges_hz[1:], band.high_hz) - np.maximum(edges_hz[:-1], band.low_hz)
    return np.asarray(np.clip(inside_hz / grid.spacing_hz, 0.0, 1.0))


def band_power_mw(level_dbm: FloatArray, grid: SweepGrid, band: Band) -> float:
    """Return the power in a band, mW; NaN when the band is not wholly inside the trace or the span is zero.

    Examples
    --------
    >>> grid = SweepGrid(0.0, 100.0, 101, 10.0)
    >>> flat_dbm = np.full(101, 10 * math.log10(grid.enbw_hz))  # 1 mW/Hz
    >>> round(band_power_mw(flat_dbm, grid, Band(50.0, 12.5)), 9)
    12.5
    """
    slack_hz = (0.5 + _EDGE_TOLERANCE) * grid.spacing_hz
    if band.width_hz <= 0.0 or band.low_hz < grid.start_hz - slack_hz or band.high_hz > grid.stop_hz + slack_hz:
        return math.nan
    shares = bin_shares(grid, band)
    return float(shares @ milliwatts_of(level_dbm)) * grid.spacing_hz / grid.enbw_hz


def adjacent_powers_mw(
    level_dbm: FloatArray, grid: SweepGrid, main: Band, neighbours: tuple[tuple[float, float], ...]
) -> tuple[float, ...]:
    """Return the power of the main channel, then of the lower and the upper channel of each pair, mW.

    ``neighbours`` holds distance from the centre and width of each pair, Hz.
    """
    bands = [main]
    bands += [Band(main.center_hz + side * offset, width) for offset, width in neighbours for side in (-1.0, 1.0)]
    return tuple(band_power_mw(level_dbm, grid, band) for band in bands)


def carrier_to_noise_db(level_dbm: FloatArray, grid: SweepGrid, noise: Band) -> float:
    """Return the highest point of the trace over the power in the noise channel, dB.

    The carrier is a line: its power is that of the highest point. The channel is placed where only noise is.
    """
    return float(level_dbm.max()) - decibels(band_power_mw(level_dbm, grid, noise))


def noise_density_dbm_hz(level_dbm: FloatArray, grid: SweepGrid, frequency_hz: float, detector: str) -> float:
    """Return the density around a marker, dBm/Hz: the mean in mW of a twentieth of the trace.

    Where the detector averages decibels or volts the known loss of doing so on noise is put back, as instruments do.
    """
    reach = max(int(0.5 * _NOISE_MARKER_SHARE * grid.points), 1)
    point = grid.nearest(frequency_hz)
    part_mw = milliwatts_of(level_dbm[max(point - reach, 0) : point + reach + 1])
    return decibels(float(part_mw.mean())) + _PUT_BACK_DB.get(detector, 0.0) - decibels(grid.enbw_hz)
