"""Attitude from level changes whose sensitivity depends on the sign of each angle, without carriers hit by rain.

The published system, equations (1) and (2), by sign-constrained least squares over the eight octants. An optimum lies
inside an octant, on a side of it or on an edge: 27 candidates, each a system of three equations at the most, of which
the cheapest feasible one is the global optimum. Columns are scaled to unit length; all carriers weigh alike.

Rain on the uplinks takes power of single carriers. The *misfit* of carrier i, in dB, is ``sign(e_i) sqrt(J - J_i)``: J
is the cost with it, J_i the cost without it, e_i its residual from the fix made without it. In a linear fit this is
``r_i / sqrt(1 - h_i)``, the residual freed from what the carrier itself pulled away, h_i being its leverage. A faded
carrier biases the fix and hides; the misfit undoes that for one carrier, and removing the worst one first undoes it for
several. Three bounded passes, each deterministic, none able to cycle:

1. Gate. While the most negative misfit is below ``-gate_db``, its carrier goes. Rain only takes power away, so a
   carrier that is too strong is no matter of this gate.
2. Return. Each carrier gone is tried again once, in the order of rejection, and stays if its misfit now passes: the
   first ones may have been blamed for a fault found later.
3. The paper's rule, ``|r_i| < gate_sigma sigma`` with ``sigma^2 = sum r^2 / N``: all carriers that the gate left are
   re-tested on every pass, so they may come back, until nothing changes. A cycle ends at its smallest set.

Never fewer than ``min_carriers`` are left; when the rules want more gone than that, ``is_exhausted`` says so, and the
fix must not be trusted. The functions are compiled as they stand.

References
----------
.. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex", 2013.
"""

import itertools
import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.paper.harmonic import ROUNDING_DB

#: (27, 3), sign of each angle in each candidate; those with more free angles first, so that the first eight are the
#: octants, then lexicographic, + - 0
SIGNS: FloatArray = np.array(
    sorted(itertools.product((1.0, -1.0, 0.0), repeat=3), key=lambda signs: signs.count(0.0)), dtype=np.float64
)
#: smallest determinant of a normal matrix with unit diagonal that counts as regular
MIN_DETERMINANT = 1e-8
#: four carriers are the least that leave one to check three angles
MIN_CARRIERS = 4
#: passes of the paper's rule, a guard that ordinary data never meet
_PASSES = 32


class RejectionReason(IntEnum):
    """Use of a carrier in the fix, or the reason of its rejection."""

    USED = 0
    ABSENT = 1
    GATE = 2
    SIGMA = 3


USED, ABSENT, GATE, SIGMA = (int(reason) for reason in RejectionReason)


class OctantFix(NamedTuple):
    """Attitude of one epoch; all NaN (octant -1) when it is not determined."""

    #: (3,) deg, yaw, roll, pitch
    attitude_deg: FloatArray
    #: sum of the squares of the residuals, dB^2
    cost: float
    #: row of `SIGNS`; an angle of exactly zero counts as +
    octant: int
    #: (3, 3) deg^2/dB^2, covariance for a noise of 1 dB of each level: of the octant's linear model, bounds ignored
    unit_covariance: FloatArray
    carriers_used: int


class RejectedFix(NamedTuple):
    """Fix of the carriers that were left."""

    #: over the carriers used
    fix: OctantFix
    #: (N,) of `RejectionReason`
    reason: IntArray
    #: (N,) dB, measured minus model for all carriers present, the rejected ones too
    residual_db: FloatArray
    #: more carriers are suspect than may be removed
    is_exhausted: bool


