"""Least squares of many carriers on one basis with the rejection rule of the paper.

``S_i = sum_k B_ik c_k + e_i`` (S in dB or dBm), solved for each carrier by the normal equations over its samples that
pass ``|B_i c - S_i| < gate_sigma sigma`` with ``sigma^2 = sum (B_i c - S_i)^2 / N`` over the samples used. The law of
this file: every pass re-tests *all* samples, so a rejected one may come back; passes end at a fixed point; a cycle is
recognised by a set seen before and ends at the smallest set of the cycle (of equals, the one seen first). The answer
does therefore not depend on a limit of passes unless the flag says so. A residual below ``ROUNDING_DB`` is never an
outlier: in noise-free data sigma is rounding, and three roundings are nobody's fault.

By the rule itself no sample of a set of ten or fewer can be rejected on its own account (max |r| / sigma is
sqrt(N - 1) for a fitted constant): that is a property of the paper's sigma and is kept.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: dB, residuals below this are rounding of the arithmetic and pass every gate.
ROUNDING_DB = 1e-9
#: Smallest ratio of eigenvalues of the normal matrix (columns scaled to unit length) that still counts as full rank.
MIN_EIGENVALUE_RATIO = 1e-10


class ClippedFit(NamedTuple):
    """Fit of N carriers on K basis functions over T samples; NaN where a carrier cannot be fitted.

    Parameters
    ----------
    coefficients : ndarray, shape (N, K)
        In the unit of the samples over the unit of the basis.
    normal_inverse : ndarray, shape (N, K, K)
        Inverse of the normal matrix over the samples used.
    rms_db : ndarray, shape (N,), dB
        The paper's sigma over the samples used.
    is_used : ndarray of bool, shape (T, N)
        Samples in the final fit.
    is_converged : ndarray of bool, shape (N,)
        True at a fixed point; False after a cycle, at the limit of passes, and where nothing could be fitted.
    """

    coefficients: FloatArray
    normal_inverse: FloatArray
    rms_db: FloatArray
    is_used: BoolArray
    is_converged: BoolArray


def fit_clipped(
    basis: FloatArray,
    samples: FloatArray,
    *,
    gate_sigma: float = 3.0,
    max_iterations: int = 50,
    min_samples: int = 8,
) -> ClippedFit:
    """Fit every carrier on one basis, rejecting samples beyond the gate until a fixed point.

    Parameters
    ----------
    basis : ndarray, shape (T, K)
        Basis functions at the samples. A row that is not finite makes its samples absent.
    samples : ndarray, shape (T, N), dB or dBm
        NaN marks an absent sample.
    gate_sigma : float
        Half width of the gate in sigmas, > 0.
    max_iterations : int
        Limit of passes, a guard that ordinary data never meet.
    min_samples : int
        Fewer samples than this in the final set give a fit of NaN.

    Returns
    -------
    ClippedFit
        One fit a carrier; a carrier with too few samples or a deficient basis is all NaN and uses no sample.

    Notes
    -----
    Columns are scaled to unit length, the normal equations are solved and refined once with the true residuals.
    """
    row_is_finite: BoolArray = np.asarray(np.isfinite(basis).all(axis=1))
    safe_basis = np.where(row_is_finite[:, np.newaxis], basis, 0.0)
    # one carrier a row inside: passes pick carriers, and rows are picked without striding
    is_present: BoolArray = np.ascontiguousarray(np.isfinite(samples).T) & row_is_finite
    safe_samples = np.where(is_present, samples.T, 0.0)
    is_used = is_present.copy()
    is_converged = np.zeros(len(is_used), dtype=np.bool_)
    seen: list[list[bytes]] = [[] for _ in is_used]
    active = np.arange(len(is_used))
    for _ in range(max_iterations):
        tested = _retest(safe_basis, safe_samples[active], is_present[active], is_used[active], gate_sigma)
        is_fixed: BoolArray = (tested == is_used[active]).all(axis=1)
        is_converged[active[is_fixed]] = True
        still = []
        for carrier, mask in zip(active[~is_fixed], tested[~is_fixed], strict=True):
            is_used[carrier], is_cycling = _next_set(mask, is_used[carrier], seen[carrier])
            if not is_cycling:
                still.append(carrier)
        active = np.array(still, dtype=np.intp)
        if active.size == 0:
            break
    return _final_fit(safe_basis, safe_samples, is_used, is_converged, min_samples)


def _retest(
    basis: FloatArray, samples: FloatArray, is_present: BoolArray, is_used: BoolArray, gate_sigma: float
) -> BoolArray:
    """Return which present samples pass the gate of the fit over the used ones."""
    coefficients, _ = _solve(basis, samples, is_used)
    residual = np.abs(samples - coefficients @ basis.T)
    gate = np.maximum(gate_sigma * _rms(residual, is_used), ROUNDING_DB)
    return np.asarray(is_present & (residual < gate[:, np.newaxis]))


def _next_set(tested: BoolArray, current: BoolArray, seen: list[bytes]) -> tuple[BoolArray, bool]:
    """Return the set of the next pass, or, when it closes a cycle, the smallest set of the cycle and True.

    ``seen`` holds the packed sets of all passes before; it is extended by the current one.
    """
    seen.append(np.packbits(current).tobytes())
    packed = np.packbits(tested).tobytes()
    if packed not in seen:
        return tested, False
    cycle = [np.unpackbits(np.frombuffer(one, dtype=np.uint8), count=tested.size) for one in seen[seen.index(packed) :]]
    return min(cycle, key=lambda mask: int(mask.sum())).astype(np.bool_), True


def _solve(basis: FloatArray, samples: FloatArray, is_used: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return coefficients (N, K) and inverse normal matrices (N, K, K); NaN where the basis is deficient."""
    size = basis.shape[1]
    weights = is_used.astype(np.float64)
    products = (basis[:, :, np.newaxis] * basis[:, np.newaxis, :]).reshape(-1, size * size)
    normal = (weights @ products).reshape(-1, size, size)
    length = np.sqrt(np.diagonal(normal, axis1=1, axis2=2))
    is_sound: BoolArray = np.asarray((length > 0.0).all(axis=1))
    scale = np.where(is_sound[:, np.newaxis], length, 1.0)
    outer = scale[:, :, np.newaxis] * scale[:, np.newaxis, :]
    scaled = np.where(is_sound[:, np.newaxis, np.newaxis], normal / outer, np.eye(size))
    eigenvalues = np.linalg.eigvalsh(scaled)
    is_sound &= eigenvalues[:, 0] > MIN_EIGENVALUE_RATIO * eigenvalues[:, -1]
    inverse = np.linalg.inv(np.where(is_sound[:, np.newaxis, np.newaxis], scaled, np.eye(size))) / outer
    inverse[~is_sound] = math.nan
    coefficients = np.zeros((len(samples), size))
    for _ in range(2):  # the second pass refines with the residuals of the first
        misfit = weights * (samples - coefficients @ basis.T)
        coefficients = coefficients + np.einsum("nij,nj->ni", inverse, misfit @ basis)
    return coefficients, inverse


def _rms(residual: FloatArray, is_used: BoolArray) -> FloatArray:
    """Return the paper's sigma of each carrier: sum r^2 / N under the root, over the used samples."""
    count = np.maximum(is_used.sum(axis=1), 1)
    return np.asarray(np.sqrt((residual**2 * is_used).sum(axis=1) / count))


def _final_fit(
    basis: FloatArray, samples: FloatArray, is_used: BoolArray, is_converged: BoolArray, min_samples: int
) -> ClippedFit:
    """Fit the final sets and blank what cannot be fitted."""
    coefficients, inverse = _solve(basis, samples, is_used)
    rms_db = _rms(samples - coefficients @ basis.T, is_used)
    is_sound: BoolArray = np.isfinite(coefficients).all(axis=1) & (is_used.sum(axis=1) >= min_samples)
    coefficients[~is_sound] = math.nan
    inverse[~is_sound] = math.nan
    return ClippedFit(
        coefficients=coefficients,
        normal_inverse=inverse,
        rms_db=np.where(is_sound, rms_db, math.nan),
        is_used=np.ascontiguousarray((is_used & is_sound[:, np.newaxis]).T),
        is_converged=is_converged & is_sound,
    )
