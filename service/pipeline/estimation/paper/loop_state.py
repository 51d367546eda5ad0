"""Angles and rates that the paper method steers by, L3 to L4: its fixes carried on by the dynamics.

A fix belongs to the middle of its mean. It counts when the fade rule has had time to object to the rows in it, and none
counts while its mean reaches back into a fade: until then dynamics carry the estimate. State kept: the estimate at the
newest fix that counted, the fixes that wait, and what was commanded since.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.filter_model import ATTITUDE, rates_deg_h
from service.core.estimation.paper.loop_observer import (
    TORQUE,
    LinearFix,
    LoopEstimate,
    LoopModel,
    initial_estimate,
    predict_estimate,
    update_estimate,
    with_other_torque,
)
from service.pipeline.config import ChainConfig
from service.pipeline.inputs.known_motion import CommandedMotion, consume, disturbance_of, heard
from service.records.calibration import Alignment
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction
from service.records.levels.attitude import AppliedCommand, Disturbance, FloatArray, ReportedCommand

#: noise of a mean of levels where they agree better, dB, and for how long it stays, s
_NOISE_DB = 0.1
_MEMORY_S = 3600.0
#: sigma of an alignment's angle that nobody states, deg
_ALIGNMENT_DEG = 0.1


class _PendingFix(NamedTuple):
    """A fix that does not count yet, when it will, the middle of its mean, and the noise of its levels."""

    due_us: int
    epoch_us: int
    fix: LinearFix
    noise_db: float


class LoopState(NamedTuple):
    """State between two rows."""

    estimate: LoopEstimate
    commanded: CommandedMotion
    pending: tuple[_PendingFix, ...] = ()
    #: until when a mean reaches back into a fade
    wet_until_us: int = 0


class RowsOfMean(NamedTuple):
    """Rows that a mean was taken of."""

    newest_us: int
    span_s: float
    period_s: float


class Steering(NamedTuple):
    """Angles with sigma, and rates, that a torque follows from: (3,) deg and deg/s, yaw, roll, pitch."""

    attitude_deg: FloatArray
    sigma_deg: FloatArray
    rates_deg_s: FloatArray


def initial_loop(alignment: Alignment, model: LoopModel) -> LoopState:
    """Return the state at an alignment."""
    attitude = np.nan_to_num(np.array(alignment.attitude_deg))
    sigma = np.nan_to_num(np.array(alignment.sigma_deg), nan=_ALIGNMENT_DEG)
    estimate = initial_estimate(alignment.epoch_us, attitude, sigma, model)
    return LoopState(estimate, CommandedMotion(alignment.epoch_us))


def loop_with_input(
    state: LoopState, content: Correction | AppliedCommand | ReportedCommand, spacecraft: Spacecraft | None
) -> LoopState:
    """Return the state that knows of one more commanded motion."""
    return state._replace(commanded=heard(state.commanded, content, spacecraft, state.estimate.epoch_us))


def loop_with_torque(state: LoopState, model: LoopModel) -> LoopState:
    """Return the state under another stated torque."""
    return state._replace(estimate=with_other_torque(state.estimate, model))


def loop_with_fade(state: LoopState, epoch_us: int, config: ChainConfig) -> LoopState:
    """Return the state after a row of a fade: what was measured of late counts no more."""
    until_us = epoch_us + int(config.estimation.averaging_window_s * US_PER_S)
    return state._replace(pending=(), wet_until_us=until_us)


def loop_with_fix(
    state: LoopState, fix: LinearFix | None, rows: RowsOfMean, model: LoopModel, config: ChainConfig
) -> LoopState:
    """Return the state after a row, whose mean makes a fix or none."""
    if fix is not None and rows.newest_us >= state.wet_until_us:
        due_us = rows.newest_us + int((config.fade.entry_s + config.fade.averaging_window_s) * US_PER_S)
        middle_us = rows.newest_us - int(0.5 * rows.span_s * US_PER_S)
        # fixes that repeat an error share what one of them would weigh
        noise_db = max(_NOISE_DB, fix.scatter_db) * math.sqrt(max(1.0, _MEMORY_S / rows.period_s))
        state = state._replace(pending=(*state.pending, _PendingFix(due_us, middle_us, fix, noise_db)))
    while state.pending and state.pending[0].due_us <= rows.newest_us:
        counted, *pending = state.pending
        estimate, commanded = _predicted(state, model, counted.epoch_us)
        estimate = update_estimate(estimate, counted.fix, counted.noise_db)
        state = state._replace(estimate=estimate, commanded=commanded, pending=tuple(pending))
    return state


def steering(state: LoopState, model: LoopModel, epoch_us: int) -> Steering:
    """Return angles with sigma, and rates, at an epoch."""
    estimate, _ = _predicted(state, model, epoch_us)
    sigma_deg = np.sqrt(estimate.covariance.diagonal()[ATTITUDE])
    rates = rates_deg_h(estimate.mean, model.motion.coupling_per_h) / 3600.0
    return Steering(estimate.mean[ATTITUDE], sigma_deg, rates)


def loop_disturbance(state: LoopState, model: LoopModel, inertia_kg_m2: tuple[float, float, float]) -> Disturbance:
    """Return the torque that the loop has learned."""
    estimate = state.estimate
    own = estimate.mean[TORQUE], estimate.covariance[TORQUE, TORQUE]
    return disturbance_of(*own, model.motion, inertia_kg_m2, estimate.epoch_us)


def _predicted(state: LoopState, model: LoopModel, epoch_us: int) -> tuple[LoopEstimate, CommandedMotion]:
    """Return the estimate at an epoch and what is commanded after it."""
    from_us = state.estimate.epoch_us
    if epoch_us <= from_us:
        return state.estimate, state.commanded
    known, commanded = consume(state.commanded, from_us, epoch_us)
    return predict_estimate(state.estimate, model, epoch_us, known), commanded