def predict_deviation_db(plus: FloatArray, minus: FloatArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the deviations of the model, shape (..., N), for attitudes of shape (..., 3).

    Examples
    --------
    >>> predict_deviation_db(np.array([[0.1, 1.0, 2.0]]), np.array([[0.1, 3.0, 4.0]]), np.array([0.0, -0.1, 0.2]))
    array([0.1])
    """
    return np.asarray(np.maximum(attitude_deg, 0.0) @ plus.T + np.minimum(attitude_deg, 0.0) @ minus.T)


def residual_db(plus: FloatArray, minus: FloatArray, deviation_db: FloatArray, attitude_deg: FloatArray) -> FloatArray:
    """Return measured minus model (N,) of each carrier."""
    residual = deviation_db.copy()
    for k in range(len(residual)):
        for axis in range(3):
            angle = attitude_deg[axis]
            residual[k] -= angle * (minus[k, axis] if angle < 0.0 else plus[k, axis])
    return residual


def solve_octants(plus: FloatArray, minus: FloatArray, deviation_db: FloatArray, is_used: BoolArray) -> OctantFix:
    """Return the attitude that best explains the deviations of some carriers: the global optimum.

    NaN with fewer than four carriers, or when they do not determine all three angles in the octant of the optimum. Of
    equal costs the candidate with more free angles wins, then the first in the order + - 0, yaw first.

    Parameters
    ----------
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities for positive and negative yaw, roll, pitch.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference power, harmonic removed.
    is_used : ndarray of bool, shape (N,)
        Carriers that count; their numbers are finite.

    Examples
    --------
    >>> plus = np.array([[0.2, 1.0, 0.1], [0.1, -1.5, 0.3], [0.3, 0.2, 1.0], [-0.2, 0.4, -1.2], [0.1, 1.1, 0.9]])
    >>> measured = plus @ [0.0, 0.1, 0.0] + 1.5 * plus @ [-0.2, 0.0, -0.3]
    >>> fix = solve_octants(plus, 1.5 * plus, measured, np.full(5, True))
    >>> fix.attitude_deg.round(9), fix.octant
    (array([-0.2,  0.1, -0.3]), 5)
    """
    count, length = 0, np.ones(6)
    # normal equations in six columns, the seventh being the right-hand side
    normal, row = np.zeros((6, 7)), np.empty(7)
    for k in range(len(deviation_db)):
        if is_used[k]:
            count += 1
            row[6] = deviation_db[k]
            for axis in range(3):
                row[axis], row[3 + axis] = plus[k, axis], minus[k, axis]
            for i in range(6):
                for j in range(i, 7):
                    normal[i, j] += row[i] * row[j]
    for i in range(6):
        if normal[i, i] > 0.0:
            length[i] = math.sqrt(normal[i, i])
    for i in range(6):
        normal[i, 6] /= length[i]
        for j in range(i, 6):
            normal[i, j] /= length[i] * length[j]
            normal[j, i] = normal[i, j]
    octant, attitude, unit_covariance = _cheapest(normal, length)
    cost = 0.0
    if octant < 0 or count < MIN_CARRIERS:
        octant, cost = -1, math.nan
        for i in range(3):
            attitude[i] = math.nan
            for j in range(3):
                unit_covariance[i, j] = math.nan
    for k in range(len(deviation_db)):
        if is_used[k]:
            residual = deviation_db[k]
            for axis in range(3):
                angle = attitude[axis]
                residual -= angle * (minus[k, axis] if angle < 0.0 else plus[k, axis])
            cost += residual * residual
    return OctantFix(attitude, cost, octant, unit_covariance, count)


def _cheapest(normal: FloatArray, length: FloatArray) -> tuple[int, FloatArray, FloatArray]:
    """Return octant, angles (3,) and covariance (3, 3) of a unit noise of the cheapest candidate; octant -1 = none."""
    matrix, inverse, side, angles = np.empty((3, 3)), np.empty((8, 3, 3)), np.empty(3), np.empty(3)
    spare, is_regular, attitude = np.empty((3, 3)), np.zeros(8, dtype=np.bool_), np.zeros(3)
    best_gain, best_octant = -math.inf, -1
    for candidate in range(len(SIGNS)):
        octant, is_feasible, gain = 0, True, 0.0
        for i in range(3):
            column = i + 3 if SIGNS[candidate, i] < 0.0 else i
            octant = 2 * octant + (1 if SIGNS[candidate, i] < 0.0 else 0)
            side[i] = 0.0 if SIGNS[candidate, i] == 0.0 else normal[column, 6]
            for j in range(3):
                other = j + 3 if SIGNS[candidate, j] < 0.0 else j
                is_free = SIGNS[candidate, i] != 0.0 and SIGNS[candidate, j] != 0.0
                # an angle that is zero has the row of the unit matrix
                matrix[i, j] = normal[column, other] if is_free else (1.0 if i == j else 0.0)
        determinant = _invert(matrix, spare)
        for i in range(3):
            angles[i] = spare[i, 0] * side[0] + spare[i, 1] * side[1] + spare[i, 2] * side[2]
            gain += angles[i] * side[i]
            is_feasible = is_feasible and angles[i] * SIGNS[candidate, i] >= 0.0
            if candidate < 8:
                is_regular[candidate] = determinant > MIN_DETERMINANT
                for j in range(3):
                    inverse[candidate, i, j] = spare[i, j]
        if determinant > MIN_DETERMINANT and is_feasible and gain > best_gain:
            best_gain, best_octant = gain, octant
            for i in range(3):
                attitude[i] = angles[i] / length[i + 3 if SIGNS[candidate, i] < 0.0 else i]
    if best_octant < 0 or not is_regular[best_octant]:
        return -1, attitude, spare
    for i in range(3):
        column = i + 3 if SIGNS[best_octant, i] < 0.0 else i
        for j in range(3):
            other = j + 3 if SIGNS[best_octant, j] < 0.0 else j
            spare[i, j] = inverse[best_octant, i, j] / (length[column] * length[other])
    return best_octant, attitude, spare


def _invert(matrix: FloatArray, inverse: FloatArray) -> float:
    """Write the inverse of a symmetric matrix (3, 3), zeros where it is singular, and return its determinant."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            inverse[i, j] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    determinant = 0.0
    for i in range(3):
        determinant += matrix[i, 0] * inverse[i, 0]
    scale = 1.0 / determinant if determinant > MIN_DETERMINANT else 0.0
    for i in range(3):
        for j in range(3):
            inverse[i, j] *= scale
    return determinant


def reject_faded_carriers(
    plus: FloatArray,
    minus: FloatArray,
    deviation_db: FloatArray,
    gate_db: float,
    gate_sigma: float,
    min_carriers: int,
) -> RejectedFix:
    """Return the paper's fix without the carriers that rain on their uplinks has hit.

    Parameters
    ----------
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities for positive and negative yaw, roll, pitch. NaN makes the carrier absent.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference power, harmonic removed. NaN marks an absent carrier.
    gate_db : float, dB
        A misfit below minus this is rain.
    gate_sigma : float
        Half width of the second gate in sigmas.
    min_carriers : int
        As many carriers are always left.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> plus = rng.normal(0.0, [0.2, 1.4, 1.2], (12, 3))
    >>> faded_db = predict_deviation_db(plus, plus, np.array([0.1, -0.1, 0.2])) - 3.0 * (np.arange(12) == 5)
    >>> result = reject_faded_carriers(plus, plus, faded_db, 1.5, 3.0, 4)
    >>> np.flatnonzero(result.reason), result.fix.attitude_deg.round(9)
    (array([5]), array([ 0.1, -0.1,  0.2]))
    """
    carriers = len(deviation_db)
    reason, is_kept = np.zeros(carriers, dtype=np.int64), np.zeros(carriers, dtype=np.bool_)
    for k in range(carriers):
        total, reason[k] = deviation_db[k], ABSENT
        for axis in range(3):
            total += plus[k, axis] + minus[k, axis]
        # a sum is finite where all of its parts are
        if math.isfinite(total):
            is_kept[k], reason[k] = True, GATE
    is_stopped = _gate(plus, minus, deviation_db, is_kept, gate_db, min_carriers)
    for k in range(carriers):
        reason[k] = SIGMA if is_kept[k] else reason[k]
    fix, is_exhausted = _clip(plus, minus, deviation_db, is_kept, gate_sigma, min_carriers)
    residual = residual_db(plus, minus, deviation_db, fix.attitude_deg)
    for k in range(carriers):
        reason[k] = USED if is_kept[k] else reason[k]
        residual[k] = math.nan if reason[k] == ABSENT else residual[k]
    return RejectedFix(fix, reason, residual, is_stopped or is_exhausted)


def _gate(
    plus: FloatArray,
    minus: FloatArray,
    deviation_db: FloatArray,
    is_kept: BoolArray,
    gate_db: float,
    min_carriers: int,
) -> bool:
    """Leave the carriers that passes 1 and 2 keep, and return whether pass 1 had to stop early."""
    carriers, kept, away = len(is_kept), 0, 0
    gone = np.empty(carriers, dtype=np.int64)
    for k in range(carriers):
        kept += is_kept[k]
    while True:
        full, worst, worst_db = solve_octants(plus, minus, deviation_db, is_kept), -1, 0.0
        # no misfit exceeds the root of the cost; NaN has nothing to judge
        if full.cost > gate_db**2:
            for k in range(carriers):
                if is_kept[k]:
                    is_kept[k] = False
                    misfit_db = _misfit_db(plus, minus, deviation_db, is_kept, k, full.cost)
                    is_kept[k] = True
                    if misfit_db < worst_db:
                        worst, worst_db = k, misfit_db
        if not worst_db < -gate_db or kept <= min_carriers:
            break
        is_kept[worst], gone[away], kept, away = False, worst, kept - 1, away + 1
    for position in range(away - 1):
        k = gone[position]
        is_kept[k] = True
        with_it = solve_octants(plus, minus, deviation_db, is_kept)
        is_kept[k] = False
        is_kept[k] = _misfit_db(plus, minus, deviation_db, is_kept, k, with_it.cost) >= -gate_db
    return worst_db < -gate_db


def _misfit_db(
    plus: FloatArray, minus: FloatArray, deviation_db: FloatArray, is_kept: BoolArray, carrier: int, cost_with: float
) -> float:
    """Return the misfit of a carrier that is not among those kept; 0 where there is no fix without it."""
    without = solve_octants(plus, minus, deviation_db, is_kept)
    reduction, residual = cost_with - without.cost, deviation_db[carrier]
    if math.isnan(reduction):
        return 0.0
    for axis in range(3):
        angle = without.attitude_deg[axis]
        residual -= angle * (minus[carrier, axis] if angle < 0.0 else plus[carrier, axis])
    return math.copysign(math.sqrt(max(reduction, 0.0)), residual)


def _clip(
    plus: FloatArray,
    minus: FloatArray,
    deviation_db: FloatArray,
    is_kept: BoolArray,
    gate_sigma: float,
    min_carriers: int,
) -> tuple[OctantFix, bool]:
    """Leave the carriers that the paper's rule uses, and return their fix and whether it wanted fewer than may be."""
    carriers = len(is_kept)
    is_used, seen = is_kept.copy(), np.empty((_PASSES, carriers), dtype=np.bool_)
    fix, is_exhausted = solve_octants(plus, minus, deviation_db, is_used), False
    for passes in range(_PASSES):
        residual = residual_db(plus, minus, deviation_db, fix.attitude_deg)
        total, used, tested, changed = 0.0, 0, 0, 0
        for k in range(carriers):
            seen[passes, k] = is_used[k]
            total += residual[k] ** 2 if is_used[k] else 0.0
            used += is_used[k]
        limit_db = max(gate_sigma * math.sqrt(total / max(used, 1)), ROUNDING_DB)
        for k in range(carriers):
            # negated, so that without a fix (NaN) nothing is rejected
            is_used[k] = is_kept[k] and not abs(residual[k]) >= limit_db
            tested += is_used[k]
            changed += is_used[k] != seen[passes, k]
        is_exhausted = changed > 0 and tested < min_carriers
        place = _place(seen, passes + 1, is_used)
        if is_exhausted:
            place = passes
        if changed > 0 and place <= passes:
            # a cycle, or the set before
            for k in range(carriers):
                is_used[k] = seen[place, k]
            fix = solve_octants(plus, minus, deviation_db, is_used)
        if place <= passes:
            break
        fix = solve_octants(plus, minus, deviation_db, is_used)
    for k in range(carriers):
        is_kept[k] = is_used[k]
    return fix, is_exhausted


def _place(sets: BoolArray, count: int, one: BoolArray) -> int:
    """Return the place of the first of the smallest sets from the one that equals another on, the count without one."""
    smallest, least = count, len(one) + 1
    for position in range(count):
        differing, size = 0, 0
        for k in range(len(one)):
            differing += sets[position, k] != one[k]
            size += sets[position, k]
        if (differing == 0 or smallest < count) and size < least:
            smallest, least = position, size
    return smallest
