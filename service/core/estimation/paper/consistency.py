"""Consistency of level changes with stated angles.

Under the hypothesis that the angles hold, what is left of the levels after f(angles) is noise and wander of each
carrier. The alternative is an attitude that differs: the drop of the weighted cost that three free angles and a common
level bring, beyond the common level's own, is chi-square with three degrees of freedom under the hypothesis.
"""

from math import erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: mean square of the residuals, in sigmas, above which levels have moved on their own
_MOVED_SCATTER = 4.0


class Consistency(NamedTuple):
    """Test of stated angles against levels."""

    #: drop of the cost by three free angles
    chi_square: float
    #: probability of a drop at least as large while the angles hold; 1 when fewer than six carriers were tested
    probability: float
    #: (3,) deg, angles by which the levels differ from the stated ones
    offset_deg: FloatArray
    carriers_tested: int


def compare_with_angles(change_db: FloatArray, sensitivity_db_per_deg: FloatArray, sigma_db: FloatArray) -> Consistency:
    """Test level changes for a missing attitude.

    Parameters
    ----------
    change_db : ndarray, shape (N,), dB
        Level of the window minus level of the calibration minus f(stated angles); NaN = not tested.
    sensitivity_db_per_deg : ndarray, shape (N, 3), dB/deg
        Slopes at the stated angles.
    sigma_db : ndarray, shape (N,), dB
        One standard deviation of each change.

    Returns
    -------
    Consistency
        Six carriers are the fewest with which four unknowns leave something to test.
    """
    present = np.isfinite(change_db) & np.isfinite(sigma_db) & (sigma_db > 0.0)
    present &= np.isfinite(sensitivity_db_per_deg).all(axis=1)
    count = int(np.count_nonzero(present))
    if count < 6:
        return Consistency(0.0, 1.0, np.full(3, np.nan), count)
    weight = 1.0 / sigma_db[present]
    ones = weight[:, None]
    full = np.hstack([sensitivity_db_per_deg[present] * ones, ones])
    wanted = change_db[present] * weight
    solution = np.linalg.lstsq(full, wanted, rcond=None)[0]
    common = float(ones[:, 0] @ wanted / (ones[:, 0] @ ones[:, 0]))
    cost_common = float(np.sum((wanted - ones[:, 0] * common) ** 2))
    cost_full = float(np.sum((wanted - full @ solution) ** 2))
    scatter = cost_full / (count - 4)
    chi_square = max(0.0, cost_common - cost_full) / (scatter if scatter > _MOVED_SCATTER else 1.0)
    return Consistency(chi_square, chi_square_tail_3(chi_square), np.asarray(solution[:3], dtype=np.float64), count)


def chi_square_tail_3(chi_square: float) -> float:
    """Return the probability that a chi-square variable with three degrees of freedom exceeds a value.

    Closed form: ``erfc(sqrt(x/2)) + sqrt(2 x / pi) exp(-x/2)``.

    Examples
    --------
    >>> round(chi_square_tail_3(7.814727903), 6)
    0.05
    """
    return erfc(sqrt(chi_square / 2.0)) + sqrt(2.0 * chi_square / pi) * exp(-chi_square / 2.0)
