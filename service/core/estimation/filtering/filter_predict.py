"""Prediction of the attitude filter over any step of time.

    yaw' = -w roll + d_yaw + m_yaw      roll' = w yaw + d_roll + m_roll      pitch' = d_pitch + m_pitch
    d' = -d / tau + noise               m = rate left behind by torques, it does not decay

w 1/h, rates in deg/h. With z = yaw + j roll the transition is a closed form of complex exponentials, exact for steps of
a second and gaps of hours alike; the noise that the drifts leave is integrated by ten Gauss points. What hidden states
add stands in `hidden_motion`.
"""

import cmath
import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.kernels import state_kernels
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    CarrierModel,
    FilterSettings,
    FloatArray,
    KnownMotion,
    model_variance_db2,
)
from service.core.estimation.filtering.model.filter_state import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    RATE,
    Gaussian,
    core_size,
    hidden_count,
    reference_states,
)
from service.core.estimation.filtering.model.hidden_motion import (
    MOMENTUM,
    add_scale_noise,
    hidden_noise,
    hidden_transition,
)
from service.core.estimation.filtering.model.torque_prior import TORQUES, has_torque
from service.core.estimation.filtering.model.wheel_momentum import moved_momentum

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)
#: below this product of rate and time the quotients of exponentials lose digits
_SMALL = 1e-6
_S_PER_H = 3600.0


class TransitionMatrices(NamedTuple):
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
    """Return the effect of a unit drift at the start on the attitude after some hours."""
    decay, turn = -1.0 / tau_h, complex(0.0, coupling_per_h)
    # the difference of the two exponentials, written so that a gap of months does not overflow
    moved = cmath.exp(turn * hours) * _quotient(decay - turn, hours)
    return _rotation(moved, _quotient(complex(decay), hours).real)


