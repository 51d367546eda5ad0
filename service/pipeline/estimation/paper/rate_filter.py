"""Attitude filter of the paper method, L3 to L4: the newest fix and the slope of the last fixes as its rate.

The published method smooths deviations, not angles, so the fix passes unchanged; only the control law needs a rate.
State kept: the fixes of the rate window. Fewer than three of them, or a third of the window, give no rate.
"""

from typing import NamedTuple

import numpy as np

from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray, IntArray


class FixHistory(NamedTuple):
    """Fixes of the rate window, oldest first."""

    #: (K,) microseconds UTC
    epochs_us: IntArray
    #: (K, 3) deg
    attitude_deg: FloatArray


NO_FIXES = FixHistory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def remember_fix(history: FixHistory, epoch_us: int, attitude_deg: FloatArray, window_s: float) -> FixHistory:
    """Return the history with a fix added and everything older than the window dropped."""
    first = history.epochs_us.searchsorted(epoch_us - int(window_s * US_PER_S), side="right")
    return FixHistory(
        np.concatenate([history.epochs_us[first:], [epoch_us]]),
        np.concatenate([history.attitude_deg[first:], attitude_deg[None, :]]),
    )


def rate_deg_s(history: FixHistory, window_s: float) -> FloatArray | None:
    """Return the slope (3,) in deg/s of the fixes in the window; None while they cover less than a third of it."""
    if len(history.epochs_us) < 3:
        return None
    time_s = (history.epochs_us - history.epochs_us[-1]) / US_PER_S
    if -time_s[0] < window_s / 3.0:
        return None
    centred_s = time_s - time_s.sum() / len(time_s)
    slope: FloatArray = centred_s @ history.attitude_deg / float(centred_s @ centred_s)
    return slope
