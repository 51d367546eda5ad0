"""Observability of the attitude by a set of carriers.

``dP = A l + c + e``: A in dB/deg with columns yaw, roll, pitch, l in deg, c one level common to all carriers in dB
(only where asked for), e noise of sigma_i. Bound of Cramer and Rao: ``sqrt diag (B' W B)^-1`` with ``B = A`` or
``[A 1]`` and ``W = diag 1 / sigma^2``. Dilution of precision is the same with sigma = 1 dB. The law of this file: a
carrier with NaN anywhere is absent, and what cannot be observed is NaN (condition number: infinite), never a large
number. All inverses go through the QR decomposition.

Observability of the attitude by a set of carriers: geometry, bounds, undetected effect of a fault of each carrier.

Everything is taken at zero attitude with the noise of one row, level common to all carriers free unless a name says
otherwise. Averages follow from the learned noise: white parts shrink with the number of rows, correlated parts only
with the span over their correlation time, and links that flicker stop gaining after minutes. The law of this file: a
quantity that a set does not determine is NaN wherever it is needed, and the condition number is then infinite.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.calibration.whitened_fit import ColouredNoise, stretch_variance_db2

#: Sigmas beyond which a carrier has less than five per cent of Tukey's weight.
GATE_SIGMAS = 4.685 * math.sqrt(1.0 - math.sqrt(0.05))
#: Quantile of the normal distribution for nine in ten.
_NINE_IN_TEN = 1.2815515655446004
#: Share of its own error that the others must see of a carrier for any fault to show.
_MIN_REDUNDANCY = 1e-6
#: Smallest ratio of the diagonal of R (columns scaled to unit length) that still counts as full rank.
MIN_RANK_RATIO = 1e-10


def crlb_deg(
    sensitivity: FloatArray,
    sigma_db: FloatArray,
    with_common: bool,  # noqa: FBT001 - the one question asked of every set
    *,
    level: IntArray | None = None,
) -> FloatArray:
    """Return the smallest standard deviations that an unbiased fix can have.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch.
    sigma_db : ndarray, shape (N,), dB
        Noise of each carrier; NaN or not positive makes it absent.
    with_common : bool
        A level common to all carriers is estimated as well.
    level : ndarray of int, shape (N,), optional
        Number of the level that each carrier shares, where they share several: only read with ``with_common``.

    Returns
    -------
    ndarray, shape (3,), deg
        Yaw, roll, pitch; NaN when the carriers do not determine them.

    Examples
    --------
    >>> crlb_deg(np.vstack([np.eye(3), -np.eye(3)]), np.full(6, 0.1), with_common=True).round(6)
    array([0.070711, 0.070711, 0.070711])
    """
    is_present = np.isfinite(sensitivity).all(axis=1) & np.isfinite(sigma_db) & (sigma_db > 0.0)
    design = sensitivity[is_present]
    if with_common:
        design = np.column_stack([design, level_columns(len(design), None if level is None else level[is_present])])
    covariance = normal_inverse(design / sigma_db[is_present, np.newaxis])
    return np.sqrt(np.diagonal(covariance)[:3])


def level_columns(carriers: int, level: IntArray | None = None) -> FloatArray:
    """Return the columns (N, L) of the levels that carriers share: one of ones, or one for each number.

    Carriers of a transponder under automatic level control share a level of their own, because its control holds their
    sum whatever happens to all of them.

    Examples
    --------
    >>> level_columns(3, np.array([-1, 2, 2]))
    array([[1., 0.],
           [0., 1.],
           [0., 1.]])
    """
    if level is None:
        return np.ones((carriers, 1))
    return np.where(level[:, np.newaxis] == np.unique(level), 1.0, 0.0)


def angle_dilution_deg_per_db(sensitivity: FloatArray) -> float:
    """Return the angle DOP ``det((A' A)^-1)^(1/6)``: the dilution of the three angles together.

    Examples
    --------
    >>> round(angle_dilution_deg_per_db(np.diag([0.25, 1.0, 4.0])), 12)
    1.0
    """
    inverse = normal_inverse(_present(sensitivity))
    if np.isnan(inverse).any():
        return math.nan
    return math.pow(float(np.linalg.det(inverse)), 1.0 / 6.0)


def condition_number(sensitivity: FloatArray) -> float:
    """Return the ratio of the largest to the smallest singular value; infinite with fewer than three carriers.

    Examples
    --------
    >>> condition_number(np.diag([0.25, 1.0, 2.0]))
    8.0
    """
    design = _present(sensitivity)
    if len(design) < design.shape[1]:
        return math.inf
    singular = np.linalg.svd(design, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0.0 else math.inf


def common_share(sensitivity: FloatArray) -> float:
    """Return the share, 0 to 1, of a change common to all carriers that some attitude explains.

    It is the squared length of the ones-vector's projection on the columns: near 1 rain cannot be told from a turn.

    Examples
    --------
    >>> round(common_share(np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])), 9)
    1.0
    """
    design = _present(sensitivity)
    if np.isnan(normal_inverse(design)).any():
        return math.nan
    ones = np.ones(len(design))
    projection = np.linalg.qr(design)[0].T @ ones
    return float(projection @ projection) / len(design)


def _present(design: FloatArray) -> FloatArray:
    """Return the rows without NaN."""
    return design[np.isfinite(design).all(axis=1)]


def normal_inverse(design: FloatArray) -> FloatArray:
    """Return (B' B)^-1 of a design (N, K) by QR of its scaled columns; all NaN without full column rank.

    Examples
    --------
    >>> normal_inverse(np.array([[1.0, 0.0], [0.0, 2.0]]))
    array([[1.  , 0.  ],
           [0.  , 0.25]])
    """
    size = design.shape[1]
    length = np.linalg.norm(design, axis=0)
    if len(design) < size or not (length > 0.0).all():
        return np.full((size, size), math.nan)
    triangle = np.linalg.qr(design / length, mode="r")
    diagonal = np.abs(np.diagonal(triangle))
    if diagonal.min() < MIN_RANK_RATIO * diagonal.max():
        return np.full((size, size), math.nan)
    root = np.linalg.inv(triangle) / length[:, np.newaxis]
    return np.asarray(root @ root.T)


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
    one_db = np.ones(len(sensitivity))
    checks = np.full((len(sensitivity), 5), math.nan)
    checks[is_present] = _mutual_checks(sensitivity[is_present], sigma_db[is_present], shared[is_present])
    return SetStatistics(
        condition=condition_number(present),
        dop_deg_per_db=crlb_deg(present, one_db, with_common=False),
        dop_with_common_deg_per_db=crlb_deg(present, one_db, with_common=True, level=shared),
        angle_dop_deg_per_db=angle_dilution_deg_per_db(present),
        crlb_deg=crlb_deg(present, sigma_db, with_common=True, level=shared),
        crlb_without_common_deg=crlb_deg(present, sigma_db, with_common=False),
        common_share=common_share(present),
        leverage=checks[:, 0],
        undetectable_fault_db=checks[:, 1],
        fault_shift_deg=checks[:, 2:],
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


def _mutual_checks(sensitivity: FloatArray, sigma_db: FloatArray, level: IntArray) -> FloatArray:
    """Return leverage, undetectable fault and its shift in each angle (N, 5) of carriers that are all present.

    ``h_i = b_i' (B' W B)^-1 b_i / sigma_i^2``: a carrier of leverage 1 is checked by no other, and a fault of it is
    infinite in the angles that it moves. All NaN where the carriers determine nothing.
    """
    design = np.column_stack([sensitivity, level_columns(len(sensitivity), level)]) / sigma_db[:, np.newaxis]
    inverse = normal_inverse(design)
    leverage = np.einsum("ni,ij,nj->n", design, inverse, design)
    redundancy = np.where(np.isnan(leverage) | (leverage < 1.0 - _MIN_REDUNDANCY), 1.0 - leverage, 0.0)
    with np.errstate(divide="ignore"):
        fault_db = sigma_db * (GATE_SIGMAS + _NINE_IN_TEN * np.sqrt(np.minimum(redundancy, 1.0))) / redundancy
    moves = (design / sigma_db[:, np.newaxis] @ inverse)[:, :3]
    return np.column_stack([leverage, fault_db, np.where(moves == 0.0, 0.0, fault_db[:, np.newaxis]) * moves])
