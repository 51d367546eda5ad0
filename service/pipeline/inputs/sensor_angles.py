"""Angles of the attitude sensors at the epochs of the rows, each axis from the sensor that was named for it.

A reading counts for a row within ``reference_reach_s``. The law of this file: what a sensor did not say is NaN.
"""

import numpy as np

from service.pipeline.config import CalibrationConfig
from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.series import ReferenceSeries


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
