"""Faults of single carriers: weight, skip, flag, release.

u = |innovation| / sigma: above 2 a carrier is trusted less (Huber), above 4 it is skipped; four skips in a row, or a
cumulative sum beyond its threshold (slow fades never reach 4 sigma at once), flag it. A flagged carrier is out for a
quarter of an hour at least; when its last 12 rows are quiet and within 0.2 dB of what it was its reference is restored.
At a higher level it must have stood for an hour before its reference is learned again, at a lower one for six: rain and
wet antennas only lower, an antenna that dries looks quiet long before it is, and a reference learned meanwhile turns
the attitude while it dries on. The reference of the alignment is kept for good: a carrier that comes back to it has it
again, whatever was learned since. A carrier without a reference shows 20 quiet rows after half an hour. A carrier that
was off for half an hour is flagged too: users who switch on again often do so at another level, too near for 4 sigma
and far enough to turn the attitude. The law of this file: times are minutes of data, never rows or clocks.

Return of flagged carriers, by the rules that `carrier_faults` states: which are quiet again, and at what level.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.causes.common_change import (
    THRESHOLD,
    Cusum,
    push_cusum,
    quiet_cusum,
    reset_cusum,
)
from service.core.estimation.filtering.model.filter_model import (
    FREE_REFERENCE_DB2,
    CarrierModel,
    Gaussian,
    hidden_count,
    reference_states,
    reset_carriers,
)

LESS_TRUSTED = 2.0
SKIPPED = 4.0
SKIPS_TO_FLAG = 4
#: a carrier that was off for longer must show its level first
ABSENT_MINUTES = 30.0
QUIET_ROWS = 20
QUIET_STD_DB = 0.32
#: rows after which another level is believed, and what its halves may differ by, dB
STANDING_ROWS = 60
STANDING_SHIFT_DB = 0.12
SAME_LEVEL_DB = 0.2
_LARGEST_VALUE = 3.0
#: counters are sums of fractions of a minute
_ROUNDING = 1e-6


class CarrierWatch(NamedTuple):
    """State of the fault detection of N carriers, with their references by the alignment."""

    #: (N,) minutes of skips in a row
    skip_minutes: FloatArray
    is_flagged: BoolArray
    #: (N,) minutes since the flag
    flagged_minutes: FloatArray
    #: (N,) reference error and its variance before the flag, dB and dB^2
    saved_reference_db: FloatArray
    saved_variance_db2: FloatArray
    #: (STANDING_ROWS, N) newest last, measured minus what the site explains, dB
    residuals_db: FloatArray
    cusum: Cusum
    #: (N,) minutes without the carrier while the others were measured
    absent_minutes: FloatArray
    #: (N,) whether the reference was learned again since the alignment
    is_relearned: BoolArray
    #: (N,) reference error and its variance by the alignment, dB and dB^2; they are kept for good
    aligned_reference_db: FloatArray
    aligned_variance_db2: FloatArray


def healthy(reference_variance_db2: FloatArray) -> CarrierWatch:
    """Return the watch of carriers (N,) that have not failed since the alignment."""
    carriers = len(reference_variance_db2)
    zeros, never = np.zeros(carriers), np.zeros(carriers, dtype=np.bool_)
    return CarrierWatch(
        zeros,
        never,
        zeros,
        zeros,
        zeros,
        np.full((STANDING_ROWS, carriers), np.nan),
        quiet_cusum(carriers),
        zeros,
        never,
        zeros,
        reference_variance_db2,
    )


def trusted_white_db2(white_db2: FloatArray, excess: FloatArray) -> FloatArray:
    """Return the white noise of each carrier raised by Huber's weight.

    Parameters
    ----------
    white_db2 : ndarray, shape (n,), dB^2
        White noise.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma.
    """
    raised: FloatArray = white_db2 * np.maximum(1.0, excess / LESS_TRUSTED)
    return raised


def count_row(
    watch: CarrierWatch,
    present: IntArray,
    excess: FloatArray,
    is_measured: BoolArray,
    minutes: float,
    values: FloatArray,
) -> CarrierWatch:
    """Return the watch with a row's skips and absences, and a minute's test values.

    A value counts for three at most: an impulse is skipped, not flagged, and a jump takes four minutes either way.

    Parameters
    ----------
    watch : CarrierWatch
        Before the row.
    present : ndarray, shape (n,)
        Carriers judged; the counters of the others stand.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of them.
    is_measured : ndarray, shape (N,)
        Carriers that are there, or that nobody expects.
    minutes : float
        Minutes for which the row stands, at most 1.
    values : ndarray, shape (N,)
        Test values of unit variance of a closed minute, NaN = none.
    """
    skips = watch.skip_minutes.copy()
    skips[present] = np.where(excess > SKIPPED, skips[present] + minutes, 0.0)
    return CarrierWatch(
        skip_minutes=skips,
        is_flagged=watch.is_flagged,
        flagged_minutes=watch.flagged_minutes,
        saved_reference_db=watch.saved_reference_db,
        saved_variance_db2=watch.saved_variance_db2,
        residuals_db=watch.residuals_db,
        cusum=push_cusum(watch.cusum, np.minimum(np.maximum(values, -_LARGEST_VALUE), _LARGEST_VALUE)),
        absent_minutes=np.where(is_measured, 0.0, watch.absent_minutes + minutes),
        is_relearned=watch.is_relearned,
        aligned_reference_db=watch.aligned_reference_db,
        aligned_variance_db2=watch.aligned_variance_db2,
    )


def failed(watch: CarrierWatch) -> BoolArray:
    """Return the carriers (N,) in use whose skips, sums or absence are beyond their limits."""
    is_beyond = watch.skip_minutes >= SKIPS_TO_FLAG - _ROUNDING
    is_beyond |= np.maximum(watch.cusum.up, watch.cusum.down) > THRESHOLD
    is_beyond |= watch.absent_minutes >= ABSENT_MINUTES - _ROUNDING
    is_failed: BoolArray = is_beyond & ~watch.is_flagged
    return is_failed


def flag_failed(
    model: CarrierModel, state: Gaussian, watch: CarrierWatch, before: Gaussian
) -> tuple[Gaussian, CarrierWatch]:
    """Flag the carriers whose skips, sums or absence are beyond their limits.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : Gaussian
        State after the row.
    watch : CarrierWatch
        Watch with the row counted.
    before : Gaussian
        State from which the old references are kept.

    Returns
    -------
    Gaussian
        The same state where nothing failed; else the failed carriers' states begin again with a free reference.
    CarrierWatch
        Watch after.
    """
    is_failed = failed(watch)
    if not is_failed.any():
        return state, watch
    positions = reference_states(model, np.arange(model.carriers), hidden_count(model, len(state.mean)))
    return set_aside(model, state, watch, is_failed, before.mean[positions], np.diagonal(before.covariance)[positions])


def set_aside(
    model: CarrierModel,
    state: Gaussian,
    watch: CarrierWatch,
    is_out: BoolArray,
    reference_db: FloatArray,
    variance_db2: FloatArray,
) -> tuple[Gaussian, CarrierWatch]:
    """Return the state without some carriers (N,), whose references (N,) are kept; their own states begin again."""
    out = np.flatnonzero(is_out)
    return (
        reset_carriers(model, state, out, np.zeros(len(out)), np.full(len(out), FREE_REFERENCE_DB2)),
        watch._replace(
            skip_minutes=np.where(is_out, 0.0, watch.skip_minutes),
            is_flagged=watch.is_flagged | is_out,
            flagged_minutes=np.where(is_out, 0.0, watch.flagged_minutes),
            saved_reference_db=np.where(is_out, reference_db, watch.saved_reference_db),
            saved_variance_db2=np.where(is_out, variance_db2, watch.saved_variance_db2),
            residuals_db=np.where(is_out, np.nan, watch.residuals_db),
            cusum=reset_cusum(watch.cusum, is_out),
        ),
    )


def give_back(
    model: CarrierModel, state: Gaussian, watch: CarrierWatch, is_back: BoolArray, more_db2: float
) -> tuple[Gaussian, CarrierWatch]:
    """Return the state in which some carriers (N,) have the aligned reference again, by ``more_db2`` less sure."""
    back = np.flatnonzero(is_back)
    variance = watch.aligned_variance_db2[back] + more_db2
    return (
        reset_carriers(model, state, back, watch.aligned_reference_db[back], variance),
        watch._replace(
            is_flagged=watch.is_flagged & ~is_back,
            cusum=reset_cusum(watch.cusum, is_back),
            is_relearned=watch.is_relearned & ~is_back,
        ),
    )


def watch_flagged(watch: CarrierWatch, residual_db: FloatArray, minutes: float) -> CarrierWatch:
    """Return the watch with one minute more of what the flagged carriers do.

    Parameters
    ----------
    watch : CarrierWatch
        Before the minute.
    residual_db : ndarray, shape (N,), dB
        Measured minus what attitude, chain and rain explain; NaN = absent.
    minutes : float
        Minutes that have passed.
    """
    return CarrierWatch(
        skip_minutes=watch.skip_minutes,
        is_flagged=watch.is_flagged,
        flagged_minutes=np.where(watch.is_flagged, watch.flagged_minutes + minutes, 0.0),
        saved_reference_db=watch.saved_reference_db,
        saved_variance_db2=watch.saved_variance_db2,
        residuals_db=np.concatenate((watch.residuals_db[1:], residual_db.reshape(1, -1))),
        cusum=watch.cusum,
        absent_minutes=watch.absent_minutes,
        is_relearned=watch.is_relearned,
        aligned_reference_db=watch.aligned_reference_db,
        aligned_variance_db2=watch.aligned_variance_db2,
    )


MIN_FLAGGED_MINUTES = 30.0
#: a carrier that is at its level again is known sooner
MIN_BACK_MINUTES = 15.0
BACK_ROWS = 12
QUIET_SHIFT_DB = 0.22
#: a lower level is rain or a wet antenna as long as one may last, minutes
WET_MINUTES = 360.0
#: what a restored reference may have moved meanwhile, dB
_RESTORED_SIGMA_DB = 0.1


def returning(watch: CarrierWatch) -> BoolArray:
    """Return the flagged carriers (N,) that have been out for long enough to come back."""
    is_back: BoolArray = watch.is_flagged & (watch.flagged_minutes >= MIN_BACK_MINUTES)
    return is_back


def release_quiet(model: CarrierModel, state: Gaussian, watch: CarrierWatch) -> tuple[Gaussian, CarrierWatch]:
    """Release the flagged carriers that are quiet again.

    Returns
    -------
    Gaussian
        The same state where none is released; else the released begin with the old reference, or a free one at the new
        level.
    CarrierWatch
        Watch after; references that were learned again are marked.
    """
    is_back = returning(watch)
    if not is_back.any():
        return state, watch
    is_quiet = is_back & (watch.flagged_minutes >= MIN_FLAGGED_MINUTES)
    level_db, back_db = (watch.residuals_db[-rows:].mean(axis=0) for rows in (QUIET_ROWS, BACK_ROWS))
    # the level before the flag may have been a wet one
    known_db = np.array([watch.saved_reference_db, watch.aligned_reference_db])
    variance_db2 = np.array([watch.saved_variance_db2, watch.aligned_variance_db2])
    distance_db = np.abs(back_db - known_db)
    nearest = np.where(np.isnan(distance_db), np.inf, distance_db).argmin(axis=0), np.arange(model.carriers)
    is_back &= distance_db[nearest] < SAME_LEVEL_DB
    is_new = np.isnan(watch.saved_reference_db)
    is_dry = (level_db > np.fmax(*known_db)) | (watch.flagged_minutes >= WET_MINUTES)
    is_quiet &= is_new | is_dry
    # what lies so low or so far that it cannot come back need not be asked how still it stands
    if is_back.any():
        is_back &= _is_still(watch.residuals_db[-BACK_ROWS:])
    if is_quiet.any():
        is_quiet &= is_new | (halves_differ_db(watch.residuals_db) < STANDING_SHIFT_DB)
        is_quiet &= _is_still(watch.residuals_db[-QUIET_ROWS:])
    is_quiet |= is_back
    if not is_quiet.any():
        return state, watch
    chosen = np.flatnonzero(is_quiet)
    is_back = is_back[chosen]
    reference_db = np.where(is_back, known_db[nearest][chosen], level_db[chosen])
    variance = np.where(is_back, variance_db2[nearest][chosen] + _RESTORED_SIGMA_DB**2, FREE_REFERENCE_DB2)
    relearned = watch.is_relearned.copy()
    relearned[chosen] = np.where(is_back, relearned[chosen] & (nearest[0][chosen] == 0), True)
    return (
        reset_carriers(model, state, chosen, reference_db, variance),
        watch._replace(
            is_flagged=watch.is_flagged & ~is_quiet,
            cusum=reset_cusum(watch.cusum, is_quiet),
            is_relearned=relearned,
        ),
    )


def halves_differ_db(rows_db: FloatArray) -> FloatArray:
    """Return how far the means of the two halves of rows (T, N) lie apart (N,), NaN where a row is absent."""
    half = len(rows_db) // 2
    return np.asarray(np.abs(rows_db[half:].mean(axis=0) - rows_db[:half].mean(axis=0)))


def _is_still(rows_db: FloatArray) -> BoolArray:
    """Return whether each carrier neither scatters nor drifts over rows (T, N)."""
    return np.asarray((rows_db.std(axis=0) < QUIET_STD_DB) & (halves_differ_db(rows_db) < QUIET_SHIFT_DB))
