"""Decibels: levels in dBm, ratios in dB, and the linear milliwatts in which everything is averaged.

Law of this file: a level is ``10 lg(P / 1 mW)``; a power that is zero, negative or NaN has no level and becomes NaN.
Means are taken in milliwatts, never in decibels: the mean of the dB values of single samples lies 2.51 dB low.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

#: dB of one neper of power, 10 / ln 10; small relative deviations times this are deviations in dB
DB_PER_NEPER = 10.0 / math.log(10.0)


def ratio_from_db(ratio_db: ArrayLike) -> FloatArray:
    """Return the power ratio of a value in dB.

    Examples
    --------
    >>> float(ratio_from_db(-10.0))
    0.1
    """
    return np.asarray(np.power(10.0, np.asarray(ratio_db, dtype=np.float64) / 10.0), dtype=np.float64)


def db_from_ratio(ratio: ArrayLike) -> FloatArray:
    """Return the dB value of a power ratio; NaN where the ratio is not positive.

    Examples
    --------
    >>> float(db_from_ratio(100.0))
    20.0
    """
    values = np.asarray(ratio, dtype=np.float64)
    positive = values > 0.0
    return np.where(positive, 10.0 * np.log10(np.where(positive, values, 1.0)), np.nan)


def mw_from_dbm(level_dbm: ArrayLike) -> FloatArray:
    """Return the power in milliwatts of a level in dBm.

    Examples
    --------
    >>> float(mw_from_dbm(20.0))
    100.0
    """
    return ratio_from_db(level_dbm)


def dbm_from_mw(power_mw: ArrayLike) -> FloatArray:
    """Return the level in dBm of a power in milliwatts; NaN where the power is not positive.

    Examples
    --------
    >>> bool(np.isnan(dbm_from_mw(-1e-9)))
    True
    """
    return db_from_ratio(power_mw)
