"""Stages of a row that numba compiles: tests of all carriers together, use of the row, what follows once a minute.

The law of this file: values in, values out, in expressions that numba compiles as they stand; numpy runs the same
source where nothing is compiled. Between the stages `attitude_filter` handles what is not ordinary in a row; each
stage says by a flag what it found.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.anchor.anchor_watch import (
    AnchorWatch,
    is_question_due,
    push_residuals,
)
from service.core.estimation.filtering.causes.carrier_faults import (
    SKIPPED,
    CarrierWatch,
    count_row,
    failed,
    returning,
    trusted_white_db2,
    watch_flagged,
)
from service.core.estimation.filtering.causes.common_cause import (
    NOTHING,
    CommonInnovation,
    RainWatch,
    common_innovation,
    pass_hold,
    pass_minutes,
    push_common,
    suspicion,
)
from service.core.estimation.filtering.filter_predict import move_state
from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.filter_update import EffectiveUpdate, Innovation, innovate, site_db, update
from service.core.estimation.filtering.model.filter_model import CHAIN, CarrierModel, Gaussian
from service.core.estimation.filtering.model.step_inputs import StepInputs
from service.core.estimation.filtering.watches.command_watch import CommandWatch, is_share_likelier, push_row
from service.core.estimation.filtering.watches.drift_watch import DriftWatch, push_drift
from service.core.estimation.filtering.watches.minute_sums import MinuteSums, push_minute
from service.core.estimation.filtering.watches.motion_watch import (
    MotionWatch,
    alarmed_axes,
    forget_shifts,
    pass_motion,
    push_shift,
)
from service.core.estimation.filtering.watches.noise_watch import NoiseWatch, push_values

MIN_CARRIERS = 4


class ScreenedRow(NamedTuple):
    """Row after the tests of all carriers together."""

    innovation: Innovation
    common: CommonInnovation
    minute: MinuteSums
    #: (N,) of a closed minute; NaN while a minute lasts
    values: FloatArray
    #: whether a minute was closed
    is_minute: bool
    rain: RainWatch
    #: of `common_cause`
    suspicion: int


def screen_row(
    model: CarrierModel, state: FilterState, deviation_db: FloatArray, present: IntArray, white_db2: FloatArray
) -> ScreenedRow:
    """Return the innovations of the carriers judged (n,) and what they say of a common cause; `state` is predicted."""
    innovation, rain = innovate(model, state.gaussian, deviation_db, present, white_db2), state.rain
    common = common_innovation(model, innovation)
    row, value = np.full(len(deviation_db) + 1, np.nan), innovation.innovation_db / _sigma_db(innovation)
    row[present] = value
    row[-1] = common.value
    sums, is_over, values = push_minute(state.minute, state.epoch_us, row)
    if is_over:
        rain = push_common(rain, float(values[-1]), float(state.gaussian.mean[CHAIN]))
    else:
        values = np.full(len(row), np.nan)
    return ScreenedRow(
        innovation, common, sums, values[:-1].copy(), is_over, rain, suspicion(rain, np.abs(value), common)
    )


class UsedRow(NamedTuple):
    """Row after the update with the carriers that are trusted."""

    gaussian: Gaussian
    carriers: CarrierWatch
    motion: MotionWatch
    command: CommandWatch
    #: carriers used, white noise raised where one is trusted less
    kept: Innovation
    #: normalised innovation squared and carriers in it, 0 where there was no update
    nis: float
    degrees: int
    #: whether an axis moves that nobody moved: the watch on commands waits for what follows from it
    is_moving: bool
    #: whether another share of the commands is likelier, and whether a carrier has failed
    is_doubted: bool
    is_failed: bool
    effective: EffectiveUpdate


def use_row(
    model: CarrierModel,
    state: FilterState,
    deviation_db: FloatArray,
    innovation: Innovation,
    is_measured: BoolArray,
    minutes: float,
    values: FloatArray,
    is_shared: bool,  # noqa: FBT001 numba knows no arguments by keyword alone
) -> UsedRow:
    """Return the state after a row; carriers beyond four sigma are skipped, fewer than four move nothing."""
    excess = np.abs(innovation.innovation_db) / _sigma_db(innovation)
    kept = _trusted(innovation, excess)
    gaussian, motion, command = state.gaussian, state.motion, state.command
    watch = count_row(state.carriers, innovation.carriers, excess, is_measured, minutes, values)
    is_failed = bool(failed(watch).any())
    if len(kept.carriers) < MIN_CARRIERS:
        effective = EffectiveUpdate(gaussian, kept, 0, 0.0)
        return UsedRow(gaussian, watch, motion, command, kept, 0.0, 0, False, False, is_failed, effective)
    updated = update(model, gaussian, deviation_db, kept)
    shifted = (
        forget_shifts(motion, state.epoch_us)
        if is_shared
        else push_shift(motion, state.epoch_us, updated.attitude_shift)
    )
    is_moving = bool(alarmed_axes(shifted).any())
    if not is_moving:
        command = push_row(model, command, kept, updated.state.covariance, is_shared)
    is_doubted = is_share_likelier(command)
    nis, degrees = updated.nis, updated.degrees
    return UsedRow(
        updated.state, watch, shifted, command, kept, nis, degrees, is_moving, is_doubted, is_failed, updated.effective
    )


class ClosedRow(NamedTuple):
    """State after a row, and what is reported of it."""

    gaussian: Gaussian
    carriers: CarrierWatch
    noise: NoiseWatch
    rain: RainWatch
    anchor: AnchorWatch
    drift: DriftWatch
    #: (N,) dB, beside attitude and common level
    residual_db: FloatArray
    #: whether the references of the alignment are to be asked, and flagged carriers to be looked at
    is_due: bool
    is_returning: bool


def close_row(
    model: CarrierModel,
    state: FilterState,
    used: UsedRow,
    rain: RainWatch,
    drift_deg_h: tuple[float, float, float],
    deviation_db: FloatArray,
    white_db2: FloatArray,
    values: FloatArray,
    is_minute: bool,  # noqa: FBT001 as above
    minutes: float,
) -> ClosedRow:
    """Return the state after what follows an update: noise, flagged carriers, rain, anchor and drift.

    What the update changed is in `used`, the rest in the state before it; `rain` holds the row's tests.
    """
    gaussian, carriers, noise, anchor = used.gaussian, used.carriers, state.noise, state.anchor
    if is_minute and used.degrees:
        # while it rains their variance holds the free walk of the rain, a quarter of a decibel a row, so that all look
        # small
        own = np.full(len(values), np.nan) if rain.is_raining else values
        noise = push_values(noise, own, used.nis, used.degrees)
    if is_minute and carriers.is_flagged.any():
        carriers = watch_flagged(carriers, deviation_db - site_db(model, gaussian.mean), 1.0)
    gaussian, rain = pass_minutes(gaussian, rain, minutes)
    residual_db = deviation_db - site_db(model, gaussian.mean)
    if is_minute:
        anchor = push_residuals(anchor, residual_db, white_db2)
    drift, gaussian = push_drift(state.drift, drift_deg_h, gaussian, minutes)
    is_due = is_minute and is_question_due(anchor, state.epoch_us)
    is_returning = is_minute and bool(returning(carriers).any())
    return ClosedRow(gaussian, carriers, noise, rain, anchor, drift, residual_db, is_due, is_returning)


class OrdinaryRow(NamedTuple):
    """Row through all stages; of no use where something in it is not ordinary."""

    is_ordinary: bool
    state: FilterState
    #: (N,) dB, NaN = absent or flagged
    innovation_db: FloatArray
    #: (n,)
    used: IntArray
    residual_db: FloatArray
    is_due: bool
    is_returning: bool
    #: None where no row was used
    effective: EffectiveUpdate | None


def state_ahead(
    state: FilterState, step: StepInputs, moved: Gaussian, variance_db2: FloatArray, command: CommandWatch
) -> FilterState:
    """Return the state after a step of time with the detectors as much later; commands have passed already."""
    return FilterState(
        state.epoch_us + step.step_us,
        moved,
        state.carriers,
        pass_hold(state.rain, step.minutes),
        state.noise,
        state.minute,
        pass_motion(state.motion, step.minutes),
        variance_db2,
        state.anchor,
        state.drift,
        command,
        state.beyond_until_us,
    )


def ordinary_row(
    model: CarrierModel,
    state: FilterState,
    step: StepInputs,
    command: CommandWatch,
    drift_deg_h: tuple[float, float, float],
    deviation_db: FloatArray,
    present: IntArray,
) -> OrdinaryRow:
    """Return the state after a step of time and a row in which nothing is found.

    The watch on commands has passed the step already; `present` are the carriers (n,) to be judged.
    """
    moved, variance_db2 = move_state(model, state.gaussian, step, state.noise.slow_scale, state.model_variance_db2)
    ahead = state_ahead(state, step, moved, variance_db2, command)
    white_db2 = (model.white_sigma_db * ahead.noise.white_scale) ** 2
    is_measured, minutes = np.isfinite(deviation_db), step.minutes
    screened = screen_row(model, ahead, deviation_db, present, white_db2)
    values, is_minute = screened.values, screened.is_minute
    used = use_row(model, ahead, deviation_db, screened.innovation, is_measured, minutes, values, False)
    closed = close_row(
        model, ahead, used, screened.rain, drift_deg_h, deviation_db, white_db2, values, is_minute, minutes
    )
    after = FilterState(
        ahead.epoch_us,
        closed.gaussian,
        closed.carriers,
        closed.rain,
        closed.noise,
        screened.minute,
        used.motion,
        ahead.model_variance_db2,
        closed.anchor,
        closed.drift,
        used.command,
        ahead.beyond_until_us,
    )
    is_ordinary = screened.suspicion == NOTHING and not (used.is_moving or used.is_doubted or used.is_failed)
    innovation_db = np.full(len(deviation_db), np.nan)
    innovation_db[present] = screened.innovation.innovation_db
    carriers, is_due, is_returning = used.kept.carriers, closed.is_due, closed.is_returning
    return OrdinaryRow(
        is_ordinary, after, innovation_db, carriers, closed.residual_db, is_due, is_returning, used.effective
    )


def _sigma_db(innovation: Innovation) -> FloatArray:
    """Return one standard deviation (n,) of each innovation, dB."""
    sigma_db: FloatArray = np.sqrt(np.diag(innovation.predicted_db2) + innovation.white_db2)
    return sigma_db


def _trusted(innovation: Innovation, excess: FloatArray) -> Innovation:
    """Return the innovations (n,) that are not skipped, with Huber's weights; `excess` = abs(innovation) / sigma."""
    kept = np.flatnonzero(excess <= SKIPPED)
    return Innovation(
        innovation.carriers[kept],
        innovation.innovation_db[kept],
        innovation.predicted_db2[kept][:, kept],
        trusted_white_db2(innovation.white_db2[kept], excess[kept]),
        innovation.core_jacobian[kept],
        innovation.cross[kept],
    )
