"""Common changes: rain over the receiving site, steps of the receiving chain, and how the filter leaves them.

Down: rain mode, r is set free and takes what the chain had already swallowed since the sum left zero. Up: the chain is
set free and control is held for ten minutes. Out of rain: abs(r) below 0.15 dB for 8 minutes, or steady for an hour and
less than 1.2 dB, which is a step of the chain or a rain that stays. The law of this file: estimation never stops.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.causes.common_change import THRESHOLD, Cusum, push_cusum, quiet_cusum
from service.core.estimation.filtering.model.filter_model import FloatArray
from service.core.estimation.filtering.model.filter_state import CHAIN, RAIN, Gaussian, freed

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
