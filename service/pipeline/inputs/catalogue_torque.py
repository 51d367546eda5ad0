"""Disturbance torque and motion sensors of a spacecraft by its catalogue; torques as accelerations of the body.

    a = T / J        T N m, J kg m2 about the axis, a deg/h^2

The law of this file: records in, settings of the filter out; order yaw, roll, pitch.
"""

import math

import numpy as np

from service.core.estimation.filtering.model.filter_model import (
    FedForward,
    LearnedMomentum,
    MomentumModel,
    RateSensorModel,
)
from service.core.estimation.filtering.model.torque_prior import DAY_US, TORQUES, scale_covariance
from service.pipeline.inputs.known_motion import DEG_H2_N_M, angle_inertia_kg_m2
from service.records.calibration import Calibration, GatheredTorque
from service.records.catalogue import AxisTorques, FedForwardTorque, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray

#: torque from outside where no profile is stated, N m: light of the Sun on the arrays of a large comsat
_UNKNOWN_GATHERED_N_M = 2e-5
#: share by which a torque may have changed since it was learned, of all axes together and of each one: it costs
#: yaw by hourly records 0.005 deg of sigma, and a torque that changed by 0.3 misleads by two sigmas in place of seven
_CHANGED_SHARES = (0.1, 0.01)
#: and share by which it changes with its age, a day: twice what the Sun's seasons make
_CHANGED_SHARE_DAY = 0.01
#: size of the wander of a torque that was learned, as a share of it: 1 % in two days, what the Sun's seasons make
_WANDER_SHARE = 0.2
#: of a torque whose size is stated; it is that of the Sun's light, nearly all wave
_STATED_CONSTANT_SHARE = 0.2


def residual_deg_h2(spacecraft: Spacecraft | None, unknown_n_m: float) -> tuple[float, float, float]:
    """Return the accelerations of yaw, roll and pitch by the torque of unknown shape that is not fed forward.

    Where the catalogue does not state its size, `unknown_n_m` is the prior.
    """
    if spacecraft is None:
        return (0.0, 0.0, 0.0)
    stated_n_m = spacecraft.onboard.residual_torque_n_m
    size_n_m = unknown_n_m if stated_n_m is None else stated_n_m
    yaw, roll, pitch = (size_n_m / DEG_H2_N_M / inertia for inertia in angle_inertia_kg_m2(spacecraft))
    return yaw, roll, pitch


def constant_share(spacecraft: Spacecraft | None) -> float:
    """Return the constant part of this torque as a share of the whole: a torque that nobody knows is half constant."""
    return math.sqrt(0.5) if is_torque_unknown(spacecraft) else _STATED_CONSTANT_SHARE


def is_torque_unknown(spacecraft: Spacecraft | None) -> bool:
    """Return whether the catalogue does not state the size of the torque that is not fed forward."""
    return spacecraft is not None and spacecraft.onboard.residual_torque_n_m is None


def fed_forward(spacecraft: Spacecraft | None) -> FedForward | None:
    """Return the profile that the loop on board takes away, its phase counted from the beginning of 1970."""
    reported = None if spacecraft is None else spacecraft.onboard.fed_forward_torque
    return None if spacecraft is None or reported is None else _profile(reported, spacecraft)


def momentum_model(
    spacecraft: Spacecraft | None, calibration: Calibration | None = None, epoch_us: int = 0
) -> MomentumModel | None:
    """Return how the momentum of the wheels is read; None where the catalogue does not use it, or turns contradict.

    What the quiet days of the calibration told of the torque takes the place of what the catalogue states; it is known
    less well by the time until an epoch. Where the error of a profile that is fed forward also moves the body, the
    catalogue alone says how large it is.
    """
    stated = None if spacecraft is None else spacecraft.onboard.momentum
    if spacecraft is None or stated is None or not stated.used:
        return None
    if calibration is not None and calibration.is_momentum_contradicted:
        return None
    is_profile_known = stated.torque is not None or spacecraft.onboard.fed_forward_torque is not None
    profile = None if stated.torque is None else _profile(stated.torque, spacecraft)
    unknown = None if is_profile_known else _accelerations(AxisTorques(*[_UNKNOWN_GATHERED_N_M] * 3), spacecraft)
    learned, result = None, None if calibration is None else calibration.result
    gathered = None if result is None else result.gathered
    if gathered is not None and spacecraft.onboard.fed_forward_torque is None:
        learned = _learned(gathered, spacecraft, epoch_us)
        profile, unknown = None, _WANDER_SHARE * _size(learned)
    return MomentumModel(
        stated.sigma_n_m_s,
        stated.scale_error,
        stated.misalignment_deg,
        angle_inertia_kg_m2(spacecraft),
        profile,
        None if unknown is None else _triple(unknown),
        learned=learned,
    )


