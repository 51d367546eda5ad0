"""Prediction of the attitude filter over any step of time.

    yaw' = -w roll + d_yaw + m_yaw      roll' = w yaw + d_roll + m_roll      pitch' = d_pitch + m_pitch
    d' = -d / tau + noise               m = rate left behind by torques, it does not decay

w 1/h, rates in deg/h. With z = yaw + j roll the transition is a closed form of complex exponentials, exact for steps of
a second and gaps of hours alike; the noise that the drifts leave is integrated by ten Gauss points.
"""

import cmath
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.declared import Declared
from service.core.estimation.filtering.filter_model import (
    CarrierModel,
    FilterSettings,
    FloatArray,
    KnownMotion,
    model_error_component,
    model_variance_db2,
)
from service.core.estimation.filtering.filter_state import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    FIRST_COMMON,
    RAIN,
    RATE,
    Gaussian,
    core_size,
    reference_states,
)

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)
#: below this product of rate and time the quotients of exponentials lose digits
_SMALL = 1e-6
_S_PER_H = 3600.0


class Motion(NamedTuple):
    """Transition of attitude, drift and commanded rate over one step."""

    #: (9, 9)
    transition: FloatArray
    #: (9, 9) covariance that the drifts add, deg and deg/h squared
    noise: FloatArray


def _quotient(exponent: complex, hours: float) -> complex:
    """Return (exp(exponent * hours) - 1) / exponent, its limit where the exponent vanishes."""
    product = exponent * hours
    return (cmath.exp(product) - 1.0) / exponent if abs(product) > _SMALL else hours * (1.0 + 0.5 * product)


def _rotation(value: complex, pitch: float) -> FloatArray:
    """Return the (3, 3) matrix of a complex factor on yaw + j roll and a real one on pitch."""
    return np.array([[value.real, -value.imag, 0.0], [value.imag, value.real, 0.0], [0.0, 0.0, pitch]])


def _drift_to_attitude(hours: float, coupling_per_h: float, tau_h: float) -> FloatArray:
    """Return what a drift of one at the start has done to the attitude after some hours."""
    decay, turn = -1.0 / tau_h, complex(0.0, coupling_per_h)
    moved = math.exp(decay * hours) * _quotient(turn - decay, hours)
    return _rotation(moved, _quotient(complex(decay), hours).real)


@lru_cache(maxsize=64)
def motion_over(step_us: int, settings: FilterSettings) -> Motion:
    """Return the exact motion over a step.

    Parameters
    ----------
    step_us : int, microseconds
        Length of the step, > 0.
    settings : FilterSettings
        Coupling and drift.

    Returns
    -------
    Motion
        Arrays nobody may write: one answer serves every step of the same length.
    """
    hours = step_us / 1e6 / _S_PER_H
    turn = complex(0.0, settings.coupling_per_h)
    transition, noise = np.eye(9), np.zeros((9, 9))
    transition[ATTITUDE, ATTITUDE] = _rotation(cmath.exp(turn * hours), 1.0)
    transition[ATTITUDE, DRIFT] = _drift_to_attitude(hours, settings.coupling_per_h, settings.drift_tau_h)
    transition[ATTITUDE, RATE] = _rotation(_quotient(turn, hours), hours)
    transition[DRIFT, DRIFT] *= math.exp(-hours / settings.drift_tau_h)
    intensity = 2.0 * np.array(settings.drift_deg_h) ** 2 / settings.drift_tau_h
    for node, weight in zip(_GAUSS_NODES.tolist(), _GAUSS_WEIGHTS.tolist(), strict=True):
        elapsed = 0.5 * hours * (1.0 + node)
        response = np.zeros((9, 3))
        response[ATTITUDE] = _drift_to_attitude(elapsed, settings.coupling_per_h, settings.drift_tau_h)
        response[DRIFT] = math.exp(-elapsed / settings.drift_tau_h) * np.eye(3)
        noise += 0.5 * hours * weight * (response * intensity) @ response.T
    noise = 0.5 * (noise + noise.T)
    transition.setflags(write=False)
    noise.setflags(write=False)
    return Motion(transition, noise)


class Weather(NamedTuple):
    """What the detectors say about the step to be predicted."""

    is_raining: bool
    #: (3,) whether motion that nobody announced is suspected about each axis
    is_unannounced: tuple[bool, bool, bool]
    #: factor on the slow noise of the carriers, learned from the innovations
    slow_scale: float
    #: (N,) error of the calibration that the state holds already, dB^2
    model_variance_db2: FloatArray
    #: what the ground declared about the step; None = nothing
    declared: Declared | None = None


