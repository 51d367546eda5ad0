"""Rehearsal of a calibration that was not flown: turns by stated beams are added to quiet days, then the chain runs.

The recommended turns are laid over the calmest hours of the quiet days: the powers there are those that were measured
plus what the beams say that the turns change. Noise, weather, gaps and the daily change are therefore those of the
links. Calibration, alignment and the robust method are the product's own; the method runs over up to two of the quiet
days, and its sigma and protection level are the prediction. The spacecraft is taken to be kept at zero by its sensor.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_columns import QuadraticResponse, predict_deviation
from service.pipeline.alignment.alignment import align_methods
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationError, CalibrationInput
from service.pipeline.chain import Chain
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.pipeline.inputs.sensor_angles import STILL, StatedAngles
from service.pipeline.planning.planning import TurnStep, turn_timetable
from service.pipeline.planning.quiet_days import QuietDays, QuietLevels, calmest_window
from service.records.calibration import (
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange, PlanChange, SpacecraftChange
from service.records.levels.attitude import AttitudeRow, Axes, BoolArray, FloatArray, IntArray, named_axes
from service.records.levels.measurement import Measurement, MeasurementSeries, ReferenceSeries

_HOUR_US = 3600 * US_PER_S
#: sensor that keeps the spacecraft at zero, deg
_SENSOR, _SENSOR_SIGMA_DEG = "star_tracker", 0.01
_AUTHOR = "rehearsal"
#: quiet hours beside the turns
_LEAST_US = 24 * _HOUR_US
#: longest rehearsal of the method, and what it takes to settle, which is not judged
_LONGEST_US, _SETTLING_US = 48 * _HOUR_US, _HOUR_US


class ExpectedAccuracy(NamedTuple):
    """Expected accuracy of the robust method after the turns, over T rows of the rehearsal."""

    epochs_us: IntArray
    #: (T, 3) deg, NaN = no estimate
    attitude_deg: FloatArray
    sigma_deg: FloatArray
    protection_deg: FloatArray
    #: share of the rows by which control would be allowed
    allowed_share: float
    #: rows in which each reason held control
    inhibitions: Mapping[str, int]

    @property
    def usual_sigma_deg(self) -> Axes:
        """Root of the mean square of sigma."""
        return _rms(self.sigma_deg)

    @property
    def departure_deg(self) -> Axes:
        """Root of the mean square of the angles, the sensor's zero taken for the truth."""
        return _rms(self.attitude_deg)


@dataclass(frozen=True)
class Rehearsal:
    """Calibration as it would come out, and the prediction."""

    result: CalibrationResult
    turns: Window
    prediction: ExpectedAccuracy


def rehearse(days: QuietDays, levels: QuietLevels, beams: QuadraticResponse, *, far_yaw: bool = False) -> Rehearsal:
    """Return the rehearsal of a calibration.

    Parameters
    ----------
    days : QuietDays
        Powers, T rows of N carriers.
    levels : QuietLevels
        Of these days.
    beams : QuadraticResponse
        Change of each carrier with the attitude, as stated or assumed; a carrier with NaN takes no part.
    far_yaw : bool
        The turns reach 1 deg about yaw.

    Raises
    ------
    CalibrationError
        The days are too short, have too few carriers, or the turns could not be found again in the powers.
    """
    series = days.rows.series
    length_us = turn_timetable(0, far_yaw=far_yaw)[-1].stop_us
    span = Window(int(series.epochs_us[0]), int(series.epochs_us[-1]) + 1)
    if span.stop_us - span.start_us < length_us + _LEAST_US:
        held_h, least_h = (span.stop_us - span.start_us) / _HOUR_US, (length_us + _LEAST_US) / _HOUR_US
        message = f"the quiet days hold {held_h:.1f} h; three days are wanted, {least_h:.1f} h are the least"
        raise CalibrationError(message)
    turns = calmest_window(series.epochs_us, levels.residual_db, length_us)
    request = CalibrationRequest(span, turns, CalibrationMethod.GEOMETRY)
    steps = turn_timetable(turns.start_us, far_yaw=far_yaw)
    result = _calibrated(days, beams, request, steps)
    calibration = Calibration(1, 1, 1, CalibrationState.ACTIVE, request, 0, _AUTHOR, result)
    return Rehearsal(result, turns, _predicted(days, calibration))


