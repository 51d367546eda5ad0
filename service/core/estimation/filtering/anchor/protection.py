"""Protection levels: bounds that the error of roll, pitch or yaw passes with a stated probability.

    smallest L with   sum over combinations of p(h) P(abs(d) > L under h) <= risk

as in satellite navigation, where the combinations are those of faulty satellites. The combinations are those of
`carrier_mixture`, which have their probabilities after the data.
"""

import numpy as np

from service.core.estimation.filtering.anchor.carrier_mixture import Mixture
from service.core.estimation.filtering.kernels.kernels import ARRAYS, AnchorKernels
from service.core.estimation.filtering.model.filter_model import FloatArray

#: probability with which the error of a row may pass the level
RISK = 1e-4
#: sigmas that a normal error passes with it, on either side
SIGMAS_OF_RISK = 3.891


def protection_levels_deg(mixture: Mixture, risk: float = RISK, kernels: AnchorKernels = ARRAYS) -> FloatArray:
    """Return the protection levels (3,) of yaw, roll and pitch, deg, at most 3 deg."""
    sigma = np.sqrt(np.diagonal(mixture.covariance_deg2, axis1=1, axis2=2))
    return kernels.levels(mixture.probability, mixture.mean_deg, sigma, risk)
