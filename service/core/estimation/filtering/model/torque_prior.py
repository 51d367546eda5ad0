"""Prior of the torque that is not fed forward: what the ground states about it before powers tell.

    m' = h_const + h_cos cos(p) + h_sin sin(p)           h (9,) as in `hidden_motion`, deg/h^2
    P  = diag(residual) + V (c^2 1 + o^2 I) V'           V (9, 3): the profile that is fed forward, axis by axis

The residual is a torque of unknown shape. What is left of a known profile has its shape: a share of it, most of it (c)
common to all axes because one model of the Sun's light made it, a little (o) of each axis' own. Both are Gaussian and
linear in h, so that shares need no states beside the nine: they are a covariance of these, and a share that one axis
shows is known about the others. The law of this file: settings in, arrays out.
"""

import math
from functools import lru_cache

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import FedForward, FilterSettings

#: states of the torque: a constant, a cosine and a sine an axis
TORQUES = 9
#: the Sun turns round the body once in this time, us
DAY_US = 86_400_000_000


def wave_period_us(settings: FilterSettings) -> int:
    """Return the time in which the torque goes round: that of the profile known, without one a solar day."""
    known = settings.fed_forward or (None if settings.momentum is None else settings.momentum.profile)
    return DAY_US if known is None else known.period_us


def torque_prior_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return the standard deviation (9,) of the residual torque.

    At every hour the torque has the size that was stated. Who states a size does not state the shape: what pushes is
    the light of the Sun, which goes round, or it stands still. With a fifth constant a constant of twice the size
    leaves yaw wrong by 0.5 deg for a day, with equal parts by 0.3, which is what powers alone allow; one of the size
    let yaw run away to 3 deg in a closed loop, for 0.9.
    """
    if has_torque(settings) and not is_pushed(settings):
        return gathered_prior_deg_h2(settings)
    return _prior(settings.torque_deg_h2)


def gathered_prior_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return the standard deviation (9,) of the torque that gathers in the wheels where no profile is known; else 0."""
    unknown = None if settings.momentum is None else settings.momentum.unknown_torque_deg_h2
    return np.zeros(TORQUES) if unknown is None else _prior(unknown)


def _prior(size_deg_h2: tuple[float, float, float]) -> FloatArray:
    """Return the standard deviation (9,) of a torque of a size, half of its variance constant."""
    return np.tile(math.sqrt(0.5) * np.array(size_deg_h2), 3)


def scale_covariance(reported: FedForward) -> FloatArray:
    """Return the covariance (9, 9) of what is wrong with a profile, (deg/h^2)^2; its rank is three."""
    profile = np.vstack([np.diag(part) for part in reported[:3]])
    shares = np.full((3, 3), reported.relative_error**2) + reported.axis_relative_error**2 * np.eye(3)
    return np.asarray(profile @ shares @ profile.T)


def torque_covariance(settings: FilterSettings) -> FloatArray:
    """Return the covariance (9, 9) of the torque before anything was learned of it, (deg/h^2)^2."""
    covariance = np.diag(torque_prior_deg_h2(settings) ** 2)
    for known in (settings.fed_forward, None if settings.momentum is None else settings.momentum.profile):
        covariance = covariance if known is None else covariance + scale_covariance(known)
    return covariance


def torque_size_deg_h2(settings: FilterSettings) -> FloatArray:
    """Return how large (3,) the torque is thought to be at the most, one sigma, deg/h^2."""
    size = np.array(settings.torque_deg_h2)
    reported = settings.fed_forward
    if reported is None:
        return size
    constant, cosine, sine = np.abs(np.array(reported[:3]))
    share = math.hypot(reported.relative_error, reported.axis_relative_error)
    return np.asarray(np.hypot(size, share * (constant + np.hypot(cosine, sine))))


@lru_cache(maxsize=64)
def is_pushed(settings: FilterSettings) -> bool:
    """Return whether a torque acts that is not fed forward."""
    return float(torque_size_deg_h2(settings).max()) > 0.0


def has_torque(settings: FilterSettings) -> bool:
    """Return whether torques are among the states: one that is not fed forward, or one that gathers in the wheels."""
    wheels = settings.momentum
    is_gathered = wheels is not None and (wheels.profile is not None or wheels.unknown_torque_deg_h2 is not None)
    return is_pushed(settings) or is_gathered
