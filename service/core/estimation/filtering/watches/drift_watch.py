"""Drift of the inertial model watched in operation: whether the spacecraft drifts as the settings say.

    E[d^2] = Var(d_hat) + P          so      m = mean of d_hat^2 / (sigma^2 - P) is one while the model holds
    W = n (m - 1 - ln m)             chi-square of one degree of freedom while it holds (Wilks 1938)

d_hat and P are the filter's drift and its variance, sigma what the settings say. A drift of correlation time tau tells
one independent sample an axis in each tau, three a day for eight hours; n counts those, as far as an axis is known. The
factor leaves one when W speaks against the settings at 5 % and m stands for 1.4 times the drift; it follows the mean
then and returns to one when the mean does. The law of this file: one factor for the three axes, never below one; a
spacecraft that drifts less than it may is no reason to believe less in the measurements.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.model.filter_model import FilterSettings
from service.core.estimation.filtering.model.filter_state import DRIFT, Gaussian

#: samples fade with this time, h
MEMORY_H = 96.0
LARGEST = 4.0
#: factor that is learned at least, and evidence for it: chi-square of one degree of freedom, one side, 5 %
LEAST_LEARNED, EVIDENCE = 1.4, 2.706
#: the prediction keeps its matrices by settings: the factor it sees moves in steps of this ratio
_STEP = 2.0**0.125
#: one axis counts for so much at most
_CUT = 25.0
#: an axis of whose drift less than this share is known says nothing, share of its variance
_LEAST_KNOWN = 0.02


class DriftWatch(NamedTuple):
    """Evidence on the drift and the factor that is believed."""

    #: independent samples of the drift, fading, and the sum of their squares over the variance of the settings
    samples: float = 0.0
    square_sum: float = 0.0
    #: factor on the drift of the settings in the steps that the prediction sees, >= 1
    scale: float = 1.0

    @property
    def evidence(self) -> float:
        """Likelihood ratio of the mean square that was found against the settings, 0 where it is smaller."""
        mean = self.square_sum / self.samples if self.samples > 0.0 else 1.0
        return self.samples * (mean - 1.0 - math.log(mean)) if mean > 1.0 else 0.0

    @property
    def learned(self) -> float:
        """Factor that the samples tell, within one and the largest."""
        mean = self.square_sum / self.samples if self.samples > 0.0 else 1.0
        return math.sqrt(min(LARGEST**2, max(1.0, mean)))


def usual_drift() -> DriftWatch:
    """Return the watch of a spacecraft that drifts as its settings say."""
    return DriftWatch()


def scaled_settings(settings: FilterSettings, watch: DriftWatch) -> FilterSettings:
    """Return the settings with the drift that was learned."""
    scale = watch.scale
    if scale == 1.0:
        return settings
    yaw, roll, pitch = settings.drift_deg_h
    return settings._replace(drift_deg_h=(scale * yaw, scale * roll, scale * pitch))


def push_drift(
    watch: DriftWatch, settings: FilterSettings, state: Gaussian, minutes: float
) -> tuple[DriftWatch, Gaussian]:
    """Return the watch after some minutes, and the state, whose drift is wider where the factor grew a step.

    Parameters
    ----------
    watch : DriftWatch
        Before.
    settings : FilterSettings
        As configured, without the factor.
    state : Gaussian
        State after the update.
    minutes : float
        Minutes of data that have passed.
    """
    samples, square_sum = _with_samples(watch, settings, state, minutes)
    pushed = DriftWatch(samples, square_sum, watch.scale)
    is_learned = pushed.learned > 1.0 if watch.scale > 1.0 else _is_proven(pushed)
    pushed = pushed._replace(scale=_stepped(pushed.learned) if is_learned else 1.0)
    if pushed.scale <= watch.scale:
        return pushed, state
    covariance = state.covariance.copy()
    growth = (pushed.scale / watch.scale) ** 2 - 1.0
    positions = np.arange(DRIFT.start, DRIFT.stop)
    covariance[positions, positions] += growth * (watch.scale * np.array(settings.drift_deg_h)) ** 2
    return pushed, Gaussian(state.mean, covariance)


def _with_samples(watch: DriftWatch, settings: FilterSettings, state: Gaussian, minutes: float) -> tuple[float, float]:
    """Return samples and sum of squares after some minutes."""
    keep = math.exp(-minutes / 60.0 / MEMORY_H)
    samples, square_sum = keep * watch.samples, keep * watch.square_sum
    mean, variance = state.mean[DRIFT].tolist(), np.diagonal(state.covariance)[DRIFT].tolist()
    for drift, uncertain, sigma in zip(mean, variance, settings.drift_deg_h, strict=True):
        sigma2 = (watch.scale * sigma) ** 2
        known = sigma2 - uncertain
        if known > _LEAST_KNOWN * sigma2:
            # an axis speaks as far as it is known
            count = known / sigma2 * minutes / 60.0 / settings.drift_tau_h
            samples += count
            square_sum += count * watch.scale**2 * min(drift**2 / known, _CUT)
    return samples, square_sum


def _is_proven(watch: DriftWatch) -> bool:
    """Return whether the samples speak against the settings."""
    return watch.learned >= LEAST_LEARNED and watch.evidence >= EVIDENCE


def _stepped(scale: float) -> float:
    """Return the next step of the factor below a value."""
    return float(_STEP ** math.floor(math.log(scale) / math.log(_STEP) + 1e-9))
