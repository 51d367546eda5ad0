"""Common cause of changes of several carriers in one row, and the unknown that is set free for it.

The common level is tested before any single carrier. Several suspects at once, or a sudden common value, go to the
chooser; a cumulative sum beyond its limit is a common change. The law of this file: what is freed is one unknown for
all that moved together, so that the carriers keep what they know relative to one another.

Common changes: rain over the receiving site, steps of the receiving chain, and how the filter leaves them.

Down: rain mode, r is set free and takes what the chain had already swallowed since the sum left zero. Up: the chain is
set free and control is held for ten minutes. Out of rain: abs(r) below 0.15 dB for 8 minutes, or steady for an hour and
less than 1.2 dB, which is a step of the chain or a rain that stays. The law of this file: estimation never stops.

Choice between the causes that move several carriers at once.

    H_h: nu ~ N(0, S + B_h B_h'),   score = log p(nu | H_h) + log prior_h

B of an attitude jump holds the three gradients, of a transponder's gain step ones at its carriers, of the receiving
chain or rain ones at all. Under every hypothesis carriers that still contradict the others are taken out one by one,
each at the price of a fault of its own, down to the breakdown of the subset; without a common cause that is all there
is. The law of this file: a pure comparison of likelihoods, the state is not touched.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.filtering.causes.carrier_faults import CarrierWatch
from service.core.estimation.filtering.causes.common_change import (
    THRESHOLD,
    Cusum,
    common_value,
    push_cusum,
    quiet_cusum,
)
from service.core.estimation.filtering.filter_update import Innovation
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    CHAIN,
    RAIN,
    CarrierModel,
    Gaussian,
    freed,
    hidden_count,
    reference_states,
)

#: sizes that the causes have, one standard deviation
JUMP_DEG = 0.3
GROUP_STEP_DB = 2.0
COMMON_STEP_DB = 2.0
OWN_STEP_DB = 3.0
#: log of how likely each is in a row against nothing
_PRIOR = {"own": -5.0, "common": -4.0, "group": -5.0, "attitude": -9.0}
#: a carrier that contradicts the others by more than this many sigma is taken out
_CONTRADICTION = 4.0
_MIN_GROUP = 3


class Cause(StrEnum):
    """Cause of a simultaneous change of several carriers."""

    INDEPENDENT = "independent"
    COMMON = "common"
    GROUP = "group"
    ATTITUDE = "attitude"


class LikeliestCause(NamedTuple):
    """The likeliest cause."""

    cause: Cause
    #: number of the transponder of a group step, -1 else
    transponder: int = -1


#: decides what moved several carriers at once, from the innovations of a row before anything is taken out
Chooser = Callable[[CarrierModel, Innovation], LikeliestCause]


def choose_cause(model: CarrierModel, innovation: Innovation) -> LikeliestCause:
    """Return the likeliest cause of a row in which several carriers fail.

    Parameters
    ----------
    model : CarrierModel
        The carriers, with the transponder of each.
    innovation : Innovation
        Of all carriers that stood unflagged before the row.

    Returns
    -------
    LikeliestCause
        `INDEPENDENT` where each failing carrier is best explained by a fault of its own.
    """
    count = len(innovation.carriers)
    candidates = [
        (LikeliestCause(Cause.INDEPENDENT), np.zeros((count, 0)), 0.0),
        (LikeliestCause(Cause.COMMON), np.full((count, 1), COMMON_STEP_DB), _PRIOR["common"]),
        (LikeliestCause(Cause.ATTITUDE), JUMP_DEG * innovation.core_jacobian[:, ATTITUDE], _PRIOR["attitude"]),
    ]
    labels = model.transponder[innovation.carriers]
    for transponder in np.unique(labels).tolist():
        members = labels == transponder
        if _MIN_GROUP <= np.count_nonzero(members) < count:
            column = GROUP_STEP_DB * members[:, None].astype(np.float64)
            candidates.append((LikeliestCause(Cause.GROUP, transponder), column, _PRIOR["group"]))
    spread = innovation.covariance_db2
    scores = [
        prior + _log_likelihood(innovation.innovation_db, spread + column @ column.T)
        for _choice, column, prior in candidates
    ]
    return candidates[int(np.argmax(scores))][0]


def _log_likelihood(innovation_db: FloatArray, covariance_db2: FloatArray) -> float:
    """Return the log likelihood with contradicting carriers taken out at their price."""
    kept = np.arange(len(innovation_db))
    allowed = (len(kept) - 4) // 2
    price = 0.0
    while True:
        inverse = np.linalg.inv(covariance_db2[np.ix_(kept, kept)])
        weighted = inverse @ innovation_db[kept]
        alone = weighted**2 / np.diagonal(inverse)
        worst = int(alone.argmax())
        if alone[worst] <= _CONTRADICTION**2 or len(innovation_db) - len(kept) >= allowed:
            break
        # without the others' word the carrier's own step is spread over OWN_STEP_DB
        step_db = weighted[worst] / inverse[worst, worst]
        price += _PRIOR["own"] - math.log(OWN_STEP_DB) - 0.5 * (step_db / OWN_STEP_DB) ** 2
        kept = np.delete(kept, worst)
    half_log_det = 0.5 * float(np.linalg.slogdet(inverse)[1])
    normal = half_log_det - 0.5 * float(innovation_db[kept] @ weighted) - 0.5 * len(kept) * math.log(2.0 * math.pi)
    return normal + price - 0.5 * (len(innovation_db) - len(kept)) * math.log(2.0 * math.pi)


SUDDEN = 7.0
HOLD_MINUTES = 10.0
DRY_DB = 0.15
DRY_MINUTES = 8.0
STEADY_ROWS = 60
STEADY_AFTER_MINUTES = 90.0
STEADY_STD_DB = 0.12
STEADY_MAX_DB = 1.2
#: least size of a change, dB
MIN_STEP_DB = 0.5
#: rain may recede by this much more than is known of it and still be rain, dB
_RECEDING_DB = 0.3


class RainWatch(NamedTuple):
    """State of the detection of common level changes."""

    is_raining: bool
    #: minutes in rain mode, and of them in a row below the dry limit
    wet_minutes: float
    dry_minutes: float
    #: minutes for which control is still held after a step up
    hold_minutes: float
    #: chain gain when the downward sum last was zero, dB
    base_chain_db: float
    #: (STEADY_ROWS,) newest last, dB
    history_db: FloatArray
    cusum: Cusum
    #: the last rain ended as a step of the chain, or stays
    is_steady: bool


def dry_watch() -> RainWatch:
    """Return the watch of a dry site."""
    history = np.full(STEADY_ROWS, np.nan)
    return RainWatch(
        is_raining=False,
        wet_minutes=0.0,
        dry_minutes=0.0,
        hold_minutes=0.0,
        base_chain_db=0.0,
        history_db=history,
        cusum=quiet_cusum(1),
        is_steady=False,
    )


def push_common(watch: RainWatch, value: float, chain_db: float) -> RainWatch:
    """Return the watch with one minute's common value of unit variance, and the chain gain before it, dB."""
    sums = push_cusum(watch.cusum, np.array([value]))
    return RainWatch(
        is_raining=watch.is_raining,
        wet_minutes=watch.wet_minutes,
        dry_minutes=watch.dry_minutes,
        hold_minutes=watch.hold_minutes,
        base_chain_db=chain_db if float(sums.down[0]) == 0.0 else watch.base_chain_db,
        history_db=watch.history_db,
        cusum=sums,
        is_steady=watch.is_steady,
    )


