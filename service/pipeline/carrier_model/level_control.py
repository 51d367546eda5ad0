"""Carriers of transponders with automatic level control: only their differences say anything.

The control holds the sum of a transponder's carriers and moves all of them by one and the same amount, which nobody
knows. A calibration fits ``P_i - mean_j (P_j - p_j)``, j over the group's present carriers and p the model so far; the
first model is each carrier's median. The filter subtracts from each row the median of what the present members do
beyond what is explained, so that rain on one of them does not move the others; patterns are counted from the mean of
the members. The law of this file: a row with fewer than three members tells nothing of the group.
"""

import numpy as np

from service.core.estimation.calibration.geometry_columns import QuadraticResponse
from service.core.estimation.filtering.filter_model import CarrierModel
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
    return transponder_mode == "alc"


def member_groups(alc_group: tuple[int, ...], is_used: BoolArray) -> tuple[IntArray, ...]:
    """Return the used members of each group."""
    groups = np.array(alc_group, dtype=np.int64) if alc_group else np.full(len(is_used), -1, dtype=np.int64)
    return tuple(np.flatnonzero((groups == group) & is_used) for group in np.unique(groups[groups >= 0]))


def centred_response(response: QuadraticResponse, groups: tuple[IntArray, ...]) -> QuadraticResponse:
    """Return the response with each member's slope and curvature counted from the mean of its group."""
    if not groups:
        return response
    slope, curvature = response.slope.copy(), response.curvature.copy()
    for members in groups:
        slope[members] -= slope[members].mean(axis=0)
        curvature[members] -= curvature[members].mean(axis=0)
    return response._replace(slope=slope, curvature=curvature)


def centred_model(model: CarrierModel, groups: tuple[IntArray, ...]) -> CarrierModel:
    """Return the filter's model with patterns counted from the group's mean; rain does not reach the members."""
    if not groups:
        return model
    gradient, hessian, share = model.gradient_db_deg.copy(), model.hessian_db_deg2.copy(), model.rain_share.copy()
    for members in groups:
        gradient[members] -= gradient[members].mean(axis=0)
        hessian[members] -= hessian[members].mean(axis=0)
        share[members] = 0.0
    return model._replace(gradient_db_deg=gradient, hessian_db_deg2=hessian, rain_share=share)


def without_group_gain(deviation_db: FloatArray, explained_db: FloatArray, groups: tuple[IntArray, ...]) -> FloatArray:
    """Return deviations (..., N) without what the members of each group do together.

    Parameters
    ----------
    deviation_db : ndarray, shape (..., N), dB
        Measured minus expected; NaN = absent.
    explained_db : ndarray, shape (..., N), dB
        What the members should do by themselves, as far as it is known.
    groups : tuple of ndarray
        Members of each group.
    """
    if not groups:
        return deviation_db
    out = deviation_db.copy()
    for members in groups:
        beyond = np.sort(deviation_db[..., members] - explained_db[..., members], axis=-1)
        count = np.isfinite(beyond).sum(axis=-1, keepdims=True)
        last = beyond.shape[-1] - 1
        lower = np.take_along_axis(beyond, np.clip((count - 1) // 2, 0, last), axis=-1)
        upper = np.take_along_axis(beyond, np.clip(count // 2, 0, last), axis=-1)
        out[..., members] -= np.where(count >= MIN_GROUP, 0.5 * (lower + upper), np.nan)
    return out
