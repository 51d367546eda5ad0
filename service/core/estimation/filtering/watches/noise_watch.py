"""Noise watched in operation: whether what the calibration learned is still true.

White part of a carrier: its squared test values must average one. Slow part, of all carriers together: a running mean
of the test values must be as small as whitened values make it; flicker that the model does not know makes it larger.
Both move a factor on the noise in small steps of its logarithm, so that sigma and integrity follow what is seen.
The law of this file: one value a carrier and minute, outliers cut at three sigma.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray

#: minutes in which the factors follow
WHITE_MINUTES = 240.0
SLOW_MINUTES = 360.0
#: length of the running mean, minutes
_MEAN_MINUTES = 30.0
_MEAN_VARIANCE = 1.0 / (2.0 * _MEAN_MINUTES - 1.0)
#: what min(z^2, 9) averages when z is normal
_CUT_MEAN = 0.9770
_CUT = 9.0
WHITE_LIMITS = (0.6, 3.0)
SLOW_LIMITS = (0.7, 4.0)
NIS_MINUTES = 60.0
#: what Huber's weights leave of z^2 on average when z is normal: the mean of min(z^2, 2 abs(z))
_WEIGHED_MEAN = 0.9545


class NoiseWatch(NamedTuple):
    """Factors on the noise and the statistics behind them."""

    #: (N,) factor on the white sigma
    white_scale: FloatArray
    #: (N,) running mean of the test values
    running_mean: FloatArray
    #: factor on the slow sigmas of all carriers
    slow_scale: float
    #: running mean of normalised innovation squared a degree of freedom; one while the model holds
    nis_ratio: float


def calm_watch(carriers: int) -> NoiseWatch:
    """Return factors of one."""
    return NoiseWatch(np.ones(carriers), np.zeros(carriers), 1.0, 1.0)


def push_values(watch: NoiseWatch, values: FloatArray, nis: float, degrees: int) -> NoiseWatch:
    """Return the watch with one minute more.

    Parameters
    ----------
    watch : NoiseWatch
        Before the minute.
    values : ndarray, shape (N,)
        Test values of unit variance, NaN where a carrier is flagged or absent.
    nis, degrees : float, int
        Normalised innovation squared of the minute's rows and its degrees of freedom, > 0.
    """
    is_present = np.isfinite(values)
    value = np.where(is_present, values, 0.0)
    surplus = np.where(is_present, np.minimum(value**2, _CUT) / _CUT_MEAN - 1.0, 0.0)
    low, high = WHITE_LIMITS
    # not np.clip: on sixteen numbers it costs four times as much
    white = np.minimum(np.maximum(watch.white_scale * np.exp(0.5 * surplus / WHITE_MINUTES), low), high)
    share = 1.0 / _MEAN_MINUTES
    cut = np.minimum(np.maximum(value, -3.0), 3.0)
    mean = watch.running_mean + np.where(is_present, share * (cut - watch.running_mean), 0.0)
    count = int(np.count_nonzero(is_present))
    slow = watch.slow_scale
    if count:
        ratio = float(np.minimum(mean[is_present] ** 2 / _MEAN_VARIANCE, _CUT).mean())
        low, high = SLOW_LIMITS
        slow = min(high, max(low, slow * math.exp(0.5 * (ratio - 1.0) / SLOW_MINUTES)))
    ratio_now = min(nis / degrees / _WEIGHED_MEAN, _CUT)
    return NoiseWatch(white, mean, slow, watch.nis_ratio + (ratio_now - watch.nis_ratio) / NIS_MINUTES)
