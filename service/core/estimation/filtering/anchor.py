"""The anchor: the references of the alignment, asked every ten minutes what the attitude has wrong; compiled.

    r_i = J_i d + s_i c + m_ib + n_ib,   n_ib normal with variance v_ib,   branch b of carrier i with probability p_ib

r is what an attitude leaves of the deviations, d its error, c what all carriers share. A branch says what may be wrong
with a carrier: nothing, rain or a wet antenna, another level. N carriers of B branches have B to the power of N
combinations; carrier by carrier the likeliest are kept, and the rest goes on as one normal distribution of their mean
and covariance, so that no probability is lost. Combinations begin in two regimes, calm and storm, which differ in the
probability of the branches: under one weather system many stations are wet at once.

The anchor never forgets: every carrier takes part with the reference that the alignment gave it, grown by its random
walk, whatever the filter learned since. Where the references contradict the attitude the filter starts again from them:
the attitude is moved by the error and set free, carriers that are likely dry have the reference of the alignment again,
those that are not are set aside; a smaller difference is left to the filter. Protection levels are bounds that the
error of roll, pitch or yaw passes with a stated probability,

    smallest L with   sum over combinations of p(h) P(abs(d) > L under h) <= risk

as in satellite navigation, where the combinations are those of faulty satellites.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.carrier_watch import ascending, set_aside, shift_rows, take_back
from service.core.estimation.filtering.filter_model import ATTITUDE
from service.core.estimation.filtering.filter_state import ANCHOR_MINUTES, FilterState
from service.core.estimation.filtering.motion_watch import forget_shifts
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import inverse_of

#: combinations kept, the rest among them
KEPT = 32
#: branches of a carrier: dry, light rain, heavy rain, another level, the level that the filter learned again
BRANCHES, DRY, LIGHT, HEAVY, CHANGED, LEARNED = 5, 0, 1, 2, 3, 4
#: hypotheses by name, as sums of branches
HYPOTHESES = {"dry": (DRY,), "wet": (LIGHT, HEAVY), "level_changed": (CHANGED,), "level_learned": (LEARNED,)}
#: probability with which the error of a row may pass the level, and sigmas that a normal error passes with it
RISK, SIGMAS_OF_RISK = 1e-4, 3.891
#: levels end here, deg, and are found to 1/2^20 of it
_GREATEST_DEG, _HALVINGS = 3.0, 20
#: logarithm of what lies beyond so many sigmas of a normal distribution, and its change to the next; between them it is
#: straight to 1e-5
_STEPS_A_SIGMA = 100.0
_LOG_BEYOND = np.array([math.log(0.5 * math.erfc(step / _STEPS_A_SIGMA / math.sqrt(2.0))) for step in range(3700)])
_LOG_CHANGE = np.append(np.diff(_LOG_BEYOND), 0.0)
#: error of yaw, roll and pitch that the filter may have beyond its own sigma, deg
ERROR_SIGMA_DEG = (0.15, 0.10, 0.10)
#: rows from which a carrier has a mean
_LEAST_ROWS = 5
#: what all carriers may have wrong together, dB, in the dry and while it rains over the receiving site
_CHAIN_DB, _RAIN_DB = 0.15, 1.0
#: between two questions, us
_PERIOD_US = 600_000_000
#: what a reference may have wrong beyond its own sigma, dB
_OWN_ERROR_DB = 0.04
#: mean and sigma of light and of heavy rain; wet antennas are light, dB
_LIGHT_DB, _HEAVY_DB = (-0.35, 0.20), (-1.3, 0.9)
#: sigma of a level that changed, and of one that the filter learned again, dB
_CHANGED_DB, _LEARNED_DB = 1.0, 0.1
#: probability that a carrier in use, and one that is set aside, is wet or at another level
_WET, _WET_ASIDE = 0.08, 0.6
_CHANGED, _CHANGED_ASIDE = 0.01, 0.2
#: probability that a carrier is wet over whose station rain is reported, and factor of its probabilities where a report
#: says dry; reports may be wrong
_WET_REPORTED, _DRY_REPORTED = 0.5, 0.4
#: probability of a storm, and that a carrier is wet in it
_STORM, _WET_IN_STORM = 0.3, 0.45
#: reference error of the filter from which the carrier has another level, dB; probabilities that it is right, where the
#: alignment tells another and where it tells none
_MOVED_DB, _RIGHT, _RIGHT_ALONE = 0.3, 0.5, 0.8
#: sigmas and degrees of yaw, roll and pitch from which the references contradict the attitude
_CONTRADICTION_SIGMAS = 3.0
_CONTRADICTION_DEG = (math.inf, 0.04, 0.05)
_LEAST_PROBABILITY = 1e-12
#: a hypothesis that is likelier than all others together
_LIKELY = 0.5
#: what a reference may have moved since the alignment, dB
_STRAYED_DB = 0.05
_HOUR_US = 3.6e9


class Mixture(NamedTuple):
    """Error of an attitude: K combinations of branches after the data, the rest of them last."""

    #: (K,) sum one
    probability: FloatArray
    #: (K, 3) deg and (K, 3, 3) deg^2
    mean_deg: FloatArray
    covariance_deg2: FloatArray
    #: (N, B) probability of each branch; a carrier without a reading has that before the data
    branch_probability: FloatArray


class Branches(NamedTuple):
    """Hypotheses of N carriers in R regimes."""

    #: (N, B) dB and dB^2
    mean_db: FloatArray
    variance_db2: FloatArray
    #: (R, N, B) in each regime
    log_probability: FloatArray
    #: (R,)
    regime_log_probability: FloatArray


def solve_mixture(
    jacobian: FloatArray, residual_db: FloatArray, branches: Branches, prior_sigma: FloatArray
) -> Mixture:
    """Return the error of an attitude as a mixture over what may be wrong with the carriers.

    Parameters
    ----------
    jacobian : ndarray, shape (N, 4), dB/deg, the last column dB/dB
        Change of the levels with yaw, roll, pitch and with what the carriers share.
    residual_db : ndarray, shape (N,), dB
        Measured minus what the attitude explains; NaN = no reading.
    branches : Branches
        Hypotheses of the carriers.
    prior_sigma : ndarray, shape (4,), deg, the last dB
        Error of yaw, roll, pitch and of the shared part before the carriers are asked, one standard deviation.
    """
    present = np.flatnonzero(np.isfinite(residual_db))
    regimes, carriers, _ = branches.log_probability.shape
    size = regimes
    before, after = _no_combinations(carriers), _no_combinations(carriers)
    for regime in range(regimes):
        before.log_weight[regime], before.regime[regime] = branches.regime_log_probability[regime], regime
        for k in range(4):
            before.covariance[regime, k, k] = prior_sigma[k] ** 2
        for carrier in range(carriers):
            for branch in range(BRANCHES):
                log_probability = branches.log_probability[regime, carrier, branch]
                before.share[regime, carrier, branch] = math.exp(log_probability)
    # the surest first: they tell the attitude by which the others are judged
    for carrier in present[ascending(branches.variance_db2[:, DRY][present])]:
        size = _ask_carrier(jacobian[carrier], residual_db[carrier], branches, carrier, before, size, after)
        before, after = after, before
    probability, by_branch = np.zeros(size), np.zeros((carriers, BRANCHES))
    for number in range(size):
        probability[number] = math.exp(before.log_weight[number])
        by_branch += probability[number] * before.share[number]
    mean, covariance = before.mean[:size, :3].copy(), before.covariance[:size, :3, :3].copy()
    return Mixture(probability, mean, covariance, by_branch)


class _Combinations(NamedTuple):
    """Combinations of branches of the carriers asked so far, `KEPT` at the most, the likeliest first."""

    log_weight: FloatArray
    regime: IntArray
    mean: FloatArray
    covariance: FloatArray
    #: (K, N, B) probability of each branch
    share: FloatArray


def _no_combinations(carriers: int) -> _Combinations:
    return _Combinations(
        np.zeros(KEPT),
        np.zeros(KEPT, dtype=np.int64),
        np.zeros((KEPT, 4)),
        np.zeros((KEPT, 4, 4)),
        np.zeros((KEPT, carriers, BRANCHES)),
    )


def _ask_carrier(
    row: FloatArray,
    residual_db: float,
    branches: Branches,
    carrier: int,
    before: _Combinations,
    size: int,
    after: _Combinations,
) -> int:
    """Write the combinations after one carrier more, and return how many there are; the rest stand last as one."""
    across, variance, surprise, candidate = _candidates(row, residual_db, branches, carrier, before, size)
    total = size * BRANCHES
    greatest = candidate.max()
    summed = 0.0
    for place in range(total):
        summed += math.exp(candidate[place] - greatest)
    candidate -= greatest + math.log(summed)
    chosen, is_chosen = _likeliest(candidate, total if total <= KEPT else KEPT - 1)
    mean, covariance = np.zeros(4), np.zeros((4, 4))
    for number in range(len(chosen)):
        place = int(chosen[number])
        parent, branch = place // BRANCHES, place % BRANCHES
        _moved(before, parent, across[parent], variance[place], surprise[place], mean, covariance)
        after.log_weight[number], after.regime[number] = candidate[place], before.regime[parent]
        after.mean[number], after.covariance[number] = mean, covariance
        after.share[number] = before.share[parent]
        after.share[number, carrier] = 0.0
        after.share[number, carrier, branch] = 1.0
    if len(chosen) == total:
        return total
    _merge_rest(before, after, carrier, candidate, is_chosen, across, variance, surprise)
    return KEPT


def _candidates(
    row: FloatArray, residual_db: float, branches: Branches, carrier: int, before: _Combinations, size: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return ``P J`` (K, 4) of the combinations, variance and surprise (K B,) of a reading, and log weights (K B,)."""
    across, variance = np.zeros((size, 4)), np.zeros(size * BRANCHES)
    surprise, candidate = np.zeros(size * BRANCHES), np.zeros(size * BRANCHES)
    for number in range(size):
        seen, left = 0.0, residual_db
        for i in range(4):
            for j in range(4):
                across[number, i] += before.covariance[number, i, j] * row[j]
            seen += across[number, i] * row[i]
            left -= before.mean[number, i] * row[i]
        for branch in range(BRANCHES):
            place = number * BRANCHES + branch
            variance[place] = seen + branches.variance_db2[carrier, branch]
            surprise[place] = left - branches.mean_db[carrier, branch]
            known = before.log_weight[number] + branches.log_probability[before.regime[number], carrier, branch]
            unlikely = math.log(variance[place]) + surprise[place] ** 2 / variance[place]
            candidate[place] = known - 0.5 * unlikely
    return across, variance, surprise, candidate


