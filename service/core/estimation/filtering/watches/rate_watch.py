"""Records of a rate sensor judged one by one, and the change between the measured rate and the inertial model.

A record far from what commands and drift make is left out; one that repeats the last to the digit tells nothing. While
records come the drift of the filter is the bias of the sensor, watched as the drift is: the factor on its size grows
where powers contradict it. Once the sensor is no better than the inertial model, or records keep being left out, it is
refused until the next alignment. The law of this file: each of both has its own factor, and neither learns by the
other's motion.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.model.filter_model import (
    RATE,
    FilterSettings,
    Gaussian,
    RateSensorModel,
)
from service.core.estimation.filtering.model.measured_motion import (
    with_inertial_drift,
    with_measured_rate,
    with_sensor_bias,
    with_unknown_drift,
)
from service.core.estimation.filtering.model.motion_sensor import MEMORY_H, NEVER_US, misled
from service.core.estimation.filtering.watches.command_watch import CommandWatch, executed_commands
from service.core.estimation.filtering.watches.drift_watch import DriftWatch, drift_scale, push_drift

#: a rate holds for so long where no newer one is known, and records of a step may be apart by so much, us
HELD_US = 600_000_000
#: after a torque from the ground powers have to show what it did for so long, us
_TORQUE_US = 3_600_000_000
#: the factor on the bias follows by so many minutes more a minute than that on the drift
_SOONER = 3.0
#: sigmas of drift and bias, and of the noise, from which a record is left out
_DRIFTS, _NOISES = 10.0, 5.0
#: the sensor is refused where more than a share of so many records is left out
_LEAST_RECORDS, _WILD_SHARE = 30.0, 0.2
_US_PER_H = 3.6e9


class RateWatch(NamedTuple):
    """State of the judgement; (3,) yaw, roll, pitch."""

    #: whether the newest step was made by a measured rate
    is_measured: bool
    #: epoch of the newest record judged, and the record, deg/h
    newest_us: int
    newest_deg_h: FloatArray
    #: epoch of the newest record that counted, and its rate beside the commanded one, deg/h
    known_us: int
    residual_deg_h: FloatArray
    #: rate that commands have left, deg/h; it stands here while the state holds the measured one
    commanded_deg_h: FloatArray
    #: newest step with a torque from the ground
    torque_us: int
    #: records of the last hours, and those left out
    records: float
    wild: float
    #: logarithm of the factor on bias or drift, whichever the state does not hold now
    other_log_scale: float
    is_refused: bool


class MovingState(NamedTuple):
    """State of a filter that a sensor changes."""

    epoch_us: int
    gaussian: Gaussian
    drift: DriftWatch
    command: CommandWatch


def fresh_rates() -> RateWatch:
    """Return the watch before the first record."""
    nothing = np.zeros(3)
    return RateWatch(False, NEVER_US, nothing, NEVER_US, nothing, nothing, NEVER_US, 0.0, 0.0, 0.0, False)


def commanded_rate(watch: RateWatch, state: MovingState) -> FloatArray:
    """Return the rate (3,) that commands have left, deg/h."""
    return watch.commanded_deg_h if watch.is_measured else state.gaussian.mean[RATE].copy()


def push_rates(
    watch: RateWatch,
    state: MovingState,
    epochs_us: IntArray,
    rates_deg_h: FloatArray,
    to_us: int,
    commanded_deg_h: FloatArray,
    settings: FilterSettings,
    sensor: RateSensorModel,
    *,
    is_pushed: bool,
) -> tuple[RateWatch, MovingState]:
    """Return watch and state before a step, its rate the measured one where one is known.

    Parameters
    ----------
    watch, state : RateWatch, MovingState
        Before.
    epochs_us, rates_deg_h : ndarray, shapes (n,) and (n, 3)
        Records up to the end of the step that were not judged yet, in order; pitch without the turn of the orbit.
    to_us : int
        End of the step.
    commanded_deg_h : ndarray, shape (3,)
        Mean commanded rate over the step.
    settings, sensor
        Inertial model and sensor as they are stated.
    is_pushed : bool
        Whether torques from the ground act within the step, or may.
    """
    own, other = drift_scale(state.drift.log_scale), drift_scale(watch.other_log_scale)
    bias, drift = (own, other) if watch.is_measured else (other, own)
    inertial = drift * np.array(settings.drift_deg_h)
    watch, mean = _judged(
        watch, epochs_us, rates_deg_h, commanded_deg_h, np.hypot(inertial, bias * sensor.bias_deg_h), sensor
    )
    torque_us = to_us if is_pushed else watch.torque_us
    is_covered = _is_covered(epochs_us, state.epoch_us, to_us)
    known_us, residual_deg_h = watch.known_us, watch.residual_deg_h
    if mean is not None:
        known_us, residual_deg_h = int(epochs_us[-1]), mean - commanded_deg_h
    watch = watch._replace(known_us=known_us, residual_deg_h=residual_deg_h, torque_us=torque_us)
    is_worse = 3.0 * (bias * sensor.bias_deg_h) ** 2 > float(inertial @ inertial)
    if is_worse or (watch.records >= _LEAST_RECORDS and watch.wild > _WILD_SHARE * watch.records):
        return refused(watch, state, inertial)
    if not is_covered or to_us - watch.known_us > HELD_US or to_us - torque_us <= _TORQUE_US:
        return inertial_motion(watch, state)
    rate = watch.residual_deg_h + commanded_deg_h if mean is None else mean
    if watch.is_measured:
        state = _sooner(state, sensor, min((to_us - state.epoch_us) / 60e6, 1.0))
    else:
        watch, state = _swapped(watch, state, with_sensor_bias(state.gaussian, bias * sensor.bias_deg_h))
    return watch, state._replace(gaussian=with_measured_rate(state.gaussian, rate))


def inertial_motion(watch: RateWatch, state: MovingState) -> tuple[RateWatch, MovingState]:
    """Return watch and state that go on by the inertial model."""
    if not watch.is_measured:
        return watch, state
    return _swapped(watch, state, with_inertial_drift(state.gaussian, watch.commanded_deg_h, watch.residual_deg_h))


def refused(watch: RateWatch, state: MovingState, drift_deg_h: FloatArray) -> tuple[RateWatch, MovingState]:
    """Return watch and state after the sensor is refused: what it may have done is known less, and so is the drift."""
    watch = watch._replace(is_refused=True)
    if not watch.is_measured:
        return watch, state
    gaussian = with_unknown_drift(state.gaussian, watch.commanded_deg_h, drift_deg_h)
    return _swapped(watch, state, misled(gaussian))


def _sooner(state: MovingState, sensor: RateSensorModel, minutes: float) -> MovingState:
    """Return the state whose factor on the bias has followed sooner than a drift's: a sensor may be worse than none."""
    sigma = sensor.bias_deg_h
    drift, gaussian = push_drift(state.drift, (sigma, sigma, sigma), state.gaussian, _SOONER * minutes)
    return state._replace(drift=drift, gaussian=gaussian)


