"""Angles and rates by the sensors of the spacecraft."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.filter_model import ORBITAL_RATE_PER_H
from service.pipeline.config import CalibrationConfig
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes, FloatArray, IntArray
from service.records.levels.measurement import ReferenceSeries

#: sigma of a sensor that states none, deg
_UNSTATED_SIGMA_DEG = 0.05
#: angles that do not change
STILL = Axes(0.0, 0.0, 0.0)


class StatedAngles(NamedTuple):
    """Attitude that an alignment starts from."""

    epoch_us: int
    attitude_deg: Axes
    sigma_deg: Axes
    #: how the angles changed over the window
    rate_deg_s: Axes = STILL


def stated_sigma_deg(stated: StatedAngles) -> FloatArray:
    """Return one standard deviation (3,) of the angles, deg, the usual one where none is stated."""
    return usual_sigma_deg(np.array(stated.sigma_deg))


def angles_over_deg(stated: StatedAngles, epochs_us: IntArray) -> FloatArray:
    """Return the attitude (T, 3) at some epochs of the window, deg, along the straight line of the sensors."""
    time_s = (epochs_us - stated.epoch_us) / US_PER_S
    return np.asarray(np.array(stated.attitude_deg) + time_s[:, np.newaxis] * np.array(stated.rate_deg_s))


def usual_sigma_deg(sigma_deg: FloatArray) -> FloatArray:
    """Return standard deviations with the usual one in place of those that are not stated, deg."""
    return np.where(np.isfinite(sigma_deg), sigma_deg, _UNSTATED_SIGMA_DEG)


def smooth_angles(
    references: tuple[ReferenceSeries, ...], source_of_axis: tuple[str, str, str]
) -> tuple[StatedAngles | None, tuple[str, ...]]:
    """Return the angles at the newest reference, or None and the names of the axes that no reference covers."""
    by_source = {series.source: series for series in references}
    columns: list[tuple[IntArray, FloatArray, FloatArray] | None] = []
    for axis, source in enumerate(source_of_axis):
        series = by_source.get(source)
        seen = np.isfinite(series.attitude_deg[:, axis]) if series is not None else np.zeros(0, dtype=np.bool_)
        if series is None or not seen.any():
            columns.append(None)
            continue
        columns.append((series.epochs_us[seen], series.attitude_deg[seen, axis], series.sigma_deg[seen, axis]))
    found = [column for column in columns if column is not None]
    missing = tuple(name for name, column in zip(("yaw", "roll", "pitch"), columns, strict=True) if column is None)
    if missing:
        return None, missing
    epoch_us = int(max(column[0][-1] for column in found))
    lines = [_line_at(epoch_us, *column) for column in found]
    angles, sigmas, rates = (Axes(*(line[k] for line in lines)) for k in range(3))
    return StatedAngles(epoch_us, angles, sigmas, rates), ()


def _line_at(
    epoch_us: int, at_us: IntArray, angle_deg: FloatArray, sigma_deg: FloatArray
) -> tuple[float, float, float]:
    """Return a straight line through some readings at an epoch, its sigma and its slope by the second."""
    each_deg = float(np.median(np.where(np.isfinite(sigma_deg), sigma_deg, _UNSTATED_SIGMA_DEG)))
    time_s = (at_us - epoch_us) / US_PER_S
    if len(at_us) < 8 or np.ptp(time_s) == 0.0:
        return float(angle_deg.mean()), each_deg / float(np.sqrt(len(at_us))), 0.0
    design = np.column_stack([np.ones(len(at_us)), time_s / float(np.ptp(time_s))])
    gram_inverse = np.linalg.inv(design.T @ design)
    coefficients = gram_inverse @ (design.T @ angle_deg)
    slope = float(coefficients[1]) / float(np.ptp(time_s))
    return float(coefficients[0]), each_deg * float(np.sqrt(gram_inverse[0, 0])), slope


def angles_at(
    epochs_us: IntArray,
    references: tuple[ReferenceSeries, ...],
    sensors: tuple[str, str, str],
    config: CalibrationConfig,
) -> FloatArray:
    """Return yaw, roll, pitch (T, 3) in deg at some epochs; series of one sensor are taken together."""
    columns = []
    for axis, sensor in enumerate(sensors):
        reported = [series for series in references if series.source == sensor]
        at_us = np.concatenate([series.epochs_us for series in reported] or [np.zeros(0, dtype=np.int64)])
        angle_deg = np.concatenate([series.attitude_deg[:, axis] for series in reported] or [np.zeros(0)])
        columns.append(_interpolate(at_us, angle_deg, epochs_us, config))
    return np.column_stack(columns)


def _interpolate(
    reading_us: IntArray, angle_deg: FloatArray, epochs_us: IntArray, config: CalibrationConfig
) -> FloatArray:
    """Return one sensor angle at the rows' epochs; NaN where no reading lies within reach."""
    seen = np.isfinite(angle_deg)
    at_us, first = np.unique(reading_us[seen], return_index=True)
    if len(at_us) < 2:
        return np.full(len(epochs_us), np.nan)
    values = np.interp(epochs_us, at_us, angle_deg[seen][first])
    right = np.clip(np.searchsorted(at_us, epochs_us), 1, len(at_us) - 1)
    nearest_us = np.minimum(np.abs(epochs_us - at_us[right]), np.abs(epochs_us - at_us[right - 1]))
    return np.where(nearest_us <= config.reference_reach_s * US_PER_S, values, np.nan)


#: turn of the orbit about pitch, which an inertial rate holds, deg/h
_ORBIT_DEG_H = np.array([0.0, 0.0, np.rad2deg(ORBITAL_RATE_PER_H)])


def inertial_deg_h(rates_deg_s: Sequence[Axes]) -> FloatArray:
    """Return inertial rates (n, 3) about yaw, roll, pitch, deg/h; that of pitch without the turn of the orbit.

    A spacecraft that points at the Earth turns by -15.04 deg/h about pitch.
    """
    return np.asarray(3600.0 * np.array(rates_deg_s, dtype=np.float64).reshape(-1, 3) + _ORBIT_DEG_H)
