"""Gain by measured motion: bounds of the attitude by powers, and with wheels, a rate sensor and polarimeters beside."""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.pipeline.inputs.catalogue_torque import rate_sensor_model
from service.pipeline.inputs.polarization import learned_feed, polarimeter_models, used_polarimeters
from service.pipeline.planning.candidates import Candidates
from service.records.calibration import FeedFit
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft, WheelMomentum
from service.records.levels.attitude import Axes, FloatArray, IntArray, named_axes

#: time between records where none is stated, s
WHEEL_PERIOD_S = 300.0
#: what three quiet days tell of a feed: offset, daily cosine and sine, one sigma of 0.02 and 0.01 deg
_QUIET_FEED = FeedFit((0.0, 0.0, 0.0), ((4e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4)), 0.0, 0.0, 0)


class MomentumGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, by a set of carriers."""

    wheels: WheelStatistics
    #: deg; NaN = the carriers do not determine it
    without_deg: Axes
    with_deg: Axes


class MotionGain(NamedTuple):
    """Bounds of a filter over a day, one sigma, deg, by a set of carriers and what the catalogue states beside them.

    NaN = the carriers do not determine it; None = nothing is stated.
    """

    powers_deg: Axes
    rates_deg: Axes | None
    polarization_deg: Axes | None
    #: wheels, rates and polarimeters together
    all_deg: Axes


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
    powers = _powers(candidates, chosen)
    bounds = (attitude_bound_deg(*powers, one) for one in (None, wheels))
    without_deg, with_deg = (named_axes(bound) for bound in bounds)
    return MomentumGain(wheels, without_deg, with_deg)


def motion_gain(
    candidates: Candidates, chosen: IntArray, spacecraft: Spacecraft, wheels: WheelStatistics | None
) -> MotionGain | None:
    """Return the bounds by some carriers; None where neither a rate sensor nor a polarimeter is stated and used."""
    sensor, stated = rate_sensor_model(spacecraft), used_polarimeters(spacecraft)
    if sensor is None and not stated:
        return None
    powers, models = _powers(candidates, chosen), polarimeter_models(spacecraft, stated)
    # references come from quiet days, and so does what they tell of a feed
    feeds = [learned_feed(_QUIET_FEED, one, 0) for one in stated]
    read = tuple(one._replace(learned=feed) for one, feed in zip(models, feeds, strict=True))
    bias = None if sensor is None else (sensor.bias_deg_h, sensor.bias_deg_h, sensor.bias_deg_h)
    drift = (
        None if sensor is None or bias is None else DriftStatistics(bias, sensor.bias_tau_h, sensor.noise_deg_sqrt_h)
    )
    return MotionGain(
        named_axes(attitude_bound_deg(*powers)),
        None if drift is None else named_axes(attitude_bound_deg(*powers, drift=drift)),
        named_axes(attitude_bound_deg(*powers, polarimeters=read)) if read else None,
        named_axes(attitude_bound_deg(*powers, wheels, drift, read)),
    )


def _powers(candidates: Candidates, chosen: IntArray) -> tuple[FloatArray, ColouredNoise]:
    """Return slopes and noise of some carriers."""
    return candidates.sensitivity_db_per_deg[chosen], ColouredNoise(*(part[chosen] for part in candidates.noise))


def _error_n_m(profile: FedForwardTorque) -> float:
    """Return one sigma of what a profile has wrong: its relative error of the rms of its parts along roll and yaw."""
    parts = (profile.constant_n_m, profile.cosine_n_m, profile.sine_n_m)
    size_n_m = float(np.sqrt(np.mean([_across(part) ** 2 for part in parts])))
    return math.hypot(profile.relative_error, profile.axis_relative_error) * size_n_m


def _across(torque: AxisTorques) -> float:
    return math.hypot(torque.roll, torque.yaw) / math.sqrt(2.0)
