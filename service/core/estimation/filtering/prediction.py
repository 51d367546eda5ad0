"""Prediction of the state over a step of time, and its update by a row; the functions are compiled as they stand.

    nu = y - h(x),   S = H P H' + R = L L',   W = L^-1 H P,   w = L^-1 nu
    x' = x + W' w,   P' = P - W' W

H has three columns of attitude, one each of chain and rain, ones at common parts and the carrier's own states, so that
H P is a sum of rows and nothing of size (D, D) is ever multiplied with another of that size. The covariance stays
symmetric, to the last bit, and positive definite. What W' W loses to rounding in row i and column j is some
n eps sqrt(P_ii P_jj), 1e-14 of the two sigmas; every step adds far more than that to each state that rows tell about,
and the white noise keeps what is left of it large against that.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    CHAIN,
    FIRST_COMMON,
    RAIN,
    RATE,
    RATE_FLOOR_DEG_H,
)
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion import StepMotion, hidden_decay, walked_variance
from service.core.estimation.filtering.plant import TORQUES, FilterModel
from service.core.estimation.filtering.row_block import RowTrace

#: attitude, drifts and rates move into one another
_MOVING = RATE.stop
_S_PER_H = 3600.0
#: an update that moves the attitude by more than this is linearised again where it leads, deg
_RELINEARISE_DEG = 0.05
_MAX_PASSES = 4


def hidden_states(model: FilterModel, states: int) -> int:
    """Return how many hidden states a vector of a size has."""
    carriers, components = model.coloured_sigma_db.shape
    return int(states - FIRST_COMMON - len(model.common) - carriers * (components + 1))


def decay_factors(model: FilterModel, state: FilterState, seconds: float, shares: int) -> tuple[FloatArray, FloatArray]:
    """Return the factor (D,) by which each number decays over a step, and the variance (E,) of the hidden ones."""
    one, watch = model.plant[0], state.watch[0]
    size, first = len(state.mean), FIRST_COMMON + len(model.common)
    hidden = hidden_states(model, size)
    factor = np.ones(size)
    factor[RAIN] = 1.0 if watch["is_raining"] else math.exp(-seconds / one["rain_dry_tau_s"])
    for part in range(len(model.common)):
        factor[FIRST_COMMON + part] = math.exp(-seconds / model.common["tau_s"][part])
    kept, variance = hidden_decay(model, hidden, shares, seconds)
    factor[first : first + hidden] = kept
    place = first + hidden
    carriers, components = model.coloured_tau_s.shape
    for component in range(components):
        for k in range(carriers):
            factor[place] = math.exp(-seconds / model.coloured_tau_s[k, component])
            place += 1
    return factor, variance


def predict_state(
    model: FilterModel,
    state: FilterState,
    motion: StepMotion,
    factor: FloatArray,
    hidden_variance: FloatArray,
    shares: int,
    step_us: int,
) -> None:
    """Move mean and covariance over a step, in place, with the error of the calibration that they hold then."""
    one, mean, covariance = model.plant[0], state.mean, state.covariance
    hours = step_us / 1e6 / _S_PER_H
    mean *= factor
    for i in range(len(mean)):
        for j in range(len(mean)):
            covariance[i, j] *= factor[i] * factor[j]
    if one["is_rate_measured"]:
        # known, and correlated with nothing
        covariance[RATE, :] = 0.0
        covariance[:, RATE] = 0.0
        for position in range(RATE.start, RATE.stop):
            covariance[position, position] = RATE_FLOOR_DEG_H**2
    first = FIRST_COMMON + len(model.common)
    _move(model, mean, covariance, motion, first, step_us)
    torques = len(hidden_variance) - shares - one["sensor_states"]
    for number in range(len(hidden_variance)):
        covariance[first + number, first + number] += hidden_variance[number]
    _add_noise(model, state, motion.core_variance, factor, hours)
    if one["is_fed_forward"] and torques >= TORQUES:
        kept = -math.expm1(-2.0 * hours / one["torque_tau_h"])
        at = first + shares
        covariance[at : at + TORQUES, at : at + TORQUES] += kept * one["scale_covariance"]


def _move(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    motion: StepMotion,
    first: int,
    step_us: int,
) -> None:
    """Move attitude, drift and rate, and the momentum of the wheels: mean to ``T x + push``, covariance alike."""
    transition, size = motion.transition, len(mean)
    rows, columns = transition.shape
    hidden = columns - _MOVING
    wheels = first + hidden - model.plant[0]["sensor_states"]
    moved, values = np.zeros((rows, size)), np.zeros(rows)
    for row in range(rows):
        values[row] = motion.push[row]
        for column in range(columns):
            share = transition[row, column]
            if share != 0.0:
                source = column if column < _MOVING else first + column - _MOVING
                values[row] += share * mean[source]
                for j in range(size):
                    moved[row, j] += share * covariance[source, j]
    own = np.zeros((rows, rows))
    for row in range(rows):
        for other in range(rows):
            total = 0.0
            for column in range(columns):
                source = column if column < _MOVING else first + column - _MOVING
                total += moved[row, source] * transition[other, column]
            own[row, other] = total
    for row in range(rows):
        target = row if row < _MOVING else wheels + row - _MOVING
        mean[target] = values[row]
        covariance[target, :] = moved[row]
        covariance[:, target] = moved[row]
    # the block of those that moved, symmetric to the last bit
    walked = walked_variance(model, step_us)
    for row in range(rows):
        target = row if row < _MOVING else wheels + row - _MOVING
        for other in range(rows):
            place = other if other < _MOVING else wheels + other - _MOVING
            noise = motion.noise[row, other] if row < _MOVING and other < _MOVING else 0.0
            if row == other and row >= _MOVING:
                noise = walked
            covariance[target, place] = 0.5 * (own[row, other] + own[other, row]) + noise


def _add_noise(
    model: FilterModel, state: FilterState, core_variance: FloatArray, factor: FloatArray, hours: float
) -> None:
    """Add the process noise of a step to the diagonal: core, common and coloured parts, references.

    Coloured parts get what keeps their variance stationary, references by the hour, both times the square of the slow
    scale. One part of each carrier also carries the error of the calibration. A growing error is added at once: the
    attitude has moved, and the error with it.
    """
    covariance, held = state.covariance, state.carriers["model_variance_db2"]
    carriers, components = model.coloured_sigma_db.shape
    size, scale2 = len(factor), state.watch[0]["slow_scale"] ** 2
    for place in range(FIRST_COMMON):
        covariance[place, place] += core_variance[place]
    for part in range(len(model.common)):
        place = FIRST_COMMON + part
        covariance[place, place] += model.common["sigma_db"][part] ** 2 * (1.0 - factor[place] ** 2)
    slope = _coefficient_slope(state.mean)
    first = size - carriers * (components + 1)
    for k in range(carriers):
        variance = 0.0
        for i in range(9):
            for j in range(9):
                variance += model.carriers["coefficient_covariance"][k, i, j] * slope[i] * slope[j]
        for component in range(components):
            place = first + component * carriers + k
            lost = 1.0 - factor[place] ** 2
            added = scale2 * model.coloured_sigma_db[k, component] ** 2 * lost
            if component == model.carriers["error_component"][k]:
                added += max(variance - (1.0 - lost) * held[k], lost * variance)
            covariance[place, place] += added
        place = size - carriers + k
        covariance[place, place] += scale2 * hours * model.carriers["reference_walk_db"][k] ** 2
        held[k] = variance


def _coefficient_slope(mean: FloatArray) -> FloatArray:
    """Return the derivative (9,) of a level by gradient and Hessian (yy, yr, yp, rr, rp, pp) at an attitude."""
    yaw, roll, pitch = mean[0], mean[1], mean[2]
    products = (yaw, roll, pitch, yaw**2 / 2.0, yaw * roll, yaw * pitch, roll**2 / 2.0, roll * pitch, pitch**2 / 2.0)
    slope = np.empty(9)
    for place in range(9):
        slope[place] = products[place]
    return slope


def widen_declared(
    model: FilterModel, state: FilterState, row: NDArray[np.void], declared: NDArray[np.void], hours: float
) -> None:
    """Add what operations may have changed over a step, in place, by the records of a row and of its carriers (N,)."""
    covariance, every = state.covariance, len(model.carriers)
    first = len(state.mean) - every
    for axis in range(3):
        covariance[axis, axis] += row["attitude_walk_deg"][axis] ** 2 * hours + row["attitude_step_deg"][axis] ** 2
    covariance[CHAIN, CHAIN] += row["chain_walk_db"] ** 2 * hours + row["chain_step_db"] ** 2
    for k in range(every):
        walk, step = declared["reference_walk_db"][k], declared["reference_step_db"][k]
        covariance[first + k, first + k] += walk**2 * hours + step**2
        # the references of a transponder moved by one and the same amount
        group_db = declared["group_step_db"][k]
        if group_db != 0.0:
            for other in range(every):
                if model.carriers["transponder"][other] == model.carriers["transponder"][k]:
                    covariance[first + k, first + other] += group_db**2


def site_level_db(model: FilterModel, mean: FloatArray) -> FloatArray:
    """Return the deviations (N,) of attitude, chain, rain and common parts, without the carriers' own states, dB."""
    attitude, first = mean[ATTITUDE], FIRST_COMMON + len(model.common)
    common = mean[CHAIN]
    for part in range(FIRST_COMMON, first):
        common += mean[part]
    level = np.empty(len(model.carriers))
    for k in range(len(level)):
        total = common - model.carriers["rain_share"][k] * mean[RAIN]
        for axis in range(3):
            slope = model.carriers["gradient_db_deg"][k, axis]
            for other in range(3):
                slope += 0.5 * model.carriers["hessian_db_deg2"][k, axis, other] * attitude[other]
            total += slope * attitude[axis]
        level[k] = total
    return level


