"""Faults of single carriers: weight, skip, flag, release; the functions are compiled as they stand.

u = |innovation| / sigma: above 2 a carrier is trusted less (Huber), above 4 it is skipped; four skips in a row, or a
cumulative sum beyond its threshold (slow fades never reach 4 sigma at once), flag it. A flagged carrier is out for a
quarter of an hour at least; when its last 12 rows are quiet and within 0.2 dB of what it was its reference is restored.
At a higher level it must have stood for an hour before its reference is learned again, at a lower one for six: rain and
wet antennas only lower, an antenna that dries looks quiet long before it is, and a reference learned meanwhile turns
the attitude while it dries on. The reference of the alignment is kept for good: a carrier that comes back to it has it
again, whatever was learned since. A carrier without a reference shows 20 quiet rows after half an hour. A carrier that
was off for half an hour is flagged too: users who switch on again often do so at another level, too near for 4 sigma
and far enough to turn the attitude. Times are minutes of data, never rows or clocks.

Changes of the mean in a series of unit variance are found by the two-sided cumulative sum:

    up   = max(0, up + z - k),   down = max(0, down - z - k),   alarm where one exceeds h

k = 0.6 and h = 9: a change of 1.2 sigma is found after about fifteen values, one of 4 sigma after three, and a dry
series raises one false alarm in about a hundred thousand values.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.filtering.filter_model import FREE_REFERENCE_DB2
from service.core.estimation.filtering.filter_state import STANDING_ROWS, FilterState
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.filtering.prediction import Innovation

#: half the smallest change that matters to a cumulative sum, and the sum that is an alarm
SLACK, THRESHOLD = 0.6, 9.0
LESS_TRUSTED, SKIPPED = 2.0, 4.0
SKIPS_TO_FLAG = 4
#: a carrier that was off for longer must show its level first
ABSENT_MINUTES = 30.0
QUIET_ROWS = 20
QUIET_STD_DB = 0.32
#: rows after which another level is believed, and what its halves may differ by, dB
STANDING_SHIFT_DB = 0.12
SAME_LEVEL_DB = 0.2
MIN_FLAGGED_MINUTES = 30.0
#: a carrier that is at its level again is known sooner
MIN_BACK_MINUTES = 15.0
BACK_ROWS = 12
QUIET_SHIFT_DB = 0.22
#: a lower level is rain or a wet antenna as long as one may last, minutes
WET_MINUTES = 360.0
#: what a restored reference may have moved meanwhile, dB
_RESTORED_SIGMA_DB = 0.1
_LARGEST_VALUE = 3.0
#: counters are sums of fractions of a minute
_ROUNDING = 1e-6
#: a minute may be short by this much, microseconds: rows come with some jitter
MINUTE_US = 59_000_000


def pushed_sum(total: float, value: float) -> float:
    """Return one side of a cumulative sum with one value more; NaN leaves it as it is."""
    return total if math.isnan(value) else max(total + value - SLACK, 0.0)


def pushed_minute(total: float, rows: float, value: float) -> tuple[float, float, float]:
    """Return sum and rows of a minute with one value of unit variance more, and their value, NaN without a row.

    The value of a minute is the sum over the square root of its rows, which keeps unit variance; at one row a minute
    or fewer every row is a minute.
    """
    if math.isfinite(value):
        total, rows = total + value, rows + 1.0
    return total, rows, total / math.sqrt(rows) if rows > 0.0 else math.nan


def ascending(values: FloatArray) -> IntArray:
    """Return the places of values (n,) in rising order, those of equal ones as they stand."""
    places = np.arange(len(values))
    for number in range(1, len(values)):
        place, at = places[number], number
        while at > 0 and values[places[at - 1]] > values[place]:
            places[at] = places[at - 1]
            at -= 1
        places[at] = place
    return places


def shift_rows(window: FloatArray) -> None:
    """Move the rows of a window (W, N) up by one, in place; the last stays and is to be written."""
    for row in range(len(window) - 1):
        window[row] = window[row + 1]


def trusted(innovation: Innovation, excess: FloatArray) -> Innovation:
    """Return the innovations (n,) that are not skipped, with Huber's weights; `excess` = abs(innovation) / sigma."""
    kept = np.flatnonzero(excess <= SKIPPED)
    white_db2 = innovation.white_db2[kept] * np.maximum(1.0, excess[kept] / LESS_TRUSTED)
    if len(kept) == len(excess):
        return Innovation(
            innovation.carriers,
            innovation.innovation_db,
            innovation.predicted_db2,
            white_db2,
            innovation.core_jacobian,
            innovation.cross,
        )
    return Innovation(
        innovation.carriers[kept],
        innovation.innovation_db[kept],
        np.ascontiguousarray(innovation.predicted_db2[kept][:, kept]),
        white_db2,
        innovation.core_jacobian[kept],
        innovation.cross[kept],
    )


