"""Observability of the attitude by a set of carriers.

``dP = A l + c + e``: A in dB/deg with columns yaw, roll, pitch, l in deg, c one level common to all carriers in dB
(only where asked for), e noise of sigma_i. Bound of Cramer and Rao: ``sqrt diag (B' W B)^-1`` with ``B = A`` or
``[A 1]`` and ``W = diag 1 / sigma^2``. Dilution of precision is the same with sigma = 1 dB. The law of this file: a
carrier with NaN anywhere is absent, and what cannot be observed is NaN (condition number: infinite), never a large
number. All inverses go through the QR decomposition.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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


def dilution_of_precision_deg_per_db(
    sensitivity: FloatArray, *, with_common: bool = False, level: IntArray | None = None
) -> FloatArray:
    """Return deg of yaw, roll, pitch error for 1 dB of independent error on every carrier, shape (3,).

    Examples
    --------
    >>> dilution_of_precision_deg_per_db(np.diag([0.25, 1.0, 2.0]))
    array([4. , 1. , 0.5])
    """
    return crlb_deg(sensitivity, np.ones(len(sensitivity)), with_common, level=level)


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


def leverages(
    sensitivity: FloatArray,
    sigma_db: FloatArray | None = None,
    *,
    with_common: bool = True,
    level: IntArray | None = None,
) -> FloatArray:
    """Return how much of each carrier's own error its model follows, shape (N,), 0 to 1; NaN = absent.

    ``h_i = b_i' (B' W B)^-1 b_i / sigma_i^2``; they add up to the number of unknowns. A carrier of leverage 1 is
    checked by no other: a fault of it is invisible in the residuals.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch.
    sigma_db : ndarray, shape (N,), dB, optional
        Noise of each carrier; without it all weigh alike.
    with_common : bool
        A level common to all carriers is estimated as well.
    level : ndarray of int, shape (N,), optional
        Number of the level that each carrier shares, where they share several.

    Examples
    --------
    >>> leverages(np.vstack([np.eye(3), np.eye(3)]), with_common=False).round(12)
    array([0.5, 0.5, 0.5, 0.5, 0.5, 0.5])
    >>> leverages(np.vstack([np.eye(3), np.eye(3)]), np.array([1, 1, 1, 2, 2, 2.0]), with_common=False).round(12)
    array([0.8, 0.8, 0.8, 0.2, 0.2, 0.2])
    """
    sigma = np.ones(len(sensitivity)) if sigma_db is None else sigma_db
    is_present = np.isfinite(sensitivity).all(axis=1) & np.isfinite(sigma) & (sigma > 0.0)
    design = sensitivity[is_present]
    if with_common:
        design = np.column_stack([design, level_columns(len(design), None if level is None else level[is_present])])
    design = design / sigma[is_present, np.newaxis]
    leverage = np.full(len(sensitivity), math.nan)
    leverage[is_present] = np.einsum("ni,ij,nj->n", design, normal_inverse(design), design)
    return leverage


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
