"""Choice of the carriers to measure: weighted A-optimal design by exchange.

``minimise sum_j u_j^2 C_jj``: C the covariance in deg^2 of (yaw, roll, pitch) from the rows ``[a_i 1] / sigma_i`` of
the chosen carriers (a in dB/deg), u the weights. Yaw weighs 0.05 because no choice makes it good and any choice that
serves it alone spoils the rest. Search: greedy growth from a weak prior, then the best exchange of a chosen carrier for
a free one until none helps. The law of this file: no transponder holds more than its share of a choice, because it
fails as one, wherever the plan offers that many carriers elsewhere; where it does not, the share is exceeded as little
as possible and the choice does not count as sufficient. Neither does one of fewer than ``MIN_CARRIERS``, or with fewer
than ``MIN_REDUNDANCY`` carriers beyond the five unknowns that a moved transponder needs.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.observability import crlb_deg, level_columns, leverages

#: Weights of yaw, roll, pitch.
AXIS_WEIGHTS = (0.05, 1.0, 1.0)
#: Attitude, and the level of one moved transponder; each level that carriers share comes on top.
_UNKNOWNS = 4
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


class Design(NamedTuple):
    """Choice among N carriers.

    Parameters
    ----------
    chosen : ndarray of int, shape (C,)
        Carriers in ascending order; fewer than asked for where fewer are eligible.
    crlb_deg : ndarray, shape (3,), deg
        Bound of yaw, roll, pitch for one row with a common level; NaN when not determined.
    cost_deg2 : float, deg^2
        Weighted sum of variances; infinite when not determined.
    leverage : ndarray, shape (N,)
        Of the chosen carriers, weighted by their noise; NaN for the others.
    redundancy : int
        Chosen carriers beyond three angles, their common levels and the level of one moved transponder.
    transponder_share : float
        Largest share of the chosen carriers in one transponder; 0 without carriers.
    """

    chosen: IntArray
    crlb_deg: FloatArray
    cost_deg2: float
    leverage: FloatArray
    redundancy: int
    transponder_share: float


def choose_carriers(
    sensitivity: FloatArray,
    sigma_db: FloatArray,
    transponder: IntArray,
    count: int,
    *,
    eligible: BoolArray | None = None,
    level: IntArray | None = None,
    axis_weights: tuple[float, float, float] = AXIS_WEIGHTS,
) -> Design:
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
    axis_weights : tuple of float
        Weights of yaw, roll, pitch.

    Returns
    -------
    Design

    References
    ----------
    .. [1] Fedorov, V. V., "Theory of Optimal Experiments", 1972 (exchange).

    Examples
    --------
    >>> sensitivity = np.array([[0.2, 1, 0], [0.2, -1, 0], [-0.2, 0, 1], [0.2, 0, -1], [0.0, 0, 0], [-0.2, 1, 1]])
    >>> choose_carriers(sensitivity, np.full(6, 0.1), np.arange(6), 5).chosen  # the flat one tells the common level
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
    weights = np.square(np.array(axis_weights))
    designs = []
    for level_prior in (_LEVEL_PRIOR, _KNOWN_LEVEL):
        # of a level that nothing is known of the first carrier tells nothing: a second growth looks beyond that
        chosen = _grown(rows, transponder, is_free, count, limit, weights, level_prior)
        chosen = _exchanged(rows, transponder, is_free, chosen, limit, weights)
        designs.append(_judged(sensitivity, sigma_db, transponder, shared, np.flatnonzero(chosen), weights))
    return min(designs, key=lambda design: design.cost_deg2)


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


def _judged(
    sensitivity: FloatArray,
    sigma_db: FloatArray,
    transponder: IntArray,
    level: IntArray,
    picked: IntArray,
    weights: FloatArray,
) -> Design:
    """Return the design of the picked carriers with its figures."""
    bound = crlb_deg(sensitivity[picked], sigma_db[picked], with_common=True, level=level[picked])
    leverage = np.full(len(sensitivity), math.nan)
    leverage[picked] = leverages(sensitivity[picked], sigma_db[picked], level=level[picked])
    is_determined = bool(np.isfinite(bound).all())
    levels = max(1, len(np.unique(level[picked])))
    redundancy, share = len(picked) - _UNKNOWNS - levels, largest_share(transponder[picked])
    return Design(
        chosen=picked.astype(np.int64),
        crlb_deg=bound,
        cost_deg2=float(np.sum(weights * bound**2)) if is_determined else math.inf,
        leverage=leverage,
        redundancy=redundancy,
        transponder_share=share,
    )


def _costs(normal: FloatArray, weights: FloatArray, level_prior: float) -> FloatArray:
    """Return the weighted sums of variances (...) of normal matrices (..., U, U)."""
    inverse = np.linalg.inv(normal + _prior(normal.shape[-1], level_prior))
    return np.asarray(np.diagonal(inverse, axis1=-2, axis2=-1)[..., :3] @ weights)


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
    weights: FloatArray,
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
        cost = _costs(added[chosen].sum(axis=0) + added[candidates], weights, level_prior)
        chosen[candidates[int(np.argmin(cost))]] = True
    return chosen


def _exchanged(
    rows: FloatArray, transponder: IntArray, is_free: BoolArray, chosen: BoolArray, limit: int, weights: FloatArray
) -> BoolArray:
    """Return the choice after the best exchanges, until none lowers the cost."""
    chosen, added = chosen.copy(), _normals(rows)
    while True:
        inside, outside = np.flatnonzero(chosen), np.flatnonzero(is_free & ~chosen)
        if not inside.size or not outside.size:
            return chosen
        held = np.array([np.count_nonzero(transponder[inside] == label) for label in transponder[outside]])
        is_same = transponder[inside][:, np.newaxis] == transponder[outside]
        inverse = np.linalg.inv(added[inside].sum(axis=0) + _prior(rows.shape[1]))
        gain = np.where(is_same | (held < limit), _exchange_gains(rows, inside, outside, inverse, weights), -math.inf)
        leaving, coming = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if not gain[leaving, coming] > _MIN_GAIN * float(np.diagonal(inverse)[:3] @ weights):
            return chosen
        chosen[inside[leaving]], chosen[outside[coming]] = False, True


def _exchange_gains(
    rows: FloatArray, inside: IntArray, outside: IntArray, inverse: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return by how much each exchange lowers the cost, shape (inside, outside).

    With C the inverse, x the leaving and y the coming row, ``(C^-1 - x x' + y y')^-1`` is C less a term of rank two
    (Woodbury); ``d = x' C y`` and ``q`` the same with C W C, W the weights, give the trace of that term.
    """
    leaving, coming = rows[inside] @ inverse, rows[outside] @ inverse
    weighted = np.append(weights, np.zeros(rows.shape[1] - 3))
    d_xx = np.vecdot(leaving, rows[inside])[:, np.newaxis]
    d_yy, d_xy = np.vecdot(coming, rows[outside]), leaving @ rows[outside].T
    q_xx = (leaving**2 @ weighted)[:, np.newaxis]
    q_yy, q_xy = coming**2 @ weighted, (leaving * weighted) @ coming.T
    determinant = (d_xx - 1.0) * (1.0 + d_yy) - d_xy**2
    return np.asarray(((1.0 + d_yy) * q_xx - 2.0 * d_xy * q_xy + (d_xx - 1.0) * q_yy) / determinant)
