"""Rows of a calibration: what the archive holds for the two windows, brought to the form that the fits take."""

from dataclasses import dataclass

import numpy as np

from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.core.geometry.node_phase import node_phase_rad
from service.pipeline.config import CalibrationConfig
from service.records.attitude import FloatArray, IntArray
from service.records.calibration import CalibrationRequest
from service.records.catalogue import CarrierPlan, Ephemeris
from service.records.epoch import US_PER_S
from service.records.series import MeasurementSeries, ReferenceSeries

_AXIS_NAMES = ("yaw", "roll", "pitch")


class CalibrationError(Exception):
    """The windows do not hold what a calibration needs; the text says what is missing and what to do."""


@dataclass(frozen=True)
class CalibrationInput:
    """What the archive holds for a request."""

    request: CalibrationRequest
    plan: CarrierPlan
    ephemeris: Ephemeris
    quiet: MeasurementSeries
    turns: MeasurementSeries
    references: tuple[ReferenceSeries, ...]


@dataclass(frozen=True)
class TurnRows:
    """Rows of the turns with known angles."""

    #: (K,) s since the first row
    time_s: FloatArray
    #: (K, 3) deg, yaw, roll, pitch
    angles_deg: FloatArray
    #: (K, N) dB, level and harmonic removed
    deviation_db: FloatArray


def phase_rad(ephemeris: Ephemeris, epochs_us: IntArray) -> FloatArray:
    """Return the node phase (T,) in rad."""
    return node_phase_rad(epochs_us, np.array(ephemeris.ascending_nodes_us, dtype=np.int64), ephemeris.nodal_period_s)


def turn_rows(
    data: CalibrationInput,
    offset_dbm: FloatArray,
    amplitude_db: FloatArray,
    harmonic_phase_rad: FloatArray,
    config: CalibrationConfig,
) -> TurnRows:
    """Return the rows of the turns that have a sensor reading nearby, level and harmonic removed.

    Raises
    ------
    CalibrationError
        Too few rows, too few of them with angles, or an axis that was not turned to both sides.
    """
    epochs_us = data.turns.epochs_us
    if len(epochs_us) < config.min_turn_rows:
        message = f"the window of turns holds {len(epochs_us)} measurements, {config.min_turn_rows} are needed"
        raise CalibrationError(message)
    request = data.request
    sensors = (request.source_yaw, request.source_roll, request.source_pitch)
    by_source = {series.source: series for series in data.references}
    angles = np.column_stack(
        [_interpolate(by_source.get(sensor), axis, epochs_us, config) for axis, sensor in enumerate(sensors)]
    )
    present = np.isfinite(angles).all(axis=1)
    if int(np.count_nonzero(present)) < config.min_turn_rows:
        message = (
            f"only {np.count_nonzero(present)} rows of the turns have angles of {', '.join(sorted(set(sensors)))}; "
            f"{config.min_turn_rows} are needed: send the sensor's references or name another source"
        )
        raise CalibrationError(message)
    _require_turned_axes(angles[present], config)
    harmonic = evaluate_harmonic(phase_rad(data.ephemeris, epochs_us), amplitude_db, harmonic_phase_rad)
    deviation = data.turns.power_dbm - offset_dbm - harmonic
    time_s = (epochs_us - epochs_us[0]) / US_PER_S
    return TurnRows(time_s[present], angles[present], deviation[present])


def _interpolate(
    series: ReferenceSeries | None, axis: int, epochs_us: IntArray, config: CalibrationConfig
) -> FloatArray:
    """Return one sensor angle at the rows' epochs; NaN where no reading lies within reach."""
    if series is None:
        return np.full(len(epochs_us), np.nan)
    seen = np.isfinite(series.attitude_deg[:, axis])
    if np.count_nonzero(seen) < 2:
        return np.full(len(epochs_us), np.nan)
    at_us = series.epochs_us[seen]
    values = np.interp(epochs_us, at_us, series.attitude_deg[seen, axis])
    right = np.clip(np.searchsorted(at_us, epochs_us), 1, len(at_us) - 1)
    nearest_us = np.minimum(np.abs(epochs_us - at_us[right]), np.abs(epochs_us - at_us[right - 1]))
    return np.where(nearest_us <= config.reference_reach_s * US_PER_S, values, np.nan)


def _require_turned_axes(angles_deg: FloatArray, config: CalibrationConfig) -> None:
    """Refuse turns that never moved an axis to both sides."""
    lowest, highest = angles_deg.min(axis=0), angles_deg.max(axis=0)
    missing = [
        f"{'+' if side > 0 else '-'}{name}"
        for name, low, high in zip(_AXIS_NAMES, lowest, highest, strict=True)
        for side, reach in ((1, high), (-1, -low))
        if reach < config.min_turn_deg
    ]
    if missing:
        message = (
            f"no turn of at least {config.min_turn_deg} deg towards {', '.join(missing)} in the window of turns; "
            "a sensitivity for each sign of each axis needs one"
        )
        raise CalibrationError(message)
