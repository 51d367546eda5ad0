"""Means of the last minutes, the rule for rain on the downlink, and the consistency of levels with stated angles.

Means and rule are compiled as they stand.
"""

import math
from math import erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray

#: mean square of the residuals, in sigmas, above which levels have moved on their own
_MOVED_SCATTER = 4.0


class Consistency(NamedTuple):
    """Test of stated angles against levels."""

    #: drop of the cost by three free angles
    chi_square: float
    #: probability of a drop at least as large while the angles hold; 1 when fewer than six carriers were tested
    probability: float
    #: (3,) deg, angles by which the levels differ from the stated ones
    offset_deg: FloatArray
    carriers_tested: int


def compare_with_angles(change_db: FloatArray, sensitivity_db_per_deg: FloatArray, sigma_db: FloatArray) -> Consistency:
    """Test level changes for a missing attitude.

    Parameters
    ----------
    change_db : ndarray, shape (N,), dB
        Level of the window minus level of the calibration minus f(stated angles); NaN = not tested.
    sensitivity_db_per_deg : ndarray, shape (N, 3), dB/deg
        Slopes at the stated angles.
    sigma_db : ndarray, shape (N,), dB
        One standard deviation of each change.

    Returns
    -------
    Consistency
        Six carriers are the fewest with which four unknowns leave something to test.
    """
    present = np.isfinite(change_db) & np.isfinite(sigma_db) & (sigma_db > 0.0)
    present &= np.isfinite(sensitivity_db_per_deg).all(axis=1)
    count = int(np.count_nonzero(present))
    if count < 6:
        return Consistency(0.0, 1.0, np.full(3, np.nan), count)
    weight = 1.0 / sigma_db[present]
    ones = weight[:, None]
    full = np.hstack([sensitivity_db_per_deg[present] * ones, ones])
    wanted = change_db[present] * weight
    solution = np.linalg.lstsq(full, wanted, rcond=None)[0]
    common = float(ones[:, 0] @ wanted / (ones[:, 0] @ ones[:, 0]))
    cost_common = float(np.sum((wanted - ones[:, 0] * common) ** 2))
    cost_full = float(np.sum((wanted - full @ solution) ** 2))
    scatter = cost_full / (count - 4)
    chi_square = max(0.0, cost_common - cost_full) / (scatter if scatter > _MOVED_SCATTER else 1.0)
    return Consistency(chi_square, chi_square_tail_3(chi_square), np.asarray(solution[:3], dtype=np.float64), count)


def chi_square_tail_3(chi_square: float) -> float:
    """Return the probability that a chi-square variable with three degrees of freedom exceeds a value.

    Closed form: ``erfc(sqrt(x/2)) + sqrt(2 x / pi) exp(-x/2)``.

    Examples
    --------
    >>> round(chi_square_tail_3(7.814727903), 6)
    0.05
    """
    return erfc(sqrt(chi_square / 2.0)) + sqrt(2.0 * chi_square / pi) * exp(-chi_square / 2.0)


#: fewer carriers than this cannot show a common change
MIN_CARRIERS = 4
#: angles that the fix took from the row
FITTED_ANGLES = 3
#: share of the spread that a turn leaves at most. Simulated fades of 1 to 3.5 dB left 0.8 to 15 times the spread, and
#: turns of 0.3 to 1 deg 0.1 to 0.5 of it
TURN_SHARE = 0.5
#: standard deviation of a normal distribution over its median absolute deviation
SIGMA_OF_MAD = 1.4826

#: settings
LIMITS = np.dtype(
    [
        ("averaging_us", "i8"),
        ("min_rows", "i8"),
        ("gate_db", "f8"),
        ("gate_sigma", "f8"),
        ("min_carriers", "i8"),
        # a row later than this after its predecessor starts the means again
        ("max_gap_us", "i8"),
        ("fade_averaging_us", "i8"),
        ("fade_depth_db", "f8"),
        ("fade_share", "f8"),
        ("fade_spread_ratio", "f8"),
        ("fade_entry_s", "f8"),
        ("fade_exit_s", "f8"),
        ("fade_max_gap_s", "f8"),
        # time after which a fix counts
        ("objection_us", "i8"),
    ],
    align=True,
)
#: state of a watch; a zero is a dry start
FADE = np.dtype(
    [
        # control is stopped because of a fade
        ("is_stopped", "?"),
        # how long the condition has stood without a break, s; a change of twice the depth counts twice
        ("wet_s", "f8"),
        # how long the median has been above minus the depth, or a turn has explained it, without a break, s
        ("dry_s", "f8"),
        # time since the last row that could be judged, s
        ("blind_s", "f8"),
    ],
    align=True,
)


