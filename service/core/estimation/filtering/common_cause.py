"""Common cause of changes of several carriers in one row, and the unknown that is set free for it; compiled.

The common level is tested before any single carrier. Several suspects at once, or a sudden common value, go to a choice
between causes; a cumulative sum beyond its limit is a common change. What is freed is one unknown for all that moved
together, so that the carriers keep what they know relative to one another.

Down: rain mode, r is set free and takes what the chain had already swallowed since the sum left zero. Up: the chain is
set free and control is held for ten minutes. Out of rain: abs(r) below 0.15 dB for 8 minutes, or steady for an hour and
less than 1.2 dB, which is a step of the chain or a rain that stays. Estimation never stops.

    H_h: nu ~ N(0, S + B_h B_h'),   score = log p(nu | H_h) + log prior_h

B of an attitude jump holds the three gradients, of a transponder's gain step ones at its carriers, of the receiving
chain or rain ones at all. Under every hypothesis carriers that still contradict the others are taken out one by one,
each at the price of a fault of its own, down to the breakdown of the subset; without a common cause that is all there
is.
"""

import math

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.carrier_watch import THRESHOLD, ascending, pushed_sum
from service.core.estimation.filtering.filter_model import CHAIN, RAIN
from service.core.estimation.filtering.filter_state import STEADY_ROWS, FilterState
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import Innovation, inverse_of

#: causes of a simultaneous change of several carriers; 0 = nothing changed
INDEPENDENT, COMMON, GROUP, ATTITUDE_JUMP = 1, 2, 3, 4
#: sizes that the causes have, one standard deviation
JUMP_DEG = 0.3
GROUP_STEP_DB = 2.0
COMMON_STEP_DB = 2.0
OWN_STEP_DB = 3.0
#: log of how likely each is in a row against nothing
_OWN_PRIOR, _COMMON_PRIOR, _GROUP_PRIOR, _ATTITUDE_PRIOR = -5.0, -4.0, -5.0, -9.0
#: a carrier that contradicts the others by more than this many sigma is taken out
_CONTRADICTION = 4.0
_MIN_GROUP = 3
#: sigmas of a sudden common value, and of a suspect; this many suspects at once have a common cause
SUDDEN, _SUSPECT, _SEVERAL = 7.0, 3.0, 3
HOLD_MINUTES = 10.0
DRY_DB = 0.15
DRY_MINUTES = 8.0
STEADY_AFTER_MINUTES = 90.0
STEADY_STD_DB = 0.12
STEADY_MAX_DB = 1.2
#: least size of a change, dB
MIN_STEP_DB = 0.5
#: rain may recede by this much more than is known of it and still be rain, dB
_RECEDING_DB = 0.3
#: variance of rain that is none, dB^2
_NO_RAIN_DB2 = 1e-6
#: what a row says of a common change: none, one of the sums, one that is to be explained
NOTHING, SLOW_CHANGE, SUDDEN_CHANGE = 0, 1, 2


