"""The joint fit of a calibration by geometry as a stage, carriers under level control included."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration, fit_geometry
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE
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
#: rows of a mean of what is left of the turns, and the square, in those of the noise, beyond which none counts
_SCATTER_ROWS, _GREATEST_SCATTER = 10, 25.0
#: sigma of the beams grows with this power of the scatter: more than its root, because rain outlasts the means and the
#: fit takes a part of it for turns. Normalised errors of slopes over 20 draws: 1.42 by the root, 1.04 by this one where
#: turns were flown in a storm; 0.98 in `nominal` (tests/regression/test_geometry_calibration_figures.py)
_SCATTER_POWER = 0.75


class TurnScatter(NamedTuple):
    """Squares of what the fit leaves of the turns over those of the noise, in S stretches of ten rows."""

    #: (S, N), NaN = not seen
    stretches: FloatArray
    #: (S, 2) first and last epoch, microseconds UTC
    epochs_us: IntArray
    #: (N,) mean of the stretches, NaN = not seen
    mean: FloatArray


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
    turn_scatter: TurnScatter


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
    scatter = _turn_scatter(fit, rows, noise)
    fit = _with_scatter(fit, scatter.mean)
    # means of several measurements stand on no grid
    first_dbm = data.quiet_first_dbm if data.row_measurements > 1.0 else None
    readings_dbm = rows.rows.power_dbm[quiet] if first_dbm is None else first_dbm
    return JointFit(
        fit,
        response_of(fit, geometry),
        noise,
        level_drift(residual_db, rows.rows.epoch_s[quiet], noise, config.reference_walk_db_sqrt_h),
        group,
        np.array([quantisation_step_db(column) for column in readings_dbm.T]),
        scatter,
    )


def _turn_scatter(fit: GeometryCalibration, rows: GeometryRows, noise: IdentifiedNoise) -> TurnScatter:
    """Return by how much the squares of what is left of the turns exceed the noise; rain makes it many times."""
    turns = np.flatnonzero(~rows.is_quiet)
    turns = turns[: len(turns) // _SCATTER_ROWS * _SCATTER_ROWS]
    left_db = fit.residual_db[turns].reshape(-1, _SCATTER_ROWS, fit.residual_db.shape[1])
    count = np.isfinite(left_db).sum(axis=1)
    mean_db = np.nansum(left_db, axis=1) / np.maximum(count, 1)
    expected_db2 = noise.white_db**2 / np.maximum(count, 1) + np.square(noise.sigma_db).sum(axis=1)
    ratio = np.where(count > 0, np.minimum(mean_db**2 / expected_db2, _GREATEST_SCATTER), np.nan)
    seen = np.isfinite(ratio).sum(axis=0)
    mean = np.where(seen > 0, np.nansum(ratio, axis=0) / np.maximum(seen, 1), np.nan)
    return TurnScatter(ratio, rows.epochs_us[turns].reshape(-1, _SCATTER_ROWS)[:, [0, -1]], mean)


def _with_scatter(fit: GeometryCalibration, scatter: FloatArray) -> GeometryCalibration:
    """Return the fit with the covariance of the beams as large as the scatter of the turns makes it."""
    scale = np.ones(fit.covariance.shape[:2])
    scale[:, -BEAM_SIZE:] = np.fmax(scatter, 1.0)[:, np.newaxis] ** _SCATTER_POWER
    return fit._replace(covariance=fit.covariance * scale[:, :, np.newaxis] * scale[:, np.newaxis, :])
