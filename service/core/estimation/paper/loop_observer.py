"""Observer of the published loop: fixes of the paper method carried on by the dynamics of the spacecraft.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | 9 torques | 3 errors of fixes]
                                                            deg, deg/h, deg/h^2 as in `motion`, deg

A fix is late by half of its mean, its slope is no rate, and it is wrong by the same for a day: levels drift. What moves
the spacecraft is known better: commands, the exchange of roll and yaw, a torque that changes slowly. So the error of
fixes is a state beside the motion, and a fix only corrects. What is done at every row is compiled as it stands.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import displacement_matrix
from service.core.estimation.filtering.filter_model import ATTITUDE, RATE, RATE_FLOOR_DEG_H, FilterSettings
from service.core.estimation.filtering.motion import core_variance, drift_noise, write_motion, write_torques
from service.core.estimation.filtering.plant import TORQUES, FilterModel, torque_covariance
from service.core.estimation.paper.downlink_fade import SIGMA_OF_MAD, median_of

#: places of torques and of the error of fixes
TORQUE = slice(RATE.stop, RATE.stop + TORQUES)
ERROR = slice(TORQUE.stop, TORQUE.stop + 3)
_MOVING, _FIRST_ERROR, _STATES = RATE.stop, TORQUE.stop, ERROR.stop
#: the least that levels have wrong for long, each one by itself, dB, and for how long, h: means of two hours are wrong
#: by 0.12 dB on the plant outside, and 0.08 of it in common
LASTING_DB = 0.1
_LASTING_H = 24.0
#: variance of what levels have wrong in common over that of each one
_COMMON_VARIANCE = 0.5
#: least squares again, each with the weights that the one before leaves
_REWEIGHTINGS = 3
#: fewest carriers of a fix
MIN_CARRIERS = 4
#: dB^2/deg^2, an axis of which levels tell less counts as zero within 50 deg/dB: stations in one place tell no yaw
_LEAST_INFORMATION = 50.0**-2
#: sweeps of Jacobi's method at most, and what is left beside the diagonal
_SWEEPS, _DIAGONAL = 12, 1e-17
_US_PER_H = 3.6e9

#: a commanded change; (3,) in the order yaw, roll, pitch
MOTION = np.dtype(
    [
        ("start_us", "i8"),
        ("stop_us", "i8"),
        # spread over the interval, deg
        ("change_deg", "f8", (3,)),
        # gained in the middle of the interval, deg/h
        ("rate_change_deg_h", "f8", (3,)),
    ],
    align=True,
)


class Commanded(NamedTuple):
    """Commanded motion since an estimate."""

    #: of `MOTION`
    motions: NDArray[np.void]
    #: (2, 3) deg and deg/h, of changes that became known after their time
    late: FloatArray
    #: changes before this epoch are part of the alignment
    since_us: int


class LinearFix(NamedTuple):
    """Angles of some levels."""

    #: (3,) deg, yaw, roll, pitch
    angles_deg: FloatArray
    #: (3, 3) deg^2/dB^2 for a noise of 1 dB of each level
    unit_covariance: FloatArray
    #: what the levels differ by from any angles, rms, dB
    scatter_db: float
    #: fewer than four make no fix
    carriers: int


def loop_slopes(plus: FloatArray, minus: FloatArray, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return the slopes (N, 3) in the middle of both signs, dB/deg, those of yaw by the places of the stations.

    The published system lets each angle choose its sign, which is right at the reach of the turns; in a loop angles are
    small. Yaw moves a station in the frame of the antenna as pitch and roll do, by its direction: so its column follows
    from theirs to 0.04 dB/deg, where the turns tell it to 0.10 (plant outside). A carrier whose station has no
    direction (NaN) has no slope of yaw and takes no part, unless too few others have one.
    """
    slope = 0.5 * (plus + minus)
    moved = displacement_matrix(azimuth_deg, elevation_deg)
    yaw = np.einsum("nj,njk,nk->n", moved[..., 0], np.linalg.inv(np.swapaxes(moved[..., 1:], 1, 2)), slope[:, 1:])
    if np.count_nonzero(np.isfinite(yaw)) >= MIN_CARRIERS:
        slope[:, 0] = yaw
    return slope


