"""Calibration of all carriers from quiet rows and turn rows in one fit tied by the geometry of the stations.

Model: ``geometry_columns``. Steps: rows thinned to stretches (``calibration_bins``); a trimmed start for each carrier,
first of level and daily change from the rows near zero attitude, then of the beam from all (``trimmed_start``); Tukey's
M-estimate of everything jointly (``joint_tukey``); noise learned from the residuals of the quiet rows; a last fit with
rows whitened by that noise (``whitened_fit``), from which coefficients and their covariance come. Nothing is rejected
for good before the joint fit: a step inside the quiet days costs its rows and not the carrier.

Prediction of a calibration: levels at zero attitude, and the response to the attitude with its errors.

``P_i(t, l) = level_i(t) + f_i(l)``: the level, in dBm, carries the daily change of the dish and what the orbit does to
the station's place in the antenna frame; f is the quadratic response. The law of this file: both parts come from one
set of coefficients, and the errors that carriers share (the downlink gradients) stay shared.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.calibration.calibration_bins import Means, Stretches, still_stretches, stretch_means
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    SOLAR_SIZE,
    CarrierGeometry,
    OrbitMotion,
    QuadraticResponse,
    beam_columns,
    daily_columns,
    is_known_orbit,
    own_prior,
    response_monomials,
    response_transform,
    solar_columns,
    symmetric_matrix,
)
from service.core.estimation.calibration.joint_tukey import JointProblem, SeparableFit, fit_jointly
from service.core.estimation.calibration.sensor_axes import (
    FreeResponse,
    StationOffsets,
    fit_free_response,
    station_offsets,
)
from service.core.estimation.calibration.whitened_fit import coloured_noise, whitened_fit
from service.core.estimation.noise_identification import IdentifiedNoise, identify_noise
from service.core.estimation.robust_statistics import middle_values

#: s, longest stretch that is averaged.
STRETCH_S = 600.0
#: deg, rows within this of zero attitude tell level and daily change.
_NEAR_ZERO_DEG = 0.1
#: A carrier seen in fewer stretches than this is not calibrated.
MIN_STRETCHES = 30
#: Rows of stretches below this weight say nothing about the noise.
_NOISE_WEIGHT = 0.25


class CalibrationRows(NamedTuple):
    """Rows of the quiet days and of the turns together, in order of time.

    Parameters
    ----------
    epoch_s : ndarray, shape (T,), s
        Seconds since any epoch, ascending.
    power_dbm : ndarray, shape (T, N), dBm
        NaN marks an absent sample.
    attitude_deg : ndarray, shape (T, 3), deg
        Yaw, roll, pitch of the attitude sensor; a row with NaN takes no part.
    phase_rad : ndarray, shape (T,), rad
        Phase since the ascending node; read only without ``motion``.
    motion : OrbitMotion or None
        From ballistics. Rows that it does not cover take no part, unless it covers none: then two harmonics are fitted.
    is_quiet : ndarray of bool, shape (T,), or None
        Rows from which the noise is learned; None takes all rows near zero attitude.
    midnight_s : float, s
        Time of ``epoch_s = 0`` since a midnight UTC, for the wave of the solar day.
    """

    epoch_s: FloatArray
    power_dbm: FloatArray
    attitude_deg: FloatArray
    phase_rad: FloatArray
    motion: OrbitMotion | None
    is_quiet: BoolArray | None = None
    midnight_s: float = 0.0


@dataclass(frozen=True, slots=True)
class GeometryCoefficients:
    """Coefficients of N carriers, as an archive keeps them; NaN for a carrier seen too little."""

    #: (N,) dBm, h
    level_dbm: FloatArray
    #: (N, 3) b1, b2 in dB/deg and k in dB/deg^2, or (N, 4) two harmonics in dB
    daily: FloatArray
    #: (N, 2) dB/deg, of all beams at the station, azimuth and elevation
    gradient: FloatArray
    #: (N, 3) dB/deg^2, az az, az el, el el
    hessian: FloatArray
    #: (R, 2) dB/deg, gradient of each band at the receiving site
    downlink: FloatArray
    #: (N, K, K) of a carrier's level, daily, gradient and Hessian in this order, errors of ``downlink`` included
    covariance: FloatArray
    #: (2 R, 2 R) dB^2/deg^2, of the downlink gradients
    downlink_covariance: FloatArray
    #: (N, K, 2 R) change of a carrier's coefficients with the downlink gradients
    downlink_gain: FloatArray
    #: whether ``daily`` is the dish law
    is_dish_law: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryCalibration(GeometryCoefficients):
    """Fit of N carriers: coefficients, and what the fit leaves of T rows."""

    #: of the quiet rows
    noise: IdentifiedNoise
    #: (N,) dB, of the stretches, weighted as in the fit
    residual_rms_db: FloatArray
    #: (T, N) dB, of all rows, NaN where absent or without attitude
    residual_db: FloatArray
    #: (T, N) robust weight that the row's stretch had; 0 for impulses and absent samples
    weight: FloatArray
    #: (N, 2) dB, cosine and sine of the solar day
    solar_db: FloatArray
    #: where the data want the stations
    offsets: StationOffsets
    #: answer with free slopes, by which the sensor's axes are judged
    free: FreeResponse


def fit_geometry(rows: CalibrationRows, geometry: CarrierGeometry) -> GeometryCalibration:
    """Return the calibration of all carriers.

    Parameters
    ----------
    rows : CalibrationRows
        Quiet rows and turn rows.
    geometry : CarrierGeometry
        Where the stations stand.

    Returns
    -------
    GeometryCalibration
        A carrier seen in fewer than thirty stretches is NaN. An axis that was not turned leaves its coefficients near
        zero with a large variance.

    Notes
    -----
    Three days and the turns (4830 rows of 16 carriers) take about 0.4 s on one idle core. Stretches of 5, 10 and
    20 min predict deviations of `nominal` to 0.025, 0.026 and 0.026 dB. With the fitted coefficients of `white` a
    snapshot of 15 rows is within 5 % of the bound of Cramer and Rao (``tests/regression/test_robust_figures.py``).

    References
    ----------
    .. [1] Golub, G. and Pereyra, V., "Separable nonlinear least squares: the variable projection method and its
       applications", Inverse Problems 19, 2003 (block elimination of the carriers' own coefficients).
    """
    is_dish_law = is_known_orbit(rows.motion)
    motion = rows.motion if is_dish_law else None
    carriers = rows.power_dbm.shape[1]
    daily = daily_columns(motion, rows.phase_rad, carriers)
    beam, downlink = beam_columns(rows.attitude_deg, geometry, motion)
    day = solar_columns(rows.midnight_s + rows.epoch_s, carriers)
    own = np.concatenate([np.ones((*daily.shape[:2], 1)), daily, day, beam], axis=-1)
    columns = np.concatenate([own, downlink], axis=-1)
    rough_dbm = np.nan_to_num(middle_values(rows.power_dbm)[0])
    # two rows at least, from whose difference the scatter of samples is told
    stretch_s = max(STRETCH_S, 2.5 * _row_period_s(rows.epoch_s))
    stretches = still_stretches(rows.epoch_s, rows.attitude_deg, stretch_s)
    monomials = np.repeat(response_monomials(rows.attitude_deg)[:, np.newaxis], carriers, axis=1)
    means = stretch_means(stretches, rows.power_dbm - rough_dbm, np.concatenate([columns, monomials], axis=-1))
    size = columns.shape[2]
    turned, means = means.columns[..., size:], means._replace(columns=means.columns[..., :size])
    problem = _problem(rows, stretches, means, own.shape[-1])
    is_seen = (problem.rows_used > 0).sum(axis=1) >= MIN_STRETCHES
    prior = own_prior(carriers, daily.shape[-1])
    fit, weight = fit_jointly(problem, prior, means.white_db)
    residual = _row_residuals(rows.power_dbm - rough_dbm, columns, fit)
    is_good = means.is_kept & (_row_weights(residual.shape, stretches, weight) > _NOISE_WEIGHT)
    identified = _identified_noise(residual, is_good, rows)
    fit = whitened_fit(problem, prior, identified, weight, is_dish_law=is_dish_law)
    attitude, noise = _stretch_attitude(rows.attitude_deg, stretches), coloured_noise(identified)
    residual = _row_residuals(rows.power_dbm - rough_dbm, columns, fit)
    return GeometryCalibration(
        **_coefficients(fit, rough_dbm, is_seen),
        is_dish_law=is_dish_law,
        noise=identified,
        residual_rms_db=np.where(is_seen, _weighted_rms_db(means, fit, weight), math.nan),
        residual_db=residual,
        weight=_row_weights(residual.shape, stretches, weight) * means.is_kept,
        offsets=station_offsets(problem, attitude, geometry, (fit, prior), noise),
        free=fit_free_response(problem, turned, prior, means.white_db, noise),
    )


def _problem(rows: CalibrationRows, stretches: Stretches, means: Means, own_size: int) -> JointProblem:
    """Return the thinned rows with their times."""
    first_s, last_s = rows.epoch_s[stretches.rows[:, 0]], rows.epoch_s[stretches.rows[:, -1]]
    attitude = rows.attitude_deg[stretches.rows[:, 0]]
    return JointProblem(
        own=means.columns[..., :own_size],
        shared=means.columns[..., own_size:],
        value=means.power_db,
        rows_used=means.rows_used.astype(np.float64),
        centre_s=0.5 * (first_s + last_s),
        span_s=last_s - first_s + _row_period_s(rows.epoch_s),
        is_near_zero=np.asarray((np.abs(attitude) < _NEAR_ZERO_DEG).all(axis=1)),
    )


def _stretch_attitude(attitude_deg: FloatArray, stretches: Stretches) -> FloatArray:
    """Return the mean attitude (B, 3) of the stretches, zero for one of no row."""
    filled = stretches.is_filled[..., np.newaxis]
    total = np.where(filled, attitude_deg[stretches.rows], 0.0).sum(axis=1)
    return np.asarray(np.nan_to_num(total) / np.maximum(filled.sum(axis=1), 1))


def _row_period_s(epoch_s: FloatArray) -> float:
    """Return the usual time between rows, s."""
    return float(np.median(np.diff(epoch_s))) if len(epoch_s) > 1 else 1.0


def _row_residuals(power_db: FloatArray, columns: FloatArray, fit: SeparableFit) -> FloatArray:
    """Return measured minus model of every row, shape (T, N)."""
    return np.asarray(power_db - np.einsum("tnk,nk->tn", columns, _all_coefficients(fit)))


def _all_coefficients(fit: SeparableFit) -> FloatArray:
    """Return own and shared coefficients of every carrier, shape (N, K + R)."""
    return np.concatenate([fit.own, np.tile(fit.shared, (len(fit.own), 1))], axis=1)


def _row_weights(shape: tuple[int, ...], stretches: Stretches, weight: FloatArray) -> FloatArray:
    """Return for each row (T, N) the weight of its stretch, 0 for rows of none."""
    out = np.zeros(shape)
    spread = np.broadcast_to(weight.T[:, np.newaxis], (*stretches.rows.shape, shape[1]))
    out[stretches.rows[stretches.is_filled]] = spread[stretches.is_filled]
    return out


def _identified_noise(residual: FloatArray, is_good: BoolArray, rows: CalibrationRows) -> IdentifiedNoise:
    """Return the noise of each carrier from the residuals of the quiet rows that count."""
    is_near = np.asarray((np.abs(rows.attitude_deg) < _NEAR_ZERO_DEG).all(axis=1))
    quiet = np.flatnonzero(is_near if rows.is_quiet is None else rows.is_quiet)
    return identify_noise(np.where(is_good, residual, math.nan)[quiet], rows.epoch_s[quiet])


def _weighted_rms_db(means: Means, fit: SeparableFit, weight: FloatArray) -> FloatArray:
    """Return the root mean square (N,) of what the fit leaves of the stretches."""
    misfit = means.power_db - (means.columns @ _all_coefficients(fit)[..., np.newaxis])[..., 0]
    return np.asarray(np.sqrt((weight * misfit**2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)))


def _coefficients(fit: SeparableFit, rough_dbm: FloatArray, is_seen: BoolArray) -> dict[str, FloatArray]:
    """Return the coefficients by name, those of carriers seen too little as NaN."""
    own = np.where(is_seen[:, np.newaxis], fit.own, math.nan)
    solar, beam = own.shape[1] - BEAM_SIZE - SOLAR_SIZE, own.shape[1] - BEAM_SIZE
    stored = np.delete(np.arange(own.shape[1]), np.arange(solar, beam))
    covariance = fit.own_covariance[:, stored][:, :, stored]
    return {
        "level_dbm": own[:, 0] + rough_dbm,
        "daily": own[:, 1:solar],
        "solar_db": own[:, solar:beam],
        "gradient": own[:, beam:-3],
        "hessian": own[:, -3:],
        "downlink": fit.shared.reshape(-1, 2),
        "covariance": np.where(is_seen[:, np.newaxis, np.newaxis], covariance, math.nan),
        "downlink_covariance": fit.shared_covariance,
        "downlink_gain": fit.gain[:, stored],
    }


def response_of(calibration: GeometryCoefficients, geometry: CarrierGeometry) -> QuadraticResponse:
    """Return the answer to the attitude, with the errors of the calibration.

    Parameters
    ----------
    calibration : GeometryCoefficients
        N carriers.
    geometry : CarrierGeometry
        The same as in the fit.

    Returns
    -------
    QuadraticResponse
    """
    position = geometry.displacement()
    own_map, downlink_map = response_transform(position[:-1], position[-1])
    carriers = len(own_map)
    per_band = np.zeros((carriers, 9, geometry.bands, 2))
    per_band[np.arange(carriers), :, geometry.band] = downlink_map
    shared_map = per_band.reshape(carriers, 9, -1)
    beam = np.concatenate([calibration.gradient, calibration.hessian], axis=1)
    coefficients = np.einsum("nij,nj->ni", own_map, beam) + shared_map @ calibration.downlink.ravel()
    # an error of the downlink gradient acts by itself and through the coefficients that it changes
    loading = shared_map + own_map @ calibration.downlink_gain[:, -BEAM_SIZE:]
    shared_covariance = calibration.downlink_covariance
    gain = calibration.downlink_gain
    alone = calibration.covariance - gain @ shared_covariance @ np.swapaxes(gain, 1, 2)
    alone_beam = alone[:, -BEAM_SIZE:, -BEAM_SIZE:]
    common_root = loading @ np.linalg.cholesky(shared_covariance)
    covariance = own_map @ alone_beam @ np.swapaxes(own_map, 1, 2) + common_root @ np.swapaxes(common_root, 1, 2)
    return QuadraticResponse(coefficients[:, :3], symmetric_matrix(coefficients[:, 3:]), covariance, common_root)


def predict_level_dbm(
    calibration: GeometryCoefficients, geometry: CarrierGeometry, motion: OrbitMotion | None, phase_rad: FloatArray
) -> FloatArray:
    """Return the levels at zero attitude, the daily change included.

    Parameters
    ----------
    calibration : GeometryCoefficients
        N carriers.
    geometry : CarrierGeometry
        The same as in the fit.
    motion : OrbitMotion or None
        Ballistics of T epochs; needed by a calibration of the dish law, not read by one of harmonics.
    phase_rad : ndarray, shape (T,), rad
        Phase since the ascending node; read by a calibration of harmonics.

    Returns
    -------
    ndarray, shape (T, N), dBm
        NaN where the epoch is not covered.
    """
    known = motion if calibration.is_dish_law else None
    if calibration.is_dish_law and motion is None:
        return np.full((len(phase_rad), len(calibration.level_dbm)), math.nan)
    daily = daily_columns(known, phase_rad, len(calibration.level_dbm))
    level = calibration.level_dbm + (daily * calibration.daily).sum(axis=-1)
    if known is None:
        return np.asarray(level)
    own, downlink = beam_columns(np.zeros((len(level), 3)), geometry, known)
    beam = np.concatenate([calibration.gradient, calibration.hessian], axis=1)
    return np.asarray(level + (own * beam).sum(axis=-1) + downlink @ calibration.downlink.ravel())
