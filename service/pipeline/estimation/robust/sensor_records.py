"""Records of other sensors that are due before a row: wheels, polarimeters, and the rate of the body."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.filtering.filter_state import NEVER_US, FilterState
from service.core.estimation.filtering.rate_sensor import HELD_US
from service.core.estimation.filtering.row_block import ANGLE, BODY_RATE, RECORD, WHEELS
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.knowledge import Knowledge, records_between
from service.pipeline.inputs.polarization import due_block
from service.pipeline.inputs.sensor_angles import inertial_deg_h
from service.records.catalogue import WheelMomentum
from service.records.epoch import US_PER_S

#: a momentum along pitch that is off the stated one by more than this share of it is of other wheels or another unit;
#: a stated one below the limit, N m s, tells nothing
_BIAS_SHARE, _LEAST_N_M_S = 0.5, 1.0
#: a record older than the newest row by more than this is not used
_LATE_US = 900 * US_PER_S

#: values of `RECORD` by name; others are zero
Values = dict[str, Any]


def due_records(state: FilterState, model: RobustModel, knowledge: Knowledge, to_us: int) -> NDArray[np.void]:
    """Return the records (M,) of `RECORD` that are due before a row of an epoch, in order."""
    values = [*_momenta(state, model, knowledge), *_angles(state, model, knowledge)]
    if model.rate_sensor is not None and not state.rates["is_refused"][0]:
        values += _body_rates(state, knowledge, to_us)
    records = np.zeros(len(values), RECORD)
    for record, each in zip(records, values, strict=True):
        for name, value in each.items():
            record[name] = value
    return records


def _momenta(state: FilterState, model: RobustModel, knowledge: Knowledge) -> Iterator[Values]:
    """Yield the records of the wheels up to the epoch of a state that were not used.

    A filter begins with the first record of after its alignment; one of before it serves only while none follows.
    """
    spacecraft, wheel_axes = knowledge.spacecraft, model.wheel_axes
    if model.settings.momentum is None or wheel_axes is None or spacecraft is None:
        return
    epoch_us, newest_us = state.epoch_us, int(state.sensors["newest_us"][0])
    records = records_between(knowledge.momenta, max(newest_us, epoch_us - _LATE_US - 1), epoch_us)
    if newest_us == NEVER_US and knowledge.alignment is not None and records:
        after_alignment = records_between(records, knowledge.alignment.epoch_us - 1, epoch_us)
        records = after_alignment or tuple(record for record in records if record is knowledge.momenta[-1])
    for record in records:
        wheel_n_m_s = record.wheel_momentum_n_m_s
        if wheel_n_m_s is None or len(wheel_n_m_s) != len(wheel_axes):
            continue
        momentum_n_m_s = np.array(wheel_n_m_s) @ wheel_axes
        # a first record of another unit, sign or spacecraft would be believed, a later one is a wild record
        too_much = max(map(abs, wheel_n_m_s)) > spacecraft.wheels.momentum_limit_n_m_s
        yield {
            "kind": WHEELS,
            "epoch_us": record.epoch_us,
            "momentum_n_m_s": momentum_n_m_s,
            "is_unloading": bool(record.thrusters_active),
            "is_impossible": too_much or _is_off_bias(float(momentum_n_m_s[1]), spacecraft.onboard.momentum),
        }


def _is_off_bias(pitch_n_m_s: float, stated: WheelMomentum | None) -> bool:
    """Return whether a momentum along pitch cannot be that of the spacecraft, by what the catalogue states."""
    bias = None if stated is None else stated.pitch_bias_n_m_s
    return bias is not None and abs(bias) >= _LEAST_N_M_S and abs(pitch_n_m_s - bias) > _BIAS_SHARE * abs(bias)


def _angles(state: FilterState, model: RobustModel, knowledge: Knowledge) -> Iterator[Values]:
    """Yield the blocks of the polarimeters that are due at the epoch of a state, less the turn of the orbit."""
    for number, polarimeter in enumerate(model.polarimeters):
        newest_us = int(state.sensors["newest_us"][1 + number])
        records = knowledge.polarization.get(polarimeter.source, ())
        block = due_block(records, polarimeter, newest_us, state.epoch_us)
        if block is None:
            continue
        angle_deg = block.angle_deg - model.orbit_turns[number](block.epoch_us)
        if math.isfinite(angle_deg):
            yield {**block._asdict(), "kind": ANGLE, "feed": number, "angle_deg": angle_deg}


def _body_rates(state: FilterState, knowledge: Knowledge, to_us: int) -> Iterator[Values]:
    """Yield the rates up to the end of a step that were not judged yet."""
    newest_us = max(int(state.rates["newest_us"][0]), state.epoch_us - HELD_US)
    for record in records_between(knowledge.rates, newest_us, to_us):
        if record.body_rate_deg_s is not None:
            rate_deg_h = inertial_deg_h([record.body_rate_deg_s])[0]
            yield {"kind": BODY_RATE, "epoch_us": record.epoch_us, "rate_deg_h": rate_deg_h}