class Innovation(NamedTuple):
    """Measured minus predicted of n carriers, with what the update needs."""

    #: (n,) numbers of the carriers
    carriers: IntArray
    #: (n,) dB
    innovation_db: FloatArray
    #: (n, n) dB^2, without the white noise
    predicted_db2: FloatArray
    #: (n,) dB^2
    white_db2: FloatArray
    #: (n, C) and (n, D)
    core_jacobian: FloatArray
    cross: FloatArray


def innovate(
    model: FilterModel,
    mean: FloatArray,
    covariance: FloatArray,
    deviation_db: FloatArray,
    carriers: IntArray,
    white_db2: FloatArray,
    at_deg: FloatArray,
) -> Innovation:
    """Return the innovations of some carriers, their patterns linearised at an attitude.

    Parameters
    ----------
    model : FilterModel
        The carriers.
    mean, covariance : ndarray, shapes (D,) and (D, D)
        Predicted state.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference minus harmonic; not NaN at the carriers used.
    carriers : ndarray, shape (n,)
        Which carriers.
    white_db2 : ndarray, shape (n,), dB^2
        White noise of them.
    at_deg : ndarray, shape (3,), deg
        Yaw, roll, pitch.
    """
    count, size, every = len(carriers), len(mean), len(model.carriers)
    common = FIRST_COMMON + len(model.common)
    core = common + hidden_states(model, size)
    jacobian, innovation_db = np.zeros((count, core)), np.empty(count)
    for row in range(count):
        k = carriers[row]
        level = 0.0
        for axis in range(3):
            bend = 0.0
            for other in range(3):
                bend += model.carriers["hessian_db_deg2"][k, axis, other] * at_deg[other]
            slope = model.carriers["gradient_db_deg"][k, axis] + bend
            jacobian[row, axis] = slope
            # gradient l - half of bend at: the pattern where it is linearised and its slope from there on
            level += slope * mean[axis] - 0.5 * bend * at_deg[axis]
        jacobian[row, CHAIN], jacobian[row, RAIN] = 1.0, -model.carriers["rain_share"][k]
        level += mean[CHAIN] - model.carriers["rain_share"][k] * mean[RAIN]
        for part in range(FIRST_COMMON, common):
            jacobian[row, part] = 1.0
            level += mean[part]
        for place in range(core + k, size, every):
            level += mean[place]
        innovation_db[row] = deviation_db[k] - level
    cross = _projected(covariance, jacobian, carriers, common, every)
    predicted = np.empty((count, count))
    for row in range(count):
        for other in range(row + 1):
            predicted[row, other] = 0.5 * (
                _seen(cross[row], jacobian[other], carriers[other], common, every)
                + _seen(cross[other], jacobian[row], carriers[row], common, every)
            )
            predicted[other, row] = predicted[row, other]
    return Innovation(carriers, innovation_db, predicted, white_db2, jacobian, cross)