def learned_units(spacecraft: Spacecraft) -> FloatArray:
    """Return the factors (13,) from `LearnedMomentum` to `GatheredTorque`: N m per deg/h^2, then 1 of the errors."""
    torques_n_m = np.tile(DEG_H2_N_M * np.array(angle_inertia_kg_m2(spacecraft)), TORQUES // 3)
    return np.concatenate([torques_n_m, np.ones(4)])


def _size(learned: LearnedMomentum) -> FloatArray:
    """Return the size (3,) of a torque that was learned, constant and wave together."""
    return np.asarray(np.linalg.norm(np.array(learned.mean[:TORQUES]).reshape(3, 3), axis=0))


def _learned(gathered: GatheredTorque, spacecraft: Spacecraft, epoch_us: int) -> LearnedMomentum:
    """Return what quiet days told as accelerations; each part of the torque may have changed with its age."""
    scale = 1.0 / learned_units(spacecraft)
    mean = scale * np.array(gathered.mean)
    covariance = scale[:, None] * np.array(gathered.covariance) * scale
    days = max(0.0, (epoch_us - gathered.stop_us) / US_PER_S / 86_400.0)
    lost = min(1.0, _CHANGED_SHARE_DAY * days) ** 2
    fresh = LearnedMomentum(tuple(mean.tolist()), tuple(map(tuple, covariance.tolist())))
    constant, cosine, sine = map(_triple, mean[:TORQUES].reshape(3, 3))
    changed = scale_covariance(FedForward(constant, cosine, sine, *_CHANGED_SHARES, DAY_US))
    covariance[:TORQUES, :TORQUES] += lost * np.diag(np.tile(_size(fresh) ** 2, 3)) + changed
    return fresh._replace(covariance=tuple(map(tuple, covariance.tolist())))


def rate_sensor_model(spacecraft: Spacecraft | None, *, is_contradicted: bool = False) -> RateSensorModel | None:
    """Return how the rates of the body are read; None where the catalogue has no sensor beside the loop."""
    stated = None if spacecraft is None else spacecraft.onboard.rate_sensor
    if stated is None or stated.in_loop or is_contradicted:
        return None
    bias, tau_h, noise = stated.bias_deg_h, stated.bias_tau_h, stated.noise_deg_sqrt_h
    if bias is None or tau_h is None or noise is None:
        return None
    return RateSensorModel(bias, tau_h, noise)


def is_rate_in_loop(spacecraft: Spacecraft | None) -> bool:
    """Return whether the rates of the body are those of a sensor that the loop on board holds still."""
    stated = None if spacecraft is None else spacecraft.onboard.rate_sensor
    return stated is not None and stated.in_loop


def _profile(reported: FedForwardTorque, spacecraft: Spacecraft) -> FedForward:
    """Return a profile as accelerations."""
    period_us = round(reported.period_s * US_PER_S)
    phase = 2.0 * math.pi * (reported.epoch_us % period_us) / period_us
    constant, cosine, sine = (
        _accelerations(part, spacecraft) for part in (reported.constant_n_m, reported.cosine_n_m, reported.sine_n_m)
    )
    return FedForward(
        _triple(constant),
        _triple(math.cos(phase) * cosine - math.sin(phase) * sine),
        _triple(math.sin(phase) * cosine + math.cos(phase) * sine),
        reported.relative_error,
        reported.axis_relative_error,
        period_us,
    )


def _accelerations(torque_n_m: AxisTorques, spacecraft: Spacecraft) -> FloatArray:
    """Return the accelerations of yaw, roll and pitch by a torque (3,), deg/h^2."""
    torque = np.array([torque_n_m.yaw, torque_n_m.roll, torque_n_m.pitch])
    return np.asarray(torque / DEG_H2_N_M / np.array(angle_inertia_kg_m2(spacecraft)))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    yaw, roll, pitch = values.tolist()
    return yaw, roll, pitch
