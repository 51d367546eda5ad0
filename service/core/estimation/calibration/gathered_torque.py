"""Torque from outside that gathers in the wheels, by their telemetry on quiet days, when sensors tell the angles.

    H' = w x H + T,   T = constant + cosine cos(p) + sine sin(p),   records as in `wheel_momentum`

A misalignment of the wheels about roll or yaw looks like a constant torque; days of one attitude do not tell them
apart, but what they are together, which is what a filter needs that predicts the same wheels. The law of this file:
records are taken by the filter's own equations and its own judgement, at angles that are known.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.filter_model import ATTITUDE, RATE, FilterSettings, Gaussian
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.plant import TORQUES, torque_covariance
from service.core.estimation.filtering.wheel_momentum import (
    learned_positions,
    momentum_covariance,
    moved_momentum,
    push_record,
)

#: behind attitude, drift and rates stand the torques, then the wheels
_FIRST = RATE.stop + TORQUES


class GatheredFit(NamedTuple):
    """Torque and errors of the telemetry in the order of `LearnedMomentum`, and the records taken."""

    mean: FloatArray
    covariance: FloatArray
    records: int


def gathered_torque(
    epochs_us: IntArray,
    reported_n_m_s: FloatArray,
    attitude_deg: FloatArray,
    attitude_sigma_deg: FloatArray,
    is_unloading: BoolArray,
    settings: FilterSettings,
) -> GatheredFit | None:
    """Return the torque that gathered in the wheels; None where the records contradict the model.

    Parameters
    ----------
    epochs_us : ndarray, shape (K,), microseconds UTC
        Epochs of the records, ascending.
    reported_n_m_s : ndarray, shape (K, 3), N m s
        Momentum of the wheels along roll, pitch, yaw of the body.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; NaN rows take no part.
    attitude_sigma_deg : ndarray, shape (3,), deg
        Noise of the sensors at a record.
    is_unloading : ndarray of bool, shape (K,)
        Thrusters unload the wheels at the record.
    settings : FilterSettings
        With the momentum, its torque unknown and the only one.

    Raises
    ------
    ValueError
        The settings have no momentum.
    """
    wheels = settings.momentum
    if wheels is None:
        message = "a torque that gathers needs settings with the momentum of wheels"
        raise ValueError(message)
    gaussian, watch = _beginning(settings), SensorWatch()
    known = np.isfinite(attitude_deg).all(axis=1) & np.isfinite(reported_n_m_s).all(axis=1)
    newest_us = int(epochs_us[known][0]) if known.any() else 0
    for k in np.flatnonzero(known).tolist():
        epoch_us = int(epochs_us[k])
        moved = moved_momentum(gaussian, _FIRST, newest_us, epoch_us - newest_us, settings)
        watch, gaussian, _ = push_record(
            watch,
            _at_attitude(moved, attitude_deg[k], attitude_sigma_deg),
            _FIRST,
            epoch_us,
            reported_n_m_s[k],
            epoch_us,
            settings,
            wheels,
            is_unloading=bool(is_unloading[k]),
        )
        newest_us = epoch_us
    if watch.is_refused:
        return None
    own = learned_positions(_FIRST, settings)
    return GatheredFit(gaussian.mean[own], gaussian.covariance[np.ix_(own, own)], int(known.sum()))


def _beginning(settings: FilterSettings) -> Gaussian:
    """Return the state before the first record."""
    wheels = settings.momentum
    sensor = np.zeros((0, 0)) if wheels is None else momentum_covariance(settings, wheels)
    covariance = np.zeros((_FIRST + len(sensor),) * 2)
    covariance[RATE.stop : _FIRST, RATE.stop : _FIRST] = torque_covariance(settings)
    covariance[_FIRST:, _FIRST:] = sensor
    return Gaussian(np.zeros(len(covariance)), covariance)


def _at_attitude(gaussian: Gaussian, attitude_deg: FloatArray, sigma_deg: FloatArray) -> Gaussian:
    """Return the state at angles that sensors tell."""
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    mean[ATTITUDE] = attitude_deg
    covariance[ATTITUDE, :] = covariance[:, ATTITUDE] = 0.0
    covariance[ATTITUDE, ATTITUDE] = np.diag(sigma_deg**2)
    return Gaussian(mean, covariance)
