"""Inputs of a step of time of the attitude filter: what acts on the state over the step, without the state.

    yaw' = -w roll + d_yaw + m_yaw      roll' = w yaw + d_roll + m_roll      pitch' = d_pitch + m_pitch
    d' = -d / tau + noise               m = rate left behind by torques, it does not decay

w 1/h, rates in deg/h. With z = yaw + j roll the transition is a closed form of complex exponentials, exact for steps of
a second and gaps of hours alike; the noise that the drifts leave is integrated by ten Gauss points. What hidden states
add stands in `hidden_motion`.
"""

import cmath
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    CarrierModel,
    FilterSettings,
    KnownMotion,
    core_size,
    no_motion,
)
from service.core.estimation.filtering.model.hidden_motion import (
    hidden_noise,
    hidden_transition,
    scale_noise,
    sensor_states,
)
from service.core.estimation.filtering.model.torque_prior import TORQUES
from service.core.estimation.filtering.model.wheel_momentum import momentum_rows, walked_variance

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)
#: below this product of rate and time the quotients of exponentials lose digits
_SMALL = 1e-6
_S_PER_H = 3600.0
#: of hidden states, where there are none
_NO_NOISE = np.zeros((0, 0))


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


class StepInputs(NamedTuple):
    """Inputs of a step of time: what acts on the state, without the state."""

    step_us: int
    seconds: float
    #: minutes for which the row behind the step stands, at most 1
    minutes: float
    #: (9, 9 + E) transition of the first states, hidden ones behind them, and (9, 9) noise of the drifts; three rows
    #: more where the momentum of the wheels is a state
    transition: FloatArray
    noise: FloatArray
    #: (9,) and (11,) what commands add to the first states, and variance beside the noise of the drifts; three numbers
    #: more of the momentum
    push: FloatArray
    core_variance: FloatArray
    #: (G + E,) dB and s, common parts, hidden states behind them
    common_sigma: FloatArray
    common_tau_s: FloatArray
    rain_factor: float
    #: (E', E') covariance that grows on the hidden states from a place on; empty = none
    torque_noise: FloatArray
    torque_first: int
    #: place of the momentum
    momentum_first: int
    #: whether a sensor measured the rate, which is known then
    is_rate_measured: bool


def step_inputs(
    model: CarrierModel,
    settings: FilterSettings,
    hidden: int,
    step_us: int,
    known: KnownMotion,
    is_unannounced: tuple[bool, bool, bool],
    *,
    is_raining: bool,
    from_us: int = 0,
) -> StepInputs:
    """Return the inputs of a step of a state with some hidden states.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    settings : FilterSettings
        The spacecraft.
    hidden : int
        Hidden states of the filter.
    step_us : int, microseconds
        Length of the step, > 0.
    known : KnownMotion
        Commanded corrections and torques of the step.
    is_unannounced : tuple of bool
        Whether motion that nobody announced is suspected about each axis.
    is_raining : bool
        Whether rain is kept; rain that is none is forgotten.
    from_us : int, microseconds UTC
        Epoch of the state: the hour of the day counts for a torque that goes round with the Sun.
    """
    motion = motion_over(step_us, settings)
    seconds = step_us / 1e6
    hours = seconds / _S_PER_H
    transition, noise = motion
    common_sigma, common_tau_s = model.common_sigma_db, model.common_tau_s
    shares, torque_noise = len(known.unreported), _NO_NOISE
    push, core_variance = (
        _of_no_commands(settings, hours, is_unannounced, is_raining)
        if known is no_motion()
        else _of_commands(settings, hours, known, is_unannounced, is_raining=is_raining)
    )
    if hidden:
        # beside the common parts: they fade and grow as those do
        transition = np.hstack([transition, hidden_transition(hidden, from_us, step_us, settings, known)])
        if settings.momentum is not None:
            noise, rows = _wide_noise(step_us, settings), momentum_rows(hidden, from_us, step_us, settings)
            transition, push = np.concatenate((transition, rows[:, :-1])), np.concatenate((push, rows[:, -1]))
        hidden_sigma, hidden_tau_s = hidden_noise(hidden, shares, settings)
        common_sigma = np.concatenate([common_sigma, hidden_sigma])
        common_tau_s = np.concatenate([common_tau_s, hidden_tau_s])
        if hidden - shares - sensor_states(settings) >= TORQUES:
            torque_noise = scale_noise(settings, hours)
    return StepInputs(
        step_us,
        seconds,
        min(step_us / 60e6, 1.0),
        transition,
        noise,
        push,
        core_variance,
        common_sigma,
        common_tau_s,
        1.0 if is_raining else math.exp(-seconds / settings.rain_dry_tau_s),
        torque_noise,
        core_size(model) + shares,
        core_size(model, hidden) - sensor_states(settings),
        settings.rate_noise_deg_sqrt_h is not None,
    )


