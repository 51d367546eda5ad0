"""Levels: decibels, and whether there is a carrier at all."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.core.arrays import BoolArray, FloatArray

#: dB of one neper of power, 10 / ln 10; small relative deviations times this are deviations in dB
DB_PER_NEPER = 10.0 / math.log(10.0)


def ratio_from_db(ratio_db: ArrayLike) -> FloatArray:
    """Return the power ratio of a value in dB.

    Examples
    --------
    >>> float(ratio_from_db(-10.0))
    0.1
    """
    return np.asarray(np.power(10.0, np.asarray(ratio_db, dtype=np.float64) / 10.0), dtype=np.float64)


def db_from_ratio(ratio: ArrayLike) -> FloatArray:
    """Return the dB value of a power ratio; NaN where the ratio is not positive.

    Examples
    --------
    >>> float(db_from_ratio(100.0))
    20.0
    """
    values = np.asarray(ratio, dtype=np.float64)
    positive = values > 0.0
    return np.where(positive, 10.0 * np.log10(np.where(positive, values, 1.0)), np.nan)


def mw_from_dbm(level_dbm: ArrayLike) -> FloatArray:
    """Return the power in milliwatts of a level in dBm.

    Examples
    --------
    >>> float(mw_from_dbm(20.0))
    100.0
    """
    return ratio_from_db(level_dbm)


def dbm_from_mw(power_mw: ArrayLike) -> FloatArray:
    """Return the level in dBm of a power in milliwatts; NaN where the power is not positive.

    Examples
    --------
    >>> bool(np.isnan(dbm_from_mw(-1e-9)))
    True
    """
    return db_from_ratio(power_mw)


#: normal quantile of a false alarm probability of 1e-6
FALSE_ALARM_SIGMA = 4.75
#: smallest threshold, dB: below it a tilt of the noise floor counts as a carrier
FLOOR_DB = 1.0
#: a carrier must stand this much above the threshold to appear, dB
HYSTERESIS_DB = 1.5
#: sweeps that must agree, of the last WINDOW
REQUIRED = 3
WINDOW = 5


class PresenceState(NamedTuple):
    """State of the presence test of N carriers."""

    #: (N,) debounced verdict
    is_present: BoolArray
    #: (N, WINDOW) verdicts of the last sweeps, newest first
    votes: BoolArray
    #: (N,) sweeps judged so far
    judged: NDArray[np.int64]


class PresenceStep(NamedTuple):
    """Outcome of one sweep."""

    state: PresenceState
    #: (N,) whether a level may be shown for this sweep
    is_visible: BoolArray


def initial_presence(carriers: int) -> PresenceState:
    """Return the state before the first sweep.

    Examples
    --------
    >>> bool(initial_presence(2).is_present.any())
    False
    """
    return PresenceState(
        np.zeros(carriers, dtype=np.bool_), np.zeros((carriers, WINDOW), dtype=np.bool_), np.zeros(carriers, np.int64)
    )


def presence_threshold_db(carrier_dof: ArrayLike, noise_dof: ArrayLike) -> FloatArray:
    """Return the threshold on (carrier + noise) / noise density.

    Parameters
    ----------
    carrier_dof, noise_dof : array_like
        Degrees of freedom of the mean inside the carrier and in the noise windows.

    Returns
    -------
    ndarray, dB
        At least ``FLOOR_DB``.

    Examples
    --------
    >>> round(float(presence_threshold_db(100.0, 100.0)), 3)
    2.232
    """
    spread = np.sqrt(1.0 / np.asarray(carrier_dof) + 1.0 / np.asarray(noise_dof))
    return np.maximum(10.0 * np.log10(1.0 + FALSE_ALARM_SIGMA * spread), FLOOR_DB)


def step_presence(state: PresenceState, ratio_db: FloatArray, threshold_db: FloatArray) -> PresenceStep:
    """Judge one sweep and advance the state.

    Parameters
    ----------
    state : PresenceState
        State after the previous sweep.
    ratio_db : ndarray, shape (N,), dB
        (Carrier + noise) over noise density of this sweep. NaN: not measured, no vote, not visible.
    threshold_db : ndarray, shape (N,), dB
        From `presence_threshold_db`.

    Returns
    -------
    PresenceStep
        New state, and which carriers may show a level.

    Notes
    -----
    The first judged sweep of a carrier sets its state by the plain threshold, so that a start loses no row.
    """
    is_judged = ~np.isnan(ratio_db)
    is_first = is_judged & (state.judged == 0)
    needed_db = threshold_db + np.where(state.is_present | is_first, 0.0, HYSTERESIS_DB)
    is_above = is_judged & (np.where(is_judged, ratio_db, -np.inf) > needed_db)
    pushed = np.concatenate([is_above[:, np.newaxis], state.votes[:, :-1]], axis=1)
    pushed = np.where(is_first[:, np.newaxis], is_above[:, np.newaxis], pushed)
    votes = np.where(is_judged[:, np.newaxis], pushed, state.votes)
    counted = votes.sum(axis=1)
    turned = np.where(state.is_present, WINDOW - counted >= REQUIRED, counted >= REQUIRED)
    is_present = np.where(is_first, is_above, state.is_present ^ (is_judged & turned))
    return PresenceStep(
        PresenceState(is_present, votes, state.judged + is_judged),
        is_above & is_present,
    )
