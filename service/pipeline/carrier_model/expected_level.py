"""Expected level of every carrier at zero attitude, from calibration and ephemeris.

With a track the dish law is evaluated at fixed instants ten minutes apart, a day at a time, and read between them by a
cubic: the same row gets the same level to the last bit for every caller and in every order. Without a track two
harmonics of the node's phase are evaluated at the row itself.
"""

from collections.abc import Callable

import numpy as np

from service.core.estimation.calibration.geometry_columns import OrbitMotion, daily_columns
from service.core.estimation.calibration.geometry_prediction import predict_level_dbm
from service.core.geometry.line_of_sight import (
    Positions,
    PredictedTrack,
    antenna_motion_deg,
    sight_motion_deg,
    track_position_deg,
)
from service.core.geometry.node_phase import node_phase_rad
from service.pipeline.carrier_model.calibrated_arrays import GeometryModel
from service.records.catalogue import Ephemeris
from service.records.epoch import US_PER_S
from service.records.geometry import GeometryFit
from service.records.levels.attitude import FloatArray, IntArray

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
    reported = ephemeris.track
    track = PredictedTrack(
        np.array(reported.epochs_us, dtype=np.int64), np.array(reported.latitude_deg), np.array(reported.longitude_deg)
    )
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
        """Return the levels at an epoch, the solar day included; NaN where nothing is known."""
        angle = 2.0 * np.pi * ((epoch_us % _DAY_US) / _DAY_US)
        solar_db = self._solar_db @ np.array([np.cos(angle), np.sin(angle)])
        if not self._is_interpolated:
            return np.asarray(self._at(np.array([epoch_us], dtype=np.int64))[0] + solar_db)
        day, within = divmod(epoch_us, _DAY_US)
        knot, offset = divmod(within, _KNOT_US)
        x = offset / _KNOT_US
        # cubic through the knots at -1, 0, 1, 2
        weights = np.array(
            [
                -x * (x - 1.0) * (x - 2.0) / 6.0,
                (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
                -(x + 1.0) * x * (x - 2.0) / 2.0,
                (x + 1.0) * x * (x - 1.0) / 6.0,
            ]
        )
        return np.asarray(weights @ self._day(day)[knot : knot + 4] + solar_db)

    def mean_dbm(self, epochs_us: IntArray) -> FloatArray:
        """Return the mean level (N,) over some epochs."""
        return np.asarray(np.array([self(int(epoch_us)) for epoch_us in epochs_us]).mean(axis=0))

    def _day(self, day: int) -> FloatArray:
        """Return the levels at the knots of a day, one before it and two after it."""
        if day not in self._days:
            if len(self._days) >= _MAX_DAYS:
                self._days.clear()
            epochs_us = day * _DAY_US + _KNOT_US * np.arange(-1, _KNOTS_A_DAY + 2, dtype=np.int64)
            self._days[day] = self._at(epochs_us)
        return self._days[day]
