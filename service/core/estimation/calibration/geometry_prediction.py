"""Prediction of a calibration: levels at zero attitude, and the response to the attitude with its errors.

``P_i(t, l) = level_i(t) + f_i(l)``: the level, in dBm, carries the daily change of the dish and what the orbit does to
the station's place in the antenna frame; f is the quadratic response. The law of this file: both parts come from one
set of coefficients, and the errors that carriers share (the downlink gradients) stay shared.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.geometry_calibration import GeometryCalibration
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    CarrierGeometry,
    OrbitMotion,
    QuadraticResponse,
    beam_columns,
    daily_columns,
    response_transform,
    symmetric_matrix,
)

FloatArray = NDArray[np.float64]


def response_of(calibration: GeometryCalibration, geometry: CarrierGeometry) -> QuadraticResponse:
    """Return the answer to the attitude, with the errors of the calibration.

    Parameters
    ----------
    calibration : GeometryCalibration
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
    calibration: GeometryCalibration, geometry: CarrierGeometry, motion: OrbitMotion | None, phase_rad: FloatArray
) -> FloatArray:
    """Return the levels at zero attitude, the daily change included.

    Parameters
    ----------
    calibration : GeometryCalibration
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
