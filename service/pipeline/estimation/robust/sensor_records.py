"""Records of other sensors that are due before a row: wheels, polarimeters, and the rate of the body."""

import math
from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.motion_sensor import NEVER_US, NO_EFFECT, SensorEffect, SensorWatch
from service.core.estimation.filtering.plant import POLARIMETER, momentum_count
from service.core.estimation.filtering.polarimeter import push_block
from service.core.estimation.filtering.rate_sensor import HELD_US, commanded_rate, push_rates
from service.core.estimation.filtering.state_changes import sensors_first
from service.core.estimation.filtering.wheel_momentum import push_record, with_impossible
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.estimation.robust.robust_state import (
    RobustState,
)
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.inputs.knowledge import Knowledge, records_between
from service.pipeline.inputs.known_motion import (
    consume,
)
from service.pipeline.inputs.polarization import due_block, orbit_turn_deg
from service.pipeline.inputs.sensor_angles import inertial_deg_h
from service.records.catalogue import Spacecraft, WheelMomentum
from service.records.epoch import US_PER_S
from service.records.inputs import TelemetryRecord


def with_polarization(
    state: RobustState, model: RobustModel, knowledge: Knowledge
) -> tuple[RobustState, list[SensorEffect]]:
    """Return the state after the blocks of the polarimeters that are due at its epoch, and the effect of each."""
    settings, epoch_us = model.settings, state.filter.epoch_us
    if knowledge.spacecraft is None or not settings.polarimeters:
        return state, []
    gaussian, effects = state.filter.gaussian, []
    first = sensors_first(model.filter, len(gaussian.mean), settings) + momentum_count(settings)
    watches = list(state.polarimeters or (SensorWatch(epoch_us),) * len(settings.polarimeters))
    for number, stated in enumerate(model.polarimeters):
        read = settings.polarimeters[number]
        block = due_block(knowledge.polarization.get(stated.source, ()), stated, watches[number].newest_us, epoch_us)
        if block is None:
            continue
        at_us = np.array([block.epoch_us], dtype=np.int64)
        turned_deg = orbit_turn_deg(knowledge.ephemeris, knowledge.spacecraft, read.sight, at_us)
        block = block._replace(angle_deg=block.angle_deg - float(turned_deg[0]))
        if math.isfinite(block.angle_deg):
            watches[number], gaussian, effect = push_block(
                watches[number], gaussian, first + POLARIMETER * number, block, epoch_us, read
            )
            effects.append(effect)
    if effects or not state.polarimeters:
        state = replace(state, filter=state.filter.with_gaussian(gaussian), polarimeters=tuple(watches))
    return state, effects


_US_PER_H = 3.6e9


def with_rates(
    state: RobustState, model: RobustModel, knowledge: Knowledge, to_us: int
) -> tuple[RobustState, RobustModel]:
    """Return state and model for the step up to an epoch: that of the measured rate where one is known."""
    sensor, watch, from_us = model.rate_sensor, state.rates, state.filter.epoch_us
    if sensor is None or watch.is_refused or to_us <= from_us:
        return state, model
    known, _ = consume(state.commanded, from_us, to_us)
    commanded = commanded_rate(watch, state.filter) + known.correction_deg * (_US_PER_H / (to_us - from_us))
    records = records_between(knowledge.rates, max(watch.newest_us, from_us - HELD_US), to_us)
    watch, moved = push_rates(
        watch,
        state.filter,
        np.array([one.epoch_us for one in records], dtype=np.int64),
        inertial_deg_h([one.body_rate_deg_s for one in records if one.body_rate_deg_s is not None]),
        to_us,
        commanded,
        model.settings,
        sensor,
        is_pushed=bool(known.rate_change_deg_h.any() or state.released),
    )
    return replace(state, filter=moved, rates=watch), model.measured if watch.is_measured else model


#: a momentum along pitch that is off the stated one by more than this share of it is of other wheels or another unit;
#: a stated one below the limit, N m s, tells nothing
_BIAS_SHARE, _LEAST_N_M_S = 0.5, 1.0
#: a record older than the newest row by more than this is not used
_LATE_US = 900 * US_PER_S


