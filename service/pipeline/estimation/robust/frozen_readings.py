"""Frozen and coarse readings: a carrier that shows one level for long, or moves in large steps alone, is not measured.

An instrument that hangs shows the same number while the level moves, one that reads in steps of a decibel nearly so.
Noise of real links moves the reading of every second row, by less than its own size, where steps are as fine.
"""

from typing import NamedTuple

import numpy as np

from service.records.epoch import US_PER_S
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: rows of one reading, and how long they last, from which it is frozen
_ROWS = 20
_LASTING_US = 20 * 60 * US_PER_S
#: least change of a reading, dB, from which it is coarse, how fast small changes of before are forgotten, and the one
#: before the first, so that six readings far apart make a carrier coarse: two are a fade or a step
_COARSE_DB, _FORGETTING, _BEFORE_DB = 0.4, 1.05, 0.3


class LastReadings(NamedTuple):
    """Last reading of N carriers, how many rows it has lasted, and since when."""

    #: (N,) dBm, NaN = never read
    power_dbm: FloatArray
    #: (N,)
    rows: IntArray
    #: (N,) microseconds UTC
    since_us: IntArray
    #: (N,) dB, least change of the last hundred or so
    least_change_db: FloatArray


def no_readings(carriers: int) -> LastReadings:
    """Return the readings before the first row."""
    zeros = np.zeros(carriers, dtype=np.int64)
    return LastReadings(np.full(carriers, np.nan), zeros, zeros, np.full(carriers, _BEFORE_DB))


def push_readings(readings: LastReadings, power_dbm: FloatArray, epoch_us: int) -> LastReadings:
    """Return the readings after a row (N,); a carrier that is absent keeps its last one."""
    is_there = np.isfinite(power_dbm)
    is_new = is_there & (power_dbm != readings.power_dbm)
    change_db = np.where(is_new, np.abs(power_dbm - readings.power_dbm), np.nan)
    least_db = np.where(is_new, _FORGETTING * readings.least_change_db, readings.least_change_db)
    return LastReadings(
        np.where(is_there, power_dbm, readings.power_dbm),
        np.where(is_new, 1, readings.rows + is_there),
        np.where(is_new, epoch_us, readings.since_us),
        np.fmin(least_db, change_db),
    )


def frozen(readings: LastReadings, epoch_us: int) -> BoolArray:
    """Return which carriers (N,) have shown one reading for too long, or move in steps that are too large."""
    is_lasting = (readings.rows >= _ROWS) & (epoch_us - readings.since_us >= _LASTING_US)
    return np.asarray(is_lasting | (readings.least_change_db >= _COARSE_DB))
