"""Rate sensor outside of the loop on board: its records judged one by one, and the motion that it measures.

    yaw' = -w roll + z_yaw + e_yaw      roll' = w yaw + z_roll + e_roll      pitch' = z_pitch + e_pitch

z is the measured inertial rate of the body about its axes, pitch without the turn of the orbit, deg/h; e = - bias of
the sensor. z stands in the states of the rate and e in those of the drift, so that whatever reads a rate from the state
reads that of the body. What was commanded is in z: nothing of it is added. Yaw and roll exchange by the orbit, whatever
mode is flown.

A record far from what commands and drift make is left out; one that repeats the last to the digit tells nothing. While
records come the drift of the filter is the bias of the sensor, watched as the drift is: the factor on its size grows
where powers contradict it. Once the sensor is no better than the inertial model, or records keep being left out, it is
refused until the next alignment. Each of both has its own factor, and neither learns by the other's motion. State and
judgement are written in place; the functions are compiled as they stand.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import DRIFT, RATE, RATE_FLOOR_DEG_H
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion_sensor import MEMORY_H, mislead
from service.core.estimation.filtering.motion_watch import drift_scale, push_drift
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.row_block import BODY_RATE, RowBlock

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


def push_rates(model: FilterModel, state: FilterState, block: RowBlock, number: int) -> None:
    """Take the rates that are due before a row into the state, in place: its rate is the measured one where one holds.

    A measured rate contains what was commanded before the row: the commands of the row are cleared, so that they count
    once.
    """
    rates, row, sensor = state.rates[0], block.rows[number], model.plant[1]
    from_us, to_us = state.watch[0]["epoch_us"], row["epoch_us"]
    if rates["is_refused"]:
        return
    commanded_deg_h, per_h = np.empty(3), _US_PER_H / (to_us - from_us)
    for axis in range(3):
        known_deg_h = rates["commanded_deg_h"][axis] if rates["is_measured"] else state.mean[RATE.start + axis]
        commanded_deg_h[axis] = known_deg_h + row["correction_deg"][axis] * per_h
    own = drift_scale(state.watch[0]["log_drift_scale"])
    other = drift_scale(rates["other_log_scale"])
    bias_scale, scale = (own, other) if rates["is_measured"] else (other, own)
    inertial_deg_h = scale * model.plant[0]["drift_deg_h"]
    bias_deg_h = bias_scale * sensor["drift_deg_h"]
    mean_deg_h = _judge(model, rates, block.records, number, commanded_deg_h, inertial_deg_h, bias_deg_h)
    if math.isfinite(mean_deg_h[0]):
        rates["known_us"] = rates["newest_us"]
        rates["residual_deg_h"][:] = mean_deg_h - commanded_deg_h
    if block.unreported.shape[1] > 0 or row["rate_change_deg_h"].any():
        rates["torque_us"] = to_us
    is_worse = (bias_deg_h**2).sum() > (inertial_deg_h**2).sum()
    if is_worse or (rates["records"] >= _LEAST_RECORDS and rates["wild"] > _WILD_SHARE * rates["records"]):
        _refuse(state, inertial_deg_h)
    elif (
        not _is_covered(block.records, number, from_us, to_us)
        or to_us - rates["known_us"] > HELD_US
        or to_us - rates["torque_us"] <= _TORQUE_US
    ):
        follow_model(state)
    else:
        if rates["is_measured"]:
            minutes = _SOONER * min((to_us - from_us) / 60e6, 1.0)
            watch = state.watch[0]
            # a sensor may be worse than none: its factor follows sooner than that of a drift
            watch["log_drift_scale"] = push_drift(
                state.mean, state.covariance, watch["log_drift_scale"], sensor["drift_deg_h"], minutes
            )
        else:
            _swap_models(state)
            _renew(state, DRIFT.start, np.zeros(3), bias_deg_h)
        state.mean[RATE.start : RATE.stop] = rates["residual_deg_h"] + commanded_deg_h
        row["correction_deg"][:] = 0.0
        row["late_correction_deg"][:] = 0.0
        row["rate_change_deg_h"][:] = 0.0
        block.unreported[number] = 0.0


def follow_model(state: FilterState) -> None:
    """Let the state go on by the inertial model, in place; its drift is what was measured beside the commanded rate."""
    rates = state.rates[0]
    if rates["is_measured"]:
        _swap_models(state)
        state.mean[DRIFT.start : DRIFT.stop] += rates["residual_deg_h"]
        _renew(state, RATE.start, rates["commanded_deg_h"], np.full(3, RATE_FLOOR_DEG_H))


def _refuse(state: FilterState, drift_deg_h: FloatArray) -> None:
    """Refuse the sensor, in place: what it may have done is known less, and nothing of the drift (3,)."""
    rates = state.rates[0]
    rates["is_refused"] = True
    if rates["is_measured"]:
        _swap_models(state)
        _renew(state, DRIFT.start, np.zeros(3), drift_deg_h)
        _renew(state, RATE.start, rates["commanded_deg_h"], np.full(3, RATE_FLOOR_DEG_H))
        mislead(state.covariance)


def _swap_models(state: FilterState) -> None:
    """Let the drift begin to be the bias, or the reverse, in place; evidence begins again."""
    rates, watch = state.rates[0], state.watch[0]
    if not rates["is_measured"]:
        rates["commanded_deg_h"][:] = state.mean[RATE.start : RATE.stop]
    other = rates["other_log_scale"]
    rates["other_log_scale"] = watch["log_drift_scale"]
    watch["log_drift_scale"] = other
    watch["score"][:] = 0.0
    watch["information"][:] = 0.0
    watch["is_by_torque"] = False
    state.sensitivity[:] = 0.0
    rates["is_measured"] = not rates["is_measured"]


def _renew(state: FilterState, first: int, value: FloatArray, sigma: FloatArray) -> None:
    """Let three numbers be others, correlated with nothing, in place."""
    state.mean[first : first + 3] = value
    state.covariance[first : first + 3] = 0.0
    state.covariance[:, first : first + 3] = 0.0
    for axis in range(3):
        state.covariance[first + axis, first + axis] = sigma[axis] ** 2


def _judge(
    model: FilterModel,
    rates: NDArray[np.void],
    records: NDArray[np.void],
    number: int,
    commanded_deg_h: FloatArray,
    inertial_deg_h: FloatArray,
    bias_deg_h: FloatArray,
) -> FloatArray:
    """Judge the records before a row, and return the mean (3,) of those that count, NaN without one."""
    total_deg_h, count, judged, wild = np.zeros(3), 0, 0, 0
    before_us, former_us, former_deg_h = rates["newest_us"], rates["newest_us"], rates["newest_deg_h"]
    for place in range(len(records)):
        epoch_us, rate_deg_h = records[place]["epoch_us"], records[place]["rate_deg_h"]
        if records["row"][place] != number or records["kind"][place] != BODY_RATE:
            continue
        former_us = max(former_us, epoch_us - HELD_US) if judged == 0 else former_us
        noise_deg_h = _NOISES * model.plant[1]["rate_noise_deg_sqrt_h"] / math.sqrt((epoch_us - former_us) / _US_PER_H)
        is_wild, is_repeated = False, True
        for axis in range(3):
            drift_deg_h = _DRIFTS * math.hypot(inertial_deg_h[axis], bias_deg_h[axis]) + abs(commanded_deg_h[axis])
            difference_deg_h = abs(rate_deg_h[axis] - commanded_deg_h[axis])
            is_wild = is_wild or difference_deg_h > drift_deg_h + noise_deg_h
            is_repeated = is_repeated and rate_deg_h[axis] == former_deg_h[axis]
        if is_wild:
            wild += 1
        elif not is_repeated:
            total_deg_h += rate_deg_h
            count += 1
        former_us, former_deg_h, judged = epoch_us, rate_deg_h, judged + 1
    if judged:
        keep = math.exp(-(former_us - max(before_us, 0)) / (MEMORY_H * _US_PER_H))
        rates["records"] = keep * rates["records"] + judged
        rates["wild"] = keep * rates["wild"] + wild
        rates["newest_us"] = former_us
        rates["newest_deg_h"][:] = former_deg_h
    return total_deg_h / count if count else np.full(3, np.nan)


def _is_covered(records: NDArray[np.void], number: int, from_us: int, to_us: int) -> bool:
    """Return whether records reach through the step before a row; a short one needs none of its own."""
    if to_us - from_us <= HELD_US:
        return True
    former_us = from_us
    for place in range(len(records)):
        if records["row"][place] == number and records["kind"][place] == BODY_RATE:
            if records["epoch_us"][place] - former_us > HELD_US:
                return False
            former_us = records["epoch_us"][place]
    return bool(to_us - former_us <= HELD_US)
