"""Smallest detectable fault of one carrier, and the attitude error of an undetected one.

A fault f of carrier i shows in its own residual as ``(1 - h_i) f``, h_i its leverage; the fix takes ``K_i f`` of it,
K the gain of the fix. The carrier is excluded beyond ``gate`` sigmas; for nine cases of ten

    f_min = (gate sigma + 1.2816 sigma sqrt(1 - h)) / (1 - h),     shift = K_i f_min.

The law of this file: a carrier that no other checks (h = 1) has an infinite bound, never a large one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Sigmas beyond which a carrier has less than five per cent of Tukey's weight.
GATE_SIGMAS = 4.685 * math.sqrt(1.0 - math.sqrt(0.05))
#: Quantile of the normal distribution for nine in ten.
_NINE_IN_TEN = 1.2815515655446004
_MIN_REDUNDANCY = 1e-6


class FaultBounds(NamedTuple):
    """Bounds of T fixes: detectable_db (T, N) in dB, shift_deg (T, N, 3) in deg."""

    detectable_db: FloatArray
    shift_deg: FloatArray


def fault_bounds(design: FloatArray, gain: FloatArray, sigma_db: FloatArray) -> FaultBounds:
    """Return the bounds of every carrier.

    Parameters
    ----------
    design : ndarray, shape (T, N, U)
        Derivative of the model by the unknowns, the attitude first.
    gain : ndarray, shape (T, U, N)
        Change of the unknowns with the deviations.
    sigma_db : ndarray, shape (T, N), dB
        NaN for absent carriers.

    Returns
    -------
    FaultBounds
        NaN for absent carriers; the shift of a carrier that nothing checks is infinite in the angles it moves.

    Examples
    --------
    >>> design = np.concatenate([np.eye(3), np.eye(3)])[np.newaxis]
    >>> bounds = fault_bounds(design, 0.5 * np.swapaxes(design, 1, 2), np.full((1, 6), 0.1))
    >>> bounds.detectable_db[0, 0].round(3), bounds.shift_deg[0, 0].round(3)
    (np.float64(1.007), array([0.503, 0.   , 0.   ]))
    """
    redundancy = 1.0 - np.einsum("tnu,tun->tn", design, gain)
    is_checked = redundancy > _MIN_REDUNDANCY
    safe = np.where(is_checked, redundancy, 1.0)
    seen_db = sigma_db * (GATE_SIGMAS + _NINE_IN_TEN * np.sqrt(np.minimum(safe, 1.0))) / safe
    detectable = np.where(is_checked | np.isnan(sigma_db), seen_db, math.inf)
    moves = np.swapaxes(gain, 1, 2)[..., :3]
    size = np.where(moves == 0.0, 0.0, detectable[..., np.newaxis])
    return FaultBounds(detectable, size * moves)
