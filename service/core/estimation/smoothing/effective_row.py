"""Effective rows of the attitude filter: what each step did to the state, as linear operations, and the way back.

A row holds, in the order in which they acted: how the state came from that of the row before (hidden states come and
go), the records of other sensors taken before the step, the step of time, the update with its weights and without the
carriers that were excluded, and the states that began again after it. Variance that was added on the way (a freed
reference, a step of the chain, a wider drift, a jump, an unloading) is noise and passes. The law of this file:
decisions are those of the filter; nothing is decided again.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.filter_records import FilterState, FilterStep
from service.core.estimation.filtering.filter_update import EffectiveUpdate
from service.core.estimation.filtering.model.filter_model import CarrierModel, FilterSettings, FloatArray, IntArray
from service.core.estimation.filtering.model.filter_state import (
    CHAIN,
    RAIN,
    RATE,
    carrier_states,
    core_size,
    hidden_count,
)
from service.core.estimation.filtering.model.sensor_effect import SensorEffect
from service.core.estimation.smoothing.adjoint import (
    Adjoint,
    LinearStep,
    SmoothedState,
    WhitenedRow,
    before_resize,
    before_row,
    before_start,
    before_step,
    no_later_rows,
    smoothed_state,
    whitened_row,
)

#: attitude, drift and rate are smoothed
_MOVING = RATE.stop


class SensedRecord(NamedTuple):
    """Record of another sensor as it acted on the state between two rows."""

    #: states that began again before the update
    restarted: IntArray
    #: None = the record was left out
    update: WhitenedRow | None


class EffectiveRow(NamedTuple):
    """Row of the filter as it acted on a state of D numbers."""

    epoch_us: int
    #: (D',) for each number of the state before the step where it stood after the row before, -1 = nowhere;
    #: None = nowhere at all
    origin: IntArray | None
    #: what records of other sensors did to it
    sensed: tuple[SensedRecord, ...]
    step: LinearStep
    #: None = no carrier moved the state
    update: WhitenedRow | None
    #: what rain below zero says by being raised to it, 1/dB
    rain_push: float
    #: whether the receiving chain took over what rain had left
    is_rain_taken: bool
    #: states that began again after the update
    restarted: IntArray
    #: (D,) state after the row, and the rows (9, D) of its covariance that belong to attitude, drift and rate
    mean: FloatArray
    covariance: FloatArray
    #: exchange of roll and yaw, by which attitude and drift make a rate, 1/h
    coupling_per_h: float


def effective_row(
    model: CarrierModel,
    settings: FilterSettings,
    before: FilterState,
    found: FilterStep,
    step: LinearStep,
    origin: IntArray | None,
    effects: Sequence[SensorEffect] = (),
) -> EffectiveRow:
    """Return a row of the filter from the state before, the result, the step of time and records taken before it."""
    after, effective = found.state, found.effective
    is_used = effective is not None and effective.degrees > 0
    return EffectiveRow(
        after.epoch_us,
        origin,
        tuple(SensedRecord(each.restarted, each.update and whitened_row(*each.update)) for each in effects),
        step,
        _whitened(model, effective) if effective is not None and is_used else None,
        0.0 if effective is None else _rain_push(effective),
        before.rain.is_raining and not after.rain.is_raining,
        restarted_states(after.gaussian.covariance),
        after.gaussian.mean,
        after.gaussian.covariance[:_MOVING].copy(),
        settings.coupling_per_h,
    )


def state_origin(
    model: CarrierModel,
    before: FloatArray,
    after: FloatArray,
    behind: tuple[int, int] = (0, 0),
    *,
    is_same: bool = True,
) -> IntArray | None:
    """Return where each number of a state stood in the one before it, -1 = nowhere; None = they have nothing in common.

    Parameters
    ----------
    model : CarrierModel
        Carriers of both.
    before, after : ndarray, shape (D,) and (D',)
        State after a row, and the one from which the next row began.
    behind : tuple of int
        Hidden states of torques and of other sensors of both, behind the shares of commands.
    is_same : bool
        Whether the other sensors are the same; else their states and those of torques began again.
    """
    former, hidden = (hidden_count(model, len(state)) for state in (before, after))
    if min(former, hidden) < 0:
        return None
    origin = np.full(len(after), -1, dtype=np.int64)
    core, own = core_size(model), model.carriers * (model.components + 1)
    origin[:core] = np.arange(core)
    origin[len(origin) - own :] = np.arange(len(before) - own, len(before))
    kept = np.arange(max(0, min(former - behind[0], hidden - behind[1])))
    origin[core + kept] = core + kept
    if is_same and behind[0] == behind[1]:
        origin[core + hidden - behind[1] : core + hidden] = np.arange(core + former - behind[0], core + former)
    stays = origin >= 0
    return origin if np.array_equal(after[stays], before[origin[stays]]) else None


def restarted_states(covariance: FloatArray) -> IntArray:
    """Return the states (n,) that have nothing in common with any other, as those that just began."""
    together = np.count_nonzero(covariance, axis=0)
    return np.flatnonzero(together <= 1)


def smoothed_rows(rows: Sequence[EffectiveRow]) -> Iterator[SmoothedState]:
    """Yield attitude, drift and rate of rows after all later ones among them, the newest row first."""
    adjoint: Adjoint | None = None
    for number in range(len(rows) - 1, -1, -1):
        row = rows[number]
        adjoint = no_later_rows(row.covariance.shape[1]) if adjoint is None else adjoint
        yield smoothed_state(row.mean[:_MOVING], row.covariance, adjoint)
        if number:
            states = rows[number - 1].covariance.shape[1]
            earlier = _before_records(row, before_step(_before_update(row, adjoint), row.step))
            adjoint = None if row.origin is None else before_resize(earlier, row.origin, states)


def _before_records(row: EffectiveRow, adjoint: Adjoint) -> Adjoint:
    """Return the adjoint before the records of other sensors that a row followed."""
    for record in reversed(row.sensed):
        adjoint = before_start(
            adjoint if record.update is None else before_row(adjoint, record.update), record.restarted
        )
    return adjoint


def _before_update(row: EffectiveRow, adjoint: Adjoint) -> Adjoint:
    """Return the adjoint before the update of a row, from that after the row."""
    adjoint = before_start(adjoint, row.restarted)
    if row.is_rain_taken:
        adjoint = before_step(adjoint, _rain_into_chain(len(adjoint.vector)))
    if row.rain_push:
        adjoint.vector[RAIN] += row.rain_push
    return adjoint if row.update is None else before_row(adjoint, row.update)


def _whitened(model: CarrierModel, effective: EffectiveUpdate) -> WhitenedRow:
    """Return the update of a row as whitened measurements."""
    used, states = effective.innovation, len(effective.state.mean)
    hidden = hidden_count(model, states)
    jacobian = np.zeros((len(used.carriers), states))
    jacobian[:, : core_size(model, hidden)] = used.core_jacobian
    own = carrier_states(model, used.carriers, hidden)
    jacobian[np.arange(len(used.carriers)), own] = 1.0
    return whitened_row(jacobian, used.innovation_db, used.covariance_db2, used.cross)


def _rain_push(effective: EffectiveUpdate) -> float:
    """Return the adjoint of rain by which the state was moved to its border."""
    return effective.rain_raised_db / float(effective.state.covariance[RAIN, RAIN])


def _rain_into_chain(states: int) -> LinearStep:
    """Return the step in which the chain takes over what the rain left."""
    factor = np.ones(states)
    factor[RAIN] = 0.0
    return LinearStep(factor, np.array([CHAIN]), np.array([CHAIN, RAIN]), np.array([[1.0, -1.0]]))
