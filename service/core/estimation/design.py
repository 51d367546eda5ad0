"""Choice of the carriers to measure: weighted A-optimal design by exchange.

``minimise sum_j u_j^2 C_jj``: C the covariance in deg^2 of (yaw, roll, pitch) from the rows ``[a_i 1] / sigma_i`` of
the chosen carriers (a in dB/deg), u the weights. Yaw weighs 0.05 because no choice makes it good and any choice that
serves it alone spoils the rest. Search: greedy growth from a weak prior, then the best exchange of a chosen carrier for
a free one until none helps. The law of this file: no transponder holds more than its share of a choice, because it
fails as one, wherever the plan offers that many carriers elsewhere; where it does not, the share is exceeded as little
as possible and the choice does not count as sufficient. Neither does one of fewer than ``MIN_CARRIERS``, or with fewer
than ``MIN_REDUNDANCY`` carriers beyond the five unknowns that a moved transponder needs.

Turns for a calibration: every axis to both sides in steps, then the corners of all octants. The spacecraft returns to
zero between the axes, so that slow changes of the users' levels are seen apart from its turns, and consecutive corners
differ in one sign, so that no slew is longer than it must be.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.observability import crlb_deg, level_columns

#: Weights of yaw, roll, pitch.
AXIS_WEIGHTS = (0.05, 1.0, 1.0)
#: Carriers beyond these that a choice keeps for mutual checks.
MIN_REDUNDANCY = 6
#: Fewest carriers of a choice that counts as sufficient.
MIN_CARRIERS = 12
#: Share of the chosen carriers in one transponder, wherever three can keep to it.
MAX_TRANSPONDER_SHARE = 0.35
#: 1/deg^2 and 1/dB^2, prior of an angle and of a level that lets the first few carriers be compared.
_ANGLE_PRIOR, _LEVEL_PRIOR = 1e-2, 1e-4
#: 1/dB^2, levels known to 0.1 dB, for a growth that does not mind how many levels there are
_KNOWN_LEVEL = 100.0
_MIN_GAIN = 1e-9
_WEIGHTS = np.square(AXIS_WEIGHTS)


def choose_carriers(
    sensitivity: FloatArray,
    sigma_db: FloatArray,
    transponder: IntArray,
    count: int,
    *,
    eligible: BoolArray | None = None,
    level: IntArray | None = None,
) -> IntArray:
    """Return the carriers that determine the attitude best.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch; NaN excludes a carrier.
    sigma_db : ndarray, shape (N,), dB
        Noise of one row; NaN or not positive excludes a carrier.
    transponder : ndarray of int, shape (N,)
        Label of each carrier's transponder.
    count : int
        How many are wanted; at least twelve suffice.
    eligible : ndarray of bool, shape (N,), optional
        Carriers that may be chosen.
    level : ndarray of int, shape (N,), optional
        Number of the level that each carrier shares; one common level by default.

    Returns
    -------
    ndarray of int, shape (C,)
        Carriers in ascending order; fewer than asked for where fewer are eligible.

    References
    ----------
    .. [1] Fedorov, V. V., "Theory of Optimal Experiments", 1972 (exchange).

    Examples
    --------
    >>> sensitivity = np.array([[0.2, 1, 0], [0.2, -1, 0], [-0.2, 0, 1], [0.2, 0, -1], [0.0, 0, 0], [-0.2, 1, 1]])
    >>> choose_carriers(sensitivity, np.full(6, 0.1), np.arange(6), 5)  # the flat one tells the common level
    array([0, 1, 3, 4, 5])
    """
    is_free = np.isfinite(sensitivity).all(axis=1) & np.isfinite(sigma_db) & (sigma_db > 0.0)
    if eligible is not None:
        is_free = is_free & eligible
    shared = np.zeros(len(sensitivity), dtype=np.int64) if level is None else level
    columns = level_columns(len(sensitivity), shared)
    rows = np.column_stack([np.where(is_free[:, np.newaxis], sensitivity, 0.0), columns])
    rows /= np.where(is_free, sigma_db, 1.0)[:, np.newaxis]
    limit = _transponder_limit(transponder[is_free], count)
    choices = []
    for level_prior in (_LEVEL_PRIOR, _KNOWN_LEVEL):
        # of a level that nothing is known of the first carrier tells nothing: a second growth looks beyond that
        grown = _grown(rows, transponder, is_free, count, limit, level_prior)
        choices.append(np.flatnonzero(_exchanged(rows, transponder, is_free, grown, limit)))

    def cost_deg2(chosen: IntArray) -> float:
        bound = crlb_deg(sensitivity[chosen], sigma_db[chosen], with_common=True, level=shared[chosen])
        return float(weighted_variance_deg2(bound))

    return min(choices, key=cost_deg2)


def weighted_variance_deg2(bound_deg: FloatArray) -> FloatArray:
    """Return the weighted sums of variances (...) of bounds (..., 3) in deg; infinite where a bound is NaN.

    Examples
    --------
    >>> weighted_variance_deg2(np.array([2.0, 0.1, np.nan])), weighted_variance_deg2(np.array([2.0, 0.1, 0.1])).round(6)
    (array(inf), np.float64(0.03))
    """
    return np.asarray(np.nan_to_num(np.square(bound_deg) @ _WEIGHTS, nan=math.inf))


def largest_share(transponder: IntArray) -> float:
    """Return the largest share of some carriers in one transponder; 0 without carriers.

    Examples
    --------
    >>> largest_share(np.array([1, 1, 1, 2]))
    0.75
    """
    if not len(transponder):
        return 0.0
    return float(np.unique_counts(transponder).counts.max() / len(transponder))


def most_share(count: int) -> float:
    """Return the share of so many carriers that one transponder may hold; three share 13 as 5, 4, 4 at best.

    Examples
    --------
    >>> most_share(12), round(most_share(13), 3)
    (0.35, 0.385)
    """
    return max(MAX_TRANSPONDER_SHARE, math.ceil(count / 3) / max(count, 1))


def _transponder_limit(transponder: IntArray, count: int) -> int:
    """Return how many carriers one transponder may hold: its share, or as little more as the plan forces."""
    held = np.unique_counts(transponder).counts
    wanted = min(count, len(transponder))
    limit = max(1, math.floor(most_share(wanted) * wanted + 1e-9))
    while int(np.minimum(held, limit).sum()) < wanted:
        limit += 1
    return limit


def _costs(normal: FloatArray, level_prior: float) -> FloatArray:
    """Return the weighted sums of variances (...) of normal matrices (..., U, U)."""
    inverse = np.linalg.inv(normal + _prior(normal.shape[-1], level_prior))
    return np.asarray(np.diagonal(inverse, axis1=-2, axis2=-1)[..., :3] @ _WEIGHTS)


def _prior(unknowns: int, level_prior: float = _LEVEL_PRIOR) -> FloatArray:
    """Return the prior information: next to none, unless levels are stated as known."""
    return np.diag([_ANGLE_PRIOR] * 3 + [level_prior] * (unknowns - 3))


def _normals(rows: FloatArray) -> FloatArray:
    """Return the contribution of each row to the normal matrix."""
    return rows[:, :, np.newaxis] * rows[:, np.newaxis]


def _grown(
    rows: FloatArray,
    transponder: IntArray,
    is_free: BoolArray,
    count: int,
    limit: int,
    level_prior: float,
) -> BoolArray:
    """Return a first choice: the carrier that helps most, one after another."""
    chosen = np.zeros(len(rows), dtype=np.bool_)
    added = _normals(rows)
    for _ in range(count):
        full = transponder[chosen]
        is_open = np.array([np.count_nonzero(full == label) < limit for label in transponder], dtype=np.bool_)
        candidates = np.flatnonzero(is_free & ~chosen & is_open)
        if not candidates.size:
            break
        cost = _costs(added[chosen].sum(axis=0) + added[candidates], level_prior)
        chosen[candidates[int(np.argmin(cost))]] = True
    return chosen


def _exchanged(rows: FloatArray, transponder: IntArray, is_free: BoolArray, chosen: BoolArray, limit: int) -> BoolArray:
    """Return the choice after the best exchanges, until none lowers the cost."""
    chosen, added = chosen.copy(), _normals(rows)
    while True:
        inside, outside = np.flatnonzero(chosen), np.flatnonzero(is_free & ~chosen)
        if not inside.size or not outside.size:
            return chosen
        held = np.array([np.count_nonzero(transponder[inside] == label) for label in transponder[outside]])
        is_same = transponder[inside][:, np.newaxis] == transponder[outside]
        inverse = np.linalg.inv(added[inside].sum(axis=0) + _prior(rows.shape[1]))
        gain = np.where(is_same | (held < limit), _exchange_gains(rows, inside, outside, inverse), -math.inf)
        leaving, coming = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if not gain[leaving, coming] > _MIN_GAIN * float(np.diagonal(inverse)[:3] @ _WEIGHTS):
            return chosen
        chosen[inside[leaving]], chosen[outside[coming]] = False, True


def _exchange_gains(rows: FloatArray, inside: IntArray, outside: IntArray, inverse: FloatArray) -> FloatArray:
    """Return by how much each exchange lowers the cost, shape (inside, outside).

    With C the inverse, x the leaving and y the coming row, ``(C^-1 - x x' + y y')^-1`` is C less a term of rank two
    (Woodbury); ``d = x' C y`` and ``q`` the same with C W C, W the weights, give the trace of that term.
    """
    leaving, coming = rows[inside] @ inverse, rows[outside] @ inverse
    weighted = np.append(_WEIGHTS, np.zeros(rows.shape[1] - 3))
    d_xx = np.vecdot(leaving, rows[inside])[:, np.newaxis]
    d_yy, d_xy = np.vecdot(coming, rows[outside]), leaving @ rows[outside].T
    q_xx = (leaving**2 @ weighted)[:, np.newaxis]
    q_yy, q_xy = coming**2 @ weighted, (leaving * weighted) @ coming.T
    determinant = (d_xx - 1.0) * (1.0 + d_yy) - d_xy**2
    return np.asarray(((1.0 + d_yy) * q_xx - 2.0 * d_xy * q_xy + (d_xx - 1.0) * q_yy) / determinant)


#: deg and minutes, the turns of a calibration: levels on each side of each axis, then the corners of all octants.
TURN_LEVELS_DEG = (0.125, 0.25, 0.375, 0.5)
TURN_CORNER_DEG = 0.3
TURN_MINUTES = 15.0
REST_MINUTES = 10.0
#: deg, yaw is turned this far where the spacecraft allows it: it is eight times less visible.
FAR_YAW_DEG = 1.0


class TurnLevel(NamedTuple):
    """One recommended level: yaw, roll, pitch in deg, held for some minutes."""

    attitude_deg: tuple[float, float, float]
    minutes: float


def recommended_turns(*, far_yaw: bool = False) -> tuple[TurnLevel, ...]:
    """Return the turns of a calibration in order, with rests at zero.

    Parameters
    ----------
    far_yaw : bool
        The spacecraft may turn 1 deg about yaw; the yaw levels are then doubled.

    Returns
    -------
    tuple of TurnLevel
        8.5 hours: plus and minus four levels for each axis, then the eight corners of 0.3 deg, one sign at a time.

    Examples
    --------
    >>> turns = recommended_turns()
    >>> len(turns), sum(turn.minutes for turn in turns) / 60.0
    (39, 8.5)
    """
    scale = (FAR_YAW_DEG / TURN_LEVELS_DEG[-1] if far_yaw else 1.0, 1.0, 1.0)
    rest = TurnLevel((0.0, 0.0, 0.0), REST_MINUTES)
    turns = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            sizes = [sign * level * scale[axis] for level in TURN_LEVELS_DEG]
            turns += [TurnLevel(_about(axis, size), TURN_MINUTES) for size in sizes]
            turns.append(rest)
    for number in range(8):
        # Gray code: consecutive corners differ in one sign
        code = number ^ (number >> 1)
        yaw, roll, pitch = (TURN_CORNER_DEG * (-1.0 if code >> bit & 1 else 1.0) for bit in (2, 1, 0))
        turns.append(TurnLevel((yaw, roll, pitch), REST_MINUTES))
    return (*turns, rest)


def _about(axis: int, size_deg: float) -> tuple[float, float, float]:
    yaw, roll, pitch = (size_deg if axis == k else 0.0 for k in range(3))
    return yaw, roll, pitch