def _calibrated(
    days: QuietDays,
    beams: QuadraticResponse,
    request: CalibrationRequest,
    steps: tuple[TurnStep, ...],
) -> CalibrationResult:
    """Return the calibration by the quiet days with turns laid over them."""
    series = days.rows.series
    angles_deg = np.zeros((len(series.epochs_us), 3))
    for step in steps:
        angles_deg[(series.epochs_us >= step.start_us) & (series.epochs_us < step.stop_us)] = step.attitude_deg
    turned = replace(series, power_dbm=series.power_dbm + predict_deviation(angles_deg, beams))
    is_turn = (series.epochs_us >= request.turns.start_us) & (series.epochs_us < request.turns.stop_us)
    sensor = ReferenceSeries(_SENSOR, series.epochs_us, angles_deg, np.full(angles_deg.shape, _SENSOR_SIGMA_DEG))
    data = CalibrationInput(
        request,
        days.plan,
        days.ephemeris,
        _part(turned, ~is_turn),
        _part(turned, is_turn),
        (sensor,),
        (sensor,),
        days.spacecraft,
        row_measurements=days.rows.usual_measurements,
        quiet_first_dbm=days.rows.first_dbm[~is_turn],
    )
    return calibrate_geometry(data, CalibrationConfig())


def _predicted(days: QuietDays, calibration: Calibration) -> ExpectedAccuracy:
    """Return what the robust method says over the quiet days when the sensor is off after their first hour."""
    series = days.rows.series
    window = Window(int(series.epochs_us[0]), int(series.epochs_us[0]) + _HOUR_US)
    stated = StatedAngles(window.stop_us, STILL, Axes(_SENSOR_SIGMA_DEG, _SENSOR_SIGMA_DEG, _SENSOR_SIGMA_DEG))
    first_hour = _part(series, series.epochs_us < window.stop_us)
    active = {calibration.request.method: calibration}
    aligned = align_methods(first_hour, stated, active, days.ephemeris, AlignmentConfig())
    alignment = replace(aligned.to_record(stated, window, _SENSOR, _AUTHOR), id=1)
    documents = JournalDocuments({1: days.plan}, {1: days.ephemeris}, {1: calibration}, {1: alignment})
    chain = Chain(documents, ChainConfig(), methods=(Method.ROBUST,), has_commands=False)
    for content in (
        SpacecraftChange(days.spacecraft, 1),
        PlanChange(1),
        EphemerisChange(1),
        CalibrationActivation(1, 1),
        AlignmentSet(1),
    ):
        chain.update(content)
    after = (series.epochs_us > window.stop_us) & (series.epochs_us < window.stop_us + _LONGEST_US)
    settled_us = window.stop_us + _SETTLING_US
    rows = [row for row in _stepped(chain, _part(series, after)) if row.epoch_us >= settled_us]
    if not rows:
        message = "the quiet days hold too few rows after their first hour; send one row a minute"
        raise CalibrationError(message)
    return ExpectedAccuracy(
        np.array([row.epoch_us for row in rows], dtype=np.int64),
        np.array([row.attitude_deg for row in rows], dtype=np.float64),
        np.array([row.sigma_deg for row in rows], dtype=np.float64),
        np.array([row.protection_deg for row in rows], dtype=np.float64),
        float(np.mean([row.control_allowed for row in rows])),
        Counter(reason for row in rows for reason in row.inhibitions),
    )


def _stepped(chain: Chain, series: MeasurementSeries) -> Iterator[AttitudeRow]:
    """Yield the row of the robust method for every row of powers."""
    for number, (epoch_us, power_dbm) in enumerate(
        zip(series.epochs_us.tolist(), series.power_dbm, strict=True), start=1
    ):
        outcome = chain.step(Measurement(epoch_us, epoch_us, number, _AUTHOR, 1, power_dbm, None))
        if outcome is not None:
            yield outcome.rows[0]


def _part(series: MeasurementSeries, rows: BoolArray) -> MeasurementSeries:
    return MeasurementSeries(series.carrier_ids, series.epochs_us[rows], series.power_dbm[rows])


def _rms(angles_deg: FloatArray) -> Axes:
    """Return the root of the mean square (3,) of angles (T, 3), NaN where there is none."""
    present = np.isfinite(angles_deg)
    squares = np.where(present, angles_deg, 0.0) ** 2
    counts = present.sum(axis=0)
    return named_axes(np.where(counts > 0, np.sqrt(squares.sum(axis=0) / np.maximum(counts, 1)), np.nan))
