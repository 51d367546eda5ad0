"""Attitude from power deviations when the sensitivity depends on the sign of the angle: the paper's model.

``dP_i = sum_j a_ij(sign l_j) l_j``: dP in dB, a in dB/deg, l = (yaw, roll, pitch) in deg; a = ``plus`` for l_j >= 0 and
``minus`` for l_j <= 0. Within one octant (one triple of signs) the model is linear and its least squares is a convex
problem with three bounds. The law of this file: the answer is the global optimum over the eight octants, found by
enumeration (``octant_candidates``). Nothing iterates, so nothing can cycle, and the answer does not depend on where a
search began or in which order the carriers stand.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.paper.octant_candidates import (
    OCTANT_SIGNS,
    CandidateChooser,
    CandidateSystems,
    choose_candidate,
    octant_of,
    solve_candidates,
)

__all__ = ["OCTANT_SIGNS", "OctantFix", "OctantFixes", "predict_deviation_db", "solve_octants", "solve_octants_rows"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Four carriers are the least that leave one to check three angles.
MIN_CARRIERS = 4


class OctantFix(NamedTuple):
    """Attitude of one epoch; all NaN (octant -1) when it is not determined.

    Parameters
    ----------
    attitude_deg : ndarray, shape (3,), deg
        Yaw, roll, pitch.
    cost : float
        ``sum (residual / sigma)^2``, or ``sum residual^2`` in dB^2 when no sigma was given.
    octant : int
        Row of ``OCTANT_SIGNS``; an angle of exactly zero counts as +.
    covariance_deg2 : ndarray, shape (3, 3), deg^2
        Of the octant's linear model, bounds ignored; scaled by the residuals when no sigma was given.
    residual_db : ndarray, shape (N,), dB
        Measured minus model, NaN for absent carriers.
    second_best_cost : float
        Cost of the best solution in any other octant. Equal to ``cost`` when an angle is zero, since the solution then
        lies in two octants at once.
    carriers_used : int
        Carriers present.
    """

    attitude_deg: FloatArray
    cost: float
    octant: int
    covariance_deg2: FloatArray
    residual_db: FloatArray
    second_best_cost: float
    carriers_used: int


class OctantFixes(NamedTuple):
    """Attitudes of T epochs: the fields of :class:`OctantFix` with a leading axis T.

    Parameters
    ----------
    attitude_deg : ndarray, shape (T, 3), deg
        As in :class:`OctantFix`.
    cost : ndarray, shape (T,)
        As in :class:`OctantFix`.
    octant : ndarray of int, shape (T,)
        As in :class:`OctantFix`.
    covariance_deg2 : ndarray, shape (T, 3, 3), deg^2
        As in :class:`OctantFix`.
    residual_db : ndarray, shape (T, N), dB
        As in :class:`OctantFix`.
    second_best_cost : ndarray, shape (T,)
        As in :class:`OctantFix`.
    carriers_used : ndarray of int, shape (T,)
        As in :class:`OctantFix`.
    """

    attitude_deg: FloatArray
    cost: FloatArray
    octant: IntArray
    covariance_deg2: FloatArray
    residual_db: FloatArray
    second_best_cost: FloatArray
    carriers_used: IntArray


def predict_deviation_db(plus: FloatArray, minus: FloatArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the deviations of the model, shape (..., N), for attitudes of shape (..., 3).

    Examples
    --------
    >>> predict_deviation_db(np.array([[0.1, 1.0, 2.0]]), np.array([[0.1, 3.0, 4.0]]), np.array([0.0, -0.1, 0.2]))
    array([0.1])
    """
    return np.asarray(np.maximum(attitude_deg, 0.0) @ plus.T + np.minimum(attitude_deg, 0.0) @ minus.T)