def _swapped(watch: RateWatch, state: MovingState, gaussian: Gaussian) -> tuple[RateWatch, MovingState]:
    """Return watch and state after the drift began to be the bias, or the reverse."""
    commanded = commanded_rate(watch, state)
    command = executed_commands()._replace(share=state.command.share, minutes_left=state.command.minutes_left)
    swapped = state._replace(gaussian=gaussian, drift=DriftWatch(watch.other_log_scale), command=command)
    other = state.drift.log_scale
    return watch._replace(is_measured=not watch.is_measured, commanded_deg_h=commanded, other_log_scale=other), swapped


def _judged(
    watch: RateWatch,
    epochs_us: IntArray,
    rates_deg_h: FloatArray,
    commanded_deg_h: FloatArray,
    drift_deg_h: FloatArray,
    sensor: RateSensorModel,
) -> tuple[RateWatch, FloatArray | None]:
    """Return the watch after some records, and the mean (3,) of those that count, None without one."""
    if not len(epochs_us):
        return watch, None
    # mostly one record: numbers cost a tenth of arrays
    former_us, former = max(watch.newest_us, int(epochs_us[0]) - HELD_US), watch.newest_deg_h.tolist()
    sent, drifted = commanded_deg_h.tolist(), (_DRIFTS * drift_deg_h + np.abs(commanded_deg_h)).tolist()
    taken, wild = [], 0
    for epoch_us, rate in zip(epochs_us.tolist(), rates_deg_h.tolist(), strict=True):
        noise = _NOISES * sensor.noise_deg_sqrt_h / math.sqrt((epoch_us - former_us) / _US_PER_H)
        if any(abs(one - known) > most + noise for one, known, most in zip(rate, sent, drifted, strict=True)):
            wild += 1
        elif rate != former:
            taken.append(rate)
        former_us, former = epoch_us, rate
    keep = math.exp(-(int(epochs_us[-1]) - max(watch.newest_us, 0)) / (MEMORY_H * _US_PER_H))
    watch = watch._replace(
        newest_us=int(epochs_us[-1]),
        newest_deg_h=rates_deg_h[-1],
        records=keep * watch.records + len(epochs_us),
        wild=keep * watch.wild + wild,
    )
    return watch, np.add.reduce(taken) / len(taken) if taken else None


def _is_covered(epochs_us: IntArray, from_us: int, to_us: int) -> bool:
    """Return whether records (n,) reach through a step; a short one needs none of its own."""
    if to_us - from_us <= HELD_US:
        return True
    return bool((np.diff(np.concatenate([[from_us], epochs_us, [to_us]])) <= HELD_US).all())