@lru_cache(maxsize=64)
def _wide_noise(step_us: int, settings: FilterSettings) -> FloatArray:
    """Return the noise (12, 12) of a step of a state with the momentum of the wheels; nobody may write to it."""
    noise, drifts = walked_variance(step_us, settings) * np.eye(12), motion_over(step_us, settings).noise
    noise[: len(drifts), : len(drifts)] = drifts
    return noise


def _of_commands(
    settings: FilterSettings,
    hours: float,
    known: KnownMotion,
    is_unannounced: tuple[bool, bool, bool],
    *,
    is_raining: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return what commands add to the first states (9,), and their variance (11,) beside the noise of the drifts."""
    variance = np.array(_core_variance(settings, hours, known, is_unannounced, is_raining=is_raining))
    return _push(hours, known), variance


@lru_cache(maxsize=64)
def _of_no_commands(
    settings: FilterSettings,
    hours: float,
    is_unannounced: tuple[bool, bool, bool],
    is_raining: bool,  # noqa: FBT001 a cache takes no arguments by keyword alone as fast
) -> tuple[FloatArray, FloatArray]:
    """Return the same for a step without commands; nobody may write to the arrays."""
    return _of_commands(settings, hours, no_motion(), is_unannounced, is_raining=is_raining)


def _push(hours: float, known: KnownMotion) -> FloatArray:
    """Return the effect of commands on attitude, drift and rate (9,)."""
    # three numbers each: lists cost a third of arrays
    rates = known.rate_change_deg_h.tolist()
    angles = zip(known.correction_deg.tolist(), known.late_correction_deg.tolist(), rates, strict=True)
    attitude = [correction + late + 0.5 * hours * rate for correction, late, rate in angles]
    return np.array([*attitude, 0.0, 0.0, 0.0, *rates])


def _core_variance(
    settings: FilterSettings,
    hours: float,
    known: KnownMotion,
    is_unannounced: tuple[bool, bool, bool],
    *,
    is_raining: bool,
) -> list[float]:
    """Return the variance that a step adds to the first eleven states beside what the drifts do.

    Commanded angles have an error of scale that lasts for a whole command; late ones may be wrong altogether.
    """
    rows = max(1.0, settings.correction_span_s / (hours * _S_PER_H))
    walks = zip(settings.unannounced_walk_deg, is_unannounced, strict=True)
    rates = [settings.torque_scale * rate for rate in known.rate_change_deg_h.tolist()]
    attitude = [
        settings.correction_scale**2 * rows * correction**2
        + late**2
        + (0.5 * hours * rate) ** 2
        + (walk**2 * hours if is_followed else 0.0)
        + (settings.rate_noise_deg_sqrt_h or 0.0) ** 2 * hours
        for correction, late, rate, (walk, is_followed) in zip(
            known.correction_deg.tolist(), known.late_correction_deg.tolist(), rates, walks, strict=True
        )
    ]
    rain_db = settings.rain_wet_db if is_raining else settings.rain_dry_db
    rest = [settings.chain_walk_db**2 * hours, rain_db**2 * 60.0 * hours]
    return attitude + [0.0] * (DRIFT.stop - DRIFT.start) + [rate**2 for rate in rates] + rest
