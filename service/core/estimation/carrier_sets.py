"""Observability of the attitude by a set of carriers: geometry, bounds, undetected effect of a fault of each carrier.

Everything is taken at zero attitude with the noise of one row, level common to all carriers free unless a name says
otherwise. Averages follow from the learned noise: white parts shrink with the number of rows, correlated parts only
with the span over their correlation time, and links that flicker stop gaining after minutes. The law of this file: a
quantity that a set does not determine is NaN wherever it is needed, and the condition number is then infinite.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.whitened_fit import ColouredNoise, stretch_variance_db2
from service.core.estimation.observability import (
    angle_dilution_deg_per_db,
    common_share,
    condition_number,
    crlb_deg,
    dilution_of_precision_deg_per_db,
    level_columns,
    leverages,
    normal_inverse,
)
from service.core.estimation.snapshot.snapshot import FaultBounds, fault_bounds

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Attitude, and the level of one moved transponder; each level that carriers share comes on top.
_UNKNOWNS = 4


class SetStatistics(NamedTuple):
    """Figures of a set of N carriers.

    Parameters
    ----------
    condition : float
        Largest over smallest singular value of the sensitivities.
    dop_deg_per_db, dop_with_common_deg_per_db : ndarray, shape (3,), deg/dB
        Dilution of precision of yaw, roll, pitch, without and with a free common level.
    angle_dop_deg_per_db : float, deg/dB
        Dilution of the three angles together.
    crlb_deg, crlb_without_common_deg : ndarray, shape (3,), deg
        Bound of Cramer and Rao for one row.
    common_share : float
        Share, 0 to 1, of a change common to all carriers that some attitude explains.
    leverage : ndarray, shape (N,)
        Weighted by the noise; sums to the unknowns, four with one common level.
    undetectable_fault_db : ndarray, shape (N,), dB
        Largest fault of the carrier that one row leaves undetected in one case of ten.
    fault_shift_deg : ndarray, shape (N, 3), deg
        What that fault moves in yaw, roll, pitch.
    redundancy : int
        Carriers beyond three angles, their common levels and the level of one moved transponder.
    """

    condition: float
    dop_deg_per_db: FloatArray
    dop_with_common_deg_per_db: FloatArray
    angle_dop_deg_per_db: float
    crlb_deg: FloatArray
    crlb_without_common_deg: FloatArray
    common_share: float
    leverage: FloatArray
    undetectable_fault_db: FloatArray
    fault_shift_deg: FloatArray
    redundancy: int


def judge_set(sensitivity: FloatArray, sigma_db: FloatArray, level: IntArray | None = None) -> SetStatistics:
    """Return the figures of a set.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch; NaN makes a carrier absent.
    sigma_db : ndarray, shape (N,), dB
        Noise of one row; NaN or not positive makes a carrier absent.
    level : ndarray of int, shape (N,), optional
        Number of the level that each carrier shares: carriers under the level control of a transponder have their own.

    Returns
    -------
    SetStatistics

    Examples
    --------
    >>> figures = judge_set(np.vstack([np.eye(3), -np.eye(3)]), np.full(6, 0.1))
    >>> figures.redundancy, round(figures.condition, 6), figures.crlb_deg.round(4), figures.leverage.round(4)
    (1, 1.0, array([0.0707, 0.0707, 0.0707]), array([0.6667, 0.6667, 0.6667, 0.6667, 0.6667, 0.6667]))
    """
    is_present = np.isfinite(sensitivity).all(axis=1) & np.isfinite(sigma_db) & (sigma_db > 0.0)
    present = np.where(is_present[:, np.newaxis], sensitivity, math.nan)
    shared = np.zeros(len(sensitivity), dtype=np.int64) if level is None else level
    faults = _fault_bounds(present, np.where(is_present, sigma_db, math.nan), shared)
    return SetStatistics(
        condition=condition_number(present),
        dop_deg_per_db=dilution_of_precision_deg_per_db(present),
        dop_with_common_deg_per_db=dilution_of_precision_deg_per_db(present, with_common=True, level=shared),
        angle_dop_deg_per_db=angle_dilution_deg_per_db(present),
        crlb_deg=crlb_deg(present, sigma_db, with_common=True, level=shared),
        crlb_without_common_deg=crlb_deg(present, sigma_db, with_common=False),
        common_share=common_share(present),
        leverage=leverages(present, sigma_db, level=shared),
        undetectable_fault_db=faults.detectable_db[0],
        fault_shift_deg=faults.shift_deg[0],
        redundancy=int(np.count_nonzero(is_present)) - _UNKNOWNS - max(1, len(np.unique(shared[is_present]))),
    )


def averaged_crlb_deg(
    sensitivity: FloatArray,
    noise: ColouredNoise,
    span_s: FloatArray,
    row_period_s: float,
    level: IntArray | None = None,
) -> FloatArray:
    """Return the bounds of means over some spans, level common to all carriers free.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch.
    noise : ColouredNoise
        Learned noise of the N carriers.
    span_s : ndarray, shape (S,), s
        Times over which deviations are averaged while the attitude stands still.
    row_period_s : float, s
        Time between rows.
    level : ndarray of int, shape (N,), optional
        Number of the level that each carrier shares.

    Returns
    -------
    ndarray, shape (S, 3), deg
        Yaw, roll, pitch; NaN when the carriers do not determine them.

    Examples
    --------
    >>> white = ColouredNoise(np.full(6, 0.1), np.zeros((6, 1)), np.ones((6, 1)))
    >>> averaged_crlb_deg(np.vstack([np.eye(3), -np.eye(3)]), white, np.array([60.0, 6000.0]), 60.0).round(5)
    array([[0.07071, 0.07071, 0.07071],
           [0.00707, 0.00707, 0.00707]])
    """
    rows = np.maximum(span_s / row_period_s, 1.0)
    sigma_db = np.sqrt(stretch_variance_db2(noise, np.tile(rows, (len(sensitivity), 1)), span_s))
    return np.array([crlb_deg(sensitivity, one, with_common=True, level=level) for one in sigma_db.T]).reshape(-1, 3)


def _fault_bounds(sensitivity: FloatArray, sigma_db: FloatArray, level: IntArray) -> FaultBounds:
    """Return the bounds of one row solved by weighted least squares; NaN where nothing is determined."""
    is_present = np.isfinite(sigma_db)
    columns = level_columns(len(sensitivity), level)[:, np.isin(np.unique(level), level[is_present])]
    design = np.column_stack([sensitivity, columns])
    weighted = np.where(is_present[:, np.newaxis], design, 0.0) / np.where(is_present, sigma_db, 1.0)[:, np.newaxis]
    inverse = normal_inverse(weighted[is_present])
    gain = inverse @ (weighted / np.where(is_present, sigma_db, 1.0)[:, np.newaxis]).T
    gain = np.where(is_present, gain, math.nan)
    bounds = fault_bounds(design[np.newaxis], gain[np.newaxis], sigma_db[np.newaxis])
    if columns.shape[1] and np.isfinite(inverse).all():
        return bounds
    nothing = np.full((1, *sensitivity.shape), math.nan)
    return FaultBounds(nothing[..., 0], nothing)
