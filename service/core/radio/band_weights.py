"""Weights of the bins of a trace for each carrier, for one setting of the analyzer.

A bucket covers ``f_i +- df/2``; a band takes the part of it that lies inside. Weights depend on the settings alone, so
they are made once and every sweep is one matrix product.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.radio.decibel import FloatArray
from service.core.radio.predicted_sigma import degrees_of_freedom
from service.core.radio.presence import FALSE_ALARM_SIGMA, BoolArray

#: part of the symbol rate over which the presence test and the power density of a carrier are taken
INNER_PART = 0.8
#: mean over median of a noise window above which it holds a signal: 1 dB as a ratio
DIRTY_WINDOW_RATIO = 10.0**0.1
#: standard deviation of a median over that of a mean, normal distribution
MEDIAN_TO_MEAN_SIGMA = 1.2533


class TraceGrid(NamedTuple):
    """Frequency axis and settings of a trace, as the analyzer states them."""

    #: centre of the first bucket, Hz
    start_hz: float
    #: distance of buckets, Hz, > 0
    step_hz: float
    #: number of buckets
    points: int
    #: noise bandwidth of the resolution filter, Hz
    enbw_hz: float
    #: sweep time, s, times the number of sweeps averaged
    sweep_time_s: float


class CarrierBands(NamedTuple):
    """Bands of N carriers and their noise windows, in the analyzer's frequencies."""

    #: (N,) Hz
    center_hz: FloatArray
    #: (N,) Hz, B_int
    integration_bw_hz: FloatArray
    #: (N,) Hz, symbol rate; of a line the resolution bandwidth
    symbol_rate_hz: FloatArray
    #: (N,) whether the carrier is an unmodulated line
    is_line: BoolArray
    #: (N) tuples of (low, high) in Hz, at least one each
    noise_windows_hz: tuple[tuple[tuple[float, float], ...], ...]


class BandWeights(NamedTuple):
    """Weights of one setting of the analyzer; made by `weigh_bands`."""

    grid: TraceGrid
    bands: CarrierBands
    #: (3 N + W, B) rows: P_band; first moment about the centre, Hz; mean inside the carrier; mean of each window
    rows: FloatArray
    #: (N,) and (N,) sums of the first two groups of rows: what a flat floor of one milliwatt a bin gives
    band_sum: FloatArray
    moment_sum_hz: FloatArray
    #: (N, W) Hz, width of each distinct window where the carrier uses it
    window_hz: FloatArray
    #: (W) bins wholly inside each window
    window_bins: tuple[NDArray[np.int64], ...]
    #: median over mean of a clean window
    median_ratio: float
    #: (W,) mean over corrected median above which a window is dirty
    dirty_ratio: FloatArray
    #: (N,) degrees of freedom over the carrier, the integration band and its inner part
    carrier_dof: FloatArray
    band_dof: FloatArray
    inner_dof: FloatArray


def span_hz(grid: TraceGrid) -> float:
    """Return the span of a trace from its first to its last point, Hz."""
    return grid.step_hz * max(grid.points - 1, 1)


def swept_dof(grid: TraceGrid, width_hz: FloatArray) -> FloatArray:
    """Return the degrees of freedom of the mean power over a swept width.

    Parameters
    ----------
    grid : TraceGrid
        Settings of the sweep.
    width_hz : ndarray, Hz
        Swept widths.

    Returns
    -------
    ndarray
        See `service.core.radio.predicted_sigma.degrees_of_freedom`.
    """
    return degrees_of_freedom(grid.enbw_hz, grid.sweep_time_s * width_hz / span_hz(grid))


def band_fractions(grid: TraceGrid, low_hz: FloatArray, high_hz: FloatArray) -> FloatArray:
    """Return which part of each bucket lies inside each band.

    Parameters
    ----------
    grid : TraceGrid
        Frequency axis with B buckets.
    low_hz, high_hz : ndarray, shape (K,), Hz
        Edges of the bands.

    Returns
    -------
    ndarray, shape (K, B)
        0 outside, 1 inside, the fraction at the edges.

    Examples
    --------
    >>> band_fractions(TraceGrid(0.0, 1.0, 4, 1.0, 1.0), np.array([0.25]), np.array([2.0])).tolist()
    [[0.25, 1.0, 0.5, 0.0]]
    """
    lower = grid.start_hz + grid.step_hz * (np.arange(grid.points) - 0.5)
    inside = np.minimum(high_hz[:, np.newaxis], lower + grid.step_hz) - np.maximum(low_hz[:, np.newaxis], lower)
    fractions: FloatArray = np.clip(inside / grid.step_hz, 0.0, 1.0)
    return fractions