def count_row(
    carriers: NDArray[np.void],
    innovation: Innovation,
    excess: FloatArray,
    is_accounted: BoolArray,
    minutes: float,
    values: FloatArray,
) -> None:
    """Count a row's skips and absences, and a minute's test values, in place.

    A value counts for three at most: an impulse is skipped, not flagged, and a jump takes four minutes either way.

    Parameters
    ----------
    carriers : ndarray, shape (N,)
        Of `CARRIER`.
    innovation : Innovation
        Of the carriers judged; the counters of the others stand.
    excess : ndarray, shape (n,)
        abs(innovation) / sigma of them.
    is_accounted : ndarray, shape (N,)
        Carriers that are there, or that nobody expects.
    minutes : float
        Minutes for which the row stands, at most 1.
    values : ndarray, shape (N,)
        Test values of unit variance of a closed minute, NaN = none.
    """
    for row in range(len(excess)):
        k = innovation.carriers[row]
        carriers["skip_minutes"][k] = carriers["skip_minutes"][k] + minutes if excess[row] > SKIPPED else 0.0
    for k in range(len(carriers)):
        value = min(max(values[k], -_LARGEST_VALUE), _LARGEST_VALUE) if math.isfinite(values[k]) else math.nan
        carriers["up"][k] = pushed_sum(carriers["up"][k], value)
        carriers["down"][k] = pushed_sum(carriers["down"][k], -value)
        carriers["absent_minutes"][k] = 0.0 if is_accounted[k] else carriers["absent_minutes"][k] + minutes


def failed(carriers: NDArray[np.void]) -> BoolArray:
    """Return the carriers (N,) in use whose skips, sums or absence are beyond their limits."""
    is_failed = np.zeros(len(carriers), dtype=np.bool_)
    for k in range(len(carriers)):
        is_beyond = carriers["skip_minutes"][k] >= SKIPS_TO_FLAG - _ROUNDING
        is_beyond |= max(carriers["up"][k], carriers["down"][k]) > THRESHOLD
        is_beyond |= carriers["absent_minutes"][k] >= ABSENT_MINUTES - _ROUNDING
        is_failed[k] = is_beyond and not carriers["is_flagged"][k]
    return is_failed


def restart_carrier(model: FilterModel, state: FilterState, k: int, reference_db: float, variance_db2: float) -> None:
    """Let a carrier begin again, in place: coloured parts at zero with stationary variance, correlated with nothing."""
    mean, covariance = state.mean, state.covariance
    every, components = model.coloured_sigma_db.shape
    for component in range(components + 1):
        place = len(mean) - every * (components + 1 - component) + k
        is_reference = component == components
        covariance[place, :] = 0.0
        covariance[:, place] = 0.0
        mean[place] = reference_db if is_reference else 0.0
        covariance[place, place] = variance_db2 if is_reference else model.coloured_sigma_db[k, component] ** 2


def set_aside(model: FilterModel, state: FilterState, k: int, reference_db: float, variance_db2: float) -> None:
    """Flag a carrier, in place; its reference from before is kept, its own states begin again with a free one."""
    restart_carrier(model, state, k, 0.0, FREE_REFERENCE_DB2)
    carriers = state.carriers
    carriers["is_flagged"][k] = True
    carriers["skip_minutes"][k] = carriers["flagged_minutes"][k] = 0.0
    carriers["up"][k] = carriers["down"][k] = 0.0
    carriers["saved_reference_db"][k], carriers["saved_variance_db2"][k] = reference_db, variance_db2
    state.aside_db[:, k] = np.nan


