"""Bandwidth that holds a part of the power of a trace, or where it is some decibels down. Arrays in, numbers out.

Both edges lie between points: the running sum of the power is taken at the edges of the bins and interpolated.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.instrument.functions.band_power import Band, band_power_mw, decibels, milliwatts_of
from analyzer_sim.instrument.spectrum import SweepGrid

FloatArray = NDArray[np.float64]


class Occupied(NamedTuple):
    """Edges of the occupied band, Hz; NaN = there is none."""

    low_hz: float
    high_hz: float

    @property
    def bandwidth_hz(self) -> float:
        """Width of the band."""
        return self.high_hz - self.low_hz

    @property
    def center_hz(self) -> float:
        """Middle of the band."""
        return 0.5 * (self.low_hz + self.high_hz)


def occupied_by_percent(level_dbm: FloatArray, grid: SweepGrid, percent: float) -> Occupied:
    """Return the band that leaves half of the remaining power on either side.

    Examples
    --------
    >>> grid = SweepGrid(0.0, 100.0, 101, 10.0)
    >>> found = occupied_by_percent(np.zeros(101), grid, 80.0)
    >>> round(found.bandwidth_hz, 6), round(found.center_hz, 6)
    (80.8, 50.0)
    """
    running = np.concatenate([[0.0], np.cumsum(milliwatts_of(level_dbm))])
    edges_hz = grid.start_hz + (np.arange(grid.points + 1) - 0.5) * grid.spacing_hz
    outside = 0.5 * (1.0 - 0.01 * percent)
    low_hz, high_hz = np.interp([outside * running[-1], (1.0 - outside) * running[-1]], running, edges_hz)
    return Occupied(float(low_hz), float(high_hz))


def occupied_by_level(level_dbm: FloatArray, grid: SweepGrid, down_db: float) -> Occupied:
    """Return the band between the outermost points that are less than ``down_db`` below the highest one.

    Edges are interpolated in decibels; NaN where the trace does not fall so far before it ends.
    """
    threshold_dbm = float(level_dbm.max()) - abs(down_db)
    above = np.flatnonzero(level_dbm >= threshold_dbm)
    return Occupied(
        _crossing_hz(level_dbm, grid, threshold_dbm, int(above[0]), -1),
        _crossing_hz(level_dbm, grid, threshold_dbm, int(above[-1]), +1),
    )


def _crossing_hz(level_dbm: FloatArray, grid: SweepGrid, threshold_dbm: float, point: int, side: int) -> float:
    outer = point + side
    if not 0 <= outer < grid.points:
        return math.nan
    inner_dbm, outer_dbm = float(level_dbm[point]), float(level_dbm[outer])
    share = (inner_dbm - threshold_dbm) / (inner_dbm - outer_dbm)
    return grid.start_hz + (point + side * share) * grid.spacing_hz


def decibels_down(level_dbm: FloatArray, grid: SweepGrid, occupied: Occupied) -> float:
    """Return how far the trace is below its highest point at the edges of a band, the mean of both, dB."""
    edges_dbm = np.interp([occupied.low_hz, occupied.high_hz], grid.frequency_hz, level_dbm)
    return float(level_dbm.max() - edges_dbm.mean())


def percent_inside(level_dbm: FloatArray, grid: SweepGrid, occupied: Occupied) -> float:
    """Return the part of the power of the trace inside a band, percent; NaN when there is no band."""
    whole = Band(0.5 * (grid.start_hz + grid.stop_hz), grid.stop_hz - grid.start_hz + grid.spacing_hz)
    inside_mw = band_power_mw(level_dbm, grid, Band(occupied.center_hz, occupied.bandwidth_hz))
    return 100.0 * inside_mw / band_power_mw(level_dbm, grid, whole)


def trace_power_dbm(level_dbm: FloatArray, grid: SweepGrid) -> float:
    """Return the power of the whole trace, dBm."""
    return decibels(float(milliwatts_of(level_dbm).sum()) * grid.spacing_hz / grid.enbw_hz)
