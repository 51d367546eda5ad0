"""Attitude from power deviations when the sensitivity depends on the sign of the angle: the paper's model."""

import itertools
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray

#: (8, 3), sign of yaw, roll, pitch in each octant, lexicographic, + before -.
OCTANT_SIGNS: FloatArray = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
#: Smallest determinant of a normal matrix with unit diagonal that counts as regular.
MIN_DETERMINANT = 1e-8

_STATES = sorted(itertools.product((1.0, -1.0, 0.0), repeat=3), key=lambda state: state.count(0.0))
#: (27, 3), sign of each angle in each candidate; those with more free angles first, then lexicographic, + - 0.
CANDIDATE_SIGNS: FloatArray = np.array(_STATES)
_FREE = CANDIDATE_SIGNS != 0.0
#: (27, 3), which of the six columns stands for each axis.
_COLUMNS = np.arange(3) + 3 * (CANDIDATE_SIGNS < 0.0)
_IS_INSIDE = np.asarray((CANDIDATE_SIGNS * OCTANT_SIGNS[:, np.newaxis] >= 0.0).all(axis=2))
#: (8, 8), the candidates that lie in each octant, and (27,), the first octant that holds each candidate.
_CANDIDATES_OF_OCTANT = np.array([np.flatnonzero(inside) for inside in _IS_INSIDE])
_OCTANT_OF_CANDIDATE = _IS_INSIDE.argmax(axis=0)

# Normal matrices are read from the 36 elements of the six columns' matrix, followed by a zero and a one: rows and
# columns of angles that are zero become those of the unit matrix by their index alone.
_ZERO, _ONE = 36, 37
_PAIRS = np.where(
    _FREE[:, :, np.newaxis] & _FREE[:, np.newaxis, :],
    _COLUMNS[:, :, np.newaxis] * 6 + _COLUMNS[:, np.newaxis, :],
    np.where(np.eye(3) > 0.0, _ONE, _ZERO),
)
_SIDES = np.where(_FREE, _COLUMNS, 6)
# The adjugate of a symmetric 3 by 3 matrix G: adj_jk = G_j'k' G_j"k" - G_j'k" G_j"k', j' and j" the rows after j.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
_ADJUGATE = np.stack([_PAIRS[:, rows][:, :, columns] for rows in (_NEXT, _LAST) for columns in (_NEXT, _LAST)])


class BestCandidate(NamedTuple):
    """Best candidate of each row.

    Parameters
    ----------
    octant : ndarray of int, shape (T,)
        Row of ``OCTANT_SIGNS``; an angle of zero counts as +.
    signs : ndarray, shape (T, 3)
        Sign of each angle, 0 where it is zero.
    columns : ndarray of int, shape (T, 3)
        Column of the six that stands for each axis.
    solution : ndarray, shape (T, 3)
        Scaled solution.
    octant_inverse : ndarray, shape (T, 3, 3)
        Inverse of the scaled normal matrix of all three angles in the octant; without meaning where it is singular.
    is_regular : ndarray of bool, shape (T,)
        False where ``octant_inverse`` does not exist.
    second_gain : ndarray, shape (T,)
        Largest reduction of the cost in any other octant.
    """

    octant: IntArray
    signs: FloatArray
    columns: IntArray
    solution: FloatArray
    octant_inverse: FloatArray
    is_regular: BoolArray
    second_gain: FloatArray


class CandidateSystems(NamedTuple):
    """Solved systems of the 27 candidates of each row, before anything was measured.

    Parameters
    ----------
    inverse : ndarray, shape (T, 27, 3, 3)
        Inverse of the scaled normal matrix; without meaning where it is singular.
    is_regular : ndarray of bool, shape (T, 27)
        False where the inverse does not exist.
    """

    inverse: FloatArray
    is_regular: BoolArray