def _projected(covariance: FloatArray, jacobian: FloatArray, carriers: IntArray, common: int, every: int) -> FloatArray:
    """Return ``H P`` (n, D)."""
    size, core = len(covariance), jacobian.shape[1]
    cross = np.zeros((len(carriers), size))
    for row in range(len(carriers)):
        own = cross[row]
        for place in range(common):
            share = jacobian[row, place]
            if share != 0.0:
                for j in range(size):
                    own[j] += share * covariance[place, j]
        for place in range(core + carriers[row], size, every):
            for j in range(size):
                own[j] += covariance[place, j]
    return cross


def _seen(values: FloatArray, jacobian: FloatArray, carrier: int, common: int, every: int) -> float:
    """Return what a carrier sees of values (D,) of the states."""
    total = 0.0
    for place in range(common):
        total += jacobian[place] * values[place]
    for place in range(len(jacobian) + carrier, len(values), every):
        total += values[place]
    return total


def update_state(
    model: FilterModel,
    state: FilterState,
    deviation_db: FloatArray,
    innovation: Innovation,
    shift: FloatArray,
    found: NDArray[np.void],
    trace: RowTrace,
) -> tuple[bool, float]:
    """Take the innovations (n,) into mean and covariance, in place; n >= 1.

    Rain below zero is put to zero along its correlations.

    Parameters
    ----------
    model, state, deviation_db, innovation
        As `innovate` takes and returns them.
    shift : ndarray, shape (3,)
        Written: shift of the attitude in units of its own sigma; white and of unit variance while the model holds.
    found : numpy.void
        Record of `RESULT`, to which is written what rain was raised by.
    trace : RowTrace
        Written where it has room.

    Returns
    -------
    bool
        False = the covariance of the innovations is not positive definite, and nothing was changed.
    float
        Normalised innovation squared.
    """
    before, covariance = state.mean.copy(), state.covariance
    final = innovation
    is_done, mean, whitened, residual, lower = _updated(before, final)
    if not is_done:
        return False, 0.0
    nis = (residual * residual).sum()
    for axis in range(3):
        moved, square = 0.0, 0.0
        for row in range(len(residual)):
            moved += residual[row] * whitened[row, axis]
            square += whitened[row, axis] ** 2
        shift[axis] = moved / math.sqrt(square)
    at_deg = before[ATTITUDE].copy()
    for _ in range(_MAX_PASSES):
        if np.abs(mean[ATTITUDE] - at_deg).max() <= _RELINEARISE_DEG:
            break
        at_deg = mean[ATTITUDE].copy()
        final = innovate(model, before, covariance, deviation_db, final.carriers, final.white_db2, at_deg)
        is_done, mean, whitened, residual, lower = _updated(before, final)
        if not is_done:
            return False, nis
    product = whitened.T @ whitened
    for i in range(len(mean)):
        for j in range(i):
            covariance[i, j] -= 0.5 * (product[i, j] + product[j, i])
            covariance[j, i] = covariance[i, j]
        covariance[i, i] -= product[i, i]
    raised_db = max(0.0, -mean[RAIN])
    if raised_db > 0.0:
        mean -= covariance[RAIN] * (mean[RAIN] / covariance[RAIN, RAIN])
        mean[RAIN] = 0.0
    state.mean[:] = mean
    found["rain_push_1_db"] = raised_db / covariance[RAIN, RAIN]
    if len(trace.factor):
        _write_trace(model, trace, final, lower, whitened, residual)
    return True, nis


