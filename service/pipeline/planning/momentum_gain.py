"""Gain by the momentum of the wheels in telemetry: bounds of the attitude with and without it."""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.attitude_bound import WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.pipeline.planning.candidates import Candidates
from service.records.catalogue import AxisTorques, FedForwardTorque, WheelMomentum
from service.records.levels.attitude import Axes, IntArray, named_axes

#: time between records where none is stated, s
WHEEL_PERIOD_S = 300.0


class MomentumGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, by a set of carriers."""

    wheels: WheelStatistics
    #: deg; NaN = the carriers do not determine it
    without_deg: Axes
    with_deg: Axes


def stated_wheels(
    stated: WheelMomentum | None, bias_n_m_s: float | None, sigma_n_m_s: float | None, period_s: float
) -> WheelStatistics | None:
    """Return the wheels by the options given, else by the catalogue; None where neither states a momentum."""
    known = stated or WheelMomentum()
    bias = known.pitch_bias_n_m_s if bias_n_m_s is None else bias_n_m_s
    if bias is None:
        return None
    wheels = WheelStatistics(bias, sigma_n_m_s or known.sigma_n_m_s, period_s, known.misalignment_deg)
    return wheels if known.torque is None else wheels._replace(torque_error_n_m=_error_n_m(known.torque))


def momentum_gain(candidates: Candidates, chosen: IntArray, wheels: WheelStatistics) -> MomentumGain:
    """Return the bounds by some carriers; their noise is that of a row a minute."""
    sensitivity = candidates.sensitivity_db_per_deg[chosen]
    noise = ColouredNoise(*(part[chosen] for part in candidates.noise))
    bounds = (attitude_bound_deg(sensitivity, noise, one) for one in (None, wheels))
    without_deg, with_deg = (named_axes(bound) for bound in bounds)
    return MomentumGain(wheels, without_deg, with_deg)


def _error_n_m(profile: FedForwardTorque) -> float:
    """Return one sigma of what a profile has wrong: its relative error of the rms of its parts along roll and yaw."""
    parts = (profile.constant_n_m, profile.cosine_n_m, profile.sine_n_m)
    size_n_m = float(np.sqrt(np.mean([_across(part) ** 2 for part in parts])))
    return math.hypot(profile.relative_error, profile.axis_relative_error) * size_n_m


def _across(torque: AxisTorques) -> float:
    return math.hypot(torque.roll, torque.yaw) / math.sqrt(2.0)
