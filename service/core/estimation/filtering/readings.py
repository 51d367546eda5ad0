"""Readings that stand still, or move in steps that are too large to tell an angle; compiled as they stand."""

import math
import sys

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.compiled_entry import CompiledEntry

#: rows of one reading, and how long they last, us, from which it is frozen
_ROWS, _LASTING_US = 20, 20 * 60 * 10**6
#: least change of a reading, dB, from which it is coarse, how fast small changes of before are forgotten, and the one
#: before the first, so that six readings far apart make a carrier coarse: two are a fade or a step
_COARSE_DB, _FORGETTING, _BEFORE_DB = 0.4, 1.05, 0.3

#: last reading of a carrier: dBm, NaN = never read; how many rows it has lasted, and since when, microseconds UTC;
#: least change of the last hundred or so, dB
READING = np.dtype([("power_dbm", "f8"), ("rows", "i8"), ("since_us", "i8"), ("least_change_db", "f8")], align=True)


def no_readings(carriers: int) -> NDArray[np.void]:
    """Return the readings (N,) before the first row."""
    readings = np.zeros(carriers, READING)
    readings["power_dbm"], readings["least_change_db"] = np.nan, _BEFORE_DB
    return readings


def frozen_readings(
    readings: NDArray[np.void], epochs_us: IntArray, power_dbm: FloatArray
) -> tuple[NDArray[np.void], BoolArray]:
    """Return the readings (N,) after rows, and which carriers (T, N) show one for too long or move in large steps.

    Parameters
    ----------
    readings : ndarray, shape (N,)
        Before; not changed.
    epochs_us : ndarray, shape (T,), microseconds UTC
        Of the rows, in order.
    power_dbm : ndarray, shape (T, N), dBm
        NaN = absent: such a carrier keeps its last reading.
    """
    after, is_frozen = readings.copy(), np.zeros(power_dbm.shape, dtype=np.bool_)
    _PUSH_READINGS(after, epochs_us, power_dbm, is_frozen)
    return after, is_frozen


def standing_readings(readings: NDArray[np.void], epoch_us: int) -> BoolArray:
    """Return which carriers (N,) are frozen at an epoch by the rows that were read."""
    is_lasting = (readings["rows"] >= _ROWS) & (epoch_us - readings["since_us"] >= _LASTING_US)
    return np.asarray(is_lasting | (readings["least_change_db"] >= _COARSE_DB))


def push_readings(readings: NDArray[np.void], epochs_us: IntArray, power_dbm: FloatArray, is_frozen: BoolArray) -> None:
    """Take rows into the readings, in place, and write which are frozen."""
    for number in range(len(epochs_us)):
        for k in range(len(readings)):
            power = power_dbm[number, k]
            if math.isfinite(power):
                last_dbm = readings["power_dbm"][k]
                readings["rows"][k] += 1
                if power != last_dbm:
                    readings["rows"][k], readings["since_us"][k] = 1, epochs_us[number]
                    least_db = _FORGETTING * readings["least_change_db"][k]
                    change_db = abs(power - last_dbm)
                    readings["least_change_db"][k] = least_db if math.isnan(change_db) else min(least_db, change_db)
                    readings["power_dbm"][k] = power
            is_lasting = epochs_us[number] - readings["since_us"][k] >= _LASTING_US
            is_frozen[number, k] = (readings["rows"][k] >= _ROWS and is_lasting) or (
                readings["least_change_db"][k] >= _COARSE_DB
            )


_PUSH_READINGS = CompiledEntry(push_readings, (sys.modules[__name__],))