def is_down(watch: RainWatch) -> bool:
    """Return whether the sums say that the common level falls."""
    return float(watch.cusum.down[0]) > THRESHOLD


def is_up(watch: RainWatch) -> bool:
    """Return whether the sums say that the common level rises."""
    return float(watch.cusum.up[0]) > THRESHOLD


def common_fell(state: Gaussian, watch: RainWatch, median_db: float) -> tuple[Gaussian, RainWatch]:
    """Return state and watch after a common fall: rain, until it proves otherwise."""
    wider = freed(state, np.array([RAIN]), max(MIN_STEP_DB, abs(median_db)) ** 2)
    if watch.is_raining:
        return wider, watch._replace(cusum=quiet_cusum(1))
    swallowed_db = max(0.0, watch.base_chain_db - float(state.mean[CHAIN]))
    mean = wider.mean.copy()
    mean[CHAIN] += swallowed_db
    mean[RAIN] += swallowed_db
    entered = dry_watch()._replace(is_raining=True, hold_minutes=watch.hold_minutes)
    return Gaussian(mean, wider.covariance), entered


def common_rose(state: Gaussian, watch: RainWatch, median_db: float) -> tuple[Gaussian, RainWatch]:
    """Return state and watch after a common rise: rain that recedes, or a step of the chain."""
    variance = max(MIN_STEP_DB, abs(median_db)) ** 2
    quiet = watch._replace(cusum=quiet_cusum(1))
    if watch.is_raining and float(state.mean[RAIN]) > abs(median_db) - _RECEDING_DB:
        return freed(state, np.array([RAIN]), variance), quiet
    return freed(state, np.array([CHAIN]), variance), quiet._replace(hold_minutes=HOLD_MINUTES)


