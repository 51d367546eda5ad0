"""Means of the last minutes, their consistency with stated angles, and the rule for rain on the downlink."""

import math
from math import erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

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


#: Fewer carriers than this cannot show a common change.
MIN_CARRIERS = 4
#: Angles that the fix took from the row.
FITTED_ANGLES = 3
#: Share of the spread that a turn leaves at most. Simulated fades of 1 to 3.5 dB left 0.8 to 15 times the spread, and
#: turns of 0.3 to 1 deg 0.1 to 0.5 of it.
TURN_SHARE = 0.5
#: Standard deviation of a normal distribution over its median absolute deviation.
SIGMA_OF_MAD = 1.4826


class FadeTest(NamedTuple):
    """Verdict on one row; figures are NaN with fewer than four carriers.

    Parameters
    ----------
    is_fade : bool
        The condition holds on this row.
    is_turn : bool
        Three angles leave less than half of the spread: it is the attitude that has changed.
    median_db : float, dB
        Median deviation.
    spread_db : float, dB
        1.48 times the median absolute deviation from the median.
    share_below : float
        Share of the present carriers below minus the depth.
    """

    is_fade: bool
    is_turn: bool
    median_db: float
    spread_db: float
    share_below: float


class FadeWatch(NamedTuple):
    """State of the watch; the default is a dry start.

    Parameters
    ----------
    is_stopped : bool
        Control is stopped because of a fade.
    wet_s : float, s
        How long the condition has stood without a break; a change of twice the depth counts twice.
    dry_s : float, s
        How long the median has been above minus the depth, or a turn has explained it, without a break.
    blind_s : float, s
        Time since the last row that could be judged.
    """

    is_stopped: bool = False
    wet_s: float = 0.0
    dry_s: float = 0.0
    blind_s: float = 0.0


def fade_sign_test(
    deviation_db: FloatArray,
    *,
    depth_db: float = 0.3,
    share: float = 0.8,
    spread_ratio: float = 0.5,
    fix_residual_db: FloatArray | None = None,
) -> FadeTest:
    """Return whether one row of deviations looks like rain on the downlink.

    Parameters
    ----------
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference power, harmonic removed; one row or the mean of some minutes. NaN marks an absent
        carrier.
    depth_db : float, dB
        A carrier below minus this takes part.
    share : float
        Least share of the present carriers that must take part.
    spread_ratio : float
        The spread must be below this times the median's size.
    fix_residual_db : ndarray, shape (N,), dB, or None
        What the attitude fix of the same row leaves of the deviations (NaN = not used). The row is a fade only if it
        leaves more than the common change does, and a turn where it leaves less than half. None, or fewer than four
        residuals: the paper's rule alone.

    Returns
    -------
    FadeTest
        ``is_fade`` is False with fewer than four carriers.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, the paragraph below figure 3.

    Examples
    --------
    >>> fade_sign_test(np.array([-1.0, -1.1, -0.9, -1.2, np.nan])).is_fade
    True
    """
    present = deviation_db[np.isfinite(deviation_db)]
    if present.size < MIN_CARRIERS:
        return FadeTest(is_fade=False, is_turn=False, median_db=math.nan, spread_db=math.nan, share_below=math.nan)
    median_db = median_of(present)
    spread_db = SIGMA_OF_MAD * median_of(np.abs(present - median_db))
    share_below = float(np.count_nonzero(present < -depth_db)) / present.size
    is_fade = share_below >= share and spread_db < spread_ratio * abs(median_db)
    left_db = math.inf if fix_residual_db is None else _left_by_angles(fix_residual_db)
    return FadeTest(
        is_fade and left_db >= spread_db, left_db < TURN_SHARE * spread_db, median_db, spread_db, share_below
    )


def _left_by_angles(fix_residual_db: FloatArray) -> float:
    """Return the spread of the residuals of a fix, dB, freed from its three unknowns."""
    present = fix_residual_db[np.isfinite(fix_residual_db)]
    if present.size < MIN_CARRIERS:
        return math.inf
    freedom = math.sqrt(present.size / (present.size - FITTED_ANGLES))
    return SIGMA_OF_MAD * median_of(np.abs(present)) * freedom