class FadeTest(NamedTuple):
    """Verdict on one row; figures are NaN with fewer than four carriers."""

    #: the condition holds on this row
    is_fade: bool
    #: three angles leave less than half of the spread: it is the attitude that has changed
    is_turn: bool
    #: median deviation, dB
    median_db: float
    #: 1.48 times the median absolute deviation from the median, dB
    spread_db: float
    #: share of the present carriers below minus the depth
    share_below: float


def fade_sign_test(
    deviation_db: FloatArray, sign: float, depth_db: float, share: float, spread_ratio: float, left_db: float
) -> FadeTest:
    """Return whether one row of deviations looks like rain on the downlink.

    Parameters
    ----------
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference power, harmonic removed; one row or the mean of some minutes. NaN marks an absent
        carrier.
    sign : float
        1 for levels that have fallen, -1 for levels that have risen: all figures are those of the product.
    depth_db : float, dB
        A carrier below minus this takes part.
    share : float
        Least share of the present carriers that must take part.
    spread_ratio : float
        The spread must be below this times the median's size.
    left_db : float, dB
        What the attitude fix of the same row leaves (`left_by_angles`). The row is a fade only if it leaves more than
        the common change does, and a turn where it leaves less than half; infinite: the paper's rule alone.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, the paragraph below figure 3.

    Examples
    --------
    >>> fade_sign_test(np.array([-1.0, -1.1, -0.9, -1.2, np.nan]), 1.0, 0.3, 0.8, 0.5, np.inf).is_fade
    True
    """
    present, count, below = np.empty(len(deviation_db)), 0, 0
    for value in deviation_db:
        if math.isfinite(value):
            present[count] = sign * value
            count += 1
            below += sign * value < -depth_db
    if count < MIN_CARRIERS:
        return FadeTest(False, False, math.nan, math.nan, math.nan)
    median_db = median_of(present, count)
    for k in range(count):
        present[k] = abs(present[k] - median_db)
    spread_db, share_below = SIGMA_OF_MAD * median_of(present, count), below / count
    is_fade = share_below >= share and spread_db < spread_ratio * abs(median_db) and left_db >= spread_db
    return FadeTest(is_fade, left_db < TURN_SHARE * spread_db, median_db, spread_db, share_below)


def left_by_angles(residual_db: FloatArray, reason: IntArray) -> float:
    """Return the spread of what a fix leaves of its carriers (N,), those of reason 0, dB, freed from three unknowns.

    Infinite with fewer than four of them.
    """
    present, count = np.empty(len(residual_db)), 0
    for k in range(len(residual_db)):
        if reason[k] == 0 and math.isfinite(residual_db[k]):
            present[count] = abs(residual_db[k])
            count += 1
    if count < MIN_CARRIERS:
        return math.inf
    return SIGMA_OF_MAD * median_of(present, count) * math.sqrt(count / (count - FITTED_ANGLES))