def common_innovation(model: FilterModel, innovation: Innovation) -> tuple[float, float]:
    """Return the median innovation of the fully affected band, dB, and that median in units of its sigma.

    Both are NaN with fewer than three carriers. The sigma is that of the mean, what the carriers share included, with
    pi/2 more variance for what they do not.
    """
    full = np.flatnonzero(model.carriers["rain_share"][innovation.carriers] >= 0.5 * model.carriers["rain_share"].max())
    count = len(full)
    if count < _SEVERAL:
        return math.nan, math.nan
    values = innovation.innovation_db[full]
    ordered = ascending(values)
    median_db = 0.5 * (values[ordered[(count - 1) // 2]] + values[ordered[count // 2]])
    total, own = 0.0, 0.0
    for row in full:
        variance = innovation.predicted_db2[row, row] + innovation.white_db2[row]
        own += variance
        total += variance
        for other in full:
            if other != row:
                total += innovation.predicted_db2[row, other]
    variance = total / count**2 + (0.5 * math.pi - 1.0) * own / count**2
    return median_db, median_db / math.sqrt(variance)


def push_common(state: FilterState, value: float) -> None:
    """Count one minute's common value of unit variance, in place; the state is the predicted one."""
    watch = state.watch[0]
    watch["common_up"] = pushed_sum(watch["common_up"], value)
    watch["common_down"] = pushed_sum(watch["common_down"], -value)
    if watch["common_down"] == 0.0:
        watch["base_chain_db"] = state.mean[CHAIN]


def suspicion(state: FilterState, excess: FloatArray, common_value: float) -> int:
    """Return whether carriers changed together in a row: `NOTHING`, `SLOW_CHANGE` or `SUDDEN_CHANGE`.

    Parameters
    ----------
    state : FilterState
        With the sums of the common level, this row included.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of all carriers that are not flagged.
    common_value : float
        Common part of them in units of its sigma.
    """
    watch = state.watch[0]
    if np.count_nonzero(excess > _SUSPECT) >= _SEVERAL or abs(common_value) > SUDDEN:
        return SUDDEN_CHANGE
    return SLOW_CHANGE if max(watch["common_up"], watch["common_down"]) > THRESHOLD else NOTHING


def choose_cause(model: FilterModel, innovation: Innovation) -> tuple[int, int]:
    """Return the likeliest cause of a row in which several carriers fail, and the transponder of a group step, -1 else.

    `INDEPENDENT` where each failing carrier is best explained by a fault of its own; the innovations are those of all
    carriers that stood unflagged before the row.
    """
    count = len(innovation.carriers)
    spread = innovation.predicted_db2.copy()
    for row in range(count):
        spread[row, row] += innovation.white_db2[row]
    nothing, column = np.zeros((count, 0)), np.full((count, 1), COMMON_STEP_DB)
    cause, transponder = INDEPENDENT, -1
    best = _log_likelihood(innovation.innovation_db, spread, nothing)
    score = _COMMON_PRIOR + _log_likelihood(innovation.innovation_db, spread, column)
    if score > best:
        cause, best = COMMON, score
    slopes = JUMP_DEG * innovation.core_jacobian[:, :3]
    score = _ATTITUDE_PRIOR + _log_likelihood(innovation.innovation_db, spread, slopes)
    if score > best:
        cause, best = ATTITUDE_JUMP, score
    labels = model.carriers["transponder"][innovation.carriers]
    for label in range(labels.max() + 1):
        is_member = labels == label
        members = np.count_nonzero(is_member)
        if _MIN_GROUP <= members < count:
            column[:, 0] = np.where(is_member, GROUP_STEP_DB, 0.0)
            score = _GROUP_PRIOR + _log_likelihood(innovation.innovation_db, spread, column)
            if score > best:
                cause, best, transponder = GROUP, score, label
    return cause, transponder if cause == GROUP else -1


def _log_likelihood(innovation_db: FloatArray, covariance_db2: FloatArray, columns: FloatArray) -> float:
    """Return the log likelihood under a cause (n, c), with contradicting carriers taken out at their price."""
    count = len(innovation_db)
    spread = covariance_db2.copy()
    for i in range(count):
        for j in range(count):
            for k in range(columns.shape[1]):
                spread[i, j] += columns[i, k] * columns[j, k]
    inverse, log_determinant = inverse_of(spread)
    is_kept, taken_out, price = np.ones(count, dtype=np.bool_), 0, 0.0
    weighted = np.zeros(count)
    while True:
        worst, greatest = -1, -1.0
        for i in range(count):
            weighted[i] = 0.0
            if is_kept[i]:
                for j in range(count):
                    weighted[i] += inverse[i, j] * innovation_db[j] if is_kept[j] else 0.0
                if weighted[i] ** 2 / inverse[i, i] > greatest:
                    worst, greatest = i, weighted[i] ** 2 / inverse[i, i]
        if greatest <= _CONTRADICTION**2 or taken_out >= (count - 4) // 2:
            break
        # without the others' word the carrier's own step is spread over OWN_STEP_DB
        step_db = weighted[worst] / inverse[worst, worst]
        price += _OWN_PRIOR - math.log(OWN_STEP_DB) - 0.5 * (step_db / OWN_STEP_DB) ** 2
        log_determinant += math.log(inverse[worst, worst])
        is_kept[worst] = False
        taken_out += 1
        # the inverse of what is left
        removed, pivot = inverse[worst].copy(), inverse[worst, worst]
        for i in range(count):
            for j in range(count):
                inverse[i, j] -= removed[i] * removed[j] / pivot
    square = 0.0
    for i in range(count):
        square += innovation_db[i] * weighted[i]
    return price - 0.5 * (log_determinant + square + count * math.log(2.0 * math.pi))


def free_together(state: FilterState, place: int, variance: float) -> None:
    """Let one number have moved by an unknown amount of a variance, in place."""
    state.covariance[place, place] += variance


def widen_cause(
    model: FilterModel,
    state: FilterState,
    cause: int,
    transponder: int,
    median_db: float,
    is_chain_worked: bool,
) -> None:
    """Let the unknown of a cause be free, in place; the state is the predicted one.

    The sums of single carriers begin again: what they had gathered belongs to the common cause. A common fall is the
    chain's where the ground declared work on it, and no rain.
    """
    carriers, watch, covariance = state.carriers, state.watch[0], state.covariance
    carriers["up"][:] = 0.0
    carriers["down"][:] = 0.0
    if cause == GROUP:
        first = len(state.mean) - len(carriers)
        members = np.flatnonzero((model.carriers["transponder"] == transponder) & ~carriers["is_flagged"])
        for k in members:
            for other in members:
                covariance[first + k, first + other] += GROUP_STEP_DB**2
    elif cause == ATTITUDE_JUMP:
        for axis in range(3):
            free_together(state, axis, JUMP_DEG**2)
    else:
        # the sums decide where they spoke, else the row itself
        is_down, is_up = watch["common_down"] > THRESHOLD, watch["common_up"] > THRESHOLD
        if not is_chain_worked and (is_down or (median_db < 0.0 and not is_up)):
            _fall(state, median_db)
        else:
            _rise(state, median_db)


def _fall(state: FilterState, median_db: float) -> None:
    """Enter rain, or let it grow."""
    watch, mean = state.watch[0], state.mean
    free_together(state, RAIN, max(MIN_STEP_DB, abs(median_db)) ** 2)
    watch["common_up"] = watch["common_down"] = 0.0
    if watch["is_raining"]:
        return
    swallowed_db = max(0.0, watch["base_chain_db"] - mean[CHAIN])
    mean[CHAIN] += swallowed_db
    mean[RAIN] += swallowed_db
    watch["is_raining"], watch["is_steady"] = True, False
    watch["wet_minutes"] = watch["dry_minutes"] = watch["base_chain_db"] = 0.0
    watch["rain_db"][:] = np.nan


def _rise(state: FilterState, median_db: float) -> None:
    """Let rain recede, or the receiving chain step."""
    watch, variance = state.watch[0], max(MIN_STEP_DB, abs(median_db)) ** 2
    watch["common_up"] = watch["common_down"] = 0.0
    if watch["is_raining"] and state.mean[RAIN] > abs(median_db) - _RECEDING_DB:
        free_together(state, RAIN, variance)
        return
    free_together(state, CHAIN, variance)
    watch["hold_minutes"] = HOLD_MINUTES


def pass_rain(state: FilterState, minutes: float) -> None:
    """Count some minutes of data after an update, in place, and leave rain where its exit rules say so."""
    watch, mean, covariance = state.watch[0], state.mean, state.covariance
    if not watch["is_raining"]:
        return
    rain_db = mean[RAIN]
    watch["wet_minutes"] += minutes
    watch["dry_minutes"] = watch["dry_minutes"] + minutes if rain_db < DRY_DB else 0.0
    history_db = watch["rain_db"]
    for row in range(STEADY_ROWS - 1):
        history_db[row] = history_db[row + 1]
    history_db[STEADY_ROWS - 1] = rain_db
    is_steady = watch["wet_minutes"] >= STEADY_AFTER_MINUTES and rain_db < STEADY_MAX_DB
    is_steady = is_steady and history_db.std() < STEADY_STD_DB
    if watch["dry_minutes"] < DRY_MINUTES and not is_steady:
        return
    watch["is_raining"], watch["is_steady"] = False, is_steady
    watch["wet_minutes"] = watch["dry_minutes"] = 0.0
    watch["common_up"] = watch["common_down"] = 0.0
    watch["base_chain_db"] = mean[CHAIN] - rain_db
    watch["rain_db"][:] = np.nan
    # the chain takes over what the rain left, with its uncertainty
    mean[CHAIN] -= mean[RAIN]
    covariance[CHAIN] -= covariance[RAIN]
    covariance[:, CHAIN] -= covariance[:, RAIN]
    mean[RAIN] = 0.0
    covariance[RAIN] = 0.0
    covariance[:, RAIN] = 0.0
    covariance[RAIN, RAIN] = _NO_RAIN_DB2
