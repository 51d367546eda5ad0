"""The paper's rule for rain on the downlink: all carriers change with one sign and by nearly the same amount.

A row of power deviations dP_i (dB) is a fade when ``share`` of the carriers lie below ``-depth`` and the spread
``1.48 median |dP_i - median dP|`` is below ``spread_ratio |median|``. The watch stops control when the condition has
stood for five minutes and lets it return when the median has been above ``-depth`` for ten.

The law of this file: the paper's rule looks at raw deviations and is blind to attitude; a roll to which all carriers
answer alike looks to it like rain. Where the stations stand on all sides of the beams it never mistakes turns of
0.3 deg for rain, but where an attitude can imitate more than about half of a common change
(``observability.common_share``) it does. Given the residuals of the attitude fix, the rule therefore asks one question
more: a row that an attitude explains better than a common change is no fade. A fall of the receiving chain that stays
is a fade to this rule in any case and keeps control stopped until a new alignment.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Fewer carriers than this cannot show a common change.
MIN_CARRIERS = 4
#: Angles that the fix took from the row.
FITTED_ANGLES = 3
#: Standard deviation of a normal distribution over its median absolute deviation.
SIGMA_OF_MAD = 1.4826


class FadeTest(NamedTuple):
    """Verdict on one row; figures are NaN with fewer than four carriers.

    Parameters
    ----------
    is_fade : bool
        The condition holds on this row.
    median_db : float, dB
        Median deviation.
    spread_db : float, dB
        1.48 times the median absolute deviation from the median.
    share_below : float
        Share of the present carriers below minus the depth.
    """

    is_fade: bool
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
        How long the condition has stood without a break.
    dry_s : float, s
        How long the median has been above minus the depth without a break.
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
        leaves more than the common change does. None, or fewer than four residuals: the paper's rule alone.

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
        return FadeTest(is_fade=False, median_db=math.nan, spread_db=math.nan, share_below=math.nan)
    median_db = _median(present)
    spread_db = SIGMA_OF_MAD * _median(np.abs(present - median_db))
    share_below = float(np.count_nonzero(present < -depth_db)) / present.size
    is_fade = share_below >= share and spread_db < spread_ratio * abs(median_db)
    if is_fade and fix_residual_db is not None:
        is_fade = not _explains_better(fix_residual_db, spread_db)
    return FadeTest(is_fade, median_db, spread_db, share_below)


def _explains_better(fix_residual_db: FloatArray, spread_db: float) -> bool:
    """Return whether the residuals of a fix, freed from its three unknowns, are smaller than the spread."""
    present = fix_residual_db[np.isfinite(fix_residual_db)]
    if present.size < MIN_CARRIERS:
        return False
    freedom = math.sqrt(present.size / (present.size - FITTED_ANGLES))
    return SIGMA_OF_MAD * _median(np.abs(present)) * freedom < spread_db


def _median(values: FloatArray) -> float:
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
        How long the condition must stand, and how long it must be dry.
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
    wet_s = wet_before_s + elapsed_s if test.is_fade else 0.0
    dry_s = dry_before_s + elapsed_s if test.median_db > -depth_db else 0.0
    is_stopped = dry_s < return_after_s if state.is_stopped else wet_s >= stop_after_s
    return FadeWatch(is_stopped, wet_s, dry_s)