def median_of(values: FloatArray, count: int) -> float:
    """Return the median of the first values, one at least, which it puts in order."""
    for k in range(1, count):
        value, place = values[k], k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return float(0.5 * (values[(count - 1) // 2] + values[count // 2]))


def step_fade_watch(watch: NDArray[np.void], place: int, dt_s: float, test: FadeTest, limits: np.void) -> None:
    """Take one row into a watch.

    Parameters
    ----------
    watch : ndarray of `FADE`
        State before the row, and after it.
    place : int
        Which of the watches.
    dt_s : float, s
        Time since the row before; the row is taken to stand for it.
    test : FadeTest
        Verdict on the row. A row that cannot be judged (NaN) leaves the counters and is counted as blind time.
    limits : record of `LIMITS`
        The depth with which the test was made; how long the condition must stand at it, a deeper change for less, and
        how long it must be dry. The spacecraft drifts during a stop, so levels may stay away by its turn. Time without
        a judged row above the greatest gap starts both counters again and adds nothing to them. A standing stop stays:
        a gap is no evidence of dry weather.
    """
    depth_db = limits["fade_depth_db"]
    elapsed_s = watch["blind_s"][place] + dt_s
    if math.isnan(test.median_db):
        watch["blind_s"][place] = elapsed_s
        return
    wet_s, dry_s = watch["wet_s"][place], watch["dry_s"][place]
    if elapsed_s > limits["fade_max_gap_s"]:
        wet_s, dry_s, elapsed_s = 0.0, 0.0, 0.0
    wet_s = wet_s + elapsed_s * abs(test.median_db) / depth_db if test.is_fade else 0.0
    dry_s = dry_s + elapsed_s if test.is_turn or test.median_db > -depth_db else 0.0
    is_stopped = dry_s < limits["fade_exit_s"] if watch["is_stopped"][place] else wet_s >= limits["fade_entry_s"]
    watch["is_stopped"][place], watch["blind_s"][place] = is_stopped, 0.0
    watch["wet_s"][place], watch["dry_s"][place] = wet_s, dry_s


def is_turn_asked(watches: NDArray[np.void], limits: np.void, change_db: FloatArray) -> bool:
    """Return whether a row may be a fade, or one stands, so that a fix tells whether a turn explains it better."""
    for place in range(len(watches)):
        if watches["is_stopped"][place] or _signed_test(limits, place, change_db, math.inf).is_fade:
            return True
    return False


def watch_fades(
    watches: NDArray[np.void],
    limits: np.void,
    dt_s: float,
    change_db: FloatArray,
    left_db: FloatArray,
    left_by_turn: float,
) -> None:
    """Apply the rule of one sign and near size to both signs.

    The print has the rule for fades alone, sign 1; a rise of all levels (-1) looks like attitude as well. A stop ends
    where the levels are back, or back but for a turn, which the dynamics predict or which explains them by itself: the
    spacecraft drifts during a stop.

    Parameters
    ----------
    watches : ndarray of `FADE`
        Of falls and rises; written.
    limits : record of `LIMITS`
        Settings.
    dt_s : float, s
        Time since the row before.
    change_db, left_db : ndarray, shape (N,), dB
        Change of levels, and what the angles that are steered by leave of it.
    left_by_turn : float, dB
        What a fix of the change leaves of it.
    """
    for place in range(len(watches)):
        is_stopped = watches["is_stopped"][place]
        test = _signed_test(limits, place, change_db, math.inf)
        if test.is_fade or is_stopped:
            test = _signed_test(limits, place, change_db, left_by_turn)
        if is_stopped:
            left = _signed_test(limits, place, left_db, left_by_turn)
            if left.median_db > test.median_db:
                test = FadeTest(left.is_fade, test.is_turn, left.median_db, left.spread_db, left.share_below)
        step_fade_watch(watches, place, dt_s, test, limits)


def _signed_test(limits: np.void, place: int, change_db: FloatArray, left_db: float) -> FadeTest:
    """Return the verdict on levels that have fallen (0) or risen (1)."""
    share, ratio = limits["fade_share"], limits["fade_spread_ratio"]
    return fade_sign_test(change_db, 1.0 - 2.0 * place, limits["fade_depth_db"], share, ratio, left_db)


def trailing_mean(
    epochs_us: IntArray, rows_db: FloatArray, count: int, span_us: int, min_rows: int
) -> tuple[FloatArray, int]:
    """Return the mean (N,) of each carrier over the last rows, and over how many; NaN = absent.

    Parameters
    ----------
    epochs_us, rows_db : ndarray, shape (R,) and (R, N)
        Rows, of which the first `count` are meant, in order of time.
    span_us : int, microseconds
        Length of the window, open at its old end: 15 rows at 60 s in 900 s.
    min_rows : int
        Carriers with fewer present values give NaN, at least 1.
    """
    carriers, first = rows_db.shape[1], count
    mean, present = np.zeros(carriers), np.zeros(carriers, dtype=np.int64)
    while first > 0 and epochs_us[first - 1] > epochs_us[count - 1] - span_us:
        first -= 1
    for row in range(first, count):
        for k in range(carriers):
            if math.isfinite(rows_db[row, k]):
                mean[k] += rows_db[row, k]
                present[k] += 1
    for k in range(carriers):
        mean[k] = mean[k] / present[k] if present[k] >= max(min_rows, 1) else math.nan
    return mean, count - first
