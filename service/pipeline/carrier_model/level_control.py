"""Carriers of transponders with automatic level control: what their group does together is taken away row by row.

The control moves all carriers of a transponder by one and the same amount, which nobody knows; only their differences
tell the attitude. The amount of a row is the median of what the present members do beyond what is explained, so that
rain on one of them does not move the others. Patterns are counted from the mean of the members. The law of this file:
a row with fewer than three members tells nothing of the group.
"""

import numpy as np

from service.core.estimation.calibration.quadratic_response import QuadraticResponse
from service.core.estimation.filtering.model.filter_model import CarrierModel
from service.pipeline.group_deviations import MIN_GROUP
from service.records.levels.attitude import BoolArray, FloatArray, IntArray


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