def median_of(values: FloatArray) -> float:
    """Return the median of some finite values; numpy's own costs ten times as much on a row."""
    ordered = np.sort(values)
    return 0.5 * float(ordered[(ordered.size - 1) // 2] + ordered[ordered.size // 2])


def step_fade_watch(
    state: FadeWatch,
    dt_s: float,
    test: FadeTest,
    *,
    depth_db: float = 0.3,
    stop_after_s: float = 300.0,
    return_after_s: float = 600.0,
    max_gap_s: float = 300.0,
) -> FadeWatch:
    """Return the state of the watch after one row.

    Parameters
    ----------
    state : FadeWatch
        State before the row.
    dt_s : float, s
        Time since the row before; the row is taken to stand for it.
    test : FadeTest
        Verdict on the row. A row that cannot be judged (NaN) leaves the counters and is counted as blind time.
    depth_db : float, dB
        The depth with which the test was made.
    stop_after_s, return_after_s : float, s
        How long the condition must stand at the depth, a deeper change for less, and how long it must be dry: the
        spacecraft drifts during a stop, so levels may stay away by its turn.
    max_gap_s : float, s
        Time without a judged row above this starts both counters again and adds nothing to them. A standing stop stays:
        a gap is no evidence of dry weather.

    Returns
    -------
    FadeWatch
        State after the row.

    Examples
    --------
    >>> wet, state = fade_sign_test(np.full(8, -2.0)), FadeWatch()
    >>> for _ in range(5):
    ...     state = step_fade_watch(state, 60.0, wet)
    >>> state.is_stopped
    True
    """
    elapsed_s = state.blind_s + dt_s
    if math.isnan(test.median_db):
        return state._replace(blind_s=elapsed_s)
    is_gap = elapsed_s > max_gap_s
    wet_before_s, dry_before_s, elapsed_s = (0.0, 0.0, 0.0) if is_gap else (state.wet_s, state.dry_s, elapsed_s)
    wet_s = wet_before_s + elapsed_s * abs(test.median_db) / depth_db if test.is_fade else 0.0
    dry_s = dry_before_s + elapsed_s if test.is_turn or test.median_db > -depth_db else 0.0
    is_stopped = dry_s < return_after_s if state.is_stopped else wet_s >= stop_after_s
    return FadeWatch(is_stopped, wet_s, dry_s)


class TrailingMean(NamedTuple):
    """Rows kept for the mean; arrays are read-only.

    Parameters
    ----------
    epoch_us : ndarray, shape (R,), microseconds UTC
        Strictly increasing.
    rows : ndarray, shape (R, N)
        Values of the carriers, NaN = absent.
    horizon_us : int, microseconds
        Rows this much older than the newest are forgotten; no window may be longer.
    """

    epoch_us: IntArray
    rows: FloatArray
    horizon_us: int


def empty_window(carriers: int, horizon_s: float = 3600.0) -> TrailingMean:
    """Return a window that holds no row yet.

    Examples
    --------
    >>> state = push(empty_window(2), 60_000_000, np.array([1.0, np.nan]))
    >>> mean(push(state, 120_000_000, np.array([3.0, 5.0])), window_s=900.0, min_rows=1)
    array([2., 5.])
    """
    return _frozen(np.empty(0, dtype=np.int64), np.empty((0, carriers)), round(horizon_s * 1e6))


def push(window_state: TrailingMean, epoch_us: int, row: FloatArray) -> TrailingMean:
    """Return the window with one row more.

    Parameters
    ----------
    window_state : TrailingMean
        Window before the row; it is not changed.
    epoch_us : int, microseconds UTC
        Epoch of the row. A row that is not newer than the newest (late, or a duplicate) leaves the window as it is.
    row : ndarray, shape (N,)
        Values, NaN = absent.

    Returns
    -------
    TrailingMean
        Window after the row, without rows older than the horizon.
    """
    if window_state.epoch_us.size and epoch_us <= window_state.epoch_us[-1]:
        return window_state
    first = rows_until(window_state.epoch_us, epoch_us - window_state.horizon_us)
    return _frozen(
        np.concatenate([window_state.epoch_us[first:], [epoch_us]]),
        np.concatenate([window_state.rows[first:], row[np.newaxis]]),
        window_state.horizon_us,
    )


def mean(state: TrailingMean, window_s: float = 900.0, min_rows: int = 8) -> FloatArray:
    """Return the mean of each carrier over the window that ends with the newest row.

    Parameters
    ----------
    state : TrailingMean
        Rows.
    window_s : float, s
        Length of the window, open at its old end: 15 rows at 60 s in 900 s. Not above the horizon.
    min_rows : int
        Carriers with fewer present values give NaN, at least 1.

    Returns
    -------
    ndarray, shape (N,)
        Means, NaN = absent.
    """
    newest_us = state.epoch_us[-1] if state.epoch_us.size else 0
    rows = state.rows[rows_until(state.epoch_us, newest_us - round(window_s * 1e6)) :]
    is_present = np.isfinite(rows)
    if len(rows) >= max(min_rows, 1) and is_present.all():
        return np.asarray(rows.sum(axis=0) / len(rows))
    count = is_present.sum(axis=0)
    total = np.where(is_present, rows, 0.0).sum(axis=0)
    return np.where(count >= max(min_rows, 1), total / np.maximum(count, 1), np.nan)


def rows_until(epochs_us: IntArray, instant_us: int) -> int:
    """Return how many of the epochs, which increase, are not after an instant."""
    return int(epochs_us.searchsorted(instant_us, side="right"))


def _frozen(epoch_us: IntArray, rows: FloatArray, horizon_us: int) -> TrailingMean:
    """Return a window of arrays that nobody can write."""
    epoch_us.setflags(write=False)
    rows.setflags(write=False)
    return TrailingMean(epoch_us, rows, horizon_us)
