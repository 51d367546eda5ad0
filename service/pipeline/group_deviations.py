"""Transponders with automatic level control: only differences between their carriers say anything.

The control holds the sum of a transponder's carriers, so what one does the others undo. Powers of such a group enter
the fit as ``P_i - mean_j (P_j - p_j)``, j over the group's present carriers and p the model so far; the first model is
each carrier's median. Whoever uses the calibration does the same with deviations: subtracts from each row the group's
mean, and from the model's gradients the mean of the same carriers. The law of this file: a group of fewer than three
carriers says nothing.
"""

import numpy as np

from service.records.catalogue import CarrierPlan
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: carriers that a group needs
MIN_GROUP = 3


def alc_groups(plan: CarrierPlan) -> IntArray:
    """Return for each carrier (N,) the number of its group, -1 where nothing couples it to others."""
    names = sorted({carrier.transponder for carrier in plan.carriers if _is_coupled(carrier.transponder_mode)})
    return np.array(
        [names.index(c.transponder) if _is_coupled(c.transponder_mode) else -1 for c in plan.carriers], dtype=np.int64
    )


def small_groups(group: IntArray) -> BoolArray:
    """Return which carriers (N,) belong to a group that is too small."""
    size = np.array([np.count_nonzero(group == number) for number in group])
    return np.asarray((group >= 0) & (size < MIN_GROUP))


def first_model_dbm(power_dbm: FloatArray) -> FloatArray:
    """Return each carrier's median level (N,), 0 for one that was never seen."""
    known = [column[np.isfinite(column)] for column in power_dbm.T]
    return np.array([float(np.median(one)) if len(one) else 0.0 for one in known])


def without_group_means(power_dbm: FloatArray, model_dbm: FloatArray, group: IntArray) -> FloatArray:
    """Return powers (T, N) less what the present carriers of each group do together beyond a model.

    Parameters
    ----------
    power_dbm : ndarray, shape (T, N), dBm
        Powers; NaN = absent.
    model_dbm : ndarray, shape (T, N) or (N,), dBm
        What the carriers should do by themselves; NaN counts as absent.
    group : ndarray of int, shape (N,)
        Number of each carrier's group, -1 = none.

    Returns
    -------
    ndarray, shape (T, N), dBm
        Rows in which fewer than three carriers of a group are present are NaN for that group.
    """
    out = power_dbm.copy()
    beyond = power_dbm - model_dbm
    for number in range(int(group.max(initial=-1)) + 1):
        members = np.flatnonzero(group == number)
        is_there = np.isfinite(beyond[:, members])
        count = is_there.sum(axis=1)
        mean = np.where(is_there, beyond[:, members], 0.0).sum(axis=1) / np.maximum(count, 1)
        out[:, members] -= np.where(count >= MIN_GROUP, mean, np.nan)[:, np.newaxis]
    return out


def _is_coupled(transponder_mode: str) -> bool:
    """Whether a mode of a transponder couples its carriers."""
    return transponder_mode == "alc"
