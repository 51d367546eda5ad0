"""Detection of changes of the mean in a series of unit variance: the two-sided cumulative sum.

    up   = max(0, up + z - k),   down = max(0, down - z - k),   alarm where one exceeds h

k = 0.6 and h = 9: a change of 1.2 sigma is found after about fifteen values, one of 4 sigma after three, and a dry
series raises one false alarm in about a hundred thousand values. The law of this file: values, no clock.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray

SLACK = 0.6
THRESHOLD = 9.0


class Cusum(NamedTuple):
    """Sums of any number of series, shape (M,)."""

    up: FloatArray
    down: FloatArray


def quiet_cusum(series: int) -> Cusum:
    """Return sums that have seen nothing."""
    return Cusum(np.zeros(series), np.zeros(series))


def push_cusum(sums: Cusum, values: FloatArray, slack: float = SLACK) -> Cusum:
    """Return the sums with one value more of every series.

    Parameters
    ----------
    sums : Cusum
        Sums before.
    values : ndarray, shape (M,)
        Values of unit variance; NaN leaves its sums as they are.
    slack : float
        Half the smallest change that matters.

    Returns
    -------
    Cusum
        Sums after.

    Examples
    --------
    >>> push_cusum(quiet_cusum(2), np.array([1.6, np.nan])).up
    array([1., 0.])
    """
    up, down = np.maximum(sums.up + values - slack, 0.0), np.maximum(sums.down - values - slack, 0.0)
    is_absent = np.isnan(values)
    return Cusum(np.where(is_absent, sums.up, up), np.where(is_absent, sums.down, down))


def reset_cusum(sums: Cusum, chosen: BoolArray) -> Cusum:
    """Return the sums with some series at zero."""
    return Cusum(np.where(chosen, 0.0, sums.up), np.where(chosen, 0.0, sums.down))


def common_value(innovation_db: FloatArray, covariance_db2: FloatArray) -> tuple[float, float]:
    """Return the median of innovations and that median in units of its sigma.

    Parameters
    ----------
    innovation_db : ndarray, shape (n,), dB
        Of the carriers of the fully affected band, n >= 1.
    covariance_db2 : ndarray, shape (n, n), dB^2
        Covariance of them.

    Returns
    -------
    tuple of float
        Median in dB, and the median over its standard deviation.

    Notes
    -----
    The sigma is that of the mean, what the carriers share included, with pi/2 more variance for what they do not.
    """
    count = len(innovation_db)
    ordered = np.sort(innovation_db)
    median = 0.5 * float(ordered[(count - 1) // 2] + ordered[count // 2])
    total, own = float(covariance_db2.sum()) / count**2, float(np.trace(covariance_db2)) / count**2
    return median, median / math.sqrt(total + (0.5 * math.pi - 1.0) * own)
