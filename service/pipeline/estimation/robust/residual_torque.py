"""Torque that acts without being fed forward: whether it has shown itself, and what the filter knows of it."""

import math

import numpy as np

from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.hidden_shares import sensors_of
from service.core.estimation.filtering.model.filter_model import FilterSettings
from service.core.estimation.filtering.model.hidden_motion import is_torque_seen, sensor_states, torque_states
from service.core.estimation.filtering.model.torque_prior import is_pushed, wave_period_us
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.known_motion import DEG_H2_N_M
from service.records.epoch import US_PER_S
from service.records.levels.attitude import named_axes
from service.records.levels.disturbance import Disturbance


def is_torque_shown(state: FilterState, model: RobustModel, shares: int) -> bool:
    """Return whether the torque that nobody stated has shown itself, in the state or as motion."""
    gaussian = state.gaussian
    positions = torque_states(model.filter, gaussian, shares, sensor_states(model.settings))
    return any(state.motion.is_followed) or (positions is not None and is_torque_seen(gaussian, positions))


def known_disturbance(state: FilterState, model: RobustModel, shares: int) -> Disturbance | None:
    """Return the torque that acts without being fed forward, its phase zero at the newest row; None = there is none."""
    gaussian, epoch_us = state.gaussian, state.epoch_us
    positions = torque_states(model.filter, gaussian, shares, sensor_states(model.settings))
    if positions is None or model.inertia_kg_m2 is None or not is_pushed(model.settings):
        return None
    period_us = wave_period_us(model.settings)
    phase = 2.0 * math.pi * (epoch_us % period_us) / period_us
    cos, sin = math.cos(phase), math.sin(phase)
    # what was a cosine since phase zero is a cosine and a sine since the row
    turn = np.kron(np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]]), np.eye(3))
    unit = np.array(model.inertia_kg_m2) * DEG_H2_N_M
    constant, cosine, sine = (turn @ gaussian.mean[positions]).reshape(3, 3) * unit
    covariance = turn @ gaussian.covariance[positions, positions] @ turn.T
    now = np.kron(np.array([1.0, 1.0, 0.0]), np.eye(3))
    # the covariance of a profile has no full rank: rounding may leave less than nothing of a variance
    sigma = np.sqrt(np.maximum(0.0, np.diag(now @ covariance @ now.T))) * unit
    return Disturbance(
        epoch_us, period_us / US_PER_S, named_axes(constant), named_axes(cosine), named_axes(sine), named_axes(sigma)
    )


def torque_of(settings: FilterSettings) -> tuple[object, ...]:
    """Return what the states of torque and sensors begin with."""
    return settings.torque_deg_h2, settings.torque_constant_share, settings.fed_forward, *sensors_of(settings)
