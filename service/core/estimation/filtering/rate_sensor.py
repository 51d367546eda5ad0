"""Rate sensor outside of the loop on board: its records judged one by one, and the motion that it measures.

    yaw' = -w roll + z_yaw + e_yaw      roll' = w yaw + z_roll + e_roll      pitch' = z_pitch + e_pitch

z is the measured inertial rate of the body about its axes, pitch without the turn of the orbit, deg/h; e = - bias of
the sensor. z stands in the states of the rate and e in those of the drift, so that whatever reads a rate from the state
reads that of the body. What was commanded is in z: nothing of it is added. Yaw and roll exchange by the orbit, whatever
mode is flown.

A record far from what commands and drift make is left out; one that repeats the last to the digit tells nothing. While
records come the drift of the filter is the bias of the sensor, watched as the drift is: the factor on its size grows
where powers contradict it. Once the sensor is no better than the inertial model, or records keep being left out, it is
refused until the next alignment. Each of both has its own factor, and neither learns by the other's motion.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    DRIFT,
    RATE,
    RATE_FLOOR_DEG_H,
    FilterSettings,
    Gaussian,
    RateSensorModel,
)
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion import ORBITAL_RATE_PER_H
from service.core.estimation.filtering.motion_sensor import MEMORY_H, NEVER_US, misled
from service.core.estimation.filtering.motion_watch import drift_scale, push_drift

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


def fresh_rates() -> RateWatch:
    """Return the watch before the first record."""
    nothing = np.zeros(3)
    return RateWatch(False, NEVER_US, nothing, NEVER_US, nothing, nothing, NEVER_US, 0.0, 0.0, 0.0, False)


def commanded_rate(watch: RateWatch, state: FilterState) -> FloatArray:
    """Return the rate (3,) that commands have left, deg/h."""
    return watch.commanded_deg_h if watch.is_measured else state.mean[RATE].copy()


def push_rates(
    watch: RateWatch,
    state: FilterState,
    epochs_us: IntArray,
    rates_deg_h: FloatArray,
    to_us: int,
    commanded_deg_h: FloatArray,
    settings: FilterSettings,
    sensor: RateSensorModel,
    *,
    is_pushed: bool,
) -> tuple[RateWatch, FilterState]:
    """Return watch and state before a step, its rate the measured one where one is known.

    Parameters
    ----------
    watch, state : RateWatch, FilterState
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
    own, other = drift_scale(_log_scale(state)), drift_scale(watch.other_log_scale)
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
    return watch, state.with_gaussian(with_measured_rate(state.gaussian, rate))


def inertial_motion(watch: RateWatch, state: FilterState) -> tuple[RateWatch, FilterState]:
    """Return watch and state that go on by the inertial model."""
    if not watch.is_measured:
        return watch, state
    return _swapped(watch, state, with_inertial_drift(state.gaussian, watch.commanded_deg_h, watch.residual_deg_h))


def refused(watch: RateWatch, state: FilterState, drift_deg_h: FloatArray) -> tuple[RateWatch, FilterState]:
    """Return watch and state after the sensor is refused: what it may have done is known less, and so is the drift."""
    watch = watch._replace(is_refused=True)
    if not watch.is_measured:
        return watch, state
    gaussian = with_unknown_drift(state.gaussian, watch.commanded_deg_h, drift_deg_h)
    return _swapped(watch, state, misled(gaussian))


def _log_scale(state: FilterState) -> float:
    return float(state.watch["log_drift_scale"][0])


def _sooner(state: FilterState, sensor: RateSensorModel, minutes: float) -> FilterState:
    """Return the state whose factor on the bias has followed sooner than a drift's: a sensor may be worse than none."""
    covariance, sigma_deg_h = state.covariance.copy(), np.full(3, sensor.bias_deg_h)
    log_scale = push_drift(state.mean, covariance, _log_scale(state), sigma_deg_h, _SOONER * minutes)
    return state._replace(covariance=covariance).with_watch(log_drift_scale=log_scale)


def _swapped(watch: RateWatch, state: FilterState, gaussian: Gaussian) -> tuple[RateWatch, FilterState]:
    """Return watch and state after the drift began to be the bias, or the reverse; evidence begins again."""
    commanded, other = commanded_rate(watch, state), _log_scale(state)
    swapped = state.with_gaussian(gaussian).with_watch(
        log_drift_scale=watch.other_log_scale, score=0.0, information=0.0, is_by_torque=False
    )
    swapped = swapped._replace(sensitivity=np.zeros_like(state.sensitivity))
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


def measured_settings(settings: FilterSettings, sensor: RateSensorModel) -> FilterSettings:
    """Return the settings of a step whose rate is measured: bias in place of drift, the true exchange."""
    bias = sensor.bias_deg_h
    return settings._replace(
        coupling_per_h=ORBITAL_RATE_PER_H,
        drift_deg_h=(bias, bias, bias),
        drift_tau_h=sensor.bias_tau_h,
        rate_noise_deg_sqrt_h=sensor.noise_deg_sqrt_h,
    )


def with_measured_rate(gaussian: Gaussian, measured_deg_h: FloatArray) -> Gaussian:
    """Return the state whose rate (3,) is the measured one; the step by it makes it known exactly but for the bias."""
    mean = gaussian.mean.copy()
    mean[RATE] = measured_deg_h
    return Gaussian(mean, gaussian.covariance)


def with_sensor_bias(gaussian: Gaussian, bias_deg_h: float) -> Gaussian:
    """Return the state whose drift becomes the bias of the sensor, of which only its size is known."""
    return _with_block(gaussian, DRIFT, np.zeros(3), np.full(3, bias_deg_h))


def with_inertial_drift(gaussian: Gaussian, commanded_deg_h: FloatArray, residual_deg_h: FloatArray) -> Gaussian:
    """Return the state that goes on by the inertial model; its drift is what was beside the commanded rate (3,)."""
    mean = gaussian.mean.copy()
    mean[DRIFT] += residual_deg_h
    return _with_block(Gaussian(mean, gaussian.covariance), RATE, commanded_deg_h, np.full(3, RATE_FLOOR_DEG_H))


def with_unknown_drift(gaussian: Gaussian, commanded_deg_h: FloatArray, drift_deg_h: FloatArray) -> Gaussian:
    """Return the state that goes on by the inertial model, of whose drift (3,) nothing is known."""
    drifting = _with_block(gaussian, DRIFT, np.zeros(3), drift_deg_h)
    return _with_block(drifting, RATE, commanded_deg_h, np.full(3, RATE_FLOOR_DEG_H))


def _with_block(gaussian: Gaussian, positions: slice, value: FloatArray, sigma: FloatArray) -> Gaussian:
    """Return the state in which three numbers are others, correlated with nothing."""
    mean, covariance = gaussian.mean.copy(), gaussian.covariance.copy()
    mean[positions] = value
    covariance[positions, :] = covariance[:, positions] = 0.0
    covariance[positions, positions] = np.diag(sigma**2)
    return Gaussian(mean, covariance)