def predict(
    model: CarrierModel, settings: FilterSettings, state: Gaussian, step_us: int, known: KnownMotion, weather: Weather
) -> tuple[Gaussian, FloatArray]:
    """Return the state after a step, before its measurement.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The craft.
    state : Gaussian
        State before the step.
    step_us : int, microseconds
        Length of the step, > 0.
    known : KnownMotion
        Commanded corrections and torques of the step.
    weather : Weather
        Rain, suspicion, scale of noise, declared operations.

    Returns
    -------
    Gaussian
        Predicted state.
    ndarray, shape (N,), dB^2
        Error of the calibration that the state holds now, for the next step's `Weather`.
    """
    motion = motion_over(step_us, settings)
    hours, core = step_us / 1e6 / _S_PER_H, core_size(model)
    factor = _decay(model, settings, hours, is_raining=weather.is_raining)
    mean, covariance = state.mean * factor, np.multiply.outer(factor, factor)
    covariance *= state.covariance
    moved = motion.transition @ covariance[:9]
    own = moved[:, :9] @ motion.transition.T
    moved[:, :9] = 0.5 * (own + own.T)
    # one product serves both sides: symmetric to the last bit
    covariance[:9], covariance[:, :9] = moved, moved.T
    mean[:9] = motion.transition @ mean[:9]
    mean[ATTITUDE] += known.correction_deg + known.late_correction_deg + 0.5 * hours * known.rate_change_deg_h
    mean[RATE] += known.rate_change_deg_h
    covariance[:9, :9] += motion.noise
    added, variance = _added_noise(model, settings, mean, hours, known, weather, factor[core:])
    diagonal = covariance.ravel()[:: len(mean) + 1]
    diagonal += added
    if weather.declared is not None:
        diagonal += _declared_variance(model, weather.declared, hours)
        _move_together(model, covariance, weather.declared.group_step_db)
    return Gaussian(mean, covariance), variance


def _decay(model: CarrierModel, settings: FilterSettings, hours: float, *, is_raining: bool) -> FloatArray:
    """Return the factor (D,) on every state; attitude, drift and rate keep theirs for the motion."""
    core = np.ones(FIRST_COMMON)
    if not is_raining:
        core[RAIN] = math.exp(-hours * _S_PER_H / settings.rain_dry_tau_s)
    seconds = hours * _S_PER_H
    return np.concatenate(
        [
            core,
            np.exp(-seconds / model.common_tau_s),
            np.exp(-seconds / model.coloured_tau_s).T.ravel(),
            np.ones(model.carriers),
        ]
    )


def _added_noise(
    model: CarrierModel,
    settings: FilterSettings,
    mean: FloatArray,
    hours: float,
    known: KnownMotion,
    weather: Weather,
    carrier_decay: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the variance (D,) that a step adds beside the drifts, and the calibration's error now."""
    core = np.zeros(core_size(model))
    core[ATTITUDE] = _commanded_variance(settings, hours, known)
    core[ATTITUDE] += np.array(weather.is_unannounced) * np.array(settings.unannounced_walk_deg) ** 2 * hours
    core[RATE] = (settings.torque_scale * known.rate_change_deg_h) ** 2
    core[CHAIN] = settings.chain_walk_db**2 * hours
    core[RAIN] = (settings.rain_wet_db if weather.is_raining else settings.rain_dry_db) ** 2 * 60.0 * hours
    core[FIRST_COMMON:] = model.common_sigma_db**2 * -np.expm1(-2.0 * hours * _S_PER_H / model.common_tau_s)
    component = model_error_component(model)
    variance = model_variance_db2(model, mean[ATTITUDE])
    keep2 = carrier_decay[: model.carriers * model.components].reshape(model.components, model.carriers).T ** 2
    coloured = (weather.slow_scale * model.coloured_sigma_db) ** 2 * (1.0 - keep2)
    at = np.arange(model.carriers)
    # a growing error is added at once: the attitude has moved, and the error with it
    grown = variance - keep2[at, component] * weather.model_variance_db2
    coloured[at, component] += np.maximum(grown, (1.0 - keep2[at, component]) * variance)
    walk = (weather.slow_scale * model.reference_walk_db) ** 2 * hours
    return np.concatenate([core, coloured.T.ravel(), walk]), variance


def _declared_variance(model: CarrierModel, declared: Declared, hours: float) -> FloatArray:
    """Return the variance (D,) that declared operations add to single states."""
    added = np.zeros(core_size(model) + model.carriers * (model.components + 1))
    added[ATTITUDE] = declared.attitude_walk_deg**2 * hours + declared.attitude_step_deg**2
    added[CHAIN] = declared.chain_walk_db**2 * hours + declared.chain_step_db**2
    added[-model.carriers :] = declared.reference_walk_db**2 * hours + declared.reference_step_db**2
    return added


def _move_together(model: CarrierModel, covariance: FloatArray, group_step_db: FloatArray) -> None:
    """Add to a covariance, in place, that the references of each transponder moved by one and the same amount."""
    for transponder in np.flatnonzero(group_step_db).tolist():
        places = reference_states(model, np.flatnonzero(model.transponder == transponder))
        covariance[np.ix_(places, places)] += group_step_db[transponder] ** 2


def _commanded_variance(settings: FilterSettings, hours: float, known: KnownMotion) -> FloatArray:
    """Return the variance (3,) of commanded angles: one error of scale lasts for a whole command."""
    rows = max(1.0, settings.correction_span_s / (hours * _S_PER_H))
    scale = settings.correction_scale**2 * rows * known.correction_deg**2
    torque = (0.5 * hours * settings.torque_scale * known.rate_change_deg_h) ** 2
    return np.asarray(scale + known.late_correction_deg**2 + torque)