def linear_fix(level_db: FloatArray, slope: FloatArray, reason: IntArray) -> LinearFix:
    """Return the least squares fix of level changes (N,) by slopes (N, 3) of the carriers of reason 0.

    Fewer than four make none.

    Levels are wrong by an error of their own and by one that all have in common: the receiving chain, a wet feed. Users
    change their levels for good, so a carrier far from the others counts less, as its square.
    """
    count, places = 0, np.empty(len(level_db), dtype=np.int64)
    for k in range(len(level_db)):
        if reason[k] == 0 and math.isfinite(level_db[k] + slope[k, 0] + slope[k, 1] + slope[k, 2]):
            places[count] = k
            count += 1
    angles, unit_covariance, scatter_db = np.zeros(3), np.zeros((3, 3)), math.nan
    share, residual, ordered = np.ones(count), np.empty(count), np.empty(count)
    for _ in range(_REWEIGHTINGS + 1 if count >= MIN_CARRIERS else 0):
        scatter_db = _weighted_fix(level_db, slope, places, share, angles, unit_covariance, residual)
        for k in range(count):
            ordered[k] = residual[k]
        middle_db = median_of(ordered, count)
        for k in range(count):
            residual[k] = ordered[k] = abs(residual[k] - middle_db)
        near_db = 2.0 * max(LASTING_DB, SIGMA_OF_MAD * median_of(ordered, count))
        for k in range(count):
            share[k] = (near_db / max(residual[k], near_db)) ** 2
    return LinearFix(angles, unit_covariance, scatter_db, count)


def _weighted_fix(
    level_db: FloatArray,
    slope: FloatArray,
    places: IntArray,
    share: FloatArray,
    angles: FloatArray,
    unit_covariance: FloatArray,
    residual: FloatArray,
) -> float:
    """Write the fix of the levels at n places under weights (n,), and what it leaves (n,); return the scatter, dB."""
    # the inverse of diag(1 / share) + common variance takes away a square of the weighted mean
    total, level, count = 0.0, 0.0, len(share)
    normal, axes, moment, sums = np.zeros((3, 3)), np.eye(3), np.zeros(3), np.zeros(3)
    for k in range(count):
        total += share[k]
        level += share[k] * level_db[places[k]]
        for i in range(3):
            weighted = share[k] * slope[places[k], i]
            sums[i] += weighted
            moment[i] += weighted * level_db[places[k]]
            for j in range(3):
                normal[i, j] += weighted * slope[places[k], j]
    for i in range(3):
        moment[i] -= sums[i] * level / (1.0 / _COMMON_VARIANCE + total)
        for j in range(3):
            normal[i, j] -= sums[i] * sums[j] / (1.0 / _COMMON_VARIANCE + total)
    turn_to_axes(normal, axes)
    for i in range(3):
        angles[i] = 0.0
        for j in range(3):
            unit_covariance[i, j] = 0.0
            for axis in range(3):
                least = max(normal[axis, axis], _LEAST_INFORMATION)
                unit_covariance[i, j] += axes[i, axis] * axes[j, axis] / least
            angles[i] += unit_covariance[i, j] * moment[j]
    misfit, common = 0.0, 0.0
    for k in range(count):
        residual[k] = level_db[places[k]]
        for i in range(3):
            residual[k] -= slope[places[k], i] * angles[i]
        misfit += share[k] * residual[k] ** 2
        common += share[k] * residual[k]
    return math.sqrt((misfit - common**2 / (1.0 / _COMMON_VARIANCE + total)) / (count - 3))


def turn_to_axes(matrix: FloatArray, axes: FloatArray) -> None:
    """Turn a symmetric matrix (3, 3) to its principal axes, the columns of what was the unit matrix (Jacobi)."""
    for _ in range(_SWEEPS):
        off_diagonal = abs(matrix[0, 1]) + abs(matrix[0, 2]) + abs(matrix[1, 2])
        if off_diagonal <= _DIAGONAL * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if matrix[p, q] == 0.0:
                    continue
                half = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
                tangent = math.copysign(1.0, half) / (abs(half) + math.hypot(half, 1.0))
                cosine = 1.0 / math.hypot(tangent, 1.0)
                sine = tangent * cosine
                for k in range(3):
                    one, other = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = cosine * one - sine * other, sine * one + cosine * other
                    one, other = axes[k, p], axes[k, q]
                    axes[k, p], axes[k, q] = cosine * one - sine * other, sine * one + cosine * other
                for k in range(3):
                    one, other = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = cosine * one - sine * other, sine * one + cosine * other