def pass_hold(watch: RainWatch, minutes: float) -> RainWatch:
    """Return the watch with control held for some minutes of data less."""
    return RainWatch(
        watch.is_raining,
        watch.wet_minutes,
        watch.dry_minutes,
        max(0.0, watch.hold_minutes - minutes),
        watch.base_chain_db,
        watch.history_db,
        watch.cusum,
        watch.is_steady,
    )


def pass_minutes(state: Gaussian, watch: RainWatch, minutes: float) -> tuple[Gaussian, RainWatch]:
    """Return state and watch after some minutes of data, out of rain mode where its exit rules say so.

    Parameters
    ----------
    state : Gaussian
        State after the update.
    watch : RainWatch
        Watch before.
    minutes : float
        Minutes of data that have passed, at most 1 a row.
    """
    if not watch.is_raining:
        return state, watch
    rain_db = float(state.mean[RAIN])
    after = RainWatch(
        is_raining=True,
        wet_minutes=watch.wet_minutes + minutes,
        dry_minutes=watch.dry_minutes + minutes if rain_db < DRY_DB else 0.0,
        hold_minutes=watch.hold_minutes,
        base_chain_db=watch.base_chain_db,
        history_db=np.append(watch.history_db[1:], rain_db),
        cusum=watch.cusum,
        is_steady=watch.is_steady,
    )
    is_steady = _is_steady(after, rain_db)
    if after.dry_minutes < DRY_MINUTES and not is_steady:
        return state, after
    dry = dry_watch()
    return _into_chain(state), RainWatch(
        is_raining=False,
        wet_minutes=0.0,
        dry_minutes=0.0,
        hold_minutes=after.hold_minutes,
        base_chain_db=float(state.mean[CHAIN]) - rain_db,
        history_db=dry.history_db,
        cusum=dry.cusum,
        is_steady=is_steady,
    )


def _is_steady(watch: RainWatch, rain_db: float) -> bool:
    if watch.wet_minutes < STEADY_AFTER_MINUTES or rain_db >= STEADY_MAX_DB:
        return False
    return float(watch.history_db.std()) < STEADY_STD_DB


