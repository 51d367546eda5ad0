"""Return of flagged carriers, by the rules that `carrier_faults` states: which are quiet again, and at what level."""

import numpy as np

from service.core.estimation.filtering.causes.carrier_faults import (
    QUIET_ROWS,
    QUIET_STD_DB,
    SAME_LEVEL_DB,
    STANDING_SHIFT_DB,
    CarrierWatch,
)
from service.core.estimation.filtering.causes.common_change import reset_cusum
from service.core.estimation.filtering.model.filter_model import BoolArray, CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import FREE_REFERENCE_DB2, Gaussian, reset_carriers

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
