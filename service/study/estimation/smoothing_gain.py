"""Gain of a smoothed answer over the filter, on the same rows.

    ratio = sqrt(mean of the smoothed answer's squared errors / mean of the filter's), axis by axis, pooled over seeds

Beside it stand the smoothed answer's own sigma, the share of its errors beyond three sigma within ten minutes of an
event, and its largest error while no carrier is on the air, the filter's beside.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray
from service.study.estimation.bounds import AXES, Statistics
from service.study.estimation.flight.drive import Driven, MethodSeries
from service.study.estimation.flight.past import PastSeries
from service.study.estimation.flight.world import World
from service.study.estimation.measures import judged_rows

#: a row is near an event within this time, min
EVENT_MIN = 10.0
#: an error beyond so many sigma is large
LARGE_SIGMAS = 3.0


class SmoothingGain(NamedTuple):
    """Sums over the M rows that filter and smoother both answer; arrays (3,) in the order yaw, roll, pitch."""

    rows: int
    filter_square_deg2: FloatArray
    smoothed_square_deg2: FloatArray
    smoothed_variance_deg2: FloatArray
    #: rows near an event, and large errors among them
    event_rows: int
    filter_large: FloatArray
    smoothed_large: FloatArray
    #: largest error of a row without any carrier, NaN = there is none
    dark_deg: FloatArray
    filter_dark_deg: FloatArray


def measure_gain(world: World, driven: Driven, series: MethodSeries, past: PastSeries) -> SmoothingGain:
    """Return what smoothing gains in one world on the judged rows that it answers."""
    epochs_us = world.ground.epochs_us[driven.rows]
    position = np.minimum(np.searchsorted(epochs_us, past.epochs_us), len(epochs_us) - 1)
    chosen = (epochs_us[position] == past.epochs_us) & judged_rows(world, driven)[position]
    position = position[chosen]
    truth_deg = world.truth.attitude_deg[driven.rows[position]]
    filtered = series.estimate_deg[position] - truth_deg
    smoothed, sigma = past.estimate_deg[chosen] - truth_deg, past.sigma_deg[chosen]
    is_near = _near_events(world)[driven.rows[position]]
    is_dark = world.truth.has_flag("off")[driven.rows[position]].all(axis=1)
    return SmoothingGain(
        len(position),
        np.sum(filtered**2, axis=0),
        np.sum(smoothed**2, axis=0),
        np.sum(sigma**2, axis=0),
        int(is_near.sum()),
        np.count_nonzero(np.abs(filtered[is_near]) > LARGE_SIGMAS * series.sigma_deg[position][is_near], axis=0),
        np.count_nonzero(np.abs(smoothed[is_near]) > LARGE_SIGMAS * sigma[is_near], axis=0),
        _largest(smoothed[is_dark]),
        _largest(filtered[is_dark]),
    )


def _largest(errors_deg: FloatArray) -> FloatArray:
    """Return the largest error (3,) of rows (T, 3), NaN without one."""
    return np.abs(errors_deg).max(axis=0) if len(errors_deg) else np.full(3, np.nan)


def _near_events(world: World) -> BoolArray:
    """Return which rows (T,) of a world lie within ten minutes of one in which anything of a carrier changes."""
    changed = np.flatnonzero((np.diff(world.truth.flags, axis=0) != 0).any(axis=1)) + 1
    reach = max(1, round(EVENT_MIN * 60.0 / world.row_period_s))
    is_near = np.zeros(len(world.ground.epochs_us), dtype=np.bool_)
    for row in changed.tolist():
        is_near[max(0, row - reach) : row + reach + 1] = True
    return is_near


def gain_statistics(name: str, seeds: Sequence[SmoothingGain]) -> Statistics:
    """Return the figures of one smoothed answer over the seeds of a scenario, under its name."""
    rows, near = sum(seed.rows for seed in seeds), sum(seed.event_rows for seed in seeds)
    if not rows:
        return {}
    square = np.sum([seed.smoothed_square_deg2 for seed in seeds], axis=0)
    filtered = np.sum([seed.filter_square_deg2 for seed in seeds], axis=0)
    variance = np.sum([seed.smoothed_variance_deg2 for seed in seeds], axis=0)
    by_axis = {
        "rms_deg": np.sqrt(square / rows),
        "over_filter": np.sqrt(square / filtered),
        "over_sigma": np.sqrt(square / variance),
    }
    if near:
        by_axis["large_near_events"] = np.sum([seed.smoothed_large for seed in seeds], axis=0) / near
        by_axis["filter_large_near_events"] = np.sum([seed.filter_large for seed in seeds], axis=0) / near
    for kind in ("dark_deg", "filter_dark_deg"):
        dark = np.array([getattr(seed, kind) for seed in seeds])
        if np.isfinite(dark).any():
            by_axis[kind] = np.nanmax(dark, axis=0)
    return {f"{name}.{kind}.{axis}": float(of[k]) for kind, of in by_axis.items() for k, axis in enumerate(AXES)}
