"""The paper's three requirements on a carrier, as figures and verdicts.

* *Stable*: what the daily harmonic leaves is small, ``rms <= max_residual_rms_db``.
* *Linear*: within +-R (``linear_range_deg``) the answer to a turn keeps to its straight line of that side. The answer
  is described by ``a x + q x^2`` on each side of the dominant axis; its departure from the best line through zero is
  ``q (x^2 - 3 R x / 4)``, largest at the end: ``|q| R^2 / 4`` dB. Divided by the carrier's slope it is an angle,
  at most ``max_nonlinearity_deg``.
* *Dominant*: the sensitivity to one axis, yaw scaled up, is ``dominance_ratio`` times that to both others.

The law of this file: noise alone does not fail a carrier as not linear. Rows are first reduced to one median per turn
level, whose scatter about the model contains the slow noise that makes rows alike; a carrier fails only if its
departure exceeds the limit by more than three standard errors of q from that scatter. What the turns do not determine
(fewer than two well separated levels on a side) is NaN and does not count as linear.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.paper.selection import axis_dominance
from service.core.estimation.paper.sensitivity import symmetric_sensitivity
from service.core.estimation.paper.turn_levels import TurnLevels, one_sided_curvature, reduce_to_levels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

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
