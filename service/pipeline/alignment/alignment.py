"""Alignment: outside angles and the powers of the same minutes become the references of every method.

Reference levels of the robust method at an alignment: what the calibration says and what the window shows, weighed.

The reference of a carrier is its level at zero attitude with the daily change removed. The calibration knows it to its
own error, grown with age; the window's mean of power minus daily change minus f(angles) knows it to the noise of an
hour and the sensor's error. What all carriers have in common between the two belongs to the receiving chain and is
taken from the window. A carrier for which both differ by more than four sigma was re-levelled: it takes the window. One
that is two sigma lower than a calibration of the last days is wet: it keeps the level of the calibration.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.core.estimation.calibration.geometry_columns import predict_deviation, predict_jacobian
from service.core.estimation.noise import averaged_sigma_db
from service.core.estimation.paper.downlink_fade import Consistency, compare_with_angles
from service.pipeline.carrier_model.expected_level import ExpectedLevel, GeometryModel, geometry_model
from service.pipeline.carrier_model.level_control import centred_response, member_groups, without_group_gain
from service.pipeline.config import AlignmentConfig
from service.pipeline.estimation.paper.paper_model import SensitivityModel, answer_db, harmonic_db, sensitivity_model
from service.pipeline.inputs.sensor_angles import StatedAngles, angles_over_deg, stated_sigma_deg
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationResult,
    CarrierReference,
    GeometryFit,
    Window,
)
from service.records.catalogue import Ephemeris, Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.records.levels.measurement import MeasurementSeries

_US_PER_HOUR = 3600 * US_PER_S


@dataclass(frozen=True)
class ReferencePowers:
    """References of one method and how they agree with the angles."""

    references: tuple[CarrierReference, ...]
    consistency: Consistency
    #: carriers whose level changed by more than the limit since the calibration
    changed: tuple[str, ...]


def reference_powers(
    series: MeasurementSeries,
    stated: StatedAngles,
    calibration: Calibration,
    ephemeris: Ephemeris,
    config: AlignmentConfig,
) -> ReferencePowers:
    """Return the paper method's references from the powers of the window (columns in the calibration's order)."""
    model = sensitivity_model(calibration)
    turned_db = answer_db(model, angles_over_deg(stated, series.epochs_us))
    removed = series.power_dbm - harmonic_db(calibration, ephemeris, series.epochs_us.astype(np.float64)) - turned_db
    samples = np.count_nonzero(np.isfinite(removed), axis=0)
    is_enough = samples >= config.min_rows
    totals = np.nansum(removed, axis=0)
    mean_dbm = np.where(is_enough, totals / np.maximum(samples, 1), np.nan)
    span_s = float(np.ptp(series.epochs_us)) / US_PER_S if len(series.epochs_us) else 0.0
    sigma_db = averaged_sigma_db(
        model.sigma_white_db,
        model.sigma_coloured_db,
        model.correlation_time_s,
        rows=max(1, int(samples.max(initial=0))),
        span_s=span_s,
    )
    carriers = calibration.result.carriers if calibration.result else ()
    change_db = mean_dbm - np.array([carrier.level_dbm for carrier in carriers])
    references = tuple(
        CarrierReference(carrier.id, float(mean_dbm[k]), float(sigma_db[k]), int(samples[k]), float(change_db[k]))
        for k, carrier in enumerate(carriers)
        if is_enough[k]
    )
    consistency, changed = _agreement(change_db, stated, calibration, model, config)
    return ReferencePowers(references, consistency, changed)


def _agreement(
    change_db: FloatArray,
    stated: StatedAngles,
    calibration: Calibration,
    model: SensitivityModel,
    config: AlignmentConfig,
) -> tuple[Consistency, tuple[str, ...]]:
    """Test whether the changes of level since the calibration tell of other angles than the stated ones.

    A change is believed to within the residual of the harmonic fit, which holds the second harmonic and the slow
    noise that a mean does not remove, the wander since calibration and what the angles' sigma is worth.
    """
    slopes = np.where(np.array(stated.attitude_deg) >= 0.0, model.plus_db_per_deg, model.minus_db_per_deg)
    hours = max(0.0, (stated.epoch_us - calibration.request.quiet.stop_us) / _US_PER_HOUR)
    carriers = calibration.result.carriers if calibration.result else ()
    residual_db = np.array([carrier.harmonic.rms_db for carrier in carriers])
    angle_deg = stated_sigma_deg(stated)
    sigma_db = np.sqrt(residual_db**2 + config.level_walk_db_sqrt_h**2 * hours + (slopes**2) @ (angle_deg**2))
    is_tested = model.is_selected & np.isfinite(change_db)
    if not is_tested.any():
        return compare_with_angles(np.full(len(change_db), np.nan), slopes, sigma_db), ()
    centre_db = float(np.median(change_db[is_tested]))
    is_changed = is_tested & (np.abs(change_db - centre_db) > config.changed_level_sigma * sigma_db)
    # when most levels moved it is not single users who re-levelled: then all take part in the test
    kept = is_tested & ~is_changed if np.count_nonzero(is_changed) * 3 < np.count_nonzero(is_tested) else is_tested
    outcome = compare_with_angles(np.where(kept, change_db, np.nan), slopes, sigma_db)
    return outcome, tuple(name for name, out in zip(model.carrier_ids, is_changed, strict=True) if out)


_HOUR_US = 3600 * US_PER_S
#: samples this far from the median of the window, in robust sigmas, are impulses
_GATE = 4.0
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class _Window:
    """Levels of N carriers in the window."""

    #: (N,) dBm at zero attitude, daily change removed; NaN = too few samples
    level_dbm: FloatArray
    #: (N,) dB
    sigma_db: FloatArray
    #: (N,)
    samples: FloatArray
    #: (N, 3) dB/deg at the stated angles
    slope: FloatArray
    #: members of each level-controlled group
    groups: tuple[IntArray, ...]


def robust_references(
    series: MeasurementSeries,
    stated: StatedAngles,
    calibration: Calibration,
    ephemeris: Ephemeris,
    config: AlignmentConfig,
) -> ReferencePowers:
    """Return the references of the robust method (columns of the series in the calibration's order).

    Raises
    ------
    ValueError
        The calibration is not one by geometry.
    """
    result = calibration.result
    if result is None or result.geometry is None:
        message = f"calibration {calibration.id} has no part by geometry"
        raise ValueError(message)
    model = geometry_model(result.geometry)
    window = _window(series, stated, model, result, ephemeris, config)
    level_dbm = np.array(result.geometry.level_dbm)
    sigma_db = _calibration_sigma_db(result.geometry, calibration, stated.epoch_us)
    change_db = window.level_dbm - level_dbm
    is_tested = np.isfinite(change_db) & np.array(result.geometry.is_used)
    common_db = np.full(len(change_db), float(np.median(change_db[is_tested])) if is_tested.any() else 0.0)
    both_db = np.hypot(sigma_db, window.sigma_db)
    # what a level-controlled group has in common was taken from its members
    is_grouped = np.isin(np.arange(len(level_dbm)), [k for group in window.groups for k in group])
    common_db = np.where(is_grouped, 0.0, common_db)
    surplus = (change_db - common_db) / both_db
    is_wet = (
        is_tested & (surplus < -config.wet_level_sigma) & (_age_h(calibration, stated.epoch_us) < config.wet_level_h)
    )
    is_changed = is_tested & (np.abs(surplus) > config.changed_level_sigma)
    is_new_level = is_changed & ~is_wet
    weight = np.where(is_wet, 1.0, np.where(is_new_level, 0.0, window.sigma_db**2 / both_db**2))
    reference_dbm = weight * (level_dbm + common_db) + (1.0 - weight) * window.level_dbm
    weighed_db = np.where(is_new_level, window.sigma_db, sigma_db * window.sigma_db / both_db)
    reference_sigma_db = np.where(is_wet, sigma_db, weighed_db)
    references = tuple(
        CarrierReference(
            carrier.id,
            float(reference_dbm[k]),
            float(reference_sigma_db[k]),
            int(window.samples[k]),
            float(change_db[k]),
        )
        for k, carrier in enumerate(result.carriers)
        if np.isfinite(reference_dbm[k])
    )
    names = tuple(carrier.id for carrier, out in zip(result.carriers, is_changed, strict=True) if out)
    consistency = _consistency(change_db - common_db, both_db, window.slope, is_tested, is_changed)
    return ReferencePowers(references, consistency, names)


def _window(
    series: MeasurementSeries,
    stated: StatedAngles,
    model: GeometryModel,
    result: CalibrationResult,
    ephemeris: Ephemeris,
    config: AlignmentConfig,
) -> _Window:
    """Return the levels of the window, corrected for the motion of the spacecraft over it."""
    fit = result.geometry
    assert fit is not None  # noqa: S101 the caller has asked
    expected = ExpectedLevel(model, fit, ephemeris)
    level_dbm = np.array(fit.level_dbm)
    angles_deg = angles_over_deg(stated, series.epochs_us)
    daily_db = np.array([expected(int(epoch_us)) for epoch_us in series.epochs_us]).reshape(-1, len(level_dbm))
    deviation_db = series.power_dbm - daily_db - predict_deviation(angles_deg, model.response)
    groups = member_groups(fit.alc_group, np.array(fit.is_used))
    removed = level_dbm + without_group_gain(deviation_db, np.zeros_like(deviation_db), groups)
    mean_dbm, samples = _means(removed, config.min_rows)
    span_s = float(np.ptp(series.epochs_us)) / US_PER_S if len(series.epochs_us) else 0.0
    response = centred_response(model.response, groups)
    slope = predict_jacobian(np.array(stated.attitude_deg), response)
    noise_db = _noise_db(result, max(1, int(samples.max(initial=0))), span_s)
    sensor_db2 = np.nan_to_num(slope) ** 2 @ stated_sigma_deg(stated) ** 2
    return _Window(mean_dbm, np.sqrt(noise_db**2 + sensor_db2), samples, slope, groups)


def _means(values: FloatArray, min_rows: int) -> tuple[FloatArray, FloatArray]:
    """Return the means (N,) of the samples near the median, NaN with too few, and how many they are."""
    means, counts = np.full(values.shape[1], np.nan), np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        present = column[np.isfinite(column)]
        if len(present) < min_rows:
            continue
        centre = float(np.median(present))
        spread = _MAD_TO_SIGMA * float(np.median(np.abs(present - centre)))
        good = present[np.abs(present - centre) <= max(_GATE * spread, 1e-9)]
        means[k], counts[k] = good.mean(), len(good)
    return means, counts


def _noise_db(result: CalibrationResult, rows: int, span_s: float) -> FloatArray:
    """Return one standard deviation (N,) of the mean of the window by the learned noise."""
    white_db = np.array([carrier.sigma_white_db for carrier in result.carriers])
    variance = np.zeros(len(white_db))
    for k, carrier in enumerate(result.carriers):
        for part in carrier.noise:
            one = np.array([part.sigma_db])
            kept = averaged_sigma_db(0.0 * one, one, np.array([part.correlation_time_s]), rows=rows, span_s=span_s)
            variance[k] += float(kept[0]) ** 2
    return np.asarray(np.sqrt(variance + white_db**2 / rows))


def _calibration_sigma_db(fit: GeometryFit, calibration: Calibration, epoch_us: int) -> FloatArray:
    """Return one standard deviation (N,) of the calibration's levels at an epoch."""
    variance = np.array([table[0][0] for table in fit.covariance])
    return np.asarray(np.sqrt(variance + np.array(fit.reference_walk_db) ** 2 * _age_h(calibration, epoch_us)))


def _age_h(calibration: Calibration, epoch_us: int) -> float:
    """Return how long ago the quiet days of a calibration ended, h."""
    return max(0.0, (epoch_us - calibration.request.quiet.stop_us) / _HOUR_US)


def _consistency(
    change_db: FloatArray, sigma_db: FloatArray, slope: FloatArray, is_tested: BoolArray, is_changed: BoolArray
) -> Consistency:
    """Test whether the changes since the calibration tell of other angles than the stated ones.

    When many levels moved it is not single users who re-levelled: then all take part.
    """
    is_kept = is_tested & ~is_changed
    if 3 * np.count_nonzero(is_changed) >= np.count_nonzero(is_tested):
        is_kept = is_tested
    return compare_with_angles(np.where(is_kept, change_db, np.nan), slope, sigma_db)


@dataclass(frozen=True)
class AlignedPowers:
    """References of every method that has a calibration."""

    #: calibration of the robust method where it has one, else of the paper method
    calibration: Calibration
    #: references of that method
    references: tuple[CarrierReference, ...]
    references_by_method: dict[str, tuple[CarrierReference, ...]]
    calibration_by_method: dict[str, int]
    consistency: Consistency
    #: carriers whose level changed by more than the limit since the calibration
    changed: tuple[str, ...]

    def to_record(
        self, stated: StatedAngles, window: Window | None, source: str, created_by: str, created_at_us: int = 0
    ) -> Alignment:
        """Return the alignment that these references make, number 0, with the angles that they were taken at."""
        return Alignment(
            id=0,
            epoch_us=stated.epoch_us,
            attitude_deg=stated.attitude_deg,
            sigma_deg=stated.sigma_deg,
            calibration_id=self.calibration.id,
            source=source,
            created_at_us=created_at_us,
            created_by=created_by,
            references=self.references,
            window=window,
            references_by_method=self.references_by_method,
            calibration_by_method=self.calibration_by_method,
            changed_carriers=self.changed,
        )


def align_methods(
    series: MeasurementSeries,
    stated: StatedAngles,
    active: Mapping[CalibrationMethod, Calibration],
    ephemeris: Ephemeris,
    config: AlignmentConfig,
) -> AlignedPowers:
    """Return the references that follow from the powers of a window and the stated angles.

    Parameters
    ----------
    series : MeasurementSeries
        Powers of the window; every carrier of the calibrations has a column, which may be empty.
    stated : StatedAngles
        Outside angles.
    active : mapping
        The active calibration of each kind of fit, at least one.
    ephemeris : Ephemeris
        Orbit that holds.
    config : AlignmentConfig
        Limits.
    """
    geometry = active.get(CalibrationMethod.GEOMETRY)
    makers = (
        (Method.ROBUST, geometry, robust_references),
        (Method.PAPER, active.get(CalibrationMethod.PAPER, geometry), reference_powers),
    )
    found = {
        method: (used, make(columns_of(series, used), stated, used, ephemeris, config))
        for method, used, make in makers
        if used is not None
    }
    calibration, powers = next(iter(found.values()))
    return AlignedPowers(
        calibration,
        powers.references,
        {method.value: reported.references for method, (_calibration, reported) in found.items()},
        {method.value: used.id for method, (used, _reported) in found.items()},
        powers.consistency,
        powers.changed,
    )


def columns_of(series: MeasurementSeries, calibration: Calibration) -> MeasurementSeries:
    """Return a series in the order of a calibration's carriers; NaN for one that the series does not have."""
    wanted = tuple(carrier.id for carrier in calibration.result.carriers) if calibration.result else ()
    position = {carrier: k for k, carrier in enumerate(series.carrier_ids)}
    columns = np.array([position.get(carrier, -1) for carrier in wanted], dtype=np.int64)
    blank = np.full((len(series.epochs_us), 1), np.nan)
    return MeasurementSeries(wanted, series.epochs_us, np.hstack([series.power_dbm, blank])[:, columns])
