"""phi1(z) = (1 - e^-z) / z and phi2(z) = (z - 1 + e^-z) / z^2, with series where differences would lose digits.

Within 4e-16 of fifty-digit arithmetic, relative (`tests/unit/service/core/flexible/test_propagation.py`).
"""

import math

import numpy as np

from service.core.arrays import FloatArray

#: up to here a series, up to the first one a short one: beyond its last term nothing is left in double precision
SHORT_SERIES_BELOW, SERIES_BELOW = 0.01, 0.5
_SHORT_TERMS, _TERMS = 8, 17


def phi1(z: FloatArray) -> FloatArray:
    """Return (1 - e^-z) / z, 1 at zero.

    Examples
    --------
    >>> phi1(np.array([0.0, 1.0])).round(6).tolist()
    [1.0, 0.632121]
    """
    return 1.0 - z * phi2(z)


def phi2(z: FloatArray) -> FloatArray:
    """Return (z - 1 + e^-z) / z^2, 1/2 at zero.

    Examples
    --------
    >>> phi2(np.array([0.0, 1.0])).round(6).tolist()
    [0.5, 0.367879]
    """
    greatest = float(np.max(np.abs(z), initial=0.0))
    if greatest < SERIES_BELOW:
        return _series(z, _SHORT_TERMS if greatest < SHORT_SERIES_BELOW else _TERMS)
    is_small = np.abs(z) < SERIES_BELOW
    large = np.where(is_small, 1.0, z)
    direct = (large + np.expm1(-large)) / large**2
    return np.where(is_small, _series(np.where(is_small, z, 0.0), _TERMS), direct)


def phi2_scalar(z: float) -> float:
    """Return phi2 of one number; plain arithmetic, so that numba compiles it."""
    if abs(z) >= SERIES_BELOW:
        return (z + math.expm1(-z)) / (z * z)
    total = 0.0
    for n in range(_SHORT_TERMS if abs(z) < SHORT_SERIES_BELOW else _TERMS, 1, -1):
        total = (1.0 - z * total) / n
    return total


def _series(z: FloatArray, terms: int) -> FloatArray:
    """Return the sum of (-z)^n / (n + 2)!."""
    total = np.zeros_like(z)
    for n in range(terms, 1, -1):
        total = (1.0 - z * total) / n
    return total
