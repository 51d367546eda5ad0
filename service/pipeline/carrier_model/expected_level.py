"""Arrays of a calibration by geometry, and the expected level of every carrier at zero attitude."""

import math
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.calibration.geometry_calibration import (
    GeometryCoefficients,
    predict_level_dbm,
    response_of,
)
from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    CarrierGeometry,
    OrbitMotion,
    QuadraticResponse,
    daily_columns,
)
from service.core.estimation.filtering.filter_model import CarrierModel
from service.core.geometry.line_of_sight import (
    Positions,
    antenna_motion_deg,
    node_phase_rad,
    sight_motion_deg,
    track_position_deg,
)
from service.pipeline.config import RobustConfig
from service.pipeline.inputs.polarization import predicted_track
from service.records.calibration import CarrierCalibration, GeometryFit, NoiseComponent
from service.records.catalogue import Ephemeris
from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: places of yy, yr, yp, rr, rp, pp behind the three slopes among the coefficients of a response
_FILTER_ORDER = np.array([0, 1, 2, 3, 6, 7, 4, 8, 5])
#: a coloured part of a carrier whose noise nobody learned
_UNKNOWN_NOISE = (NoiseComponent(1200.0, 0.09),)


class GeometryModel(NamedTuple):
    """Calibration of N carriers by geometry, as arrays."""

    calibration: GeometryCoefficients
    geometry: CarrierGeometry
    #: stations and, last, the receiving site
    positions: Positions
    response: QuadraticResponse


def geometry_model(fit: GeometryFit) -> GeometryModel:
    """Return the arrays of a calibration."""
    azimuth_deg, elevation_deg = np.array(fit.station_azimuth_deg), np.array(fit.station_elevation_deg)
    is_beacon = np.isnan(azimuth_deg)
    site_deg = np.array(fit.site_deg)
    band = np.array(fit.band, dtype=np.int64)
    geometry = CarrierGeometry(
        np.where(is_beacon, site_deg[0], azimuth_deg), np.where(is_beacon, site_deg[1], elevation_deg), site_deg, band
    )
    calibration = _coefficients(fit, is_beacon)
    latitude_deg, longitude_deg, height_m = fit.site_position
    positions = Positions(
        np.append(np.where(is_beacon, latitude_deg, np.array(fit.station_latitude_deg)), latitude_deg),
        np.append(np.where(is_beacon, longitude_deg, np.array(fit.station_longitude_deg)), longitude_deg),
        np.append(np.where(is_beacon, height_m, 0.0), height_m),
    )
    return GeometryModel(calibration, geometry, positions, response_of(calibration, geometry))


def _coefficients(fit: GeometryFit, is_beacon: FloatArray) -> GeometryCoefficients:
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
    return GeometryCoefficients(
        level_dbm=np.array(fit.level_dbm),
        daily=np.nan_to_num(np.array(fit.daily, dtype=np.float64)),
        gradient=gradient,
        hessian=hessian,
        downlink=downlink,
        covariance=covariance,
        downlink_covariance=downlink_covariance,
        downlink_gain=gain,
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


_KNOT_US = 600 * US_PER_S
_KNOTS_A_DAY = 144
_DAY_US = _KNOT_US * _KNOTS_A_DAY
#: days kept; a live chain needs one, a comparison of two a few
_MAX_DAYS = 40

#: instants of a day at which the error of the daily change is looked at
_ERROR_INSTANTS = 48

#: levels (T, N) in dBm of some epochs (T,)
Levels = Callable[[IntArray], FloatArray]


def expected_levels(model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris) -> Levels:
    """Return the function that gives the levels at zero attitude; NaN where the ephemeris does not reach."""
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)

    def at(epochs_us: IntArray) -> FloatArray:
        phase = node_phase_rad(epochs_us, nodes_us, ephemeris.nodal_period_s)
        motion = _motion(model, fit, ephemeris, epochs_us) if fit.is_dish_law else None
        return predict_level_dbm(model.calibration, model.geometry, motion, phase)

    return at


def _motion(model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris, epochs_us: IntArray) -> OrbitMotion | None:
    """Return the motion of the satellite by the track at some epochs, None without a track."""
    if ephemeris.track is None:
        return None
    track = predicted_track(ephemeris.track)
    stations = Positions(*(values[:-1] for values in model.positions))
    sight = sight_motion_deg(track_position_deg(track, epochs_us), stations, fit.nominal_longitude_deg)
    return OrbitMotion(sight, antenna_motion_deg(track, epochs_us, model.positions, fit.nominal_longitude_deg))


