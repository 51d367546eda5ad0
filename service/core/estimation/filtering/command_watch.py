"""Commanded corrections watched: whether the spacecraft does what the ground announced, or the opposite, or nothing.

    x(s) = x + (s - s0) v          nu(s) = nu - (s - s0) H v          s = share of the commands that is carried out
    log p(s) / p(s0) = (s - s0) b - (s - s0)^2 j / 2      b = sum (H v)' S^-1 nu      j = sum (H v)' S^-1 H v

v is the derivative of the state by s: commands enter it as they enter attitude and rate, updates take out what the
powers have told; a rate that was given long ago is no longer in question. A roll command against a yaw that nobody
announced looks like a command that was lost; a yaw rate of unknown size therefore runs beside s as a second column and
is taken out of b and j. Where another share explains the last hour beyond chance the state moves along v, the share is
believed for an hour and control is told. Shares are of a short list; sums forget, so that what was commanded long ago
excuses nothing. The functions are compiled as they stand.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_model import ATTITUDE, FIRST_COMMON, RAIN, RATE
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import Innovation

#: shares that an on-board mode makes of a command: other sign, nothing, half, all, twice
SHARES = (-1.0, 0.0, 0.5, 1.0, 2.0)
#: log likelihood ratio that is believed; ten worlds of two days whose commands are carried out stay below it
BELIEVED = 5.0
#: sums forget with this time, minutes
_FORGET_MINUTES = 60.0
#: a share found is known to this
SHARE_ERROR = 0.25
#: minutes for which a found share is told and believed
DOUBTED_MINUTES = 60.0
#: size of yaw rates that nobody announced, deg/h
_UNTOLD_YAW_DEG_H = 0.4
#: an attitude that commands moved by less than this is not watched, deg
_LEAST_DEG = 1e-4
#: a share that would move the attitude by more than this is not believed: its first order is not enough, deg
_MOST_DEG = 0.5


def pass_commands(
    model: FilterModel,
    state: FilterState,
    transition: FloatArray,
    factor: FloatArray,
    correction_deg: FloatArray,
    rate_change_deg_h: FloatArray,
    step_us: int,
) -> None:
    """Move the derivative over a step, in place, before the state moves.

    Parameters
    ----------
    model : FilterModel
        The carriers.
    state : FilterState
        Before the step.
    transition : ndarray, shape (9, 9 + E)
        Of attitude, drift and rate, hidden states behind them.
    factor : ndarray, shape (D,)
        By which each number decays.
    correction_deg, rate_change_deg_h : ndarray, shape (3,)
        As announced.
    step_us : int, microseconds
        Length of the step, > 0.
    """
    watch, sensitivity = state.watch[0], state.sensitivity
    hours, minutes = step_us / 3.6e9, step_us / 60e6
    is_by_torque = rate_change_deg_h.any()
    is_commanded = is_by_torque or correction_deg.any()
    is_sensitive = sensitivity.any()
    watch["doubted_minutes"] = max(0.0, watch["doubted_minutes"] - minutes)
    if watch["doubted_minutes"] == 0.0:
        watch["share"] = 1.0
    watch["is_by_torque"] = watch["is_by_torque"] or is_by_torque
    keep = math.exp(-minutes / _FORGET_MINUTES)
    watch["score"][:] *= keep
    watch["information"][:] *= keep
    if not is_commanded and not is_sensitive:
        return
    moved = np.zeros((RATE.stop, 2))
    first = FIRST_COMMON + len(model.common)
    for row in range(RATE.stop):
        for column in range(transition.shape[1]):
            source = column if column < RATE.stop else first + column - RATE.stop
            forgotten = keep if RATE.start <= column < RATE.stop else 1.0
            for k in range(2):
                moved[row, k] += transition[row, column] * forgotten * sensitivity[source, k]
    for place in range(RATE.stop, len(sensitivity)):
        # hidden states stay: what is in question is what commands left in attitude and rate
        if place < first or place >= first + transition.shape[1] - RATE.stop:
            sensitivity[place] *= factor[place]
    sensitivity[: RATE.stop] = moved
    for axis in range(3):
        sensitivity[axis, 0] += correction_deg[axis] + 0.5 * hours * rate_change_deg_h[axis]
        sensitivity[RATE.start + axis, 0] += rate_change_deg_h[axis]
    sensitivity[ATTITUDE.start, 1] += hours
    every, components = model.coloured_sigma_db.shape
    for k in range(every):
        if state.carriers["is_flagged"][k]:
            # states of carriers that are out have no part in it
            for place in range(len(sensitivity) - every * (components + 1) + k, len(sensitivity), every):
                sensitivity[place] = 0.0


def push_row(model: FilterModel, state: FilterState, used: Innovation, is_shared: bool) -> None:
    """Take an update into the derivative and its evidence, in place; the state is the updated one.

    A row in which something else moved all carriers says nothing about commands (`is_shared`).
    ``K h = P H' R^-1 h`` with P after the update, ``S^-1 h = R^-1 (h - H K h)``: no matrix is inverted here.
    """
    sensitivity, watch = state.sensitivity, state.watch[0]
    if np.abs(sensitivity[ATTITUDE, 0]).max() < _LEAST_DEG:
        return
    every, core = len(model.carriers), used.core_jacobian.shape[1]
    expected_db = _seen(used, sensitivity, every)
    spread = np.zeros(sensitivity.shape)
    for row in range(len(used.carriers)):
        for column in range(2):
            weighted = expected_db[row, column] / used.white_db2[row]
            for place in range(core):
                spread[place, column] += used.core_jacobian[row, place] * weighted
            for place in range(core + used.carriers[row], len(spread), every):
                spread[place, column] = weighted
    removed = state.covariance @ spread
    if not is_shared:
        left_db = expected_db - _seen(used, removed, every)
        score, information = watch["score"], watch["information"]
        for row in range(len(used.carriers)):
            for column in range(2):
                whitened = left_db[row, column] / used.white_db2[row]
                score[column] += whitened * used.innovation_db[row]
                for other in range(2):
                    information[column, other] += whitened * expected_db[row, other]
    sensitivity -= removed


def _seen(used: Innovation, change: FloatArray, every: int) -> FloatArray:
    """Return the effect of changes (D, 2) of the state on the carriers used (n, 2), dB."""
    core = used.core_jacobian.shape[1]
    seen = np.zeros((len(used.carriers), 2))
    for row in range(len(used.carriers)):
        for column in range(2):
            for place in range(core):
                seen[row, column] += used.core_jacobian[row, place] * change[place, column]
            for place in range(core + used.carriers[row], len(change), every):
                seen[row, column] += change[place, column]
    return seen


def share_gain(watch: NDArray[np.void], share: float) -> float:
    """Return the log likelihood ratio of a share against the believed one, of a record of `WATCH`."""
    information, by_share, believed = watch["information"], watch["score"], watch["share"]
    excused = information[0, 1] / (information[1, 1] + _UNTOLD_YAW_DEG_H**-2)
    score = by_share[0] - excused * by_share[1]
    known = information[0, 0] - excused * information[0, 1]
    return float((share - believed) * score - 0.5 * (share - believed) ** 2 * known)


def likelier_share(watch: NDArray[np.void]) -> float:
    """Return the share that explains the commands beyond chance, NaN = the believed one does."""
    best, greatest = math.nan, BELIEVED
    for share in SHARES:
        gain = share_gain(watch, share)
        if gain > greatest:
            best, greatest = share, gain
    return best


def forget_evidence(watch: NDArray[np.void]) -> None:
    """Forget the evidence, in place, after something else was found that may have moved what was seen."""
    watch["score"][:] = 0.0
    watch["information"][:] = 0.0


def judge_commands(state: FilterState) -> None:
    """Move the state, in place, to where a share leads that is likelier beyond chance."""
    watch, sensitivity = state.watch[0], state.sensitivity
    share = likelier_share(watch)
    if math.isnan(share):
        return
    apart = share - watch["share"]
    forget_evidence(watch)
    watch["doubted_minutes"] = DOUBTED_MINUTES
    if abs(apart) * np.abs(sensitivity[ATTITUDE, 0]).max() <= _MOST_DEG:
        change = sensitivity[:, 0].copy()
        state.mean[:] += apart * change
        state.mean[RAIN] = max(0.0, state.mean[RAIN])
        for i in range(len(change)):
            for j in range(len(change)):
                state.covariance[i, j] += SHARE_ERROR**2 * (change[i] * change[j])
        watch["share"] = share
    sensitivity[:] = 0.0


def missed_log_ratio(watch: NDArray[np.void]) -> float:
    """Return how much likelier "no effect" or "reversed" is than that commands are carried out, logarithm.

    Once one of both is believed the ratio with which it came to be believed stands, and what the rows since then say
    of whole commands is added; where another share is believed commands act, and nothing is missed.
    """
    if watch["share"] == 1.0:
        return max(share_gain(watch, 0.0), share_gain(watch, -1.0))
    return BELIEVED - share_gain(watch, 1.0) if watch["share"] <= 0.0 else 0.0


def share_log_ratio(mean: float, variance: float, prior_sigma: float) -> float:
    """Return how much likelier the powers make a command that did nothing or the reverse than one that was carried out.

    Parameters
    ----------
    mean, variance : float
        Of the share of the command that was carried out, as the filter has it after the powers; variance > 0.
    prior_sigma : float
        Before them, about 0.

    Examples
    --------
    >>> round(share_log_ratio(0.0, 0.02, 1.0), 1), round(share_log_ratio(1.0, 0.02, 1.0), 1)
    (24.5, -25.5)
    """
    gains = [-0.5 * (share - mean) ** 2 / variance + 0.5 * (share / prior_sigma) ** 2 for share in (0.0, -1.0, 1.0)]
    return max(gains[:2]) - gains[2]
