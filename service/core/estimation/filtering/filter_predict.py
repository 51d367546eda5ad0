"""Prediction of the attitude filter over any step of time: what acts on it stands in `step_inputs`."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.kernels import state_kernels
from service.core.estimation.filtering.model.declared import Declared
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    CHAIN,
    RATE,
    CarrierModel,
    FilterSettings,
    Gaussian,
    KnownMotion,
    core_size,
    hidden_count,
    model_variance_db2,
    no_motion,
    reference_states,
)
from service.core.estimation.filtering.model.hidden_motion import hidden_transition, sensor_states, sensors_first
from service.core.estimation.filtering.model.step_inputs import StepInputs, motion_over, step_inputs
from service.core.estimation.filtering.model.torque_prior import TORQUES, is_pushed

_S_PER_H = 3600.0
#: the period of the control law, for which the spacecraft may be left alone
_ALONE_US = 7200 * 10**6
#: how much worse than its mean a torque is taken, and how sure an angle must be, in sigmas: two of an angle would bring
#: `flicker_hard` 9 min of wrong torque for 4, three `transponder` 1 min for none
_TORQUE_SIGMAS, _ANGLE_SIGMAS = 2.0, 4.0

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
    model: CarrierModel, state: Gaussian, step: StepInputs, slow_scale: float, held_variance_db2: FloatArray
) -> tuple[Gaussian, FloatArray]:
    """Return the state after a step, and the error (N,) of the calibration that it holds then, dB^2.

    `slow_scale` is the factor on the slow noise of the carriers; the calibration's error was `held_variance_db2` (N,)
    before.
    """
    mean, covariance, factor = state_kernels.fade(
        state.mean, state.covariance, step.rain_factor, step.seconds, step.common_tau_s, model.coloured_tau_s
    )
    if step.is_rate_measured:
        state_kernels.know_rate(covariance)
    state_kernels.turn(mean, covariance, step.transition, step.noise, step.push, core_size(model), step.momentum_first)
    variance = model_variance_db2(model.coefficient_covariance, mean[ATTITUDE])
    state_kernels.add_process_noise(
        covariance,
        factor,
        step.core_variance,
        step.common_sigma,
        model.coloured_sigma_db,
        model.coloured_tau_s,
        model.reference_walk_db,
        slow_scale**2,
        step.seconds / _S_PER_H,
        held_variance_db2,
        variance,
    )
    first, behind = step.torque_first, step.torque_first + len(step.torque_noise)
    if behind > first:
        covariance[first:behind, first:behind] += step.torque_noise
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
    model, settings, step_us, known, from_us
        As `step_inputs` takes them.
    state : Gaussian
        State before the step.
    weather : Weather
        Rain, suspicion, scale of noise, declared operations.
    mover : callable
        `move_state`, compiled or not.

    Returns
    -------
    Gaussian
        Predicted state.
    ndarray, shape (N,), dB^2
        Error of the calibration that the state holds now, for the next step's `Weather`.
    """
    hidden = hidden_count(model, len(state.mean))
    is_unannounced, is_raining = weather.is_unannounced, weather.is_raining
    step = step_inputs(model, settings, hidden, step_us, known, is_unannounced, is_raining=is_raining, from_us=from_us)
    moved, variance = mover(model, state, step, weather.slow_scale, weather.model_variance_db2)
    if weather.declared is not None:
        size, hours = len(moved.mean), step.seconds / _S_PER_H
        moved.covariance.ravel()[:: size + 1] += _declared_variance(model, weather.declared, hours, size)
        _move_together(model, moved.covariance, weather.declared.group_step_db)
    return moved, variance


def waiting_loss_deg(model: CarrierModel, settings: FilterSettings, state: Gaussian, epoch_us: int) -> FloatArray:
    """Return what is lost about yaw, roll and pitch (3,) in two hours without control, deg.

    The greater of two angles: by how much the torque may turn the axis, mean and two sigmas, and how far from zero the
    axis will surely be, mean less four sigmas. An angle that may as well be an error of the estimate is none of them:
    control would not remove it.
    """
    places = np.arange(RATE.stop)
    turns = motion_over(_ALONE_US, settings).transition[ATTITUDE]
    pushed = np.zeros(3)
    if is_pushed(settings):
        stop, hidden = sensors_first(model, state, settings), TORQUES + sensor_states(settings)
        torque = np.arange(stop - TORQUES, stop)
        by_torque = hidden_transition(hidden, epoch_us, _ALONE_US, settings, no_motion())[ATTITUDE, :TORQUES]
        mean_deg, sigma_deg = _combined(by_torque, state, torque)
        pushed = np.abs(mean_deg) + _TORQUE_SIGMAS * sigma_deg
        places, turns = np.append(places, torque), np.hstack([turns, by_torque])
    mean_deg, sigma_deg = _combined(turns, state, places)
    return np.maximum(pushed, np.abs(mean_deg) - _ANGLE_SIGMAS * sigma_deg)


def _combined(matrix: FloatArray, state: Gaussian, places: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and sigma (3,) of combinations (3, P) of some states."""
    variance = ((matrix @ state.covariance[places[:, None], places]) * matrix).sum(axis=1)
    return matrix @ state.mean[places], np.sqrt(np.maximum(variance, 0.0))


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