@lru_cache(maxsize=64)
def motion_over(step_us: int, settings: FilterSettings) -> TransitionMatrices:
    """Return the exact motion over a step.

    Parameters
    ----------
    step_us : int, microseconds
        Length of the step, > 0.
    settings : FilterSettings
        Coupling and drift.

    Returns
    -------
    TransitionMatrices
        Nobody may write to the arrays: one answer serves every step of the same length.
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
    return TransitionMatrices(transition, noise)


#: `move_state`, compiled or not
Mover = Callable[..., tuple[Gaussian, FloatArray]]


class Weather(NamedTuple):
    """Findings of the detectors for the step to be predicted."""

    is_raining: bool
    #: (3,) whether motion that nobody announced is suspected about each axis
    is_unannounced: tuple[bool, bool, bool]
    #: factor on the slow noise of the carriers, learned from the innovations
    slow_scale: float
    #: (N,) error of the calibration that the state holds already, dB^2
    model_variance_db2: FloatArray
    #: what the ground declared about the step; None = nothing
    declared: Declared | None = None


def move_state(
    model: CarrierModel,
    state: Gaussian,
    motion: TransitionMatrices,
    push: FloatArray,
    core_variance: FloatArray,
    common_sigma: FloatArray,
    common_tau_s: FloatArray,
    seconds: float,
    rain_factor: float,
    slow_scale: float,
    held_variance_db2: FloatArray,
) -> tuple[Gaussian, FloatArray]:
    """Return the state after a step, and the error (N,) of the calibration that it holds then, dB^2.

    Hidden states (E,) stand behind the common parts, with columns of the transition (9, 9 + E) and, after those of the
    common parts, sigma and correlation time (G + E,) of their own. Push (9,) and variance (11,) are what the step adds
    to the first states; the calibration's error was `held_variance_db2` (N,) before.
    """
    mean, covariance, factor = state_kernels.fade(
        state.mean, state.covariance, rain_factor, seconds, common_tau_s, model.coloured_tau_s
    )
    state_kernels.turn(mean, covariance, motion.transition, motion.noise, push, core_size(model))
    variance = model_variance_db2(model.coefficient_covariance, mean[ATTITUDE])
    state_kernels.add_process_noise(
        covariance,
        factor,
        core_variance,
        common_sigma,
        model.coloured_sigma_db,
        model.coloured_tau_s,
        model.reference_walk_db,
        slow_scale**2,
        seconds / _S_PER_H,
        held_variance_db2,
        variance,
    )
    return Gaussian(mean, covariance), variance


def predict(
    model: CarrierModel,
    settings: FilterSettings,
    state: Gaussian,
    step_us: int,
    known: KnownMotion,
    weather: Weather,
    mover: Mover = move_state,
    from_us: int = 0,
) -> tuple[Gaussian, FloatArray]:
    """Return the state after a step, before its measurement.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The spacecraft.
    state : Gaussian
        State before the step.
    step_us : int, microseconds
        Length of the step, > 0.
    known : KnownMotion
        Commanded corrections and torques of the step.
    weather : Weather
        Rain, suspicion, scale of noise, declared operations.
    mover : callable
        `move_state`, compiled or not.
    from_us : int, microseconds UTC
        Epoch of the state: the hour of the day counts for a torque that goes round with the Sun.

    Returns
    -------
    Gaussian
        Predicted state.
    ndarray, shape (N,), dB^2
        Error of the calibration that the state holds now, for the next step's `Weather`.
    """
    motion = motion_over(step_us, settings)
    seconds = step_us / 1e6
    hours = seconds / _S_PER_H
    # rain that is none is forgotten
    rain_factor = 1.0 if weather.is_raining else math.exp(-seconds / settings.rain_dry_tau_s)
    hidden = hidden_count(model, len(state.mean))
    transition, common_sigma, common_tau_s = motion.transition, model.common_sigma_db, model.common_tau_s
    if settings.momentum is not None:
        first = core_size(model, hidden) - MOMENTUM
        state = moved_momentum(
            state, first, from_us, step_us, settings, settings.momentum, has_torque=has_torque(settings)
        )
    if hidden:
        # beside the common parts: they fade and grow as those do
        transition = np.hstack([transition, hidden_transition(hidden, from_us, step_us, settings, known)])
        hidden_sigma, hidden_tau_s = hidden_noise(hidden, len(known.unreported), settings)
        common_sigma = np.concatenate([common_sigma, hidden_sigma])
        common_tau_s = np.concatenate([common_tau_s, hidden_tau_s])
    moved, variance = mover(
        model,
        state,
        TransitionMatrices(transition, motion.noise),
        _push(hours, known),
        np.array(_core_variance(settings, hours, known, weather)),
        common_sigma,
        common_tau_s,
        seconds,
        rain_factor,
        weather.slow_scale,
        weather.model_variance_db2,
    )
    if hidden - len(known.unreported) >= TORQUES:
        add_scale_noise(moved.covariance, core_size(model) + len(known.unreported), settings, hours)
    if weather.declared is not None:
        size = len(moved.mean)
        moved.covariance.ravel()[:: size + 1] += _declared_variance(model, weather.declared, hours, size)
        _move_together(model, moved.covariance, weather.declared.group_step_db)
    return moved, variance


def _push(hours: float, known: KnownMotion) -> FloatArray:
    """Return the effect of commands on attitude, drift and rate (9,)."""
    # three numbers each: lists cost a third of arrays
    rates = known.rate_change_deg_h.tolist()
    angles = zip(known.correction_deg.tolist(), known.late_correction_deg.tolist(), rates, strict=True)
    attitude = [correction + late + 0.5 * hours * rate for correction, late, rate in angles]
    return np.array([*attitude, 0.0, 0.0, 0.0, *rates])


def _core_variance(settings: FilterSettings, hours: float, known: KnownMotion, weather: Weather) -> list[float]:
    """Return the variance that a step adds to the first eleven states beside what the drifts do.

    Commanded angles have an error of scale that lasts for a whole command; late ones may be wrong altogether.
    """
    rows = max(1.0, settings.correction_span_s / (hours * _S_PER_H))
    walks = zip(settings.unannounced_walk_deg, weather.is_unannounced, strict=True)
    rates = [settings.torque_scale * rate for rate in known.rate_change_deg_h.tolist()]
    attitude = [
        settings.correction_scale**2 * rows * correction**2
        + late**2
        + (0.5 * hours * rate) ** 2
        + (walk**2 * hours if is_followed else 0.0)
        for correction, late, rate, (walk, is_followed) in zip(
            known.correction_deg.tolist(), known.late_correction_deg.tolist(), rates, walks, strict=True
        )
    ]
    rain_db = settings.rain_wet_db if weather.is_raining else settings.rain_dry_db
    rest = [settings.chain_walk_db**2 * hours, rain_db**2 * 60.0 * hours]
    return attitude + [0.0] * (DRIFT.stop - DRIFT.start) + [rate**2 for rate in rates] + rest


def _declared_variance(model: CarrierModel, declared: Declared, hours: float, states: int) -> FloatArray:
    """Return the variance (D,) that declared operations add to single states."""
    added = np.zeros(states)
    added[ATTITUDE] = declared.attitude_walk_deg**2 * hours + declared.attitude_step_deg**2
    added[CHAIN] = declared.chain_walk_db**2 * hours + declared.chain_step_db**2
    added[-model.carriers :] = declared.reference_walk_db**2 * hours + declared.reference_step_db**2
    return added


def _move_together(model: CarrierModel, covariance: FloatArray, group_step_db: FloatArray) -> None:
    """Add to a covariance, in place, that the references of each transponder moved by one and the same amount."""
    hidden = hidden_count(model, len(covariance))
    for transponder in np.flatnonzero(group_step_db).tolist():
        positions = reference_states(model, np.flatnonzero(model.transponder == transponder), hidden)
        covariance[np.ix_(positions, positions)] += group_step_db[transponder] ** 2
