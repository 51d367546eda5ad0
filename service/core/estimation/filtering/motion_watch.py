"""Assumptions of the filter watched beside it: unannounced motion, noise, drift; the functions are compiled.

Motion: while the model holds, what a row adds to an angle, in units of its sigma, is white and of unit variance. A
correction that was lost, doubled or turned round, or a coupling that does not act, makes shifts of one sign: the
two-sided sum finds them, the axis is followed with a wide drift for an hour and control is told. Where a torque that
nobody feeds forward is among the states it may be greater than it was thought to be: the first alarm of an axis widens
it, and control goes on, for to stop it would leave the spacecraft to that torque. The second within the hour widens it
again and is reported for a quarter of an hour. What moves the axis on after that is something else.

Noise: squared test values of a carrier must average one, and a running mean of them must be as small as whitened values
make it; flicker that the model does not know makes it larger. Both move a factor on the noise in small steps of its
logarithm, one value a carrier and minute, outliers cut at three sigma, so that sigma and integrity follow what is seen.

Drift:  E[d^2] = Var(d_hat) + P          so      d_hat^2 / (sigma^2 - P) averages one while the model holds

d_hat and P are the filter's drift and its variance, sigma what the settings say, times the factor learned so far: one
for the three axes, never below one; a craft that drifts less than it may is no reason to believe less in the
measurements.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.filtering.carrier_watch import MINUTE_US, THRESHOLD, pushed_minute, pushed_sum
from service.core.estimation.filtering.filter_model import DRIFT, RATE
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.plant import TORQUES, FilterModel
from service.core.estimation.filtering.prediction import hidden_states

#: minutes for which an axis is followed after an alarm
FOLLOWED_MINUTES = 60.0
#: minutes for which the second alarm of an axis is reported where a torque may explain it
EXPLAINED_MINUTES = 15.0
#: alarms of an axis, each within an hour of the one before, that a torque may explain
_EXPLAINED_ALARMS = 2
#: a torque that motion makes doubtful may be this many times what was stated, and have been so for this long, h
_DOUBT, _DOUBTED_H = 5.0, 2.0

#: chi-square of three degrees of freedom that chance exceeds once in a thousand
_SEEN_CHI_SQUARE = 16.27

#: minutes in which the factors on the noise follow, and length of the running mean
WHITE_MINUTES, SLOW_MINUTES, _MEAN_MINUTES = 240.0, 360.0, 30.0
_MEAN_VARIANCE = 1.0 / (2.0 * _MEAN_MINUTES - 1.0)
#: what min(z^2, 9) averages when z is normal
_CUT_MEAN, _NOISE_CUT = 0.9770, 9.0
WHITE_LIMITS, SLOW_LIMITS = (0.6, 3.0), (0.7, 4.0)
NIS_MINUTES = 60.0
#: what Huber's weights leave of z^2 on average when z is normal: the mean of min(z^2, 2 abs(z))
_WEIGHED_MEAN = 0.9545

#: time in which the factor on the drift follows, minutes, and its largest value
FOLLOW_MINUTES, LARGEST = 600.0, 4.0
#: the factor that the prediction sees moves in steps of this ratio
_STEP = 2.0**0.125
#: one axis counts for so much at most
_DRIFT_CUT = 12.0
#: an axis of whose drift less than this share is known says nothing, share of its variance
_LEAST_KNOWN = 0.02


def push_shift(watch: NDArray[np.void], shift: FloatArray) -> None:
    """Count the shifts (3,) of a row, in sigmas, in a record of `WATCH`, in place."""
    is_over = watch["epoch_us"] - watch["shift_start_us"] >= MINUTE_US
    total, rows, up, down = watch["shift_total"], watch["shift_rows"], watch["shift_up"], watch["shift_down"]
    for axis in range(3):
        total[axis], rows[axis], value = pushed_minute(total[axis], rows[axis], shift[axis])
        if is_over:
            up[axis], down[axis] = pushed_sum(up[axis], value), pushed_sum(down[axis], -value)
            total[axis] = rows[axis] = 0.0
    if is_over:
        watch["shift_start_us"] = watch["epoch_us"]


def forget_shifts(watch: NDArray[np.void]) -> None:
    """Forget the sums, in place: what moved the row is known and was no motion."""
    watch["shift_start_us"] = watch["epoch_us"]
    watch["shift_total"][:] = 0.0
    watch["shift_rows"][:] = 0.0
    watch["shift_up"][:] = 0.0
    watch["shift_down"][:] = 0.0


def alarmed_axes(watch: NDArray[np.void]) -> BoolArray:
    """Return the axes (3,) whose shifts are beyond their limit."""
    axes: BoolArray = np.maximum(watch["shift_up"], watch["shift_down"]) > THRESHOLD
    return axes


def raise_alarms(watch: NDArray[np.void], axes: BoolArray, is_explained: bool) -> None:
    """Follow and report the motion of alarmed axes (3,), in place; `is_explained` = a torque may be it.

    Motion that a torque explains is reported from its second alarm on.
    """
    for axis in range(3):
        if not axes[axis]:
            continue
        watch["alarms"][axis] += 1.0
        minutes = FOLLOWED_MINUTES
        if is_explained and watch["alarms"][axis] <= _EXPLAINED_ALARMS:
            minutes = EXPLAINED_MINUTES if watch["alarms"][axis] == _EXPLAINED_ALARMS else 0.0
        watch["reported_minutes"][axis] = max(minutes, watch["reported_minutes"][axis])
        _follow(watch, axis)


def explain_by_torque(watch: NDArray[np.void], axes: BoolArray) -> None:
    """Follow motion about some axes (3,), in place, that a torque is to explain."""
    for axis in range(3):
        if axes[axis]:
            watch["alarms"][axis] += 1.0
            _follow(watch, axis)


def _follow(watch: NDArray[np.void], axis: int) -> None:
    watch["followed_minutes"][axis] = FOLLOWED_MINUTES
    watch["shift_up"][axis] = watch["shift_down"][axis] = 0.0


def newly_explained(alarms_before: FloatArray, watch: NDArray[np.void]) -> BoolArray:
    """Return the axes (3,) whose motion a greater torque is to explain from this row on."""
    return (watch["alarms"] > alarms_before) & (watch["alarms"] <= _EXPLAINED_ALARMS)


def follow_jump(watch: NDArray[np.void]) -> None:
    """Follow all axes of a spacecraft that has jumped, in place: no torque explains it."""
    for axis in range(3):
        watch["alarms"][axis] += _EXPLAINED_ALARMS
        watch["reported_minutes"][axis] = FOLLOWED_MINUTES
        _follow(watch, axis)
    watch["jump_minutes"] = FOLLOWED_MINUTES


def pass_motion(watch: NDArray[np.void], minutes: float) -> None:
    """Let some minutes of data pass, in place."""
    if not watch["followed_minutes"].any():
        return
    for axis in range(3):
        watch["followed_minutes"][axis] = max(0.0, watch["followed_minutes"][axis] - minutes)
        watch["reported_minutes"][axis] = max(0.0, watch["reported_minutes"][axis] - minutes)
        if watch["followed_minutes"][axis] == 0.0:
            watch["alarms"][axis] = 0.0
    watch["jump_minutes"] = max(0.0, watch["jump_minutes"] - minutes)


def doubt_torque(model: FilterModel, state: FilterState, axes: BoolArray, shares: int) -> None:
    """Let the torque about some axes (3,) be greater than was stated, in place, where there are any states of it."""
    one, covariance = model.plant[0], state.covariance
    hidden, size = hidden_states(model, len(state.mean)), len(state.mean)
    if hidden - shares - one["sensor_states"] < TORQUES:
        return
    every, components = model.coloured_sigma_db.shape
    first = size - every * (components + 1) - hidden + shares
    for axis in range(3):
        if not axes[axis]:
            continue
        unknown = one["unknown_torque_deg_h2"][axis]
        greatest = max(_DOUBT * one["torque_size_deg_h2"][axis], unknown)
        rate, torque = RATE.start + axis, first + axis
        covariance[rate, rate] += (greatest * _DOUBTED_H) ** 2
        covariance[torque, torque] += greatest**2
        covariance[rate, torque] += greatest**2 * _DOUBTED_H
        covariance[torque, rate] += greatest**2 * _DOUBTED_H
        for wave in (torque + 3, torque + 6):
            covariance[wave, wave] = max(covariance[wave, wave], 0.5 * unknown**2)


def is_torque_seen(mean: FloatArray, covariance: FloatArray, first: int) -> bool:
    """Return whether the torque about any axis, constant and wave together, differs from none beyond chance.

    `first` is the place of the nine states; nothing is seen of a torque that is known exactly.
    """
    lower, whitened = np.zeros((3, 3)), np.zeros(3)
    for axis in range(3):
        chi_square = 0.0
        for i in range(3):
            place, left = first + axis + 3 * i, mean[first + axis + 3 * i]
            for j in range(i + 1):
                value = covariance[place, first + axis + 3 * j]
                for k in range(j):
                    value -= lower[i, k] * lower[j, k]
                lower[i, j] = value / lower[j, j] if j < i else math.sqrt(max(value, 0.0))
            for j in range(i):
                left -= lower[i, j] * whitened[j]
            if lower[i, i] <= 0.0:
                return False
            whitened[i] = left / lower[i, i]
            chi_square += whitened[i] ** 2
        if chi_square > _SEEN_CHI_SQUARE:
            return True
    return False


def push_noise(state: FilterState, values: FloatArray, nis: float, degrees: int) -> None:
    """Learn noise from one minute more, in place.

    Parameters
    ----------
    state : FilterState
        Before the minute.
    values : ndarray, shape (N,)
        Test values of unit variance, NaN where a carrier is flagged or absent.
    nis, degrees : float, int
        Normalised innovation squared of the minute's rows and its degrees of freedom, > 0.
    """
    carriers, watch = state.carriers, state.watch[0]
    total, count = 0.0, 0
    for k in range(len(values)):
        if not math.isfinite(values[k]):
            continue
        surplus = min(values[k] ** 2, _NOISE_CUT) / _CUT_MEAN - 1.0
        white = carriers["white_scale"][k] * math.exp(0.5 * surplus / WHITE_MINUTES)
        carriers["white_scale"][k] = min(max(white, WHITE_LIMITS[0]), WHITE_LIMITS[1])
        cut = min(max(values[k], -3.0), 3.0)
        carriers["running_mean"][k] += (cut - carriers["running_mean"][k]) / _MEAN_MINUTES
        total += min(carriers["running_mean"][k] ** 2 / _MEAN_VARIANCE, _NOISE_CUT)
        count += 1
    if count:
        slow = watch["slow_scale"] * math.exp(0.5 * (total / count - 1.0) / SLOW_MINUTES)
        watch["slow_scale"] = min(SLOW_LIMITS[1], max(SLOW_LIMITS[0], slow))
    ratio = min(nis / degrees / _WEIGHED_MEAN, _NOISE_CUT)
    watch["nis_ratio"] += (ratio - watch["nis_ratio"]) / NIS_MINUTES


def drift_scale(log_scale: float) -> float:
    """Return the factor on the drift in the steps that the prediction sees, >= 1, of its logarithm."""
    return _STEP ** math.floor(log_scale / math.log(_STEP) + 1e-9)


def push_drift(
    mean: FloatArray, covariance: FloatArray, log_scale: float, drift_deg_h: FloatArray, minutes: float
) -> float:
    """Return the logarithm of the factor after some minutes of data.

    Where it grew by a step the covariance, which is written to, knows the drift less; `drift_deg_h` (3,) is the drift
    as configured, without the factor.
    """
    surplus, scale = 0.0, drift_scale(log_scale)
    for axis in range(3):
        place = DRIFT.start + axis
        sigma2 = (scale * drift_deg_h[axis]) ** 2
        known = sigma2 - covariance[place, place]
        if known > _LEAST_KNOWN * sigma2:
            # an axis speaks as far as it is known
            surplus += known / sigma2 * (min(mean[place] ** 2 / known, _DRIFT_CUT) - 1.0) / 3.0
    pushed = min(math.log(LARGEST), max(0.0, log_scale + surplus * minutes / FOLLOW_MINUTES))
    grown = drift_scale(pushed)
    if grown > scale:
        for axis in range(3):
            place = DRIFT.start + axis
            covariance[place, place] += ((grown / scale) ** 2 - 1.0) * (scale * drift_deg_h[axis]) ** 2
    return pushed
