"""From the archive's record of a calibration by geometry to the arrays that the core computes with.

A beacon has no station: it is given the receiving site's place and the downlink gradient of its band, so that it tells
the common level and the little that the attitude does to the downlink.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.estimation.calibration.geometry_calibration import GeometryCalibration
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, CarrierGeometry
from service.core.estimation.calibration.geometry_prediction import response_of
from service.core.estimation.calibration.quadratic_response import QuadraticResponse
from service.core.estimation.filtering.model.filter_model import CarrierModel
from service.core.geometry.line_of_sight import Positions
from service.pipeline.config import RobustConfig
from service.records.calibration import CarrierCalibration
from service.records.geometry import GeometryFit
from service.records.levels.attitude import BoolArray, FloatArray
from service.records.noise import NoiseComponent

#: places of yy, yr, yp, rr, rp, pp behind the three slopes among the coefficients of a response
_FILTER_ORDER = np.array([0, 1, 2, 3, 6, 7, 4, 8, 5])
#: a coloured part of a carrier whose noise nobody learned
_UNKNOWN_NOISE = (NoiseComponent(1200.0, 0.09),)


class GeometryModel(NamedTuple):
    """Calibration of N carriers by geometry, as arrays."""

    calibration: GeometryCalibration
    geometry: CarrierGeometry
    #: stations and, last, the receiving site
    positions: Positions
    response: QuadraticResponse


def geometry_model(fit: GeometryFit, carriers: tuple[CarrierCalibration, ...]) -> GeometryModel:
    """Return the arrays of a calibration."""
    azimuth_deg, elevation_deg = np.array(fit.station_azimuth_deg), np.array(fit.station_elevation_deg)
    is_beacon = np.isnan(azimuth_deg)
    site_deg = np.array(fit.site_deg)
    band = np.array(fit.band, dtype=np.int64)
    geometry = CarrierGeometry(
        np.where(is_beacon, site_deg[0], azimuth_deg), np.where(is_beacon, site_deg[1], elevation_deg), site_deg, band
    )
    calibration = _core_calibration(fit, carriers, is_beacon)
    latitude_deg, longitude_deg, height_m = fit.site_position
    positions = Positions(
        np.append(np.where(is_beacon, latitude_deg, np.array(fit.station_latitude_deg)), latitude_deg),
        np.append(np.where(is_beacon, longitude_deg, np.array(fit.station_longitude_deg)), longitude_deg),
        np.append(np.where(is_beacon, height_m, 0.0), height_m),
    )
    return GeometryModel(calibration, geometry, positions, response_of(calibration, geometry))


def _core_calibration(
    fit: GeometryFit, carriers: tuple[CarrierCalibration, ...], is_beacon: FloatArray
) -> GeometryCalibration:
    """Return the fit with the beams of beacons made of their band's downlink."""
    gradient, hessian = np.array(fit.gradient, dtype=np.float64), np.array(fit.hessian, dtype=np.float64)
    downlink = np.array(fit.downlink, dtype=np.float64).reshape(-1, 2)
    downlink_covariance = np.array(fit.downlink_covariance, dtype=np.float64)
    covariance = np.array(fit.covariance, dtype=np.float64)
    gain = np.array(fit.downlink_gain, dtype=np.float64)
    beam = slice(covariance.shape[1] - BEAM_SIZE, covariance.shape[1])
    for k in np.flatnonzero(is_beacon):
        own = slice(2 * fit.band[k], 2 * fit.band[k] + 2)
        gradient[k], hessian[k] = downlink[fit.band[k]], 0.0
        covariance[k, beam], covariance[k, :, beam], gain[k] = 0.0, 0.0, 0.0
        covariance[k, beam.start : beam.start + 2, beam.start : beam.start + 2] = downlink_covariance[own, own]
    nothing = np.zeros(len(carriers))
    return GeometryCalibration(
        level_dbm=np.array(fit.level_dbm),
        daily=np.nan_to_num(np.array(fit.daily, dtype=np.float64)),
        gradient=gradient,
        hessian=hessian,
        downlink=downlink,
        covariance=covariance,
        downlink_covariance=downlink_covariance,
        downlink_gain=gain,
        noise=ColouredNoise(nothing, nothing[:, None], nothing[:, None]),
        residual_rms_db=nothing,
        residual_db=np.zeros((0, len(carriers))),
        weight=np.zeros((0, len(carriers))),
        stretches_used=nothing.astype(np.int64),
        is_dish_law=fit.is_dish_law,
    )


def carrier_model(
    model: GeometryModel, fit: GeometryFit, carriers: tuple[CarrierCalibration, ...], config: RobustConfig
) -> CarrierModel:
    """Return the measurement model of the attitude filter; carriers without coefficients stand in it with zeros."""
    is_known: BoolArray = np.asarray(np.isfinite(model.response.slope).all(axis=1))
    sigma_db, tau_s = _coloured(carriers)
    common = fit.common_noise
    white_db = np.array([carrier.sigma_white_db for carrier in carriers])
    curvature = np.where(is_known[:, None, None], model.response.curvature, 0.0)
    return CarrierModel(
        gradient_db_deg=np.where(is_known[:, None], model.response.slope, 0.0),
        hessian_db_deg2=curvature,
        rain_share=np.array(fit.rain_share)[np.array(fit.band, dtype=np.int64)],
        transponder=np.array(fit.transponder, dtype=np.int64),
        white_sigma_db=np.where(np.isfinite(white_db), np.maximum(white_db, config.min_white_db), 1.0),
        coloured_sigma_db=sigma_db,
        coloured_tau_s=tau_s,
        reference_walk_db=np.nan_to_num(np.array(fit.reference_walk_db)),
        common_sigma_db=np.array([part.sigma_db for part in common], dtype=np.float64),
        common_tau_s=np.array([part.correlation_time_s for part in common], dtype=np.float64),
        coefficient_covariance=np.where(
            is_known[:, None, None], model.response.covariance[:, _FILTER_ORDER][:, :, _FILTER_ORDER], 0.0
        ),
    )


def _coloured(carriers: tuple[CarrierCalibration, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the coloured parts (N, K) of all carriers over one ladder of K correlation times."""
    parts = [carrier.noise or _UNKNOWN_NOISE for carrier in carriers]
    ladder = sorted({part.correlation_time_s for own in parts for part in own})
    sigma_db = np.zeros((len(carriers), len(ladder)))
    for k, own in enumerate(parts):
        for part in own:
            sigma_db[k, ladder.index(part.correlation_time_s)] = part.sigma_db
    return sigma_db, np.tile(np.array(ladder, dtype=np.float64), (len(carriers), 1))