def _into_chain(state: Gaussian) -> Gaussian:
    """Return the state in which the chain took over what the rain left, with its uncertainty."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[CHAIN] -= mean[RAIN]
    covariance[CHAIN] -= covariance[RAIN]
    covariance[:, CHAIN] -= covariance[:, RAIN]
    variance = 1e-6
    mean[RAIN] = 0.0
    covariance[RAIN] = 0.0
    covariance[:, RAIN] = 0.0
    covariance[RAIN, RAIN] = variance
    return Gaussian(mean, covariance)


#: carriers beyond this many sigma are suspects; this many at once have a common cause
_SUSPECT = 3.0
_SEVERAL = 3


#: what a row says of a common change: none, one of the sums, one that a chooser must explain
NOTHING, SLOW_CHANGE, SUDDEN_CHANGE = 0, 1, 2


class CommonInnovation(NamedTuple):
    """Median innovation of the fully affected band; NaN with too few of them."""

    median_db: float
    #: in units of its sigma
    value: float


class Widened(NamedTuple):
    """State in which the cause's unknown is free."""

    gaussian: Gaussian
    carriers: CarrierWatch
    rain: RainWatch


def common_innovation(model: CarrierModel, innovation: Innovation) -> CommonInnovation:
    """Return the common part of a row's innovations."""
    is_full = (model.rain_share >= 0.5 * model.rain_share.max())[innovation.carriers]
    full = np.flatnonzero(is_full)
    if len(full) < _SEVERAL:
        return CommonInnovation(np.nan, np.nan)
    spread = (innovation.predicted_db2 + np.diag(innovation.white_db2))[full][:, full]
    median_db, value = common_value(innovation.innovation_db[full], spread)
    return CommonInnovation(median_db, value)


def suspicion(rain: RainWatch, excess: FloatArray, common: CommonInnovation) -> int:
    """Return whether carriers changed together in a row: `NOTHING`, `SLOW_CHANGE` or `SUDDEN_CHANGE`.

    Parameters
    ----------
    rain : RainWatch
        Sums of the common level, this row included.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of all carriers that are not flagged.
    common : CommonInnovation
        Common part of them.
    """
    if np.count_nonzero(excess > _SUSPECT) >= _SEVERAL or abs(common.value) > SUDDEN:
        return SUDDEN_CHANGE
    return SLOW_CHANGE if is_down(rain) or is_up(rain) else NOTHING


def widen(
    model: CarrierModel,
    gaussian: Gaussian,
    carriers: CarrierWatch,
    rain: RainWatch,
    choice: LikeliestCause,
    common: CommonInnovation,
    *,
    is_chain_worked: bool = False,
) -> Widened:
    """Return the state in which the unknown of a cause is free.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    gaussian, carriers, rain : Gaussian, CarrierWatch, RainWatch
        Predicted state and watches.
    choice : LikeliestCause
        Cause, not `INDEPENDENT`.
    common : CommonInnovation
        Common part of the row.
    is_chain_worked : bool
        Whether the ground declared work on the receiving chain: a common fall is the chain's then, and no rain.

    Returns
    -------
    Widened
        The sums of single carriers begin again: what they had gathered belongs to the common cause.
    """
    calm = carriers._replace(cusum=quiet_cusum(model.carriers))
    if choice.cause is Cause.GROUP:
        members = np.flatnonzero((model.transponder == choice.transponder) & ~carriers.is_flagged)
        positions = reference_states(model, members, hidden_count(model, len(gaussian.mean)))
        return Widened(freed(gaussian, positions, GROUP_STEP_DB**2), calm, rain)
    if choice.cause is Cause.ATTITUDE:
        for axis in range(ATTITUDE.start, ATTITUDE.stop):
            gaussian = freed(gaussian, np.array([axis]), JUMP_DEG**2)
        return Widened(gaussian, calm, rain)
    # the sums decide where they spoke, else the row itself
    falls = not is_chain_worked and (is_down(rain) or (common.median_db < 0.0 and not is_up(rain)))
    changed, watch = (common_fell if falls else common_rose)(gaussian, rain, common.median_db)
    return Widened(changed, calm, watch)
