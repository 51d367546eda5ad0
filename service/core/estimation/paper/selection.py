"""The paper's choice of carriers: for each axis those that answer mostly to it.

``s_ij = |a_ij| u_j``: a the symmetric sensitivity in dB/deg, u = (yaw_scale, 1, 1), because every carrier answers to
yaw about eight times less than to roll. The margin of carrier i for axis j, in dB/deg, is ``s_ij - max over the
others``: by how much it answers more to this axis than to any other. The axes take turns (roll, pitch, yaw, in the
order in which the paper names them), each taking the carrier of largest margin that is still free. A ranking by the
ratio instead of the margin also likes carriers that answer to nothing: of 40 stations it costs 69 per cent in the bound
of yaw at 8 carriers, 22 per cent at 16. The law of this file: the choice depends on the carriers, not on their order;
of equal margins the first carrier wins.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.observability import condition_number

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Columns of the sensitivity in the order in which the axes choose.
TURN_ORDER = (1, 2, 0)


class SelectionReason(IntEnum):
    """Reason for which a carrier was chosen or not."""

    CHOSEN = 0
    NOT_ELIGIBLE = 1
    NOT_MEASURED = 2
    NOT_NEEDED = 3


class AxisSelection(NamedTuple):
    """Choice among N carriers.

    Parameters
    ----------
    chosen : ndarray of int, shape (C,)
        Carriers in the order of choice; fewer than asked for when there are not enough.
    axis : ndarray of int, shape (N,)
        Axis for which the carrier was chosen, else the one it answers to most (0 yaw, 1 roll, 2 pitch); -1 when not
        measured.
    rank : ndarray of int, shape (N,)
        Position in ``chosen``; -1 when not chosen.
    dominance : ndarray, shape (N,)
        Dominance of the carrier for that axis.
    reason : ndarray of int, shape (N,)
        :class:`SelectionReason`.
    condition : float
        Condition number of the chosen carriers' sensitivities.
    """

    chosen: IntArray
    axis: IntArray
    rank: IntArray
    dominance: FloatArray
    reason: IntArray
    condition: float


def axis_margin(symmetric: FloatArray, *, yaw_scale: float = 8.0) -> FloatArray:
    """Return for each carrier and axis the scaled sensitivity minus the largest of the other two, shape (N, 3), dB/deg.

    Examples
    --------
    >>> axis_margin(np.array([[0.1, 2.0, -0.5]]))
    array([[-1.2,  1.2, -1.5]])
    """
    scaled, others = _scaled_and_others(symmetric, yaw_scale)
    return np.where(np.isnan(scaled).any(axis=1, keepdims=True), math.nan, scaled - others)


def axis_dominance(symmetric: FloatArray, *, yaw_scale: float = 8.0) -> FloatArray:
    """Return for each carrier and axis the scaled sensitivity over the largest of the other two, shape (N, 3).

    Examples
    --------
    >>> axis_dominance(np.array([[0.1, 2.0, -0.5]]))
    array([[0.4 , 2.5 , 0.25]])
    """
    scaled, others = _scaled_and_others(symmetric, yaw_scale)
    alone = np.where(scaled > 0.0, math.inf, 0.0)
    dominance = np.where(others > 0.0, scaled / np.where(others > 0.0, others, 1.0), alone)
    return np.where(np.isnan(scaled).any(axis=1, keepdims=True), math.nan, dominance)


def _scaled_and_others(symmetric: FloatArray, yaw_scale: float) -> tuple[FloatArray, FloatArray]:
    """Return sizes of the sensitivities, yaw scaled up, and for each axis the larger of the other two."""
    scaled = np.abs(symmetric) * np.array([yaw_scale, 1.0, 1.0])
    return scaled, np.stack([np.maximum(scaled[:, j - 2], scaled[:, j - 1]) for j in range(3)], axis=1)


def select_by_axis(symmetric: FloatArray, eligible: BoolArray, count: int, *, yaw_scale: float = 8.0) -> AxisSelection:
    """Return the carriers that the paper's rule recommends.

    Parameters
    ----------
    symmetric : ndarray, shape (N, 3), dB/deg
        Symmetric sensitivity. NaN marks a carrier that was not measured.
    eligible : ndarray of bool, shape (N,)
        Carriers that may be chosen (``criteria``).
    count : int
        How many are wanted.
    yaw_scale : float
        How much less carriers answer to yaw.

    Returns
    -------
    AxisSelection
        Choice with a reason for every carrier.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, third requirement on carriers.

    Examples
    --------
    >>> symmetric = np.array([[0.0, 1.0, 0.1], [0.0, 0.1, 1.0], [0.2, 0.1, 0.1], [0.0, 1.0, 0.9]])
    >>> select_by_axis(symmetric, np.ones(4, dtype=bool), 3).chosen
    array([0, 1, 2])
    """
    dominance = axis_dominance(symmetric, yaw_scale=yaw_scale)
    margin = axis_margin(symmetric, yaw_scale=yaw_scale)
    is_measured: BoolArray = np.asarray(np.isfinite(symmetric).all(axis=1))
    is_free = eligible & is_measured
    axis = np.where(is_measured, np.argmax(np.where(np.isnan(margin), 0.0, margin), axis=1), -1)
    reason = np.where(
        is_measured,
        np.where(eligible, SelectionReason.NOT_NEEDED, SelectionReason.NOT_ELIGIBLE),
        SelectionReason.NOT_MEASURED,
    )
    chosen: list[int] = []
    for turn in range(min(count, int(is_free.sum()))):
        taking = TURN_ORDER[turn % 3]
        best = int(np.argmax(np.where(is_free, margin[:, taking], -math.inf)))
        axis[best], reason[best], is_free[best] = taking, SelectionReason.CHOSEN, False
        chosen.append(best)
    rank = np.full(len(symmetric), -1, dtype=np.int64)
    rank[chosen] = np.arange(len(chosen))
    return AxisSelection(
        chosen=np.array(chosen, dtype=np.int64),
        axis=axis.astype(np.int64),
        rank=rank,
        dominance=dominance[np.arange(len(axis)), axis],
        reason=reason.astype(np.int64),
        condition=condition_number(symmetric[chosen]),
    )
