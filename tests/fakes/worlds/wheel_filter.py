"""A filter that holds the momentum of the wheels, before its first record."""

import numpy as np

from service.core.estimation.filtering.filter_model import FedForward, FilterSettings, Gaussian, MomentumModel

#: nine core states, chain and rain, nine torques, seven of the momentum
FIRST, SIZE = 20, 27
PROFILE = FedForward((1e-3, 2e-3, 3e-3), (0.0, 1e-3, 0.0), (0.0, 0.0, 2e-3), 0.05, 0.01, 86_400_000_000)
WHEELS = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), PROFILE)
SETTINGS = FilterSettings(momentum=WHEELS)
MINUTE_US, H = 60_000_000, np.array([0.4, -8.0, -0.3])


def state(yaw_deg: float = 0.0) -> Gaussian:
    mean = np.zeros(SIZE)
    mean[:3], mean[FIRST : FIRST + 3] = (yaw_deg, 0.02, -0.03), H
    mean[FIRST + 3 :] = (0.01, -0.02, 1e-3, -2e-3)
    sigma = np.array([0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, *(1e-4,) * 9])
    covariance = np.diag(np.square([*sigma, 0.02, 0.02, 0.02, 0.05, 0.05, 0.005, 0.005]))
    return Gaussian(mean, covariance)