def solve_candidates(normal: FloatArray) -> CandidateSystems:
    """Return the inverses of the 27 systems of each row.

    Parameters
    ----------
    normal : ndarray, shape (T, 36)
        Scaled normal matrices of the six columns, flattened; zero rows for columns that are zero.
    """
    zero = np.zeros((len(normal), 1))
    elements = np.concatenate([normal, zero, zero + 1.0], axis=1)
    factors = elements[:, _ADJUGATE]
    adjugate = factors[:, 0] * factors[:, 3] - factors[:, 1] * factors[:, 2]
    determinant = np.vecdot(elements[:, _PAIRS[:, 0]], adjugate[:, :, 0])
    is_regular = determinant > MIN_DETERMINANT
    return CandidateSystems(adjugate / np.where(is_regular, determinant, 1.0)[:, :, np.newaxis, np.newaxis], is_regular)


class CandidateChooser:
    """Chooses the candidate of one row whose carriers are those of many rows: what they settle is computed once.

    Parameters
    ----------
    candidates : CandidateSystems
        Of this row alone.
    """

    def __init__(self, candidates: CandidateSystems) -> None:
        self.inverse, self.is_regular = candidates.inverse[0], candidates.is_regular[0]
        # (81, 6) from the scaled right-hand sides to all solutions
        self._solve = (self.inverse @ np.eye(7)[_SIDES])[:, :, :6].reshape(81, 6)

    def choose(self, moment: FloatArray) -> tuple[int, FloatArray, float]:
        """Return the best candidate of a row, its solution (3,) and the largest gain in another octant.

        Parameters
        ----------
        moment : ndarray, shape (6,)
            Scaled right-hand sides.
        """
        solution = (self._solve @ moment).reshape(27, 3)
        is_feasible = self.is_regular & ((solution * CANDIDATE_SIGNS).min(axis=1) >= 0.0)
        # where an angle is zero its solution is
        gain = np.where(is_feasible, np.vecdot(solution, moment[_COLUMNS]), -math.inf)
        best = int(gain.argmax())
        gain_of_octant = gain[_CANDIDATES_OF_OCTANT].max(axis=1)
        gain_of_octant[_OCTANT_OF_CANDIDATE[best]] = -math.inf
        return best, solution[best], float(gain_of_octant.max())


def octant_of(candidate: int) -> tuple[int, IntArray]:
    """Return the first octant that holds a candidate, and which of the six columns stands for each axis (3,)."""
    return int(_OCTANT_OF_CANDIDATE[candidate]), _COLUMNS[candidate]


def choose_candidate(candidates: CandidateSystems, moment: FloatArray) -> BestCandidate:
    """Return the cheapest feasible candidate of each row.

    Parameters
    ----------
    candidates : CandidateSystems
        Of each row.
    moment : ndarray, shape (T, 6)
        Scaled right-hand sides.

    Returns
    -------
    BestCandidate
        Of equal costs the candidate with more free angles wins, then the first in the order + - 0, yaw first. The
        candidate with three zeros is always feasible, so a choice always exists.
    """
    inverse, is_regular = candidates
    rows = np.arange(len(moment))
    side = np.concatenate([moment, np.zeros((len(moment), 1))], axis=1)[:, _SIDES]
    solution = (inverse @ side[..., np.newaxis])[..., 0]
    is_feasible = is_regular & (solution * CANDIDATE_SIGNS >= 0.0).all(axis=2)
    gain = np.where(is_feasible, np.vecdot(solution, side), -math.inf)
    best = gain.argmax(axis=1)
    octant = _OCTANT_OF_CANDIDATE[best]
    gain_of_octant = gain[:, _CANDIDATES_OF_OCTANT].max(axis=2)
    gain_of_octant[rows, octant] = -math.inf
    return BestCandidate(
        octant=octant,
        signs=CANDIDATE_SIGNS[best],
        columns=_COLUMNS[best],
        solution=solution[rows, best],
        octant_inverse=inverse[rows, octant],  # the first eight candidates are the octants, in their order
        is_regular=is_regular[rows, octant],
        second_gain=gain_of_octant.max(axis=1),
    )


__all__ = ["OCTANT_SIGNS", "OctantFix", "OctantFixes", "predict_deviation_db", "solve_octants", "solve_octants_rows"]


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
