"""Rejection of carriers hit by rain on their uplinks, around the paper's fix.

Model and units as in ``octants``; all carriers weigh alike. The *misfit* of carrier i, in dB, is
``sign(e_i) sqrt(J - J_i)``: J is the cost with it, J_i the cost without it, e_i its residual from the fix made without
it. In a linear fit this is ``r_i / sqrt(1 - h_i)``, the residual freed from what the carrier itself pulled away, h_i
being its leverage. A faded carrier biases the fix and hides; the misfit undoes that for one carrier, and removing the
worst one first undoes it for several. The law of this file: three bounded passes, each deterministic, none able to
cycle.

1. Gate. While the most negative misfit is below ``-gate_db``, its carrier goes. Rain only takes power away, so a
   carrier that is too strong is no matter of this gate.
2. Return. Each carrier gone is tried again once, in the order of rejection, and stays if its misfit now passes: the
   first ones may have been blamed for a fault found later.
3. The paper's rule, ``|r_i| < gate_sigma sigma`` with ``sigma^2 = sum r^2 / N``: all carriers that the gate left are
   re-tested on every pass, so they may come back, until nothing changes. A cycle ends at its smallest set.

Never fewer than ``min_carriers`` are left; when the rules want more gone than that, ``is_exhausted`` says so, and the
fix must not be trusted.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.paper.harmonic import ROUNDING_DB
from service.core.estimation.paper.octants import OctantFix, predict_deviation_db, solve_octants, solve_octants_rows


class RejectionReason(IntEnum):
    """Use of a carrier in the fix, or the reason of its rejection."""

    USED = 0
    ABSENT = 1
    GATE = 2
    SIGMA = 3


_USED, _ABSENT, _GATE, _SIGMA = (int(reason) for reason in RejectionReason)


class RejectedFix(NamedTuple):
    """Fix of the carriers that were left.

    Parameters
    ----------
    fix : OctantFix
        Fix over the carriers used.
    rejected : ndarray of bool, shape (N,)
        Carriers present but rejected.
    reason : ndarray of int, shape (N,)
        :class:`RejectionReason` of every carrier.
    residual_db : ndarray, shape (N,), dB
        Measured minus model for all carriers present, the rejected ones too.
    is_exhausted : bool
        More carriers are suspect than may be removed.
    """

    fix: OctantFix
    rejected: BoolArray
    reason: IntArray
    residual_db: FloatArray
    is_exhausted: bool


class _Row(NamedTuple):
    """One row of deviations with its model and limits."""

    plus: FloatArray
    minus: FloatArray
    deviation_db: FloatArray
    min_carriers: int

    def solve(self, is_used: BoolArray) -> OctantFix:
        """Return the fix over some carriers."""
        return solve_octants(self.plus, self.minus, np.where(is_used, self.deviation_db, math.nan), None)

    def residual_db(self, fix: OctantFix) -> FloatArray:
        """Return measured minus model of all carriers present."""
        return self.deviation_db - predict_deviation_db(self.plus, self.minus, fix.attitude_deg)


def reject_faded_carriers(
    plus: FloatArray,
    minus: FloatArray,
    deviation_db: FloatArray,
    *,
    gate_db: float = 1.5,
    gate_sigma: float = 3.0,
    min_carriers: int = 4,
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

    Returns
    -------
    RejectedFix
        The fix is NaN where :func:`solve_octants` has none.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> plus = rng.normal(0.0, [0.2, 1.4, 1.2], (12, 3))
    >>> faded_db = predict_deviation_db(plus, plus, np.array([0.1, -0.1, 0.2])) - 3.0 * (np.arange(12) == 5)
    >>> result = reject_faded_carriers(plus, plus, faded_db)
    >>> np.flatnonzero(result.rejected), result.fix.attitude_deg.round(9)
    (array([5]), array([ 0.1, -0.1,  0.2]))
    """
    row = _Row(plus, minus, deviation_db, min_carriers)
    # a sum is finite where all of its parts are
    is_present: BoolArray = np.isfinite(deviation_db + (plus + minus).sum(axis=1))
    gated = _gate(row, is_present, gate_db)
    clipped = _sigma_rule(row, gated.is_kept, gated.fix, gate_sigma)
    is_used = clipped.is_used
    reason = np.where(is_used, _USED, np.where(gated.is_kept, _SIGMA, np.where(is_present, _GATE, _ABSENT)))
    return RejectedFix(
        fix=clipped.fix,
        rejected=is_present & ~is_used,
        reason=reason,
        residual_db=np.where(is_present, clipped.residual_db, math.nan),
        is_exhausted=gated.is_exhausted or clipped.is_exhausted,
    )