def lasting_deg2(slope: FloatArray, is_used: BoolArray, coloured_db: float = LASTING_DB) -> FloatArray:
    """Return the covariance (3, 3), deg^2, of what fixes by slopes (N, 3) of some carriers have wrong for long.

    Levels had a coloured noise on quiet days. Of too few carriers nothing is known of fixes.
    """
    fix = linear_fix(np.zeros(len(slope)), slope, np.where(is_used, 0, 1))
    return np.asarray(max(LASTING_DB, coloured_db) ** 2 * fix.unit_covariance)


def initial_estimate(
    attitude_deg: FloatArray, sigma_deg: FloatArray, settings: FilterSettings
) -> tuple[FloatArray, FloatArray]:
    """Return mean (21,) and covariance (21, 21) at an alignment with attitude (3,) and sigma (3,): levels are right."""
    mean, covariance = np.zeros(_STATES), np.zeros((_STATES, _STATES))
    mean[ATTITUDE] = attitude_deg
    variance = np.concatenate([sigma_deg**2, np.square(settings.drift_deg_h), np.full(3, RATE_FLOOR_DEG_H**2)])
    covariance[:_MOVING, :_MOVING] = np.diag(variance)
    return with_other_torque(mean, covariance, settings)


def with_other_torque(
    mean: FloatArray, covariance: FloatArray, settings: FilterSettings
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance whose torque begins again by what is stated now."""
    mean, covariance = mean.copy(), covariance.copy()
    mean[TORQUE], covariance[TORQUE], covariance[:, TORQUE] = 0.0, 0.0, 0.0
    covariance[TORQUE, TORQUE] = torque_covariance(settings)
    return mean, covariance


def known_motion(commanded: Commanded, from_us: int, to_us: int) -> FloatArray:
    """Return what was commanded between two epochs (3, 3): angles deg, late angles deg, gained rates deg/h."""
    motions, late = commanded.motions, commanded.late
    known, half_h = np.zeros((3, 3)), 0.5 * (to_us - from_us) / _US_PER_H
    for axis in range(3):
        # the filter lets a gained rate act for half of the step: a late one acted for all of it
        known[1, axis] = late[0, axis] + half_h * late[1, axis]
        known[2, axis] = late[1, axis]
    for k in range(len(motions)):
        start_us = max(motions["start_us"][k], from_us, commanded.since_us)
        stop_us = min(motions["stop_us"][k], to_us)
        if stop_us <= start_us:
            continue
        share = (stop_us - start_us) / (motions["stop_us"][k] - motions["start_us"][k])
        # a pulse acts from its middle on
        acted_h = (to_us - 0.5 * (start_us + stop_us)) / _US_PER_H
        for axis in range(3):
            rate = share * motions["rate_change_deg_h"][k, axis]
            known[0, axis] += share * motions["change_deg"][k, axis] + (acted_h - half_h) * rate
            known[2, axis] += rate
    return known


def predict_estimate(
    motion: FilterModel,
    lasting: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    commanded: Commanded,
    from_us: int,
    to_us: int,
) -> None:
    """Write mean and covariance at a later epoch, after what was commanded; an earlier one changes nothing."""
    step_us, one = to_us - from_us, motion.plant[0]
    if step_us <= 0:
        return
    hours, known = step_us / _US_PER_H, known_motion(commanded, from_us, to_us)
    transition = np.zeros((_MOVING, _FIRST_ERROR))
    write_motion(transition, one["coupling_per_h"], one["drift_tau_h"], hours)
    write_torques(transition, _MOVING, from_us, step_us, one["coupling_per_h"], one["wave_period_us"])
    calm, noise = np.zeros(3, dtype=np.bool_), drift_noise(motion, hours, 1.0)
    # numba knows no arguments by keyword alone
    variance = core_variance(motion, hours, known[0], known[1], known[2], math.nan, calm, False)
    forgotten = math.exp(-hours / _LASTING_H)
    settled = -math.expm1(-2.0 * hours / one["torque_tau_h"])
    mixed, moved = np.zeros((_MOVING, _STATES)), np.zeros(_MOVING)
    for i in range(_MOVING):
        if i < 3:
            moved[i] = known[0, i] + known[1, i] + 0.5 * hours * known[2, i]
        if i >= RATE.start:
            moved[i] = known[2, i - RATE.start]
        for k in range(_FIRST_ERROR):
            factor = transition[i, k]
            if factor != 0.0:
                moved[i] += factor * mean[k]
                for j in range(_STATES):
                    mixed[i, j] += factor * covariance[k, j]
    for i in range(_MOVING):
        mean[i] = moved[i]
        for j in range(i + 1):
            total = noise[i, j] + (variance[i] if i == j else 0.0)
            for k in range(_FIRST_ERROR):
                total += mixed[i, k] * transition[j, k]
            covariance[i, j] = covariance[j, i] = total
        for j in range(_MOVING, _STATES):
            value = mixed[i, j] * (forgotten if j >= _FIRST_ERROR else 1.0)
            covariance[i, j] = covariance[j, i] = value
    for i in range(_MOVING, _FIRST_ERROR):
        covariance[i, i] += settled * one["torque_prior_deg_h2"][i - _MOVING] ** 2
        for j in range(_MOVING, _FIRST_ERROR):
            if one["is_fed_forward"]:
                covariance[i, j] += settled * one["scale_covariance"][i - _MOVING, j - _MOVING]
        for j in range(_FIRST_ERROR, _STATES):
            covariance[i, j] = covariance[j, i] = forgotten * covariance[i, j]
    gained = -math.expm1(-2.0 * hours / _LASTING_H)
    for i in range(_FIRST_ERROR, _STATES):
        mean[i] *= forgotten
        for j in range(_FIRST_ERROR, _STATES):
            error = gained * lasting[i - _FIRST_ERROR, j - _FIRST_ERROR]
            covariance[i, j] = forgotten * forgotten * covariance[i, j] + error


def update_estimate(mean: FloatArray, covariance: FloatArray, angles_deg: FloatArray, noise_deg2: FloatArray) -> None:
    """Correct mean and covariance by a fix (3,) of their epoch, whose noise has a covariance (3, 3)."""
    seen, innovation, gain = np.empty((3, _STATES)), np.empty((3, 3)), np.empty((_STATES, 3))
    for i in range(3):
        for j in range(_STATES):
            seen[i, j] = covariance[i, j] + covariance[_FIRST_ERROR + i, j]
    for i in range(3):
        for j in range(3):
            innovation[i, j] = seen[i, j] + seen[i, _FIRST_ERROR + j] + noise_deg2[i, j]
    factor_3(innovation)
    for k in range(_STATES):
        # two triangular systems
        for i in range(3):
            gain[k, i] = seen[i, k]
            for j in range(i):
                gain[k, i] -= innovation[i, j] * gain[k, j]
            gain[k, i] /= innovation[i, i]
        for i in range(2, -1, -1):
            for j in range(i + 1, 3):
                gain[k, i] -= innovation[j, i] * gain[k, j]
            gain[k, i] /= innovation[i, i]
    shift = np.empty(3)
    for i in range(3):
        shift[i] = angles_deg[i] - mean[i] - mean[_FIRST_ERROR + i]
    left = np.empty((_STATES, _STATES))
    for i in range(_STATES):
        for k in range(3):
            mean[i] += gain[i, k] * shift[k]
        for j in range(_STATES):
            left[i, j] = covariance[i, j]
            for k in range(3):
                left[i, j] -= gain[i, k] * seen[k, j]
    for i in range(_STATES):
        for j in range(i + 1):
            total = left[i, j]
            for k in range(3):
                weighed = -(left[i, k] + left[i, _FIRST_ERROR + k])
                for axis in range(3):
                    weighed += gain[i, axis] * noise_deg2[axis, k]
                total += weighed * gain[j, k]
            covariance[i, j] = covariance[j, i] = total


def factor_3(matrix: FloatArray) -> None:
    """Write the lower triangular factor of a positive definite matrix (3, 3) into its lower half."""
    for j in range(3):
        for i in range(j, 3):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(total) if i == j else total / matrix[j, j]
