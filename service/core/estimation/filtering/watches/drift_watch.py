"""Drift of the inertial model watched in operation: whether the spacecraft drifts as the settings say.

    E[d^2] = Var(d_hat) + P          so      d_hat^2 / (sigma^2 - P) averages one while the model holds

d_hat and P are the filter's drift and its variance, sigma what the settings say (times the factor learned so far). The
factor moves in small steps of its logarithm. The law of this file: one factor for the three axes, never below one; a
craft that drifts less than it may is no reason to believe less in the measurements.
"""

import math
from typing import NamedTuple

from service.core.estimation.filtering.model.filter_model import DRIFT, FilterSettings, Gaussian

#: time in which the factor follows, minutes
FOLLOW_MINUTES = 600.0
LARGEST = 4.0
#: the prediction keeps its matrices by settings: the factor it sees moves in steps of this ratio
_STEP = 2.0**0.125
#: one axis counts for so much at most
_CUT = 12.0
#: an axis of whose drift less than this share is known says nothing, share of its variance
_LEAST_KNOWN = 0.02


class DriftWatch(NamedTuple):
    """Factor on the drift of the settings."""

    #: logarithm of the factor, >= 0
    log_scale: float

    @property
    def scale(self) -> float:
        """Factor in the steps that the prediction sees, >= 1."""
        return drift_scale(self.log_scale)


def drift_scale(log_scale: float) -> float:
    """Return the factor in the steps that the prediction sees, >= 1, of its logarithm."""
    return float(_STEP ** math.floor(log_scale / math.log(_STEP) + 1e-9))


def usual_drift() -> DriftWatch:
    """Return the watch of a spacecraft that drifts as its settings say."""
    return DriftWatch(0.0)


def scaled_settings(settings: FilterSettings, watch: DriftWatch) -> FilterSettings:
    """Return the settings with the drift that was learned."""
    scale = watch.scale
    if scale == 1.0:
        return settings
    yaw, roll, pitch = settings.drift_deg_h
    return settings._replace(drift_deg_h=(scale * yaw, scale * roll, scale * pitch))


def push_drift(
    watch: DriftWatch, drift_deg_h: tuple[float, float, float], state: Gaussian, minutes: float
) -> tuple[DriftWatch, Gaussian]:
    """Return the watch after some minutes, and the state, whose drift is wider where the factor grew a step.

    Parameters
    ----------
    watch : DriftWatch
        Before.
    drift_deg_h : tuple of float
        Drift as configured, without the factor.
    state : Gaussian
        State after the update.
    minutes : float
        Minutes of data that have passed.
    """
    surplus, scale = 0.0, drift_scale(watch.log_scale)
    for axis, sigma in enumerate(drift_deg_h):
        position = DRIFT.start + axis
        sigma2 = (scale * sigma) ** 2
        known = sigma2 - float(state.covariance[position, position])
        if known > _LEAST_KNOWN * sigma2:
            # an axis speaks as far as it is known
            surplus += known / sigma2 * (min(float(state.mean[position]) ** 2 / known, _CUT) - 1.0) / 3.0
    log_scale = watch.log_scale + surplus * minutes / FOLLOW_MINUTES
    pushed = DriftWatch(min(math.log(LARGEST), max(0.0, log_scale)))
    grown = drift_scale(pushed.log_scale)
    if grown <= scale:
        return pushed, state
    covariance = state.covariance.copy()
    for axis, sigma in enumerate(drift_deg_h):
        position = DRIFT.start + axis
        covariance[position, position] += ((grown / scale) ** 2 - 1.0) * (scale * sigma) ** 2
    return pushed, Gaussian(state.mean, covariance)