def _likeliest(candidate: FloatArray, count: int) -> tuple[IntArray, BoolArray]:
    """Return the places of the greatest of some numbers (M,) in falling order, and which (M,) are among them."""
    chosen, size = np.zeros(count, dtype=np.int64), 0
    for place in range(len(candidate)):
        if size == count and candidate[place] <= candidate[chosen[count - 1]]:
            continue
        at = size if size < count else count - 1
        while at > 0 and candidate[chosen[at - 1]] < candidate[place]:
            chosen[at] = chosen[at - 1]
            at -= 1
        chosen[at] = place
        size = min(size + 1, count)
    is_chosen = np.zeros(len(candidate), dtype=np.bool_)
    for number in range(count):
        is_chosen[chosen[number]] = True
    return chosen, is_chosen


def _moved(
    before: _Combinations,
    parent: int,
    across: FloatArray,
    variance: float,
    surprise: float,
    mean: FloatArray,
    covariance: FloatArray,
) -> None:
    """Write mean (4,) and covariance (4, 4) of a combination after a reading."""
    for i in range(4):
        gain = across[i] / variance
        mean[i] = before.mean[parent, i] + gain * surprise
        for j in range(4):
            covariance[i, j] = before.covariance[parent, i, j] - gain * across[j]


def _merge_rest(
    before: _Combinations,
    after: _Combinations,
    carrier: int,
    candidate: FloatArray,
    is_chosen: BoolArray,
    across: FloatArray,
    variance: FloatArray,
    surprise: FloatArray,
) -> None:
    """Write what was not chosen as one combination, the last: mean and covariance of all of it."""
    last, greatest, least = KEPT - 1, -math.inf, math.inf
    for place in range(len(candidate)):
        if not is_chosen[place]:
            greatest = max(greatest, candidate[place])
            if candidate[place] <= least:
                least, after.regime[last] = candidate[place], before.regime[place // BRANCHES]
    total, mean, covariance, of_parent = 0.0, np.zeros(4), np.zeros((4, 4)), np.zeros(KEPT)
    after.mean[last], after.covariance[last], after.share[last] = 0.0, 0.0, 0.0
    for place in range(len(candidate)):
        if not is_chosen[place]:
            part, parent = math.exp(candidate[place] - greatest), place // BRANCHES
            total += part
            of_parent[parent] += part
            _moved(before, parent, across[parent], variance[place], surprise[place], mean, covariance)
            for i in range(4):
                after.mean[last, i] += part * mean[i]
                for j in range(4):
                    after.covariance[last, i, j] += part * (covariance[i, j] + mean[i] * mean[j])
    own = np.zeros(BRANCHES)
    for place in range(len(candidate)):
        if not is_chosen[place]:
            own[place % BRANCHES] += math.exp(candidate[place] - greatest) / total
    after.log_weight[last] = greatest + math.log(total)
    for parent in range(KEPT):
        part = of_parent[parent] / total
        if part > 0.0:
            for other in range(after.share.shape[1]):
                for branch in range(BRANCHES):
                    after.share[last, other, branch] += part * before.share[parent, other, branch]
    after.share[last, carrier] = own
    after.mean[last] /= total
    for i in range(4):
        for j in range(4):
            second = after.covariance[last, i, j] / total
            after.covariance[last, i, j] = second - after.mean[last, i] * after.mean[last, j]


def mixture_error_deg(mixture: Mixture) -> tuple[FloatArray, FloatArray]:
    """Return the expected error (3,) and one standard deviation of it, deg."""
    error, second = np.zeros(3), np.zeros(3)
    for number in range(len(mixture.probability)):
        for axis in range(3):
            mean = mixture.mean_deg[number, axis]
            error[axis] += mixture.probability[number] * mean
            second[axis] += mixture.probability[number] * (mixture.covariance_deg2[number, axis, axis] + mean**2)
    return error, np.sqrt(second - error**2)


def protection_levels_deg(mixture: Mixture, moved_deg: FloatArray, risk: float) -> FloatArray:
    """Return the protection levels (3,) of an attitude that was moved (3,) since, deg, at most 3 deg."""
    count = len(mixture.probability)
    level_deg, sigma = np.zeros(3), np.zeros(count)
    for axis in range(3):
        for number in range(count):
            sigma[number] = math.sqrt(mixture.covariance_deg2[number, axis, axis])
        mean = mixture.mean_deg[:, axis] - moved_deg[axis]
        low, high = 0.0, _GREATEST_DEG
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            passed = 0.0
            for number in range(count):
                outside = beyond((middle + mean[number]) / sigma[number])
                outside += beyond((middle - mean[number]) / sigma[number])
                passed += outside * mixture.probability[number]
            if passed > risk:
                low = middle
            else:
                high = middle
        level_deg[axis] = high
    return level_deg


def beyond(sigmas: float) -> float:
    """Return the probability of a normal error beyond so many sigmas, on one side."""
    position = min(abs(sigmas) * _STEPS_A_SIGMA, len(_LOG_BEYOND) - 1.0)
    step = int(position)
    tail = math.exp(_LOG_BEYOND[step] + (position - step) * _LOG_CHANGE[step])
    return 1.0 - tail if sigmas < 0.0 else tail


def push_anchor(state: FilterState, residual_db: FloatArray, white_db2: FloatArray) -> None:
    """Keep a minute for the next question, in place.

    Parameters
    ----------
    state : FilterState
        Before the minute.
    residual_db : ndarray, shape (N,), dB
        Measured minus what attitude, chain and rain of the state explain; NaN = absent.
    white_db2 : ndarray, shape (N,), dB^2
        White noise of the row.
    """
    shift_rows(state.anchor[0])
    shift_rows(state.anchor[1])
    state.anchor[0, ANCHOR_MINUTES - 1], state.anchor[1, ANCHOR_MINUTES - 1] = residual_db, white_db2
    state.watch[0]["anchor_minutes"] += 1


def is_question_due(state: FilterState) -> bool:
    """Return whether the references of the alignment are to be asked after a minute."""
    watch = state.watch[0]
    is_old = watch["epoch_us"] - watch["answered_us"] >= _PERIOD_US
    return bool(watch["anchor_minutes"] <= ANCHOR_MINUTES or is_old)


def ask_anchor(model: FilterModel, state: FilterState, reported_wet: FloatArray) -> Mixture:
    """Return the answer of the references, with what follows from it written into the state.

    `reported_wet` (N,) is 1 where rain over the station is reported, 0 where none is, NaN where nobody says.
    """
    watch, every = state.watch[0], len(state.carriers)
    mean_db, dry_db2, is_there = np.full(every, np.nan), np.zeros(every), np.zeros(every, dtype=np.bool_)
    residual_db = np.full(every, np.nan)
    hours = (watch["epoch_us"] - watch["since_us"]) / _HOUR_US
    for k in range(every):
        count, total, noise = 0, 0.0, 0.0
        for row in range(ANCHOR_MINUTES):
            if math.isfinite(state.anchor[0, row, k]):
                count += 1
                total += state.anchor[0, row, k]
                noise += state.anchor[1, row, k]
        aligned_db = state.carriers["aligned_reference_db"][k]
        mean_db[k] = total / max(count, 1) - (0.0 if math.isnan(aligned_db) else aligned_db)
        dry_db2[k] = _dry_variance_db2(model, state, k, hours) + noise / max(count, 1) ** 2
        is_there[k] = count > 0
        if count >= min(_LEAST_ROWS, watch["anchor_minutes"]):
            residual_db[k] = mean_db[k]
    jacobian = _slopes(model, state)
    prior_sigma = np.zeros(4)
    for axis in range(3):
        prior_sigma[axis] = math.sqrt(ERROR_SIGMA_DEG[axis] ** 2 + state.covariance[axis, axis])
    prior_sigma[3] = _RAIN_DB if watch["is_raining"] else _CHAIN_DB
    mixture = solve_mixture(jacobian, residual_db, _branches(state, dry_db2, reported_wet), prior_sigma)
    watch["answered_us"] = watch["epoch_us"]
    watch["level_deg"][:] = protection_levels_deg(mixture, np.zeros(3), RISK)
    watch["nominal_deg"][:] = _nominal_levels_deg(jacobian, residual_db, dry_db2, prior_sigma)
    for axis in range(3):
        watch["answer_sigma_deg"][axis] = math.sqrt(state.covariance[axis, axis])
    _name_hypotheses(state, mixture, is_there)
    return mixture


def _slopes(model: FilterModel, state: FilterState) -> FloatArray:
    """Return the change (N, 4) of the levels with an error of the attitude and with what the carriers share.

    What is left of rain over the site stands in the bands as rain does, an error of the chain in all alike.
    """
    attitude, is_raining = state.mean[ATTITUDE], state.watch[0]["is_raining"]
    slopes = np.ones((len(state.carriers), 4))
    for k in range(len(slopes)):
        for axis in range(3):
            slopes[k, axis] = model.carriers["gradient_db_deg"][k, axis]
            for other in range(3):
                slopes[k, axis] += model.carriers["hessian_db_deg2"][k, axis, other] * attitude[other]
        if is_raining:
            slopes[k, 3] = model.carriers["rain_share"][k]
    return slopes


def _nominal_levels_deg(
    jacobian: FloatArray, residual_db: FloatArray, dry_db2: FloatArray, prior_sigma: FloatArray
) -> FloatArray:
    """Return the protection levels (3,) if nothing were wrong with any carrier (N,) that has a reading."""
    precision = np.diag(prior_sigma**-2.0)
    for k in range(len(dry_db2)):
        if math.isfinite(residual_db[k]):
            for i in range(4):
                for j in range(4):
                    precision[i, j] += jacobian[k, i] * jacobian[k, j] / dry_db2[k]
    covariance, _ = inverse_of(precision)
    return SIGMAS_OF_RISK * np.sqrt(np.diag(covariance)[:3])


def _name_hypotheses(state: FilterState, mixture: Mixture, is_there: BoolArray) -> None:
    """Keep the likeliest hypothesis of each carrier (N,) that was there; the others keep theirs."""
    carriers, epoch_us = state.carriers, state.watch[0]["epoch_us"]
    for k in range(len(carriers)):
        if not is_there[k]:
            continue
        by_branch = mixture.branch_probability[k]
        likeliest, greatest = 0, by_branch[DRY]
        for place, probability in enumerate(
            (by_branch[LIGHT] + by_branch[HEAVY], by_branch[CHANGED], by_branch[LEARNED])
        ):
            if probability > greatest:
                likeliest, greatest = place + 1, probability
        carriers["probability"][k] = greatest
        if likeliest != carriers["hypothesis"][k]:
            carriers["hypothesis"][k], carriers["hypothesis_since_us"][k] = likeliest, epoch_us


def _branches(state: FilterState, dry_db2: FloatArray, reported_wet: FloatArray) -> Branches:
    """Return the hypotheses of the carriers beside the reference of the alignment."""
    carriers, every = state.carriers, len(dry_db2)
    mean_db, variance_db2 = np.zeros((every, BRANCHES)), np.zeros((every, BRANCHES))
    log_probability = np.zeros((2, every, BRANCHES))
    spread_db = (0.0, _LIGHT_DB[1], _HEAVY_DB[1], _CHANGED_DB, _LEARNED_DB)
    first = len(state.mean) - every
    for k in range(every):
        aligned_db = carriers["aligned_reference_db"][k]
        is_aside, is_known = carriers["is_flagged"][k], math.isfinite(aligned_db)
        moved_db = state.mean[first + k] - (aligned_db if is_known else 0.0)
        # a transponder's step moves references that were never learned again
        is_learned = not is_aside and (carriers["is_relearned"][k] or abs(moved_db) > _MOVED_DB)
        mean_db[k, LIGHT], mean_db[k, HEAVY] = _LIGHT_DB[0], _HEAVY_DB[0]
        mean_db[k, LEARNED] = moved_db if is_learned else 0.0
        for branch in range(BRANCHES):
            variance_db2[k, branch] = dry_db2[k] + spread_db[branch] ** 2
        learned = (_RIGHT if is_known else _RIGHT_ALONE) if is_learned else 0.0
        for regime in range(2):
            wet = _WET_ASIDE if is_aside else _WET
            wet = max(wet, _WET_IN_STORM) if regime == 1 else wet
            if reported_wet[k] == 1.0:
                wet = max(wet, _WET_REPORTED)
            elif reported_wet[k] == 0.0:
                wet *= _DRY_REPORTED
            changed = _CHANGED_ASIDE if is_aside else _CHANGED
            wet = wet * (1.0 - learned) if is_known else 0.0
            changed = changed * (1.0 - learned) if is_known else 1.0 - learned
            each = (1.0 - wet - changed - learned, 0.5 * wet, 0.5 * wet, changed, learned)
            for branch in range(BRANCHES):
                log_probability[regime, k, branch] = math.log(max(each[branch], _LEAST_PROBABILITY))
    return Branches(mean_db, variance_db2, log_probability, np.log(np.array([1.0 - _STORM, _STORM])))


def _dry_variance_db2(model: FilterModel, state: FilterState, k: int, hours: float) -> float:
    """Return the variance of the mean of a carrier with which nothing is wrong, without its white noise."""
    slow_db2 = 0.0
    for component in range(model.coloured_tau_s.shape[1]):
        span = 60.0 * ANCHOR_MINUTES / model.coloured_tau_s[k, component]
        kept = 2.0 * (span - 1.0 + math.exp(-span)) / span**2
        slow_db2 += model.coloured_sigma_db[k, component] ** 2 * kept
    aligned_db2 = state.carriers["aligned_variance_db2"][k]
    return float(slow_db2 + aligned_db2 + model.carriers["reference_walk_db"][k] ** 2 * hours + _OWN_ERROR_DB**2)


def is_contradicted(mixture: Mixture) -> bool:
    """Return whether the references of the alignment contradict roll or pitch."""
    error, sigma = mixture_error_deg(mixture)
    for axis in range(3):
        least_deg = max(_CONTRADICTION_SIGMAS * sigma[axis], _CONTRADICTION_DEG[axis])
        if abs(error[axis]) > least_deg:
            return True
    return False


def start_again(model: FilterModel, state: FilterState, mixture: Mixture) -> None:
    """Start again, in place, at the attitude that the references of the alignment ask for, with these references.

    Drift, rates, receiving chain and rain go on as they are. The rows that follow settle the attitude, so that no
    reading counts twice.
    """
    watch, carriers, mean, covariance = state.watch[0], state.carriers, state.mean, state.covariance
    error_deg, _ = mixture_error_deg(mixture)
    slopes, every = _slopes(model, state), len(carriers)
    for row in range(ANCHOR_MINUTES):
        for k in range(every):
            for axis in range(3):
                state.anchor[0, row, k] -= slopes[k, axis] * error_deg[axis]
    watch["level_deg"][:] = protection_levels_deg(mixture, error_deg, RISK)
    for axis in range(3):
        # as the anchor was asked: the error that it found, and what the filter did not know before
        variance = ERROR_SIGMA_DEG[axis] ** 2 + covariance[axis, axis]
        watch["answer_sigma_deg"][axis] = math.sqrt(variance)
        mean[axis] += error_deg[axis]
        covariance[axis, :] = 0.0
        covariance[:, axis] = 0.0
        covariance[axis, axis] = variance
    for k in range(every):
        probability = mixture.branch_probability[k]
        aligned_db, aligned_db2 = carriers["aligned_reference_db"][k], carriers["aligned_variance_db2"][k]
        was_flagged = carriers["is_flagged"][k]
        if probability[DRY] > _LIKELY and math.isfinite(aligned_db):
            take_back(model, state, k, aligned_db, aligned_db2 + _STRAYED_DB**2)
            carriers["is_relearned"][k] = False
        elif not was_flagged and probability[LEARNED] < _LIKELY:
            set_aside(model, state, k, aligned_db, aligned_db2)
    carriers["up"][:] = 0.0
    carriers["down"][:] = 0.0
    forget_shifts(watch)
