"""Episodes of the truth, rain, faults of carriers, silence and alarms, and whether an answer noticed them.

Rows are those that were measured; what falls into a gap is judged from the first row after it. Delays are in minutes
and may be negative: a rain can be found before it passes the depth from which it counts. What is never found within its
time has the delay infinity.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.estimation.flight.world import Truth

#: dB, from which a rain over the receiving site counts as wet, and a change of a carrier as a fault
WET_DB = 0.3
FAULT_DB = 0.8
#: a fault must be found within this time, min
FOUND_WITHIN_MIN = 30.0
#: a carrier is clean this long after its last fault, min: release takes 30 min and 20 quiet rows
RECOVERY_MIN = 120.0
#: an alarm after this time belongs to something else, min
ALARM_WITHIN_MIN = 1440.0
#: after carriers have come back, an error is looked at from this time on and for so long, min
_BACK_MIN, _BACK_SPAN_MIN = 60.0, 10.0
_MINUTE_US = 6e7
#: what can be wrong with a carrier on the air; a wet antenna is the end of its rain
_PASSING_FAULTS = (("uplink_rain", "wet_antenna"), ("interference",))
#: what stays: one of them may follow another without a row between them
_LASTING_FAULTS = (("step",),)
#: an answer's error before a transponder's step is that of this time, and after it that of the last so many minutes of
#: the time within which faults are found, min
_SHIFT_MEAN_MIN = 10.0


class RainStatistics(NamedTuple):
    """Rains over the receiving site; arrays (E,), one element a rain."""

    #: minutes from the row that passed ``WET_DB`` to the first row flagged
    delay_min: FloatArray
    #: share of the wet rows flagged
    coverage: FloatArray
    #: minutes of wrong torque while it rained
    wrong_min: FloatArray
    #: dry rows, and those of them that were flagged
    dry_rows: int
    false_rows: int


class FaultStatistics(NamedTuple):
    """Faults of single carriers."""

    #: (E,) minutes from the row that passed ``FAULT_DB`` to the carrier's exclusion
    delay_min: FloatArray
    #: pairs of row and carrier without any fault, and those of them that were excluded
    clean_pairs: int
    false_pairs: int


class DarkStatistics(NamedTuple):
    """Times in which no carrier was on the air; deg, yaw, roll, pitch."""

    #: rows, and the sums (3,) of their squared errors
    rows: int
    square_sum: FloatArray
    #: (E, 3) largest error from one hour after the end on, for ten minutes
    after: FloatArray


def stretches(is_so: BoolArray) -> list[tuple[int, int]]:
    """Return first and last row, the last one exclusive, of every run of true rows.

    Examples
    --------
    >>> stretches(np.array([False, True, True, False, True]))
    [(1, 3), (4, 5)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_so.astype(np.int64), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def measure_rain(
    epochs_us: IntArray, fade_db: FloatArray, is_flagged: BoolArray, is_wrong: BoolArray, row_min: float
) -> RainStatistics:
    """Return how the rains (T,) over the receiving site were noticed.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    fade_db : ndarray, shape (T,), dB
        Truth.
    is_flagged, is_wrong : ndarray, shape (T,)
        Whether the answer speaks of rain, and whether its torque would be wrong.
    row_min : float
        Minutes that a row stands for.
    """
    delays, coverage, wrong = [], [], []
    for first, last in stretches(fade_db > 0.0):
        wet = first + np.flatnonzero(fade_db[first:last] > WET_DB)
        if len(wet) == 0:
            continue
        found = first + np.flatnonzero(is_flagged[first:last])
        delays.append((epochs_us[found[0]] - epochs_us[wet[0]]) / _MINUTE_US if len(found) else np.inf)
        coverage.append(float(is_flagged[wet].mean()))
        wrong.append(row_min * np.count_nonzero(is_wrong[first:last]))
    is_dry = fade_db == 0.0
    return RainStatistics(
        np.array(delays), np.array(coverage), np.array(wrong), int(is_dry.sum()), int((is_dry & is_flagged).sum())
    )


def measure_faults(
    epochs_us: IntArray, truth: Truth, rows: IntArray, is_excluded: BoolArray, is_judged: BoolArray
) -> FaultStatistics:
    """Return how the faults of the carriers were noticed.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Epochs of the rows that were measured.
    truth : Truth
        Of the whole world.
    rows : ndarray of int, shape (T,)
        Rows of the world that were measured.
    is_excluded : ndarray, shape (T, N)
        Carriers present and left out by the answer.
    is_judged : ndarray, shape (N,)
        Carriers that the answer uses at all.
    """
    delays: list[float] = []
    for k in np.flatnonzero(is_judged).tolist():
        for onset in _onsets(truth, rows, k):
            within_us = epochs_us[onset.large] + FOUND_WITHIN_MIN * _MINUTE_US
            found = np.flatnonzero(is_excluded[:, k] & (epochs_us <= within_us))
            found = found[found >= onset.first]
            delays.append((epochs_us[found[0]] - epochs_us[onset.large]) / _MINUTE_US if len(found) else np.inf)
    is_clean = _is_clean(epochs_us, truth.flags[rows]) & is_judged
    return FaultStatistics(np.array(delays), int(is_clean.sum()), int((is_clean & is_excluded).sum()))


class _Onset(NamedTuple):
    """First row of a fault, and the first in which it is large."""

    first: int
    large: int


def _onsets(truth: Truth, rows: IntArray, column: int) -> list[_Onset]:
    """Return the faults of one carrier that begin after the first row."""
    level_db = truth.level_db[rows, column]
    is_on = ~truth.has_flag("off")[rows, column]
    found = []
    for kinds in (*_PASSING_FAULTS, *_LASTING_FAULTS):
        for begin, end in stretches(truth.has_flag(*kinds)[rows, column] & is_on):
            starts = [begin]
            if kinds in _LASTING_FAULTS:
                steps = begin + 1 + np.flatnonzero(np.abs(np.diff(level_db[begin:end])) >= FAULT_DB)
                starts += steps.tolist()
            for first, last in zip(starts, [*starts[1:], end], strict=True):
                # what stood at the first row belongs to the references
                if first == 0:
                    continue
                # no column of the truth holds the power of an interfering signal; all that are made exceed the limit
                change_db = np.abs(level_db[first:last] - level_db[first - 1])
                large = np.flatnonzero(change_db >= FAULT_DB) if kinds != ("interference",) else np.array([0])
                found += [_Onset(first, first + int(large[0]))] if len(large) else []
    return found


def _is_clean(epochs_us: IntArray, flags: IntArray) -> BoolArray:
    """Return where (T, N) nothing was wrong with a carrier for ``RECOVERY_MIN``."""
    newest_us = np.where(flags != 0, epochs_us[:, np.newaxis].astype(np.float64), -np.inf)
    since_us = epochs_us[:, np.newaxis] - np.maximum.accumulate(newest_us, axis=0)
    return np.asarray(since_us > RECOVERY_MIN * _MINUTE_US)


def measure_group_steps(epochs_us: IntArray, is_moved: BoolArray, error_deg: FloatArray) -> FloatArray:
    """Return by how much (E, 3) in deg the error changed over each step of a transponder.

    A step that is known as one leaves its carriers in the fix, so that no exclusion tells of it; what it must not do is
    move the answer.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    is_moved : ndarray, shape (T, N)
        Carriers whose transponder's gain stands beside its first value.
    error_deg : ndarray, shape (T, 3)
        Answer minus truth.
    """
    steps = np.flatnonzero((is_moved[1:] != is_moved[:-1]).any(axis=1)) + 1
    shifts = []
    for step in steps.tolist():
        since_min = (epochs_us - epochs_us[step]) / _MINUTE_US
        before = error_deg[(since_min >= -_SHIFT_MEAN_MIN) & (since_min < 0.0)]
        after = error_deg[(since_min >= FOUND_WITHIN_MIN - _SHIFT_MEAN_MIN) & (since_min < FOUND_WITHIN_MIN)]
        if len(before) and len(after):
            shifts.append(np.abs(after.mean(axis=0) - before.mean(axis=0)))
    return np.array(shifts).reshape(-1, 3)


def measure_dark(epochs_us: IntArray, is_dark: BoolArray, error_deg: FloatArray) -> DarkStatistics:
    """Return the errors (T, 3) while there was nothing to measure and when it had come back for an hour."""
    inside = is_dark & np.isfinite(error_deg).all(axis=1)
    after = []
    for _first, last in stretches(is_dark):
        since_min = (epochs_us - epochs_us[last - 1]) / _MINUTE_US
        rows = (since_min >= _BACK_MIN) & (since_min < _BACK_MIN + _BACK_SPAN_MIN)
        if rows.any():
            after.append(np.max(error_deg[rows], axis=0))
    return DarkStatistics(int(inside.sum()), np.sum(error_deg[inside] ** 2, axis=0), np.array(after).reshape(-1, 3))


def measure_alarms(
    epochs_us: IntArray, is_alarm: BoolArray, start_us: int, wrong_from_h: tuple[float, ...]
) -> tuple[FloatArray, float]:
    """Return the delays (E,) in minutes of the alarms that were due, and how many alarms began a day.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    is_alarm : ndarray, shape (T,)
        Whether the answer alarms.
    start_us : int
        Start of operation.
    wrong_from_h : tuple of float
        Hours of operation from which the spacecraft does other than it was told, ascending; an alarm belongs to the
        last.
    """
    delays = []
    starts_us = [start_us + 60.0 * hours * _MINUTE_US for hours in wrong_from_h]
    for due_us, next_us in pairwise([*starts_us, math.inf]):
        if due_us >= epochs_us[-1]:
            continue
        inside = (epochs_us >= due_us) & (epochs_us <= min(next_us, due_us + ALARM_WITHIN_MIN * _MINUTE_US))
        raised_us = epochs_us[is_alarm & inside]
        delays.append(float((raised_us[0] - due_us) / _MINUTE_US) if len(raised_us) else np.inf)
    days = float(epochs_us[-1] - epochs_us[0]) / (1440.0 * _MINUTE_US)
    return np.array(delays), len(stretches(is_alarm)) / days if days > 0.0 else 0.0