def with_records(
    state: RobustState, model: RobustModel, knowledge: Knowledge, to_us: int, recorder: RowRecorder | None
) -> tuple[RobustState, RobustModel]:
    """Return state and model for a row of an epoch, with the records of wheels, polarimeters and rates that are due."""
    if not model.has_sensors:
        return state, model
    began = state.filter.mean
    state, of_wheels = with_momenta(state, model, knowledge)
    state, of_angles = with_polarization(state, model, knowledge)
    state, model = with_rates(state, model, knowledge, to_us)
    if recorder is not None:
        moved = None if model.rate_sensor is None else state.filter
        recorder.sense(began, (*of_wheels, *of_angles), moved, is_measured=state.rates.is_measured)
    return state, model


def with_momenta(
    state: RobustState, model: RobustModel, knowledge: Knowledge
) -> tuple[RobustState, list[SensorEffect]]:
    """Return the state after the records of the wheels that are due at its epoch, and the effect of each."""
    if model.settings.momentum is None or model.wheel_axes is None or knowledge.spacecraft is None:
        return state, []
    effects = []
    for record in _due_momenta(state, knowledge):
        state, effect = _with_momentum(state, model, knowledge.spacecraft, record)
        effects.append(effect)
    return state, effects


def _due_momenta(state: RobustState, knowledge: Knowledge) -> tuple[TelemetryRecord, ...]:
    """Return the records up to the epoch of a state that were not used.

    A filter begins with the first record of after its alignment; one of before it serves only while none follows.
    """
    epoch_us, newest_us = state.filter.epoch_us, state.momentum.newest_us
    records = records_between(knowledge.momenta, max(newest_us, epoch_us - _LATE_US - 1), epoch_us)
    if newest_us != NEVER_US or knowledge.alignment is None or not records:
        return records
    after_alignment = records_between(records, knowledge.alignment.epoch_us - 1, epoch_us)
    return after_alignment or tuple(record for record in records if record is knowledge.momenta[-1])


def _with_momentum(
    state: RobustState, model: RobustModel, spacecraft: Spacecraft, record: TelemetryRecord
) -> tuple[RobustState, SensorEffect]:
    """Return the state after a record of the wheels that is not later, and its effect."""
    wheels, wheel_axes, wheel_n_m_s = model.settings.momentum, model.wheel_axes, record.wheel_momentum_n_m_s
    if wheels is None or wheel_axes is None or wheel_n_m_s is None or len(wheel_n_m_s) != len(wheel_axes):
        return state, NO_EFFECT
    momentum_n_m_s = np.array(wheel_n_m_s) @ wheel_axes
    too_much = max(map(abs, wheel_n_m_s)) > spacecraft.wheels.momentum_limit_n_m_s
    if too_much or _is_off_bias(float(momentum_n_m_s[1]), spacecraft.onboard.momentum):
        # a first record of another unit, sign or spacecraft would be believed, a later one is a wild record
        return replace(state, momentum=with_impossible(state.momentum)), NO_EFFECT
    gaussian = state.filter.gaussian
    watch, gaussian, effect = push_record(
        state.momentum,
        gaussian,
        sensors_first(model.filter, len(gaussian.mean), model.settings),
        record.epoch_us,
        momentum_n_m_s,
        state.filter.epoch_us,
        model.settings,
        wheels,
        is_unloading=bool(record.thrusters_active),
    )
    return replace(state, filter=state.filter.with_gaussian(gaussian), momentum=watch), effect


def _is_off_bias(pitch_n_m_s: float, stated: WheelMomentum | None) -> bool:
    """Return whether a momentum along pitch cannot be that of the spacecraft, by what the catalogue states."""
    bias = None if stated is None else stated.pitch_bias_n_m_s
    return bias is not None and abs(bias) >= _LEAST_N_M_S and abs(pitch_n_m_s - bias) > _BIAS_SHARE * abs(bias)
