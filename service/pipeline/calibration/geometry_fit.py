"""The joint fit of a calibration by geometry as a stage, carriers under level control included."""

from dataclasses import dataclass

import numpy as np

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration, fit_geometry
from service.core.estimation.calibration.geometry_prediction import response_of
from service.core.estimation.calibration.level_drift import LevelDrift, level_drift
from service.core.estimation.calibration.quadratic_response import QuadraticResponse
from service.core.estimation.noise.quantisation import quantisation_step_db
from service.core.estimation.noise_identification import IdentifiedNoise, identify_noise
from service.pipeline.calibration.geometry_rows import GeometryRows
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.carrier_model.level_control import alc_groups, first_model_dbm, small_groups, without_group_means
from service.pipeline.config import CalibrationConfig
from service.records.levels.attitude import FloatArray, IntArray

#: rows of stretches below this weight say nothing about levels
_GOOD_WEIGHT = 0.25


@dataclass(frozen=True)
class JointFit:
    """Result of the joint fit."""

    fit: GeometryCalibration
    response: QuadraticResponse
    noise: IdentifiedNoise
    drift: LevelDrift
    #: (N,) number of each carrier's group under level control, -1 = none
    group: IntArray
    #: (N,) dB
    quantisation_db: FloatArray


def fit_rows(data: CalibrationInput, rows: GeometryRows, config: CalibrationConfig) -> JointFit:
    """Return the fit of the rows, groups under level control by their differences."""
    group = alc_groups(data.plan)
    geometry = rows.positions.geometry
    is_asked = np.array([carrier.enabled and carrier.uplink_power_control != "auto" for carrier in data.plan.carriers])
    is_asked &= ~(np.isnan(geometry.azimuth_deg) & ~rows.positions.is_beacon) & ~small_groups(group)
    # what is not to be used must not bend the downlink that all share either
    power_dbm = np.where(is_asked, rows.rows.power_dbm, np.nan)
    if (group < 0).all():
        fit = fit_geometry(rows.rows._replace(power_dbm=power_dbm), geometry)
    else:
        taken_dbm = without_group_means(power_dbm, first_model_dbm(power_dbm), group)
        first = fit_geometry(rows.rows._replace(power_dbm=taken_dbm), geometry)
        taken_dbm = without_group_means(power_dbm, taken_dbm - first.residual_db, group)
        fit = fit_geometry(rows.rows._replace(power_dbm=taken_dbm), geometry)
    quiet = np.flatnonzero(rows.is_quiet)
    residual_db = np.where(fit.weight > _GOOD_WEIGHT, fit.residual_db, np.nan)[quiet]
    noise = fit.identified or identify_noise(residual_db, rows.rows.epoch_s[quiet])
    return JointFit(
        fit,
        response_of(fit, geometry),
        noise,
        level_drift(residual_db, rows.rows.epoch_s[quiet], noise, config.reference_walk_db_sqrt_h),
        group,
        np.array([quantisation_step_db(column) for column in rows.rows.power_dbm[quiet].T]),
    )
