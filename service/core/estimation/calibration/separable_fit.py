"""Least squares of many carriers with coefficients of their own and a few that all share.

``y_i = A_i c_i + S_i t + e_i``, e_i white of unit variance (rows are scaled or whitened before). QR of
``[A_i S_i y_i]`` for each carrier leaves below its first K rows an equation in t alone; these are stacked and solved
together, then each c_i follows by back substitution: block elimination without normal equations. The law of this file:
coefficients carry a weak prior (row ``c_k / prior_k = 0``), so that what the data do not determine comes out as zero
with an honest, large variance, never as a large number.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class SeparableFit(NamedTuple):
    """Fit of N carriers with K own and R shared coefficients.

    Parameters
    ----------
    own : ndarray, shape (N, K)
        c.
    shared : ndarray, shape (R,)
        t.
    own_covariance : ndarray, shape (N, K, K)
        Of c_i, the errors of t included.
    shared_covariance : ndarray, shape (R, R)
        Of t.
    gain : ndarray, shape (N, K, R)
        ``d c_i / d t``: the errors of c_i and c_j correlate by ``gain_i shared_covariance gain_j'``.
    """

    own: FloatArray
    shared: FloatArray
    own_covariance: FloatArray
    shared_covariance: FloatArray
    gain: FloatArray


def fit_separable(
    own_columns: FloatArray, shared_columns: FloatArray, values: FloatArray, own_prior: FloatArray, shared_prior: float
) -> SeparableFit:
    """Return the joint fit.

    Parameters
    ----------
    own_columns : ndarray, shape (N, B, K)
        A, rows whitened; rows of absent samples are zero.
    shared_columns : ndarray, shape (N, B, R)
        S, whitened alike.
    values : ndarray, shape (N, B)
        y, whitened alike.
    own_prior : ndarray, shape (N, K)
        One sigma of each own coefficient before the data; 0 holds it at zero.
    shared_prior : float
        The same for the shared ones, > 0.

    Returns
    -------
    SeparableFit

    Examples
    --------
    >>> own, shared = np.ones((2, 3, 1)), np.array([[[0.0], [1.0], [2.0]], [[0.0], [1.0], [3.0]]])
    >>> fit = fit_separable(own, shared, own[..., 0] * 5.0 + shared[..., 0] * 2.0, np.full((2, 1), 1e6), 1e6)
    >>> fit.own.round(6), fit.shared.round(6)
    (array([[5.],
           [5.]]), array([2.]))
    """
    carriers, _, own_size = own_columns.shape
    shared_size = shared_columns.shape[2]
    is_free = own_prior > 0.0
    prior_row = np.eye(own_size) / np.where(is_free, own_prior, 1.0)[:, np.newaxis]
    own = np.concatenate([own_columns * is_free[:, np.newaxis], prior_row], axis=1)
    pad = np.zeros((carriers, own_size, shared_size + 1))
    rest = np.concatenate([shared_columns, values[..., np.newaxis]], axis=2)
    triangle = _triangle(np.concatenate([own, np.concatenate([rest, pad], axis=1)], axis=2))
    upper = triangle[:, :own_size, :own_size]
    coupling = triangle[:, :own_size, own_size:-1]
    below = triangle[:, own_size:, own_size:].reshape(-1, shared_size + 1)
    stacked = np.concatenate([below, np.eye(shared_size, shared_size + 1) / shared_prior])
    shared_triangle = _triangle(stacked)
    shared_root = np.linalg.inv(shared_triangle[:shared_size, :shared_size])
    shared = shared_root @ shared_triangle[:shared_size, shared_size]
    inverse = np.linalg.inv(upper)
    gain = -inverse @ coupling
    right = triangle[:, :own_size, -1]
    own_fit = np.einsum("nij,nj->ni", inverse, right) + gain @ shared
    shared_covariance = shared_root @ shared_root.T
    held = np.where(is_free, 1.0, 0.0)
    own_covariance = inverse @ np.swapaxes(inverse, 1, 2) + gain @ shared_covariance @ np.swapaxes(gain, 1, 2)
    return SeparableFit(
        own=own_fit * held,
        shared=shared,
        own_covariance=own_covariance * held[:, :, np.newaxis] * held[:, np.newaxis],
        shared_covariance=shared_covariance,
        gain=gain * held[:, :, np.newaxis],
    )


def _triangle(equations: FloatArray) -> FloatArray:
    """Return R of the QR decomposition of equations (..., rows, unknowns + 1)."""
    return np.asarray(np.linalg.qr(equations, mode="r"))
