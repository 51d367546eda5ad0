"""Trials of the expected level: how far the daily change that a calibration predicts is off some days later.

Powers of ``white`` less the level that calibration and ballistics expect, less what the true attitude does to them, are
noise and the error of the prediction. Means of two hours leave 0.015 dB of the noise; its variance is known and taken
off.
"""

import numpy as np

from service.core.estimation.calibration.geometry_columns import predict_deviation
from service.pipeline.carrier_model.expected_level import GeometryModel, expected_levels
from service.records.catalogue import Ephemeris
from service.records.geometry import GeometryFit
from service.records.levels.attitude import FloatArray
from service.study.estimation.flight.world import World

#: days of operation that are looked at, counted from 1
DAYS = (1, 7)
#: rows of a minute in one mean, and means of a day
_BLOCK, _BLOCKS = 120, 12


def level_error_db2(world: World, model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris) -> FloatArray:
    """Return the mean square (D,) in dB^2 of the prediction's error on each of ``DAYS``, over all carriers.

    Parameters
    ----------
    world : World
        White noise only, rows of a minute, as many days of operation as the last of ``DAYS``.
    model, fit : GeometryModel, GeometryFit
        Calibration of its quiet days.
    ephemeris : Ephemeris
        Orbit that the ground predicts.
    """
    first = int(np.searchsorted(world.ground.epochs_us, world.ground.phases["operation"].start_us))
    squares = []
    for day in DAYS:
        begin = first + (day - 1) * _BLOCK * _BLOCKS
        rows = slice(begin, begin + _BLOCK * _BLOCKS)
        expected_dbm = expected_levels(model, fit, ephemeris)(world.ground.epochs_us[rows])
        turned_db = predict_deviation(world.truth.attitude_deg[rows], model.response)
        error_db = world.ground.power_dbm[rows] - expected_dbm - turned_db
        means_db = error_db.reshape(_BLOCKS, _BLOCK, -1).mean(axis=1)
        squares.append(np.mean(means_db**2 - world.truth.white_db**2 / _BLOCK))
    return np.array(squares)
