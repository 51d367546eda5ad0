"""Kernels of the filter step as loops, to be compiled; `array_kernels` says what each one does.

The law of this file: what numba compiles without help: no call of another function of ours, no keyword, no object. The
innermost loops run along rows of memory and add to arrays, never to one number, so that the processor takes several
elements at once although no sum is reordered.
"""

import math

import numpy as np

from service.core.estimation.filtering.model.filter_model import MODEL_ERROR_TAU_S, FloatArray, IntArray

# places of the core states; numba wants numbers where the rest of the filter has slices
_MOVING = 9
_CHAIN = 9
_RAIN = 10
_FIRST_COMMON = 11


def fade(
    mean: FloatArray,
    covariance: FloatArray,
    rain_factor: float,
    seconds: float,
    common_tau_s: FloatArray,
    coloured_tau_s: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, covariance and factors after every state has decayed."""
    carriers, components = coloured_tau_s.shape
    first = _FIRST_COMMON + len(common_tau_s)
    factor = np.ones(len(mean))
    factor[_RAIN] = rain_factor
    for position in range(len(common_tau_s)):
        factor[_FIRST_COMMON + position] = math.exp(-seconds / common_tau_s[position])
    for carrier in range(carriers):
        for part in range(components):
            factor[first + part * carriers + carrier] = math.exp(-seconds / coloured_tau_s[carrier, part])
    faded_mean, faded = np.empty(len(mean)), np.empty((len(mean), len(mean)))
    for row in range(len(mean)):
        faded_mean[row] = factor[row] * mean[row]
        for column in range(len(mean)):
            faded[row, column] = factor[row] * factor[column] * covariance[row, column]
    return faded_mean, faded, factor


def turn(
    mean: FloatArray,
    covariance: FloatArray,
    transition: FloatArray,
    drift_noise: FloatArray,
    push: FloatArray,
    first_hidden: int,
) -> None:
    """Move the first nine states in place."""
    size, moving = len(mean), transition.shape[1]
    # the last column carries the mean
    moved = np.zeros((_MOVING, size + 1))
    for row in range(_MOVING):
        moved[row, size] = push[row]
        for inner in range(moving):
            position = inner if inner < _MOVING else first_hidden + inner - _MOVING
            moved[row, size] += transition[row, inner] * mean[position]
            for column in range(size):
                moved[row, column] += transition[row, inner] * covariance[position, column]
    for row in range(_MOVING):
        mean[row] = moved[row, size]
        for column in range(_MOVING, size):
            covariance[row, column] = moved[row, column]
            covariance[column, row] = moved[row, column]
        for column in range(row + 1):
            total = drift_noise[row, column]
            for inner in range(moving):
                position = inner if inner < _MOVING else first_hidden + inner - _MOVING
                total += moved[row, position] * transition[column, inner]
            covariance[row, column] = total
            covariance[column, row] = total


def model_variance(coefficient_covariance: FloatArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the variance by errors of the calibrated coefficients at an attitude."""
    yaw, roll, pitch = attitude_deg[0], attitude_deg[1], attitude_deg[2]
    slope = np.empty(9)
    slope[0], slope[1], slope[2] = yaw, roll, pitch
    slope[3], slope[4], slope[5] = yaw * yaw / 2.0, yaw * roll, yaw * pitch
    slope[6], slope[7], slope[8] = roll * roll / 2.0, roll * pitch, pitch * pitch / 2.0
    variance = np.zeros(len(coefficient_covariance))
    for carrier in range(len(variance)):
        for row in range(9):
            total = 0.0
            for column in range(9):
                total += coefficient_covariance[carrier, row, column] * slope[column]
            variance[carrier] += total * slope[row]
    return variance


def add_process_noise(
    covariance: FloatArray,
    factor: FloatArray,
    core_added: FloatArray,
    common_sigma_db: FloatArray,
    coloured_sigma_db: FloatArray,
    coloured_tau_s: FloatArray,
    reference_walk_db: FloatArray,
    scale2: float,
    hours: float,
    held_variance: FloatArray,
    variance: FloatArray,
) -> None:
    """Add to the diagonal, in place, what a step brings."""
    carriers, components = coloured_sigma_db.shape
    first = _FIRST_COMMON + len(common_sigma_db)
    for position in range(_FIRST_COMMON):
        covariance[position, position] += core_added[position]
    for position in range(_FIRST_COMMON, first):
        covariance[position, position] += common_sigma_db[position - _FIRST_COMMON] ** 2 * (1.0 - factor[position] ** 2)
    for carrier in range(carriers):
        carrying = 0
        for part in range(components):
            distance = abs(math.log(coloured_tau_s[carrier, part] / MODEL_ERROR_TAU_S))
            if distance < abs(math.log(coloured_tau_s[carrier, carrying] / MODEL_ERROR_TAU_S)):
                carrying = part
        for part in range(components):
            position = first + part * carriers + carrier
            lost = 1.0 - factor[position] ** 2
            covariance[position, position] += scale2 * coloured_sigma_db[carrier, part] ** 2 * lost
        position = first + carrying * carriers + carrier
        lost = 1.0 - factor[position] ** 2
        grown = variance[carrier] - (1.0 - lost) * held_variance[carrier]
        covariance[position, position] += max(grown, lost * variance[carrier])
        position = first + components * carriers + carrier
        covariance[position, position] += scale2 * hours * reference_walk_db[carrier] ** 2


def linearise(
    mean: FloatArray,
    at_deg: FloatArray,
    gradient_db_deg: FloatArray,
    hessian_db_deg2: FloatArray,
    rain_share: FloatArray,
    deviation_db: FloatArray,
    carriers: IntArray,
    common: int,
    hidden: int,
) -> tuple[FloatArray, FloatArray]:
    """Return innovations and Jacobian of the core states."""
    count, seen = len(rain_share), _FIRST_COMMON + common
    core = seen + hidden
    innovation_db = np.empty(len(carriers))
    jacobian = np.zeros((len(carriers), core))
    level_db = mean[_CHAIN]
    for position in range(_FIRST_COMMON, seen):
        level_db += mean[position]
    for row in range(len(carriers)):
        carrier = carriers[row]
        expected_db = level_db - rain_share[carrier] * mean[_RAIN]
        for axis in range(3):
            bend = 0.0
            for other in range(3):
                bend += hessian_db_deg2[carrier, axis, other] * at_deg[other]
            jacobian[row, axis] = gradient_db_deg[carrier, axis] + bend
            expected_db += jacobian[row, axis] * mean[axis] - 0.5 * bend * at_deg[axis]
        for position in range(_CHAIN, seen):
            jacobian[row, position] = 1.0
        jacobian[row, _RAIN] = -rain_share[carrier]
        for position in range(core + carrier, len(mean), count):
            expected_db += mean[position]
        innovation_db[row] = deviation_db[carrier] - expected_db
    return innovation_db, jacobian


def project(covariance: FloatArray, jacobian: FloatArray, carriers: IntArray, count: int) -> FloatArray:
    """Return H P."""
    used, core = jacobian.shape
    cross = np.zeros((used, len(covariance)))
    for row in range(used):
        for position in range(core):
            share = jacobian[row, position]
            if share != 0.0:
                for column in range(len(covariance)):
                    cross[row, column] += share * covariance[position, column]
        for position in range(core + carriers[row], len(covariance), count):
            for column in range(len(covariance)):
                cross[row, column] += covariance[position, column]
    return cross


def spread(cross: FloatArray, jacobian: FloatArray, carriers: IntArray, count: int) -> FloatArray:
    """Return H P H'."""
    used, core = jacobian.shape
    lower = np.zeros((used, used))
    for row in range(used):
        for column in range(row + 1):
            total = 0.0
            for position in range(core):
                total += cross[row, position] * jacobian[column, position]
            for position in range(core + carriers[column], cross.shape[1], count):
                total += cross[row, position]
            lower[row, column] = total
            lower[column, row] = total
    return lower


def update_state(
    mean: FloatArray, innovation_db: FloatArray, spread_db2: FloatArray, white_db2: FloatArray, cross: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, L^-1 H P and L^-1 nu."""
    moved, whitened, residual = mean.copy(), cross.copy(), innovation_db.copy()
    lower = np.zeros((len(residual), len(residual)))
    for row in range(len(residual)):
        pivot = spread_db2[row, row] + white_db2[row]
        for column in range(row):
            total = spread_db2[row, column]
            for inner in range(column):
                total -= lower[row, inner] * lower[column, inner]
            lower[row, column] = total / lower[column, column]
            pivot -= lower[row, column] ** 2
        if not pivot > 0.0:
            raise np.linalg.LinAlgError("the covariance of the innovations is not positive definite")
        lower[row, row] = math.sqrt(pivot)
        for inner in range(row):
            share = lower[row, inner]
            residual[row] -= share * residual[inner]
            for column in range(len(mean)):
                whitened[row, column] -= share * whitened[inner, column]
        residual[row] /= lower[row, row]
        for column in range(len(mean)):
            whitened[row, column] /= lower[row, row]
            moved[column] += residual[row] * whitened[row, column]
    return moved, whitened, residual


def reduce(covariance: FloatArray, whitened: FloatArray) -> FloatArray:
    """Return P - W' W."""
    reduced = covariance.copy()
    fours = len(whitened) - len(whitened) % 4
    for row in range(len(covariance)):
        target = reduced[row, : row + 1]
        # four at a time: each number of the target is fetched and stored a quarter as often
        for inner in range(0, fours, 4):
            first, second = whitened[inner], whitened[inner + 1]
            third, fourth = whitened[inner + 2], whitened[inner + 3]
            a, b, c, d = first[row], second[row], third[row], fourth[row]
            for column in range(len(target)):
                target[column] = (
                    target[column] - a * first[column] - b * second[column] - c * third[column] - d * fourth[column]
                )
        for inner in range(fours, len(whitened)):
            last = whitened[inner]
            for column in range(len(target)):
                target[column] -= last[row] * last[column]
    for row in range(len(covariance)):
        for column in range(row + 1, len(covariance)):
            reduced[row, column] = reduced[column, row]
    return reduced
