"""Variances of white noise and of parts with fixed correlation times, from grouped periodograms.

``S(f) = sum_k v_k E_k(f)``, v_k >= 0; the likelihood of a periodogram I is ``-sum n (log S + I / S)``. It is climbed
by the multiplicative rule ``v <- v sqrt((sum n E I / S^2) / (sum n E / S))``, which never decreases it and never leaves
the positive (Fevotte and Idier, Neural Computation 23, 2011). The law of this file: one carrier's days do not tell what
is slow, all carriers' days do, so each estimate is drawn towards that of all with the weight of a few frequencies, and
what nobody's days can exclude is not believed to be zero.
"""

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.noise.periodogram import Spectra

FloatArray = NDArray[np.float64]

_PASSES = 500
#: variance below this is nothing, dB^2
_LEAST_DB2 = 1e-12


def fitted_variances(
    spectra: Spectra, start_db2: FloatArray, prior_db2: FloatArray, prior_weight: FloatArray
) -> FloatArray:
    """Return the variances of each series' parts.

    Parameters
    ----------
    spectra : Spectra
        N series, C + 1 parts, F groups.
    start_db2 : ndarray, shape (N, C + 1), dB^2
        Where the climb begins, > 0.
    prior_db2 : ndarray, shape (N, C + 1), dB^2
        Where each variance is drawn to.
    prior_weight : ndarray, shape (C + 1,)
        How many frequencies that is worth; 0 = nothing.

    Returns
    -------
    ndarray, shape (N, C + 1), dB^2
    """
    variance = np.maximum(start_db2, _LEAST_DB2)
    for _ in range(_PASSES):
        total = np.einsum("nc,ncf->nf", variance, spectra.expected)
        weight = spectra.weight / total
        reported = np.einsum("ncf,nf->nc", spectra.expected, weight * spectra.power / total)
        owed = np.einsum("ncf,nf->nc", spectra.expected, weight)
        reported = reported + prior_weight * prior_db2 / variance**2
        owed = owed + prior_weight / variance
        variance = np.maximum(variance * np.sqrt(reported / np.maximum(owed, 1e-300)), _LEAST_DB2)
    return variance


def pooled_variances(spectra: Spectra, start_db2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variances that all series share, each with its own white noise, and their standard errors.

    Parameters
    ----------
    spectra : Spectra
        N series.
    start_db2 : ndarray, shape (N, C + 1), dB^2
        Where the climb begins, > 0.

    Returns
    -------
    shared_db2 : ndarray, shape (C,), dB^2
        Of the correlated parts.
    error_db2 : ndarray, shape (C,), dB^2
        One standard error of each, the other parts being unknown too.
    """
    white = np.maximum(start_db2[:, :1], _LEAST_DB2)
    is_seen = spectra.weight.any(axis=1)
    shared = np.maximum(start_db2[is_seen, 1:].mean(axis=0), _LEAST_DB2) if is_seen.any() else start_db2[0, 1:]
    for _ in range(_PASSES):
        total = _total(spectra, white, shared)
        weight = spectra.weight / total
        reported = np.einsum("ncf,nf->nc", spectra.expected, weight * spectra.power / total)
        owed = np.maximum(np.einsum("ncf,nf->nc", spectra.expected, weight), 1e-300)
        white = np.maximum(white * np.sqrt(reported[:, :1] / owed[:, :1]), _LEAST_DB2)
        shared = np.maximum(shared * np.sqrt(reported[:, 1:].sum(axis=0) / owed[:, 1:].sum(axis=0)), _LEAST_DB2)
    relative = spectra.expected / _total(spectra, white, shared)[:, np.newaxis]
    information = np.einsum("nf,ncf,ndf->cd", spectra.weight, relative, relative)
    scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True)
    return shared, (np.sqrt(np.maximum(np.diagonal(inverse), 0.0)) / scale)[1:]


def _total(spectra: Spectra, white: FloatArray, shared: FloatArray) -> FloatArray:
    """Return S (N, F) of own white noise (N, 1) and shared correlated parts (C,)."""
    variance = np.concatenate([white, np.broadcast_to(shared, (len(white), len(shared)))], axis=1)
    return np.asarray(np.einsum("nc,ncf->nf", variance, spectra.expected))
