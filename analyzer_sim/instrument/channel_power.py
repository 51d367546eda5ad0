"""Channel power: its settings, the settings of its sweeps, and the sum over a shown trace. No command.

A point of a trace at spacing ``df`` stands for the bin ``f +- df/2`` and shows the density times the noise bandwidth of
the resolution filter. The power of a band is therefore, always in mW::

    P = sum of (share of the bin inside the band) * p * df / ENBW

A band that is not wholly inside the trace has no power: a part of it would be a wrong number.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from analyzer_sim.instrument.instrument_settings import MAX_SWEEPS, Limits, Settings
from analyzer_sim.instrument.quantities import store
from analyzer_sim.instrument.spectrum import SweepGrid
from analyzer_sim.streams import FloatArray

#: span and averages of a measurement that sweeps on its own
OWN_SPAN_HZ = Limits(100.0, 26.5e9, 3e6)
OWN_AVERAGES = Limits(1, MAX_SWEEPS, 10)
_EDGE_TOLERANCE = 1e-6


@dataclass(slots=True)
class ChannelSettings:
    """Settings of the channel power; ``*RST`` restores their defaults."""

    #: 0 = as wide as the span
    width_hz: float
    is_selected: bool = False
    #: the result is a density
    is_density: bool = False
    #: the measurement sweeps with the settings below, as Keysight has it
    is_own_sweep: bool = False
    span_hz: float = OWN_SPAN_HZ.default
    averages: float = OWN_AVERAGES.default
    is_averaging: bool = True
    #: ``None`` = automatic
    rbw_hz: float | None = None
    time_s: float | None = None


def own_sweep_settings(settings: Settings, channel: ChannelSettings) -> Settings:
    """Return the settings of a sweep that the measurement takes on its own: RMS detector, averages of mW."""
    own = replace(settings, detector="RMS", is_averaging=False, is_rbw_auto=True, is_vbw_auto=True, is_time_auto=True)
    store(own, "span_hz", channel.span_hz)
    own.count = round(channel.averages) if channel.is_averaging else 1
    if channel.rbw_hz is not None:
        store(own, "rbw_hz", channel.rbw_hz)
    if channel.time_s is not None:
        store(own, "time_s", channel.time_s)
    return own


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
    return float(bin_shares(grid, band) @ 10.0 ** (0.1 * level_dbm)) * grid.spacing_hz / grid.enbw_hz