def take_back(model: FilterModel, state: FilterState, k: int, reference_db: float, variance_db2: float) -> None:
    """Let a carrier take part again, in place, with a reference."""
    restart_carrier(model, state, k, reference_db, variance_db2)
    carriers = state.carriers
    carriers["is_flagged"][k] = False
    carriers["up"][k] = carriers["down"][k] = 0.0


def watch_flagged(state: FilterState, residual_db: FloatArray, minutes: float) -> None:
    """Count some minutes, in place, of what the flagged carriers do; residuals (N,), NaN = absent."""
    carriers = state.carriers
    for k in range(len(carriers)):
        is_flagged = carriers["is_flagged"][k]
        carriers["flagged_minutes"][k] = carriers["flagged_minutes"][k] + minutes if is_flagged else 0.0
    shift_rows(state.aside_db)
    state.aside_db[STANDING_ROWS - 1] = residual_db


def is_returning(carriers: NDArray[np.void]) -> bool:
    """Return whether a flagged carrier has been out for long enough to come back."""
    return bool((carriers["is_flagged"] & (carriers["flagged_minutes"] >= MIN_BACK_MINUTES)).any())


def release_quiet(model: FilterModel, state: FilterState) -> bool:
    """Release the flagged carriers that are quiet again, in place, and return whether there was one.

    The released begin with the old reference, or a free one at the new level; references that were learned again are
    marked.
    """
    is_any, carriers = False, state.carriers
    for k in range(len(carriers)):
        minutes = carriers["flagged_minutes"][k]
        if not carriers["is_flagged"][k] or minutes < MIN_BACK_MINUTES:
            continue
        rows_db = state.aside_db[:, k]
        level_db, back_db = rows_db[-QUIET_ROWS:].mean(), rows_db[-BACK_ROWS:].mean()
        saved_db, aligned_db = carriers["saved_reference_db"][k], carriers["aligned_reference_db"][k]
        # the level before the flag may have been a wet one
        by_saved, by_aligned = abs(back_db - saved_db), abs(back_db - aligned_db)
        is_aligned = by_aligned < by_saved or (math.isnan(by_saved) and not math.isnan(by_aligned))
        distance_db = by_aligned if is_aligned else by_saved
        # what lies so low or so far that it cannot come back need not be asked how still it stands
        is_back = distance_db < SAME_LEVEL_DB and _is_still(rows_db[-BACK_ROWS:])
        is_new = math.isnan(saved_db)
        highest_db = _greater(saved_db, aligned_db)
        is_dry = level_db > highest_db or minutes >= WET_MINUTES
        is_quiet = minutes >= MIN_FLAGGED_MINUTES and (is_new or is_dry)
        is_quiet = is_quiet and (is_new or halves_differ_db(rows_db) < STANDING_SHIFT_DB)
        is_quiet = is_quiet and _is_still(rows_db[-QUIET_ROWS:])
        if is_back:
            known_db = aligned_db if is_aligned else saved_db
            name_db2 = carriers["aligned_variance_db2"][k] if is_aligned else carriers["saved_variance_db2"][k]
            take_back(model, state, k, known_db, name_db2 + _RESTORED_SIGMA_DB**2)
            carriers["is_relearned"][k] = carriers["is_relearned"][k] and not is_aligned
        elif is_quiet:
            take_back(model, state, k, level_db, FREE_REFERENCE_DB2)
            carriers["is_relearned"][k] = True
        is_any = is_any or is_back or is_quiet
    return is_any


def _greater(one: float, other: float) -> float:
    """Return the greater of two numbers, that which is one where the other is NaN."""
    if math.isnan(one):
        return other
    return one if math.isnan(other) else max(one, other)


def halves_differ_db(rows_db: FloatArray) -> float:
    """Return how far the means of the two halves of rows (T,) lie apart, NaN where a row is absent."""
    half = len(rows_db) // 2
    return float(abs(rows_db[half:].mean() - rows_db[:half].mean()))


def _is_still(rows_db: FloatArray) -> bool:
    """Return whether a carrier neither scatters nor drifts over rows (T,)."""
    return rows_db.std() < QUIET_STD_DB and halves_differ_db(rows_db) < QUIET_SHIFT_DB