class _Gated(NamedTuple):
    """Carriers and fix after passes 1 and 2."""

    is_kept: BoolArray
    #: over the carriers kept
    fix: OctantFix
    #: pass 1 had to stop early
    is_exhausted: bool


def _gate(row: _Row, is_present: BoolArray, gate_db: float) -> _Gated:
    """Return the carriers that passes 1 and 2 leave."""
    is_kept = is_present.copy()
    gone: list[int] = []
    fix = row.solve(is_kept)
    worst, misfit_db = _worst_misfit(row, is_kept, fix, gate_db)
    while misfit_db < -gate_db and is_kept.sum() > row.min_carriers:
        is_kept[worst] = False
        gone.append(worst)
        fix = row.solve(is_kept)
        worst, misfit_db = _worst_misfit(row, is_kept, fix, gate_db)
    for carrier in gone[:-1]:
        is_kept[carrier] = _single_misfit(row, is_kept, carrier) >= -gate_db
    if gone and is_kept[gone].any():
        fix = row.solve(is_kept)
    return _Gated(is_kept, fix, misfit_db < -gate_db)


def _worst_misfit(row: _Row, is_kept: BoolArray, full: OctantFix, gate_db: float) -> tuple[int, float]:
    """Return the carrier with the most negative misfit, and the misfit; 0 dB where none can be below the gate."""
    if not full.cost > gate_db**2:  # no misfit exceeds the root of the cost; NaN has nothing to judge
        return 0, 0.0
    carriers = np.flatnonzero(is_kept)
    left_out = np.where(is_kept, row.deviation_db, math.nan) + np.zeros((carriers.size, 1))
    left_out[np.arange(carriers.size), carriers] = math.nan
    others = solve_octants_rows(row.plus, row.minus, left_out, None)
    model_db = np.vecdot(np.maximum(others.attitude_deg, 0.0), row.plus[carriers]) + np.vecdot(
        np.minimum(others.attitude_deg, 0.0), row.minus[carriers]
    )
    misfit_db = _misfit_db(row.deviation_db[carriers] - model_db, full.cost - others.cost)
    worst = int(np.argmin(misfit_db))
    return int(carriers[worst]), float(misfit_db[worst])


def _single_misfit(row: _Row, is_kept: BoolArray, carrier: int) -> float:
    """Return the misfit of a carrier that is not among those kept."""
    without = row.solve(is_kept)
    with_it = row.solve(is_kept | (np.arange(is_kept.size) == carrier))
    return float(_misfit_db(row.residual_db(without)[carrier], np.asarray(with_it.cost - without.cost)))


def _misfit_db(residual_db: FloatArray, cost_reduction: FloatArray) -> FloatArray:
    """Return the signed root of the reduction of the cost; 0 where the fix without the carrier does not exist."""
    size_db = np.sqrt(np.maximum(cost_reduction, 0.0))
    return np.where(np.isnan(cost_reduction), 0.0, np.copysign(size_db, residual_db))


class _Clipped(NamedTuple):
    """Carriers and fix after pass 3."""

    is_used: BoolArray
    fix: OctantFix
    #: (N,) dB, measured minus model of the fix
    residual_db: FloatArray
    #: the rule wanted fewer carriers than may be left
    is_exhausted: bool


def _sigma_rule(row: _Row, is_kept: BoolArray, fix: OctantFix, gate_sigma: float) -> _Clipped:
    """Return the carriers that the paper's rule uses."""
    is_used, seen = is_kept, [is_kept]
    while True:
        residual_db = row.residual_db(fix)
        size_db = np.abs(residual_db)
        sigma_db = math.sqrt((size_db[is_used] ** 2).sum() / max(np.count_nonzero(is_used), 1))
        # negated, so that without a fix (NaN) nothing is rejected
        tested = is_kept & ~(size_db >= max(gate_sigma * sigma_db, ROUNDING_DB))
        if (tested == is_used).all():
            return _Clipped(is_used, fix, residual_db, is_exhausted=False)
        if tested.sum() < row.min_carriers:
            return _Clipped(is_used, fix, residual_db, is_exhausted=True)
        is_used = tested
        repeats = [k for k, one in enumerate(seen) if np.array_equal(one, tested)]
        if repeats:
            smallest = min(seen[repeats[0] :], key=lambda one: int(one.sum()))
            fix = row.solve(smallest)
            return _Clipped(smallest, fix, row.residual_db(fix), is_exhausted=False)
        seen.append(tested)
        fix = row.solve(is_used)