def weigh_bands(grid: TraceGrid, bands: CarrierBands) -> BandWeights:
    """Return the weights that turn a trace into carrier powers.

    Parameters
    ----------
    grid : TraceGrid
        Axis and settings of the traces to come.
    bands : CarrierBands
        N carriers with W distinct noise windows.

    Returns
    -------
    BandWeights
        To be kept as long as the settings stand.

    Raises
    ------
    ValueError
        A band or noise window does not lie inside the trace, or a carrier has no noise window.
    """
    bare = [k for k, own in enumerate(bands.noise_windows_hz) if not own]
    if bare:
        message = f"carrier {bare[0]} has no noise window"
        raise ValueError(message)
    half_hz = bands.integration_bw_hz / 2.0
    inner_hz = np.where(bands.is_line, bands.integration_bw_hz, INNER_PART * bands.symbol_rate_hz)
    band = band_fractions(grid, bands.center_hz - half_hz, bands.center_hz + half_hz)
    inner = band_fractions(grid, bands.center_hz - inner_hz / 2.0, bands.center_hz + inner_hz / 2.0)
    windows = sorted({window for own in bands.noise_windows_hz for window in own})
    window = band_fractions(grid, np.array([w[0] for w in windows]), np.array([w[1] for w in windows]))
    _require_inside(band, bands.integration_bw_hz, grid, "integration band")
    _require_inside(window, np.array([w[1] - w[0] for w in windows]), grid, "noise window")
    used = np.array([[w in own for w in windows] for own in bands.noise_windows_hz], dtype=np.float64)
    to_band = band * (grid.step_hz / grid.enbw_hz)
    away_hz = grid.start_hz + grid.step_hz * np.arange(grid.points) - bands.center_hz[:, np.newaxis]
    moment = to_band * away_hz
    rows = np.concatenate([to_band, moment, _averaging(inner), _averaging(window)])
    return BandWeights(
        grid,
        bands,
        rows,
        to_band.sum(axis=1),
        moment.sum(axis=1),
        used * window.sum(axis=1) * grid.step_hz,
        tuple(np.flatnonzero(row > 0.5) for row in window),
        _median_ratio(grid),
        _dirty_ratio(grid, windows),
        swept_dof(grid, bands.symbol_rate_hz),
        swept_dof(grid, bands.integration_bw_hz),
        swept_dof(grid, inner_hz),
    )


def _require_inside(fractions: FloatArray, width_hz: FloatArray, grid: TraceGrid, name: str) -> None:
    """Raise when a band is not covered by the trace to a hundredth of a bucket."""
    missing_hz = width_hz - fractions.sum(axis=1) * grid.step_hz
    worst = int(np.argmax(missing_hz))
    if missing_hz[worst] > 0.01 * grid.step_hz or width_hz.min() <= 0.0:
        message = f"{name} {worst} does not lie inside the trace"
        raise ValueError(message)


def _averaging(fractions: FloatArray) -> FloatArray:
    """Return rows that sum to one."""
    mean: FloatArray = fractions / fractions.sum(axis=1, keepdims=True)
    return mean


def _median_ratio(grid: TraceGrid) -> float:
    """Return median over mean of a clean window: that of a gamma distribution (Wilson and Hilferty)."""
    dof = float(swept_dof(grid, np.array([grid.step_hz]))[0])
    return (1.0 - 1.0 / (9.0 * dof)) ** 3


def _dirty_ratio(grid: TraceGrid, windows: list[tuple[float, float]]) -> FloatArray:
    """Return mean over median above which a window is dirty: 1 dB, and what chance alone would do to the median."""
    dof = swept_dof(grid, np.array([high - low for low, high in windows]))
    return np.asarray(DIRTY_WINDOW_RATIO + FALSE_ALARM_SIGMA * MEDIAN_TO_MEAN_SIGMA / np.sqrt(dof), dtype=np.float64)
