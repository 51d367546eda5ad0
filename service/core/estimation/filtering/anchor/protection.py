"""Protection levels: bounds that the error of roll, pitch or yaw passes with a stated probability.

    smallest L with   sum over combinations of p(h) P(abs(d) > L under h) <= risk

as in satellite navigation, where the combinations are those of faulty satellites. The combinations are those of
`carrier_mixture`, which have their probabilities after the data.
"""

import math

import numpy as np

from service.core.estimation.filtering.anchor.carrier_mixture import Mixture
from service.core.estimation.filtering.model.filter_model import FloatArray

#: probability with which the error of a row may pass the level
RISK = 1e-4
#: levels end here, deg, and are found to 1/2^20 of it
_GREATEST_DEG = 3.0
_HALVINGS = 20
#: logarithm of what lies beyond so many sigmas of a normal distribution; between them it is straight to 1e-5
_SIGMAS = np.arange(0.0, 37.0, 0.01)
_LOG_BEYOND = np.array([math.log(0.5 * math.erfc(sigmas / math.sqrt(2.0))) for sigmas in _SIGMAS.tolist()])


def protection_levels_deg(mixture: Mixture, risk: float = RISK) -> FloatArray:
    """Return the protection levels (3,) of yaw, roll and pitch, deg."""
    sigma = np.sqrt(np.diagonal(mixture.covariance_deg2, axis1=1, axis2=2))
    low, high = np.zeros(3), np.full(3, _GREATEST_DEG)
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        beyond = _beyond((level + mixture.mean_deg) / sigma) + _beyond((level - mixture.mean_deg) / sigma)
        is_passed = mixture.probability @ beyond > risk
        low, high = np.where(is_passed, level, low), np.where(is_passed, high, level)
    return high


def _beyond(sigmas: FloatArray) -> FloatArray:
    """Return the probability of a normal error beyond so many sigmas, on one side."""
    tail = np.exp(np.interp(np.abs(sigmas), _SIGMAS, _LOG_BEYOND))
    return np.asarray(np.where(sigmas < 0.0, 1.0 - tail, tail))
