"""The 27 candidate solutions of the sign-dependent least squares, for many rows at once.

Each axis of ``dP = A l`` is positive (column of ``plus``), negative (column of ``minus``) or zero: 3^3 = 27 linear
systems of at most three unknowns. A candidate is feasible when its solution has the signs it assumed. The law of this
file: the cheapest feasible candidate *is* the global optimum. The optimum of an octant is the unconstrained least
squares of the angles that are not zero at it, hence among the 27; and each feasible candidate is a point of its octant,
hence not below the optimum. A singular system is skipped without loss: along a direction that leaves the cost as it is
one can go until another angle becomes zero, and that system is among the 27 as well.

Normal matrices are scaled to unit diagonal: ``G_jk = a_j' W a_k / (|a_j| |a_k|)`` over the six columns (three plus,
three minus), without unit; solutions are scaled by ``|a_j|`` and therefore in dB (or in sigmas).
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

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