def _write_trace(
    model: FilterModel,
    trace: RowTrace,
    innovation: Innovation,
    lower: FloatArray,
    whitened: FloatArray,
    residual: FloatArray,
) -> None:
    """Write an update as whitened measurements."""
    every, core = len(model.carriers), innovation.core_jacobian.shape[1]
    size = whitened.shape[1]
    for row in range(len(residual)):
        own = trace.update[row]
        own[:] = 0.0
        own[:core] = innovation.core_jacobian[row]
        for place in range(core + innovation.carriers[row], size, every):
            own[place] = 1.0
        for k in range(row):
            for place in range(size):
                own[place] -= lower[row, k] * trace.update[k, place]
        for place in range(size):
            own[place] /= lower[row, row]
            own[size + place] = whitened[row, place]
        own[2 * size] = residual[row]


def _updated(mean: FloatArray, innovation: Innovation) -> tuple[bool, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return whether S is positive definite, the mean after the innovations, W, w and L."""
    count = len(innovation.white_db2)
    factor, whitened = innovation.predicted_db2.copy(), innovation.cross.copy()
    residual, after = innovation.innovation_db.copy(), mean.copy()
    for row in range(count):
        factor[row, row] += innovation.white_db2[row]
        for column in range(row + 1):
            total = factor[row, column]
            for k in range(column):
                total -= factor[row, k] * factor[column, k]
            if column < row:
                factor[row, column] = total / factor[column, column]
            elif total > 0.0:
                factor[row, row] = math.sqrt(total)
            else:
                return False, after, whitened, residual, factor
        own = whitened[row]
        for k in range(row):
            share = factor[row, k]
            residual[row] -= share * residual[k]
            for j in range(len(own)):
                own[j] -= share * whitened[k, j]
        residual[row] /= factor[row, row]
        for j in range(len(own)):
            own[j] /= factor[row, row]
            after[j] += residual[row] * own[j]
    return True, after, whitened, residual, factor


def inverse_of(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse (n, n) of a symmetric positive definite matrix and the logarithm of its determinant."""
    inverse, log_determinant = matrix.copy(), 0.0
    size = len(inverse)
    for k in range(size):
        pivot = inverse[k, k]
        log_determinant += math.log(pivot)
        inverse[k, k] = 1.0
        for j in range(size):
            inverse[k, j] /= pivot
        for i in range(size):
            if i != k:
                share = inverse[i, k]
                inverse[i, k] = 0.0
                for j in range(size):
                    inverse[i, j] -= share * inverse[k, j]
    return inverse, log_determinant
