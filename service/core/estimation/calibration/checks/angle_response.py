"""Response of the angle of a polarimeter to the calibration turns: its sign and scale.

    z = a p + slow        p = s . (roll, pitch, yaw) by the sensors, z as measured; slow: a cubic; a = 1 of a true one

Offset, daily wave and wander of the instrument are slow beside a turn. The law of this file: means of some minutes, so
that a single wild record counts little; what the turns do not determine is NaN.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: records are averaged over so much, h
_BLOCK_H = 1.0 / 12.0
_SLOW_DEGREE = 3
#: fewest means beyond the unknowns
_LEAST_FREE = 6
#: the response counts as determined up to this sigma
DETERMINED = 0.2
#: share by which wander and the sensor may make the response wrong
_WANDER_SHARE = 0.05


class AngleResponse(NamedTuple):
    """Response of an angle to the turns; NaN = not determined."""

    coefficient: float
    sigma: float

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell sign and scale."""
        return self.sigma <= DETERMINED

    def deviation(self) -> float:
        """Return the deviation from a true instrument, sigmas; 0 where the turns tell nothing."""
        if not self.sigma <= DETERMINED * max(1.0, abs(self.coefficient)):
            return 0.0
        return abs(self.coefficient - 1.0) / math.hypot(self.sigma, _WANDER_SHARE)


def angle_response(epochs_h: FloatArray, measured_deg: FloatArray, expected_deg: FloatArray) -> AngleResponse:
    """Return the response of a measured angle to the expected one.

    Parameters
    ----------
    epochs_h : ndarray, shape (K,), h
        Epochs of the records, ascending.
    measured_deg, expected_deg : ndarray, shape (K,), deg
        Angle about the line of sight by the polarimeter and by the sensors; records with NaN take no part.
    """
    known = np.isfinite(measured_deg) & np.isfinite(expected_deg)
    unknown = AngleResponse(math.nan, math.nan)
    if not known.any():
        return unknown
    block = np.floor((epochs_h[known] - epochs_h[known][0]) / _BLOCK_H).astype(np.int64)
    _, mean_of, count = np.unique(block, return_inverse=True, return_counts=True)
    mean_h, mean_measured, mean_expected = (
        np.bincount(mean_of, values[known]) / count for values in (epochs_h, measured_deg, expected_deg)
    )
    span = max(float(np.ptp(mean_h)), _BLOCK_H)
    slow = np.vander((mean_h - mean_h.mean()) / span, _SLOW_DEGREE + 1)
    design = np.column_stack([mean_expected, slow])
    free = len(mean_h) - design.shape[1]
    if free < _LEAST_FREE or np.linalg.matrix_rank(design) < design.shape[1]:
        return unknown
    solved = np.linalg.lstsq(design, mean_measured, rcond=None)[0]
    scatter = float(np.square(mean_measured - design @ solved).sum()) / free
    sigma = math.sqrt(scatter * float(np.linalg.inv(design.T @ design)[0, 0]))
    return AngleResponse(float(solved[0]), sigma)