def daily_error_db(model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris, start_us: int) -> FloatArray:
    """Return the error of each carrier's daily change (N,) by the calibration's own covariance, rms, dB.

    Small over the orbit of the quiet days; weeks later the satellite moves along another line, of which they told less.
    Zero where the ephemeris does not reach.
    """
    epochs_us = start_us + (_DAY_US // _ERROR_INSTANTS) * np.arange(_ERROR_INSTANTS, dtype=np.int64)
    motion = _motion(model, fit, ephemeris, epochs_us) if fit.is_dish_law else None
    if fit.is_dish_law and motion is None:
        return np.zeros(len(fit.level_dbm))
    nodes_us = np.array(ephemeris.ascending_nodes_us, dtype=np.int64)
    phase = node_phase_rad(epochs_us, nodes_us, ephemeris.nodal_period_s)
    columns = daily_columns(motion, phase, len(fit.level_dbm))
    columns = columns[np.isfinite(columns).all(axis=(1, 2))]
    if not len(columns):
        return np.zeros(len(fit.level_dbm))
    # the mean of the day is part of the reference
    columns = columns - columns.mean(axis=0)
    size = columns.shape[2]
    covariance = np.nan_to_num(np.array(fit.covariance)[:, 1 : 1 + size, 1 : 1 + size])
    return np.asarray(np.sqrt(np.einsum("tni,nij,tnj->n", columns, covariance, columns) / len(columns)))


class ExpectedLevel:
    """Level (N,) in dBm of one row, quickly.

    Parameters
    ----------
    model : GeometryModel
        Calibration as arrays.
    fit : GeometryFit
        The same calibration as the archive keeps it.
    ephemeris : Ephemeris
        Orbit that holds.
    """

    def __init__(self, model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris) -> None:
        self._at = expected_levels(model, fit, ephemeris)
        self._is_interpolated = fit.is_dish_law
        self._solar_db = np.array(fit.solar_day_db, dtype=np.float64).reshape(-1, 2)
        self._days: dict[int, FloatArray] = {}

    def __call__(self, epoch_us: int) -> FloatArray:
        """Return the levels (N,) at an epoch as `rows` does."""
        return np.asarray(self.rows(np.array([epoch_us], dtype=np.int64))[0])

    def rows(self, epochs_us: IntArray) -> FloatArray:
        """Return the levels (T, N) at some epochs, the solar day included; NaN where nothing is known.

        The bits of a row do not depend on the other rows.
        """
        levels, start = np.empty((len(epochs_us), len(self._solar_db))), 0
        while start < len(epochs_us):
            day = int(epochs_us[start] // _DAY_US)
            knots_dbm = self._day(day) if self._is_interpolated else self._at(epochs_us[start : start + 1])
            start = WRITE_LEVELS(knots_dbm, day * _DAY_US, self._solar_db, epochs_us, start, levels)
        return levels

    def mean_dbm(self, epochs_us: IntArray) -> FloatArray:
        """Return the mean level (N,) over some epochs."""
        return np.asarray(self.rows(np.asarray(epochs_us, dtype=np.int64)).mean(axis=0))

    def _day(self, day: int) -> FloatArray:
        """Return the levels at the knots of a day, one before it and two after it."""
        if day not in self._days:
            if len(self._days) >= _MAX_DAYS:
                self._days.clear()
            epochs_us = day * _DAY_US + _KNOT_US * np.arange(-1, _KNOTS_A_DAY + 2, dtype=np.int64)
            self._days[day] = np.ascontiguousarray(self._at(epochs_us))
        return self._days[day]


def _write_levels(
    knots_dbm: FloatArray, day_us: int, solar_db: FloatArray, epochs_us: IntArray, start: int, levels: FloatArray
) -> int:
    """Write the levels of the rows of one day from `start` on, and return the first row that is of another one.

    The levels are cubics through knots (K, N) with the solar day (N, 2); one knot stands for the row at `start` alone.
    """
    number = start
    while number < len(epochs_us) and 0 <= epochs_us[number] - day_us < _DAY_US:
        within_us = epochs_us[number] - day_us
        angle = 2.0 * math.pi * (within_us / _DAY_US)
        cos, sin = math.cos(angle), math.sin(angle)
        knot = within_us // _KNOT_US
        # a knot before the time, and two after it
        x = (within_us - knot * _KNOT_US) / _KNOT_US
        before, first = -x * (x - 1.0) * (x - 2.0) / 6.0, (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0
        second, after = (x + 1.0) * x * (x - 2.0) / 2.0, (x + 1.0) * x * (x - 1.0) / 6.0
        for k in range(len(solar_db)):
            level = knots_dbm[0, k]
            if len(knots_dbm) > 1:
                level = before * knots_dbm[knot, k] + first * knots_dbm[knot + 1, k]
                level = level - second * knots_dbm[knot + 2, k] + after * knots_dbm[knot + 3, k]
            levels[number, k] = level + (cos * solar_db[k, 0] + sin * solar_db[k, 1])
        number += 1
        if len(knots_dbm) == 1:
            break
    return number


WRITE_LEVELS = CompiledEntry(_write_levels, (sys.modules[__name__],))
