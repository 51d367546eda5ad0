"""Rows of a calibration: what the archive holds for the two windows, brought to the form that the fits take."""

import math
from dataclasses import dataclass

import numpy as np

from service.core.estimation.paper.harmonic import evaluate_harmonic
from service.core.geometry.node_phase import node_phase_rad
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import CalibrationRequest
from service.records.catalogue import CarrierPlan, Ephemeris, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, Operation, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.series import MeasurementSeries, ReferenceSeries

_AXIS_NAMES = ("yaw", "roll", "pitch")


class CalibrationError(Exception):
    """The windows do not hold what a calibration needs; the text says what is missing and what to do."""


@dataclass(frozen=True)
class CalibrationInput:
    """Data of the archive for a calibration request."""

    request: CalibrationRequest
    plan: CarrierPlan
    ephemeris: Ephemeris
    quiet: MeasurementSeries
    turns: MeasurementSeries
    #: of the turns
    references: tuple[ReferenceSeries, ...]
    #: of the quiet window; the paper method does without
    quiet_references: tuple[ReferenceSeries, ...] = ()
    #: positions of satellite and receiving site; the paper method does without
    spacecraft: Spacecraft | None = None
    #: declared, overlapping one of the windows
    operations: tuple[Operation, ...] = ()
    #: announced, within the turns
    corrections: tuple[Correction, ...] = ()
    #: measurements behind a row of the quiet window; above 1 rows are means (`minute_rows`)
    row_measurements: float = 1.0
    #: (T, N) dBm, of each row of the quiet window its first measurement; None = the row is the measurement
    quiet_first_dbm: FloatArray | None = None
    #: records of the quiet days and of the turns
    telemetry: tuple[TelemetryRecord, ...] = ()
    polarization: tuple[PolarizationRecord, ...] = ()

    @property
    def sensors(self) -> tuple[str, str, str]:
        """Sensor of yaw, roll, pitch."""
        request = self.request
        return request.source_yaw, request.source_roll, request.source_pitch

    @property
    def white_scale(self) -> float:
        """White noise of a measurement over that of a row."""
        return math.sqrt(self.row_measurements)


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
    *,
    is_every_axis_needed: bool = True,
) -> TurnRows:
    """Return the rows of the turns that have a sensor reading nearby, level and harmonic removed.

    Raises
    ------
    CalibrationError
        Too few rows, too few of them with angles, or, where every axis is needed, one not turned to both sides.
    """
    epochs_us = data.turns.epochs_us
    if len(epochs_us) < config.min_turn_rows:
        message = f"the window of turns holds {len(epochs_us)} measurements, {config.min_turn_rows} are needed"
        raise CalibrationError(message)
    angles = angles_at(epochs_us, data.references, data.sensors, config)
    present = np.isfinite(angles).all(axis=1)
    if int(np.count_nonzero(present)) < config.min_turn_rows:
        message = (
            f"only {np.count_nonzero(present)} rows of the turns have angles of {', '.join(sorted(set(data.sensors)))};"
            f" {config.min_turn_rows} are needed: send the sensor's references or name another source"
        )
        raise CalibrationError(message)
    missing = unturned_sides(angles[present], config)
    if missing and is_every_axis_needed:
        message = (
            f"no turn of at least {config.min_turn_deg} deg towards {', '.join(missing)} in the window of turns; "
            "a sensitivity for each sign of each axis needs one"
        )
        raise CalibrationError(message)
    harmonic = evaluate_harmonic(phase_rad(data.ephemeris, epochs_us), amplitude_db, harmonic_phase_rad)
    deviation = data.turns.power_dbm - offset_dbm - harmonic
    time_s = (epochs_us - epochs_us[0]) / US_PER_S
    return TurnRows(time_s[present], angles[present], deviation[present])


def unturned_sides(angles_deg: FloatArray, config: CalibrationConfig) -> list[str]:
    """Return the sides, like ``-roll``, towards which turns (K, 3) never moved."""
    lowest, highest = angles_deg.min(axis=0), angles_deg.max(axis=0)
    return [
        f"{'+' if side > 0 else '-'}{name}"
        for name, low, high in zip(_AXIS_NAMES, lowest, highest, strict=True)
        for side, reach in ((1, high), (-1, -low))
        if reach < config.min_turn_deg
    ]
