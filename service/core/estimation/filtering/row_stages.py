"""Stages of a row that has enough carriers: common changes first, then single carriers, then the watch on both.

The law of this file: each stage takes a state and returns another; their order is written in `attitude_filter`.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import is_contradicted, push_anchor
from service.core.estimation.filtering.causes.carrier_faults import (
    SKIPPED,
    release_quiet,
    trusted_white_db2,
    watch_flagged,
)
from service.core.estimation.filtering.causes.common_cause import common_innovation, find_cause, widen
from service.core.estimation.filtering.causes.fault_hypotheses import Cause, Chooser, LikeliestCause
from service.core.estimation.filtering.causes.rain_state import push_common
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.filter_update import Innovation, Updated, site_db
from service.core.estimation.filtering.kernels.kernels import Kernels
from service.core.estimation.filtering.model.filter_model import BoolArray, CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import CHAIN
from service.core.estimation.filtering.new_start import start_again
from service.core.estimation.filtering.watches.minute_sums import empty_minute, push_minute
from service.core.estimation.filtering.watches.motion_watch import MotionWatch, follow_all, forget_shifts, push_shift
from service.core.estimation.filtering.watches.noise_watch import push_values


class Heard(NamedTuple):
    """State after the tests of all carriers together."""

    state: FilterState
    #: None = nothing moved them together
    choice: LikeliestCause | None
    #: (N,) values of a closed minute for the tests of single carriers; None while a minute lasts, and in a row whose
    #: innovations belong to a common cause
    values: FloatArray | None


def common_first(
    model: CarrierModel, state: FilterState, innovation: Innovation, chooser: Chooser, *, is_chain_worked: bool
) -> Heard:
    """Return the state after the tests of all carriers together, with the unknown of their cause set free."""
    common = common_innovation(model, innovation)
    row, value = np.full(model.carriers + 1, np.nan), innovation.innovation_db / innovation.sigma_db
    row[innovation.carriers] = value
    row[-1] = common.value
    sums, values = push_minute(state.minute, state.epoch_us, row)
    rain = state.rain
    if values is not None:
        rain = push_common(rain, float(values[-1]), float(state.gaussian.mean[CHAIN]))
    choice = find_cause(model, rain, innovation, np.abs(value), common, chooser)
    if choice is None or choice.cause is Cause.INDEPENDENT:
        # what single carriers did says nothing about the common level
        heard = state._replace(minute=sums, rain=rain if choice is None else state.rain)
        return Heard(heard, choice, None if values is None else values[:-1])
    widened = widen(model, state.gaussian, state.carriers, rain, choice, common, is_chain_worked=is_chain_worked)
    motion = follow_all(state.motion) if choice.cause is Cause.ATTITUDE else state.motion
    minute = empty_minute(model.carriers + 1, state.epoch_us)
    freed = state._replace(
        gaussian=widened.gaussian, carriers=widened.carriers, rain=widened.rain, motion=motion, minute=minute
    )
    return Heard(freed, choice, None)


def is_shared(choice: LikeliestCause | None) -> bool:
    """Return whether one cause moved all that moved."""
    return choice is not None and choice.cause is not Cause.INDEPENDENT


def moved(state: FilterState, updated: Updated, choice: LikeliestCause | None, *, is_pushed: bool) -> MotionWatch:
    """Return the watch on motion after an update; `is_pushed` = a torque is among the states."""
    motion, epoch_us = state.motion, state.epoch_us
    if is_shared(choice):
        return forget_shifts(motion, epoch_us)
    return push_shift(motion, epoch_us, updated.attitude_shift, is_pushed=is_pushed)


def trusted(innovation: Innovation, excess: FloatArray) -> Innovation:
    """Return the innovations of the carriers that are not skipped, with Huber's weights.

    Parameters
    ----------
    innovation : Innovation
        Of n carriers.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of them.
    """
    if (excess <= SKIPPED).all():
        # most rows: nothing to be left out
        return innovation._replace(white_db2=trusted_white_db2(innovation.white_db2, excess))
    kept = np.flatnonzero(excess <= SKIPPED)
    return Innovation(
        innovation.carriers[kept],
        innovation.innovation_db[kept],
        innovation.predicted_db2[kept][:, kept],
        trusted_white_db2(innovation.white_db2[kept], excess[kept]),
        innovation.core_jacobian[kept],
        innovation.cross[kept],
    )


def minute_update(
    model: CarrierModel,
    state: FilterState,
    deviation_db: FloatArray,
    values: FloatArray | None,
    updated: Updated | None,
    is_noise_declared: BoolArray | None,
) -> FilterState:
    """Return the state after what is done once a minute: noise and flagged carriers.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : FilterState
        State after the update.
    deviation_db : ndarray, shape (N,), dB
        The row.
    values : ndarray, shape (N,), optional
        Values of a closed minute; without them nothing is done.
    updated : Updated, optional
        The update, where there was one.
    is_noise_declared : ndarray, shape (N,), optional
        Carriers whose noise is declared: nothing is learned from them.
    """
    if values is None:
        return state
    noise = state.noise
    if updated is not None:
        own = values if is_noise_declared is None else np.where(is_noise_declared, np.nan, values)
        if state.rain.is_raining:
            # their variance holds the free walk of the rain, a quarter of a decibel a row, so that all look small
            own = np.full_like(own, np.nan)
        noise = push_values(noise, own, updated.nis, updated.degrees)
    if not state.carriers.is_flagged.any():
        return state._replace(noise=noise)
    residual_db = deviation_db - site_db(model, state.gaussian.mean)
    gaussian, watch = release_quiet(model, state.gaussian, watch_flagged(state.carriers, residual_db, 1.0))
    return state._replace(gaussian=gaussian, carriers=watch, noise=noise)


def with_anchor(
    model: CarrierModel,
    state: FilterState,
    deviation_db: FloatArray,
    white_db2: FloatArray,
    reported_wet: FloatArray | None,
    kernels: Kernels,
) -> FilterState:
    """Return the state after the question to the references of the alignment, started again where they demand it."""
    residual_db = deviation_db - site_db(model, state.gaussian.mean)
    anchor, mixture = push_anchor(
        model,
        state.anchor,
        state.carriers,
        state.gaussian,
        residual_db,
        white_db2,
        state.epoch_us,
        is_raining=state.rain.is_raining,
        reported_wet=reported_wet,
        kernels=kernels,
    )
    state = state._replace(anchor=anchor)
    return start_again(model, state, mixture) if mixture is not None and is_contradicted(mixture) else state
