"""Reference powers of the paper method: the mean of a carrier's power over the window, brought to zero attitude.

Harmonic and calibrated change at the sensors' angles are removed from every row, so that the spacecraft need not stand
at zero when it is aligned: the angles of the sensors are the initial setting, as published.

Powers that tell of other angles than the stated ones are reported with a probability; the caller refuses.
"""

from dataclasses import dataclass

import numpy as np

from service.core.estimation.noise_model import averaged_sigma_db
from service.core.estimation.paper.downlink_fade import Consistency, compare_with_angles
from service.pipeline.config import AlignmentConfig
from service.pipeline.estimation.paper.harmonic_removal import harmonic_db
from service.pipeline.estimation.paper.snapshot_fix import SensitivityModel, answer_db, sensitivity_model
from service.pipeline.inputs.sensor_angles import StatedAngles, angles_over_deg, stated_sigma_deg
from service.records.calibration import Calibration, CarrierReference
from service.records.catalogue import Ephemeris
from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import MeasurementSeries

_HOUR_US = 3600 * US_PER_S


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
    consistency, changed = _consistency(change_db, stated, calibration, model, config)
    return ReferencePowers(references, consistency, changed)


def _consistency(
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
    hours = max(0.0, (stated.epoch_us - calibration.request.quiet.stop_us) / _HOUR_US)
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
