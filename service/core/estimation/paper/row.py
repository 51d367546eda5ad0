"""Rows of the published method, compiled: from powers to a fix, the fade rule and the angles of the loop.

    deviation -> means of the last minutes -> fade rule -> fix over the eight octants -> observer of the loop

A fix belongs to the middle of its mean. It counts when the
fade rule has had time to object to the rows in it, and none counts while its mean reaches back into a fade: until then
dynamics carry the estimate. A late row gets a fix of its own and leaves the state alone.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import rates_deg_h
from service.core.estimation.filtering.motion import write_wave
from service.core.estimation.filtering.plant import FilterModel
from service.core.estimation.paper.downlink_fade import (
    FADE,
    is_turn_asked,
    left_by_angles,
    median_of,
    trailing_mean,
    watch_fades,
)
from service.core.estimation.paper.loop_observer import (
    TORQUE,
    Commanded,
    LinearFix,
    linear_fix,
    predict_estimate,
    update_estimate,
)
from service.core.estimation.paper.snapshot import USED, RejectedFix, reject_faded_carriers

#: noise of a mean of levels where they agree better, dB, and for how long it stays, s
_NOISE_DB, _MEMORY_S = 0.1, 3600.0
#: shares of a correlation time below which a mean keeps all of a coloured noise
_SHORT = 1e-3
_US_PER_S = 1e6

#: a carrier
CARRIER = np.dtype(
    [
        # expected level without its harmonic, NaN = no reference, and the harmonic
        ("reference_dbm", "f8"),
        ("amplitude_db", "f8"),
        ("phase_rad", "f8"),
        ("is_selected", "?"),
        ("white_sigma_db", "f8"),
    ],
    align=True,
)
#: a fix that does not count yet, when it will, and the middle of its mean
PENDING = np.dtype(
    [
        ("due_us", "i8"),
        ("epoch_us", "i8"),
        ("angles_deg", "f8", (3,)),
        ("noise_deg2", "f8", (3, 3)),
    ],
    align=True,
)
#: what is one of a kind in a state
COUNTERS = np.dtype(
    [
        # rows of the window and fixes that wait
        ("rows", "i8"),
        ("pending", "i8"),
        # epoch of the newest row, if there was one
        ("has_row", "?"),
        ("newest_us", "i8"),
        # epoch of the estimate of the loop
        ("estimate_us", "i8"),
        # until when a mean reaches back into a fade
        ("wet_until_us", "i8"),
    ],
    align=True,
)
#: what a row leaves of each carrier
LEVEL = np.dtype(
    [
        ("expected_dbm", "f8"),
        ("deviation_db", "f8"),
        ("residual_db", "f8"),
        # assumed standard deviation of the averaged deviation
        ("sigma_db", "f8"),
        # as in `RejectionReason`
        ("reason", "i8"),
    ],
    align=True,
)
#: what a row leaves of the spacecraft; (3,) in the order yaw, roll, pitch
RESULT = np.dtype(
    [
        ("attitude_deg", "f8", (3,)),
        ("sigma_deg", "f8", (3,)),
        ("steering_deg", "f8", (3,)),
        ("steering_sigma_deg", "f8", (3,)),
        ("rates_deg_s", "f8", (3,)),
        # carriers that entered the fix, and selected ones that did not
        ("carriers_used", "i8"),
        ("carriers_out", "i8"),
        ("residual_rms_db", "f8"),
        # rows that the mean rests on
        ("rows", "i8"),
        ("is_fading", "?"),
        ("is_risen", "?"),
        # size of a standing fade, 0 while none stands
        ("fade_db", "f8"),
        # epoch of the estimate of the loop, and its torque as `write_wave` has it
        ("estimate_us", "i8"),
        ("torque_deg_h2", "f8", (4, 3)),
    ],
    align=True,
)


class PaperArrays(NamedTuple):
    """Model of N carriers with C coloured parts each."""

    limits: NDArray[np.void]
    carriers: NDArray[np.void]
    #: (N, 3) dB/deg, of positive and negative angles, and of the loop
    plus: FloatArray
    minus: FloatArray
    slope: FloatArray
    #: (N, C) dB and s, zeros where a carrier has fewer parts
    coloured_sigma_db: FloatArray
    correlation_time_s: FloatArray
    #: (3, 3) deg^2, what fixes have wrong for long
    lasting_deg2: FloatArray
    #: motion of the spacecraft, without carriers
    motion: FilterModel


class PaperState(NamedTuple):
    """State between two rows: a window of R rows, F fixes that wait, the estimate of the loop."""

    counters: NDArray[np.void]
    #: (2,) of `FADE`: levels that have fallen, and levels that have risen
    watches: NDArray[np.void]
    #: (R,), microseconds UTC, increasing, and (R, N) dB, NaN = absent
    window_us: IntArray
    window_db: FloatArray
    pending: NDArray[np.void]
    #: (21,) and (21, 21)
    mean: FloatArray
    covariance: FloatArray


class PaperBlock(NamedTuple):
    """Powers (T, N) in dBm at epochs (T,) with their phases since the ascending node, rad."""

    epochs_us: IntArray
    phases_rad: FloatArray
    power_dbm: FloatArray
    is_late: bool


def initial_arrays(carriers: int, estimate_us: int, mean: FloatArray, covariance: FloatArray) -> PaperState:
    """Return the state before the first row, by an estimate of the loop."""
    window = np.zeros(0, dtype=np.int64), np.zeros((0, carriers))
    counters, pending = np.zeros(1, COUNTERS), np.zeros(0, PENDING)
    counters["estimate_us"] = estimate_us
    return PaperState(counters, np.zeros(2, FADE), *window, pending, mean, covariance)


def empty_means(state: PaperState, carriers: int) -> PaperState:
    """Return the state before the first row of other carriers, which keeps the loop."""
    counters = state.counters.copy()
    counters["rows"], counters["has_row"] = 0, False
    window = np.zeros(0, dtype=np.int64), np.zeros((0, carriers))
    return PaperState(counters, np.zeros(2, FADE), *window, state.pending, state.mean, state.covariance)


def room(state: PaperState, rows: int) -> PaperState:
    """Return arrays into which a state fits after some rows more, and as many fixes; their numbers are undefined."""
    rows_more, fixes_more = len(state.window_us) + rows, len(state.pending) + rows
    return PaperState(
        np.empty(1, COUNTERS),
        np.empty(2, FADE),
        np.empty(rows_more, dtype=np.int64),
        np.empty((rows_more, state.window_db.shape[1])),
        np.empty(fixes_more, PENDING),
        np.empty_like(state.mean),
        np.empty_like(state.covariance),
    )


def without_room(state: PaperState) -> PaperState:
    """Return a state whose arrays end with its newest row and the last fix that waits."""
    rows, pending = int(state.counters["rows"][0]), int(state.counters["pending"][0])
    window = state.window_us[:rows], state.window_db[:rows]
    return PaperState(state.counters, state.watches, *window, state.pending[:pending], state.mean, state.covariance)


def take_rows(
    model: PaperArrays,
    state: PaperState,
    after: PaperState,
    commanded: Commanded,
    block: PaperBlock,
    levels: NDArray[np.void],
    results: NDArray[np.void],
) -> None:
    """Take rows in order.

    Parameters
    ----------
    state : PaperState
        Before the rows; it is not changed.
    after : PaperState
        Written unless the rows are late, with room for them.
    levels, results : ndarray
        (T, N) of `LEVEL` and (T,) of `RESULT`, written.
    """
    estimate_us, moving = state.counters["estimate_us"][0], state
    if not block.is_late:
        moving = after
        _copy_state(state, after)
    for number in range(len(block.epochs_us)):
        _take_row(model, moving, commanded, block, number, levels[number], results[number : number + 1])
        if moving.counters["estimate_us"][0] > estimate_us:
            # late changes count once
            commanded = Commanded(commanded.motions, np.zeros((2, 3)), commanded.since_us)


def _copy_state(state: PaperState, into: PaperState) -> None:
    """Write a state into arrays that have room for it."""
    into.counters[0], into.mean[:], into.covariance[:, :] = state.counters[0], state.mean, state.covariance
    for place in range(2):
        into.watches[place] = state.watches[place]
    for place in range(state.counters["pending"][0]):
        into.pending[place] = state.pending[place]
    rows = state.counters["rows"][0]
    into.window_us[:rows], into.window_db[:rows] = state.window_us[:rows], state.window_db[:rows]


def _take_row(
    model: PaperArrays,
    after: PaperState,
    commanded: Commanded,
    block: PaperBlock,
    number: int,
    levels: NDArray[np.void],
    result: NDArray[np.void],
) -> None:
    """Take one row of a block, whose carriers and itself leave records (N,) and (1,)."""
    limits, plus, minus, epoch_us = model.limits[0], model.plus, model.minus, block.epochs_us[number]
    gates = limits["gate_db"], limits["gate_sigma"], limits["min_carriers"]
    mean_db, rows, span_s, dt_s = _left_by_harmonic_db(model, block, number, levels), 1, 0.0, 0.0
    if not block.is_late:
        dt_s = _push(limits, after, epoch_us, mean_db)
    counters, watches, times_us, window_db = after[:4]
    change_db, _ = trailing_mean(times_us, window_db, counters["rows"][0], limits["fade_averaging_us"], 1)
    _leave_selected(model, change_db)
    if not block.is_late:
        left_by_turn, left_db = math.inf, change_db
        if is_turn_asked(watches, limits, change_db):
            turn = reject_faded_carriers(plus, minus, change_db, gates[0], gates[1], gates[2])
            left_by_turn = left_by_angles(turn.residual_db, turn.reason)
        if watches["is_stopped"][0] or watches["is_stopped"][1]:
            mean, covariance = after.mean.copy(), after.covariance.copy()
            from_us = counters["estimate_us"][0]
            predict_estimate(model.motion, model.lasting_deg2, mean, covariance, commanded, from_us, epoch_us)
            left_db = _left_db(plus, minus, change_db, mean)
        watch_fades(watches, limits, dt_s, change_db, left_db, left_by_turn)
        count, span_us, last = counters["rows"][0], limits["averaging_us"], counters["rows"][0] - 1
        mean_db, rows = trailing_mean(times_us, window_db, count, span_us, limits["min_rows"])
        span_s = (times_us[last] - times_us[last + 1 - rows]) / _US_PER_S
    considered_db = mean_db.copy()
    _leave_selected(model, considered_db)
    outcome = reject_faded_carriers(plus, minus, considered_db, gates[0], gates[1], gates[2])
    write_fix(model, outcome, considered_db, rows, span_s, levels, result)
    _write_fade(watches, change_db, result)
    if block.is_late:
        return
    result["rows"][0] = rows
    if result["is_fading"][0] or result["is_risen"][0]:
        counters["pending"][0], counters["wet_until_us"][0] = 0, epoch_us + limits["averaging_us"]
    elif rows >= limits["min_rows"] and epoch_us >= counters["wet_until_us"][0]:
        fix = linear_fix(mean_db, model.slope, outcome.reason)
        _add_fix(after, fix, epoch_us, limits["objection_us"], span_s, rows)
    due, mean, covariance = 0, after.mean, after.covariance
    for due in range(counters["pending"][0] + 1):
        is_fix = due < counters["pending"][0] and after.pending["due_us"][due] <= epoch_us
        if not is_fix:
            mean, covariance = mean.copy(), covariance.copy()
        from_us, to_us = counters["estimate_us"][0], after.pending["epoch_us"][due] if is_fix else epoch_us
        predict_estimate(model.motion, model.lasting_deg2, mean, covariance, commanded, from_us, to_us)
        if not is_fix:
            break
        if to_us > from_us:
            counters["estimate_us"][0] = to_us
            # late changes count once
            commanded = Commanded(commanded.motions, np.zeros((2, 3)), commanded.since_us)
        update_estimate(mean, covariance, after.pending["angles_deg"][due], after.pending["noise_deg2"][due])
    _forget_fixes(after, due)
    _write_angles(model, after, mean, covariance, result)


def _left_by_harmonic_db(model: PaperArrays, block: PaperBlock, number: int, levels: NDArray[np.void]) -> FloatArray:
    """Return the deviation (N,) of the powers, and write it with the expected powers."""
    carriers = model.carriers
    deviation_db = np.empty(len(carriers))
    for k in range(len(carriers)):
        turned = carriers["amplitude_db"][k] * math.cos(block.phases_rad[number] + carriers["phase_rad"][k])
        levels["expected_dbm"][k] = carriers["reference_dbm"][k] + turned
        levels["deviation_db"][k] = deviation_db[k] = block.power_dbm[number, k] - levels["expected_dbm"][k]
    return deviation_db


def _push(limits: np.void, state: PaperState, epoch_us: int, deviation_db: FloatArray) -> float:
    """Write a row more into the window of a state, in place, and return the time since the row before, s.

    A long gap empties the window; a row that is not newer leaves it as it is.
    """
    counters, first = state.counters, 0
    gap_us = epoch_us - counters["newest_us"][0] if counters["has_row"][0] else 0
    counters["has_row"][0], counters["newest_us"][0] = True, epoch_us
    rows = counters["rows"][0]
    if gap_us > limits["max_gap_us"]:
        first = rows
    is_newer = first == rows or epoch_us > state.window_us[rows - 1]
    longest_us = max(limits["averaging_us"], limits["fade_averaging_us"])
    while is_newer and first < rows and state.window_us[first] <= epoch_us - longest_us:
        first += 1
    for row in range(first, rows if first else 0):
        state.window_us[row - first] = state.window_us[row]
        for k in range(len(deviation_db)):
            state.window_db[row - first, k] = state.window_db[row, k]
    rows -= first
    if is_newer:
        state.window_us[rows] = epoch_us
        for k in range(len(deviation_db)):
            state.window_db[rows, k] = deviation_db[k]
        rows += 1
    counters["rows"][0] = rows
    return float(gap_us / _US_PER_S)


def _leave_selected(model: PaperArrays, values_db: FloatArray) -> None:
    """Make the carriers (N,) that do not enter the fix absent."""
    for k in range(len(values_db)):
        if not model.carriers["is_selected"][k]:
            values_db[k] = math.nan


def _left_db(plus: FloatArray, minus: FloatArray, change_db: FloatArray, angles_deg: FloatArray) -> FloatArray:
    """Return what angles leave of a change of levels (N,); an axis without coefficients changes nothing."""
    left_db = change_db.copy()
    for k in range(len(left_db)):
        for axis in range(3):
            slope = minus[k, axis] if angles_deg[axis] < 0.0 else plus[k, axis]
            left_db[k] -= 0.0 if math.isnan(slope) else slope * angles_deg[axis]
    return left_db


def write_fix(
    model: PaperArrays,
    outcome: RejectedFix,
    deviation_db: FloatArray,
    rows: int,
    span_s: float,
    levels: NDArray[np.void],
    result: NDArray[np.void],
) -> None:
    """Write the fix of deviations (N,) that are the mean of some rows over a span."""
    fix, carriers = outcome.fix, len(deviation_db)
    known_db2, known, total, count, used, out = 0.0, 0, 0.0, 0, 0, 0
    used_db, moment = np.empty(carriers), np.zeros(3)
    for k in range(carriers):
        # as `averaged_sigma_db`
        variance = model.carriers["white_sigma_db"][k] ** 2 / max(rows, 1)
        for part in range(model.coloured_sigma_db.shape[1]):
            ratio, kept = span_s / max(model.correlation_time_s[k, part], 1e-9), 1.0
            if ratio >= _SHORT:
                kept = 2.0 * (ratio - 1.0 + math.exp(-ratio)) / ratio**2
            variance += model.coloured_sigma_db[k, part] ** 2 * kept
        levels["sigma_db"][k], levels["reason"][k] = math.sqrt(variance), outcome.reason[k]
        levels["residual_db"][k] = outcome.residual_db[k]
        if math.isfinite(outcome.residual_db[k]):
            total += outcome.residual_db[k] ** 2
            count += 1
        if outcome.reason[k] != USED:
            out += 1 if model.carriers["is_selected"][k] else 0
        else:
            used_db[used] = deviation_db[k]
            used += 1
            for axis in range(3):
                moment[axis] += model.minus[k, axis] if fix.attitude_deg[axis] < 0.0 else model.plus[k, axis]
            if math.isfinite(variance):
                known_db2 += variance
                known += 1
    # residuals that happen to agree better than the learned noise of the carriers allows do not shrink the covariance
    variance = fix.cost / max(fix.carriers_used - 3, 1)
    if variance > 0.0 and known > 0:
        variance = max(variance, known_db2 / known)
    # a fade too shallow for the rule of one sign turns the angles by as much as the median of the levels does
    common_db = median_of(used_db, used) if used > 0 else 0.0
    for i in range(3):
        turned = 0.0
        for j in range(3):
            turned += fix.unit_covariance[i, j] * moment[j] * common_db
        result["attitude_deg"][0, i] = fix.attitude_deg[i]
        result["sigma_deg"][0, i] = math.sqrt(variance * fix.unit_covariance[i, i] + turned**2)
    result["carriers_used"][0], result["carriers_out"][0] = fix.carriers_used, out
    result["residual_rms_db"][0] = math.sqrt(total / count) if count > 0 else math.nan


def _write_fade(watches: NDArray[np.void], change_db: FloatArray, result: NDArray[np.void]) -> None:
    """Write whether a fade or a rise stands, and the size of the fade."""
    present_db, count = np.empty(len(change_db)), 0
    for value in change_db:
        if math.isfinite(value):
            present_db[count] = value
            count += 1
    result["is_fading"][0], result["is_risen"][0] = watches["is_stopped"][0], watches["is_stopped"][1]
    is_deep = watches["is_stopped"][0] and count > 0
    result["fade_db"][0] = max(0.0, -median_of(present_db, count)) if is_deep else 0.0


def _add_fix(after: PaperState, fix: LinearFix, epoch_us: int, objection_us: int, span_s: float, rows: int) -> None:
    """Add the linear fix of a mean of some rows to those that wait; too few carriers make none."""
    if math.isnan(fix.scatter_db):
        return
    # fixes that repeat an error share what one of them would weigh
    repeated = max(1.0, _MEMORY_S / max(1.0, span_s / max(1, rows - 1)))
    place, noise_db2 = after.counters["pending"][0], max(_NOISE_DB, fix.scatter_db) ** 2 * repeated
    after.counters["pending"][0] = place + 1
    after.pending["due_us"][place] = epoch_us + objection_us
    after.pending["epoch_us"][place] = epoch_us - int(0.5 * span_s * _US_PER_S)
    for i in range(3):
        after.pending["angles_deg"][place, i] = fix.angles_deg[i]
        for j in range(3):
            after.pending["noise_deg2"][place, i, j] = noise_db2 * fix.unit_covariance[i, j]


def _forget_fixes(after: PaperState, count: int) -> None:
    """Forget the first fixes that wait."""
    for place in range(count, after.counters["pending"][0]):
        after.pending[place - count] = after.pending[place]
    after.counters["pending"][0] -= count


def _write_angles(
    model: PaperArrays, after: PaperState, mean: FloatArray, covariance: FloatArray, result: NDArray[np.void]
) -> None:
    """Write the angles with sigma, and the rates, that a torque follows from, and the torque at the estimate."""
    plant, estimate_us = model.motion.plant[0], after.counters["estimate_us"][0]
    rates = rates_deg_h(mean, plant["coupling_per_h"])
    for axis in range(3):
        result["rates_deg_s"][0, axis], result["steering_deg"][0, axis] = rates[axis] / 3600.0, mean[axis]
        result["steering_sigma_deg"][0, axis] = math.sqrt(covariance[axis, axis])
    result["estimate_us"][0], period_us = estimate_us, plant["wave_period_us"]
    write_wave(result["torque_deg_h2"][0], after.mean, after.covariance, TORQUE.start, estimate_us, period_us)
