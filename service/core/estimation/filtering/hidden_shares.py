"""Shares and torques that come to the states of a running filter, or leave them.

The law of this file: whatever holds one number a state moves with the states: mean, covariance and what the watch on
commands derives.
"""

import numpy as np

from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.model.filter_model import CarrierModel, FilterSettings, Gaussian, core_size
from service.core.estimation.filtering.model.hidden_motion import (
    SHARE_SIGMA,
    dropped,
    inserted,
    sensor_states,
    torque_states,
    with_wider_torque,
)
from service.core.estimation.filtering.model.polarimeter import polarimeter_covariance, with_learned_feeds
from service.core.estimation.filtering.model.torque_prior import (
    TORQUES,
    has_torque,
    is_pushed,
    torque_covariance,
    torque_prior_deg_h2,
)
from service.core.estimation.filtering.model.wheel_momentum import momentum_covariance, with_learned_momentum
from service.core.estimation.filtering.watches.command_watch import executed_commands


def with_share(model: CarrierModel, state: FilterState, shares: int) -> FilterState:
    """Return the state with one share more, of which nothing is known, behind those it has."""
    position = core_size(model, shares)
    gaussian = inserted(state.gaussian, position, np.array([[SHARE_SIGMA**2]]))
    command = state.command
    if len(command.sensitivity):
        command = command._replace(sensitivity=np.insert(command.sensitivity, position, 0.0, axis=0))
    return state._replace(gaussian=gaussian, command=command)


def without_shares(model: CarrierModel, state: FilterState, shares: int) -> FilterState:
    """Return the state without its shares."""
    positions = slice(core_size(model), core_size(model, shares))
    command = state.command
    if len(command.sensitivity):
        command = command._replace(sensitivity=np.delete(command.sensitivity, positions, axis=0))
    return state._replace(gaussian=dropped(state.gaussian, positions), command=command)


def with_torque(model: CarrierModel, gaussian: Gaussian, settings: FilterSettings) -> Gaussian:
    """Return the state at an alignment, which has no hidden states, with those of the torque that is stated, if any."""
    return _begun(gaussian, core_size(model), settings)


def with_stated_torque(
    model: CarrierModel, state: FilterState, shares: int, before: FilterSettings, after: FilterSettings
) -> FilterState:
    """Return the state after the catalogue states another torque that is not fed forward.

    Where it states one for the first time its states come, where it states none they go; a greater one is known less.
    What was learned under another profile is learned again: its shares and its wave are not those of the new one.
    """
    gaussian, positions = state.gaussian, torque_states(model, state.gaussian, shares, sensor_states(before))
    if sensors_of(before) != sensors_of(after):
        return _with_stated_sensors(model, state, shares, before, after)
    if positions is not None and (before.fed_forward != after.fed_forward or not is_pushed(after)):
        gaussian, positions = dropped(gaussian, positions), None
    if positions is not None:
        grown = torque_prior_deg_h2(after) ** 2 - torque_prior_deg_h2(before) ** 2
        gaussian = with_wider_torque(gaussian, positions, np.maximum(0.0, grown))
    elif is_pushed(after):
        gaussian = inserted(gaussian, core_size(model, shares), torque_covariance(after))
    command = executed_commands()._replace(share=state.command.share, minutes_left=state.command.minutes_left)
    return state._replace(gaussian=gaussian, command=command)


def sensors_of(settings: FilterSettings) -> tuple[object, ...]:
    """Return what the states of sensors begin with; a filter that runs knows more than new quiet days tell."""
    wheels = settings.momentum
    if wheels is not None and wheels.learned is not None:
        wheels = wheels._replace(learned=None, unknown_torque_deg_h2=None)
    return wheels, tuple(each._replace(learned=None) for each in settings.polarimeters)


def _begun(gaussian: Gaussian, position: int, settings: FilterSettings) -> Gaussian:
    """Return the state with the states of torque, wheels and polarimeters at a place, where there are any."""
    if settings.polarimeters:
        gaussian = inserted(gaussian, position, polarimeter_covariance(settings))
        gaussian = with_learned_feeds(gaussian, position, settings)
    if settings.momentum is not None:
        gaussian = inserted(gaussian, position, momentum_covariance(settings, settings.momentum))
    if not has_torque(settings):
        return gaussian
    gaussian = inserted(gaussian, position, torque_covariance(settings))
    return with_learned_momentum(gaussian, position + TORQUES, settings)


def _with_stated_sensors(
    model: CarrierModel, state: FilterState, shares: int, before: FilterSettings, after: FilterSettings
) -> FilterState:
    """Return the state after the catalogue states other wheels or polarimeters: they and torques begin again."""
    first = core_size(model, shares)
    known = (TORQUES if has_torque(before) else 0) + sensor_states(before)
    gaussian = _begun(dropped(state.gaussian, slice(first, first + known)), first, after)
    command = executed_commands()._replace(share=state.command.share, minutes_left=state.command.minutes_left)
    return state._replace(gaussian=gaussian, command=command)
