"""The paper's requirements on a carrier, and its choice of carriers for each axis."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.observability import condition_number
from service.core.estimation.paper.sensitivity import (
    TurnLevels,
    one_sided_curvature,
    reduce_to_levels,
    symmetric_sensitivity,
)

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


#: Standard errors by which a departure must exceed the limit.
DOUBT_SIGMA = 3.0


class CarrierVerdicts(NamedTuple):
    """Verdicts on N carriers.

    Parameters
    ----------
    stable, linear, dominant : ndarray of bool, shape (N,)
        The three requirements; False where a figure is NaN.
    axis : ndarray of int, shape (N,)
        0 yaw, 1 roll, 2 pitch, -1 when no axis dominates.
    axis_ratio : ndarray, shape (N,)
        Largest scaled sensitivity over the second largest.
    residual_rms_db : ndarray, shape (N,), dB
        As given.
    deviation_at_0p5_deg_db : ndarray, shape (N,), dB
        Departure from the straight line at 0.5 deg, signed, of the side where it is larger.
    nonlinearity_deg : ndarray, shape (N,), deg
        Size of the departure at the end of the linear range over the slope, larger side.
    nonlinearity_sigma_deg : ndarray, shape (N,), deg
        Its standard error.
    range_deg : ndarray, shape (N,), deg
        Largest range for which the carrier still counts as linear, at most the excursion made on both sides.
    """

    stable: BoolArray
    linear: BoolArray
    dominant: BoolArray
    axis: IntArray
    axis_ratio: FloatArray
    residual_rms_db: FloatArray
    deviation_at_0p5_deg_db: FloatArray
    nonlinearity_deg: FloatArray
    nonlinearity_sigma_deg: FloatArray
    range_deg: FloatArray


def judge_carriers(
    residual_rms_db: FloatArray,
    angle_deg: FloatArray,
    deviation_db: FloatArray,
    plus: FloatArray,
    minus: FloatArray,
    *,
    max_residual_rms_db: float = 0.25,
    max_nonlinearity_deg: float = 0.1,
    linear_range_deg: float = 0.5,
    dominance_ratio: float = 2.0,
    yaw_scale: float = 8.0,
) -> CarrierVerdicts:
    """Return which carriers meet the paper's requirements.

    Parameters
    ----------
    residual_rms_db : ndarray, shape (N,), dB
        Root mean square of the quiet window's residuals after the harmonic.
    angle_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch of the rows of the turns, in order of time.
    deviation_db : ndarray, shape (K, N), dB
        Powers of the turns with harmonic and level removed. NaN marks an absent sample.
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities of both signs (``sensitivity.fit_turn_sensitivity``), NaN = not measured.
    max_residual_rms_db : float, dB
        Limit of stability.
    max_nonlinearity_deg, linear_range_deg : float, deg
        Limit of the departure from a straight line, and the range on which it is judged.
    dominance_ratio : float
        Limit of dominance.
    yaw_scale : float
        How much less carriers answer to yaw.

    Returns
    -------
    CarrierVerdicts
        Figures and verdicts.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, the three requirements on the signals.
    """
    symmetric = symmetric_sensitivity(plus, minus)
    dominance = axis_dominance(symmetric, yaw_scale=yaw_scale)
    is_measured: BoolArray = np.asarray(np.isfinite(dominance).any(axis=1))
    ratio = np.where(is_measured, np.where(np.isnan(dominance), -1.0, dominance).max(axis=1), math.nan)
    main = np.where(is_measured, np.where(np.isnan(dominance), -1.0, dominance).argmax(axis=1), -1)
    levels = reduce_to_levels(angle_deg, deviation_db)
    q, q_sigma, excursion_deg = _curvatures(levels, main, linear_range_deg)
    slope = np.abs(symmetric[np.arange(len(main)), main])
    departure = linear_range_deg**2 / 4.0 / np.where(slope > 0.0, slope, math.nan)
    sure_q = np.maximum(np.abs(q) - DOUBT_SIGMA * q_sigma, 0.0).max(axis=1)
    rows = np.arange(len(main))
    side = np.abs(q).argmax(axis=1)
    q_worst = q[rows, side]
    unlimited_deg = np.sqrt(4.0 * max_nonlinearity_deg * slope / np.where(sure_q > 0.0, sure_q, math.nan))
    return CarrierVerdicts(
        stable=residual_rms_db <= max_residual_rms_db,
        linear=sure_q * departure <= max_nonlinearity_deg,
        dominant=ratio >= dominance_ratio,
        axis=np.where(ratio >= dominance_ratio, main, -1).astype(np.int64),
        axis_ratio=ratio,
        residual_rms_db=residual_rms_db,
        deviation_at_0p5_deg_db=q_worst * 0.5**2 / 4.0,
        nonlinearity_deg=np.abs(q_worst) * departure,
        nonlinearity_sigma_deg=q_sigma[rows, side] * departure,
        range_deg=np.where(np.isnan(sure_q), math.nan, np.fmin(unlimited_deg, excursion_deg)),
    )


def _curvatures(levels: TurnLevels, axis: IntArray, range_deg: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return q and its standard error, (N, 2) for both sides, and the excursion (N,) of each carrier's main axis."""
    fits = [one_sided_curvature(levels, carrier, int(axis[carrier]), range_deg) for carrier in range(len(axis))]
    q = np.array([fit.q_db_per_deg2 for fit in fits]).reshape(-1, 2)
    q_sigma = np.array([fit.sigma_db_per_deg2 for fit in fits]).reshape(-1, 2)
    return q, q_sigma, np.array([fit.excursion_deg for fit in fits])