def solve_octants(
    plus: FloatArray, minus: FloatArray, deviation_db: FloatArray, sigma_db: FloatArray | None
) -> OctantFix:
    """Return the attitude that best explains one row of power deviations.

    Parameters
    ----------
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities for positive and negative yaw, roll, pitch. NaN makes the carrier absent.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference power, harmonic removed. NaN marks an absent carrier.
    sigma_db : ndarray, shape (N,), dB, or None
        Noise of each deviation; not positive or NaN makes the carrier absent. None weighs all alike.

    Returns
    -------
    OctantFix
        The global optimum. NaN with fewer than four carriers, or when the carriers do not determine all three angles in
        the octant of the optimum.

    Notes
    -----
    Columns scaled to unit length, normal equations of 27 systems solved in closed form. Never worse
    than a grid of 0.01 deg over +-0.6 deg polished by an independent optimiser
    (``tests/unit/service/core/estimation/paper/test_octants.py``).

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, equations (1) and (2).

    Examples
    --------
    >>> plus = np.array([[0.2, 1.0, 0.1], [0.1, -1.5, 0.3], [0.3, 0.2, 1.0], [-0.2, 0.4, -1.2], [0.1, 1.1, 0.9]])
    >>> fix = solve_octants(plus, 1.5 * plus, plus @ [0.0, 0.1, 0.0] + 1.5 * plus @ [-0.2, 0.0, -0.3], None)
    >>> fix.attitude_deg.round(9), fix.octant
    (array([-0.2,  0.1, -0.3]), 5)
    """
    row_db = deviation_db[np.newaxis]
    if sigma_db is None:
        row = _row_of(plus.tobytes(), minus.tobytes(), np.isfinite(deviation_db).tobytes())
        system, fix = row.system, _fix(row, deviation_db)
        if fix is not None:
            return fix
    else:
        system = _normal_system(np.concatenate([plus, minus], axis=1), np.isfinite(row_db), sigma_db)
    fixes = _fixes(system, row_db, is_weighted=sigma_db is not None)
    attitude, cost, octant, covariance, residual, second, count = (values[0] for values in fixes)
    return OctantFix(attitude, float(cost), int(octant), covariance, residual, float(second), int(count))


def solve_octants_rows(
    plus: FloatArray, minus: FloatArray, deviation_db: FloatArray, sigma_db: FloatArray | None
) -> OctantFixes:
    """Return the attitude of many rows at once, as :func:`solve_octants` does for one.

    Parameters
    ----------
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities, the same for all rows.
    deviation_db : ndarray, shape (T, N), dB
        Power deviations, each row with its own absent carriers (NaN). Work space is about 15 kB a row.
    sigma_db : ndarray, shape (N,) or (T, N), dB, or None
        Noise of each deviation.

    Returns
    -------
    OctantFixes
        Rows agree with :func:`solve_octants` to rounding, not bit for bit: sums of a batch are ordered differently.
    """
    system = _normal_system(np.concatenate([plus, minus], axis=1), np.isfinite(deviation_db), sigma_db)
    return _fixes(system, deviation_db, is_weighted=sigma_db is not None)


class _System(NamedTuple):
    """Normal equations of T rows in six columns, scaled: all that depends only on the carriers that are present."""

    #: (N, 6)
    design: FloatArray
    #: (T, N)
    is_present: BoolArray
    #: (T, N)
    weights: FloatArray
    #: (T,)
    carriers_used: IntArray
    #: (T, 6)
    length: FloatArray
    candidates: CandidateSystems


def _outer(vectors: FloatArray) -> FloatArray:
    """Return the outer product of each row with itself."""
    return vectors[:, :, np.newaxis] * vectors[:, np.newaxis, :]


class _RowSystem(NamedTuple):
    """Equations of one row of equal weights, solved as far as its carriers settle them."""

    system: _System
    #: (N, 6), zeros where a carrier is absent
    design: FloatArray
    #: (6, N) from deviations to scaled right-hand sides
    moment: FloatArray
    chooser: CandidateChooser


# some sets of carriers for each spacecraft of a fleet, 10 kB each
@lru_cache(maxsize=512)
def _row_of(plus: bytes, minus: bytes, is_measured: bytes) -> _RowSystem:
    """Return the equations of one row of equal weights: from row to row the carriers hardly ever change."""
    columns = [np.frombuffer(each).reshape(-1, 3) for each in (plus, minus)]
    system = _normal_system(np.concatenate(columns, axis=1), np.frombuffer(is_measured, np.bool_)[np.newaxis], None)
    design = system.weights[0, :, np.newaxis] * system.design
    return _RowSystem(system, design, (design / system.length[0]).T.copy(), CandidateChooser(system.candidates))


