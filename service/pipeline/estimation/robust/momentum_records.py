"""Records of wheel momentum on their way to the filter: each is used once, with the first row that is later."""

from dataclasses import replace
from typing import Any

import numpy as np

from service.core.estimation.filtering.model.hidden_motion import sensors_first
from service.core.estimation.filtering.model.sensor_effect import NO_EFFECT, SensorEffect
from service.core.estimation.filtering.watches.momentum_watch import NEVER_US, push_record, with_impossible
from service.pipeline.estimation.robust.method import RobustState, RobustStep, step_robust
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.estimation.robust.polarization_records import with_polarization
from service.pipeline.estimation.robust.rate_records import with_rates
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.inputs.knowledge import Knowledge, records_between
from service.records.catalogue import Spacecraft, WheelMomentum
from service.records.epoch import US_PER_S
from service.records.inputs import TelemetryRecord
from service.records.levels.measurement import Measurement

#: a momentum along pitch that is off the stated one by more than this share of it is of other wheels or another unit;
#: a stated one below the limit, N m s, tells nothing
_BIAS_SHARE, _LEAST_N_M_S = 0.5, 1.0
#: a record older than the newest row by more than this is not used
_LATE_US = 900 * US_PER_S


def step_with_record(
    state: RobustState,
    *,
    model: RobustModel,
    knowledge: Knowledge,
    measurement: Measurement,
    is_late: bool,
    recorder: RowRecorder | None = None,
    **inputs: Any,
) -> RobustStep:
    """Take the records of wheels, polarimeters and rates that are due, then a row, as `step_robust` does."""
    if not is_late:
        began = state.filter.gaussian
        state, of_wheels = with_momenta(state, model, knowledge)
        state, of_angles = with_polarization(state, model, knowledge)
        state, model = with_rates(state, model, knowledge, measurement.epoch_us)
        if recorder is not None:
            moved = None if model.rate_sensor is None else state.filter
            recorder.sense(began.mean, (*of_wheels, *of_angles), moved, is_measured=state.rates.is_measured)
    return step_robust(state, model, knowledge, measurement, is_late=is_late, recorder=recorder, **inputs)


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
        sensors_first(model.filter, gaussian, model.settings),
        record.epoch_us,
        momentum_n_m_s,
        state.filter.epoch_us,
        model.settings,
        wheels,
        is_unloading=bool(record.thrusters_active),
    )
    return replace(state, filter=state.filter._replace(gaussian=gaussian), momentum=watch), effect


def _is_off_bias(pitch_n_m_s: float, stated: WheelMomentum | None) -> bool:
    """Return whether a momentum along pitch cannot be that of the spacecraft, by what the catalogue states."""
    bias = None if stated is None else stated.pitch_bias_n_m_s
    return bias is not None and abs(bias) >= _LEAST_N_M_S and abs(pitch_n_m_s - bias) > _BIAS_SHARE * abs(bias)
