"""Effective rows of the attitude filter: what each step did to the state, as linear operations, and the way back.

A row holds, in the order in which they acted: how the state came from that of the row before (hidden states come and
go), the records of other sensors taken before the step, the step of time, the update with its weights and without the
carriers that were excluded, and the states that began again after it. Variance that was added on the way (a freed
reference, a step of the chain, a wider drift, a jump, an unloading) is noise and passes. The law of this file:
decisions are those of the filter; nothing is decided again.

Adjoint of the filter: what later rows say of a state, carried backwards (modified Bryson-Frazier).

    x_s = x + P l,   P_s = P - P M P                  x, P the filter's, l adjoint (D,), M its covariance (D, D)

    step x' = F x + noise              l = F' l',                       M = F' M' F
    row  x' = x + W' w                 l = l' + U' (w - W l'),          M = (I - U' W) M' (I - W' U) + U' U
                                       S = L L',  U = L^-1 H,  W = U P,  w = L^-1 nu

No covariance of the state is inverted, so that a singular one does no harm. Noise of any kind passes: it is in P. The
law of this file: a state that begins again had no past, so that nothing later says anything about it before.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    CHAIN,
    RAIN,
    RATE,
    CarrierModel,
    FilterSettings,
    core_size,
    hidden_count,
)
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.plant import sensor_states
from service.core.estimation.filtering.row_block import RowTrace


class Adjoint(NamedTuple):
    """Adjoint of a state of D numbers: the evidence of all later rows about it."""

    #: (D,) and (D, D)
    vector: FloatArray
    covariance: FloatArray


class LinearStep(NamedTuple):
    """Step of a state: most numbers decay by a factor, some are mixtures of others."""

    #: (D,) factor of each number that is no mixture
    factor: FloatArray
    #: (h,) numbers that are mixtures, of which (k,) others, and the shares (h, k)
    targets: IntArray
    sources: IntArray
    shares: FloatArray


class WhitenedRow(NamedTuple):
    """Row of n measurements as it moved the state."""

    #: (n, D) ``L^-1 H`` and ``L^-1 H P``, (n,) ``L^-1 nu``
    jacobian: FloatArray
    cross: FloatArray
    residual: FloatArray


class SmoothedState(NamedTuple):
    """Smoothed numbers (k,) and their covariance (k, k)."""

    mean: FloatArray
    covariance: FloatArray


def no_later_rows(states: int) -> Adjoint:
    """Return the adjoint after the newest row."""
    return Adjoint(np.zeros(states), np.zeros((states, states)))


def before_row(adjoint: Adjoint, row: WhitenedRow) -> Adjoint:
    """Return the adjoint before a row."""
    vector = adjoint.vector + row.jacobian.T @ (row.residual - row.cross @ adjoint.vector)
    seen = row.cross @ adjoint.covariance
    # half of the square on either side keeps it symmetric
    middle = seen @ row.cross.T
    middle.ravel()[:: len(middle) + 1] += 1.0
    crossed = row.jacobian.T @ (seen - 0.5 * middle @ row.jacobian)
    return Adjoint(vector, adjoint.covariance - crossed - crossed.T)


def before_step(adjoint: Adjoint, step: LinearStep) -> Adjoint:
    """Return the adjoint before a step; noise and known motion of the step pass."""
    own = step.factor.copy()
    own[step.targets] = 0.0
    vector = own * adjoint.vector
    vector[step.sources] += step.shares.T @ adjoint.vector[step.targets]
    left = own[:, None] * adjoint.covariance
    left[step.sources] += step.shares.T @ adjoint.covariance[step.targets]
    covariance = left * own
    covariance[:, step.sources] += left[:, step.targets] @ step.shares
    return Adjoint(vector, covariance)


def before_start(adjoint: Adjoint, positions: IntArray) -> Adjoint:
    """Return the adjoint before some states began again: nothing later concerns what they were."""
    vector, covariance = adjoint.vector.copy(), adjoint.covariance.copy()
    vector[positions] = 0.0
    covariance[positions] = 0.0
    covariance[:, positions] = 0.0
    return Adjoint(vector, covariance)


def before_resize(adjoint: Adjoint, origin: IntArray, states: int) -> Adjoint:
    """Return the adjoint (states,) of the numbers from which those of now were taken; origin (D,), -1 = it is new."""
    kept = np.flatnonzero(origin >= 0)
    before = no_later_rows(states)
    before.vector[origin[kept]] = adjoint.vector[kept]
    before.covariance[np.ix_(origin[kept], origin[kept])] = adjoint.covariance[np.ix_(kept, kept)]
    return before


def smoothed_state(mean: FloatArray, covariance: FloatArray, adjoint: Adjoint) -> SmoothedState:
    """Return the first k numbers after later rows, from the filter's mean (k,) and covariance rows (k, D)."""
    count = len(mean)
    removed = covariance @ adjoint.covariance @ covariance.T
    own = covariance[:, :count] - 0.5 * (removed + removed.T)
    return SmoothedState(mean + covariance @ adjoint.vector, own)


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
    after: FilterState,
    row: np.void,
    trace: RowTrace,
    origin: IntArray | None,
) -> EffectiveRow:
    """Return a row of `RESULT` with its trace, the records taken before it among it, and the states around it."""
    restarted = map(np.flatnonzero, trace.is_restarted)
    sensed = [SensedRecord(next(restarted), _whitened_row(each)) for each in trace.record_updates]
    sensed.append(SensedRecord(next(restarted), None))
    return EffectiveRow(
        after.epoch_us,
        origin,
        tuple(each for each in sensed if each.update is not None or len(each.restarted)),
        _linear_step(model, settings, trace),
        _whitened_row(trace.update),
        float(row["rain_push_1_db"]),
        bool(before.watch["is_raining"][0] and not after.watch["is_raining"][0]),
        restarted_states(after.covariance),
        after.mean,
        after.covariance[:_MOVING].copy(),
        settings.coupling_per_h,
    )


def _whitened_row(traced: FloatArray) -> WhitenedRow | None:
    """Return the measurements of a trace (n, 2 D + 1), None where there were none."""
    rows, states = traced[np.isfinite(traced[:, -1])], traced.shape[1] // 2
    return WhitenedRow(rows[:, :states], rows[:, states:-1], rows[:, -1]) if len(rows) else None


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
    adjoint = before_start(adjoint, row.restarted)
    if row.is_rain_taken:
        adjoint = before_step(adjoint, _rain_into_chain(len(adjoint.vector)))
    if row.rain_push:
        adjoint.vector[RAIN] += row.rain_push
    return adjoint if row.update is None else before_row(adjoint, row.update)


def _rain_into_chain(states: int) -> LinearStep:
    """Return the step in which the chain takes over what the rain left."""
    factor = np.ones(states)
    factor[RAIN] = 0.0
    return LinearStep(factor, np.array([CHAIN]), np.array([CHAIN, RAIN]), np.array([[1.0, -1.0]]))


def _linear_step(model: CarrierModel, settings: FilterSettings, trace: RowTrace) -> LinearStep:
    """Return the step of a state whose first nine numbers, and the momentum of the wheels, move by a transition."""
    moving, hidden = np.arange(_MOVING), trace.transition.shape[1] - _MOVING
    sources = np.concatenate([moving, core_size(model) + np.arange(hidden)])
    wheels = core_size(model, hidden) - sensor_states(settings) + np.arange(3 * (settings.momentum is not None))
    targets = np.concatenate([moving, wheels])
    return LinearStep(trace.factor, targets, sources, trace.transition[: len(targets)] * trace.factor[sources])