def _fix(row: _RowSystem, deviation_db: FloatArray) -> OctantFix | None:
    """Return the optimum of one row of deviations (N,); None where it is not determined."""
    system, count, is_present = row.system, int(row.system.carriers_used[0]), row.system.is_present[0]
    measured = np.where(is_present, deviation_db, 0.0)
    best, solution, second_gain = row.chooser.choose(row.moment @ measured)
    octant, columns = octant_of(best)
    if count < MIN_CARRIERS or not row.chooser.is_regular[octant]:
        return None
    attitude = solution / (scale := system.length[0, columns])
    residual = measured - row.design[:, columns] @ attitude
    cost = float(residual @ residual)
    return OctantFix(
        attitude_deg=attitude,
        cost=cost,
        octant=octant,
        covariance_deg2=row.chooser.inverse[octant] * (cost / max(count - 3, 1)) / np.multiply.outer(scale, scale),
        residual_db=np.where(is_present, residual, math.nan),
        second_best_cost=max(float(measured @ measured) - second_gain, cost),
        carriers_used=count,
    )


def _normal_system(design: FloatArray, is_measured: BoolArray, sigma_db: FloatArray | None) -> _System:
    """Return the scaled normal equations; absent carriers weigh nothing."""
    is_known = np.isfinite(design)
    is_present = is_measured & is_known.all(axis=1)
    if sigma_db is None:
        weights = is_present.astype(np.float64)
    else:
        is_present = is_present & (sigma_db > 0.0) & np.isfinite(sigma_db)
        weights = is_present / np.where(is_present, sigma_db, 1.0) ** 2
    safe = np.where(is_known, design, 0.0)
    normal = weights @ _outer(safe).reshape(-1, 36)
    length = np.sqrt(normal[:, ::7])
    length[length == 0.0] = 1.0
    candidates = solve_candidates(normal / _outer(length).reshape(-1, 36))
    return _System(safe, is_present, weights, is_present.sum(axis=1), length, candidates)


def _fixes(system: _System, deviation_db: FloatArray, *, is_weighted: bool) -> OctantFixes:
    """Return the optimum of each row of deviations (T, N)."""
    measured = np.where(system.is_present, deviation_db, 0.0)
    weighted = system.weights * measured
    choice = choose_candidate(system.candidates, weighted @ system.design / system.length)
    position = np.arange(len(measured))[:, np.newaxis], choice.columns
    scale = system.length[position]
    angles = np.zeros_like(system.length)
    angles[position] = attitude = choice.solution / scale
    residual = measured - angles @ system.design.T
    cost = np.vecdot(system.weights * residual, residual)
    count = system.carriers_used
    variance = 1.0 if is_weighted else cost / np.maximum(count - 3, 1)
    fixes = OctantFixes(
        attitude_deg=attitude,
        cost=cost,
        octant=choice.octant,
        covariance_deg2=choice.octant_inverse * np.reshape(variance, (-1, 1, 1)) / _outer(scale),
        residual_db=np.where(system.is_present, residual, math.nan),
        second_best_cost=np.maximum(np.vecdot(weighted, measured) - choice.second_gain, cost),
        carriers_used=count,
    )
    is_determined = choice.is_regular & (count >= MIN_CARRIERS)
    return fixes if is_determined.all() else _blanked(fixes, is_determined)


def _blanked(fixes: OctantFixes, is_determined: BoolArray) -> OctantFixes:
    """Return the fixes with the undetermined rows absent."""
    column = is_determined[:, np.newaxis]
    return OctantFixes(
        attitude_deg=np.where(column, fixes.attitude_deg, math.nan),
        cost=np.where(is_determined, fixes.cost, math.nan),
        octant=np.where(is_determined, fixes.octant, -1),
        covariance_deg2=np.where(column[:, :, np.newaxis], fixes.covariance_deg2, math.nan),
        residual_db=np.where(column, fixes.residual_db, math.nan),
        second_best_cost=np.where(is_determined, fixes.second_best_cost, math.nan),
        carriers_used=fixes.carriers_used,
    )
