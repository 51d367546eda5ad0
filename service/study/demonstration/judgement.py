"""Judgement of the demonstration: estimates beside the truth, the archive, replays, and the control of a closed loop.

Every rms stands beside the rms of the truth itself; skill = 1 - mean(error^2) / mean(truth^2), so that the answer
0/0/0 has skill 0 and cannot pass for an estimate.
"""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from service.client.documents import Attitude, Json
from service.client.service_client import ServiceClient
from service.records.epoch import US_PER_S, format_epoch, parse_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.closed_loop.plant_process import PlantProcess
from service.study.demonstration.control_centre import AXES, ControlLog
from service.study.demonstration.demonstration import Story

#: bounds of a demonstration by method: rms of each axis in deg, slope of estimate on truth
RMS_BOUNDS_DEG = {
    "robust": {"yaw": 0.18, "roll": 0.03, "pitch": 0.04},
    "paper": {"roll": 0.08, "pitch": 0.10},
}
SLOPE_BOUNDS = {"robust": {"yaw": 0.30, "roll": 0.05, "pitch": 0.05}, "paper": {"roll": 0.15, "pitch": 0.15}}
#: least rms of the truth: a spacecraft that hardly moves proves nothing
TRUTH_RMS_DEG = 0.12


class AxisMerit(NamedTuple):
    """Figures of one axis, deg."""

    rms_deg: float
    #: 95 % of the errors are smaller
    error_95_deg: float
    truth_rms_deg: float
    skill: float
    #: least-squares slope of the estimate on the truth
    slope: float


def judge_axis(estimate_deg: FloatArray, truth_deg: FloatArray) -> AxisMerit:
    """Return the figures of some estimates; rows without an estimate (NaN) do not count."""
    present = np.isfinite(estimate_deg) & np.isfinite(truth_deg)
    estimate, truth = estimate_deg[present], truth_deg[present]
    if len(truth) < 2:
        nan = float("nan")
        return AxisMerit(nan, nan, nan, nan, nan)
    error = estimate - truth
    mean_square_truth = float(np.mean(truth**2))
    centred = truth - truth.mean()
    return AxisMerit(
        float(np.sqrt(np.mean(error**2))),
        float(np.quantile(np.abs(error), 0.95)),
        float(np.sqrt(mean_square_truth)),
        1.0 - float(np.mean(error**2)) / mean_square_truth,
        float(centred @ (estimate - estimate.mean()) / (centred @ centred)),
    )


def missed_figures(merits: Mapping[str, AxisMerit], method: str, *, is_moved: bool = True) -> list[str]:
    """Return what misses the bounds of the demonstration, in words; NaN misses every bound.

    Of a spacecraft that is kept still (`is_moved` false) only errors are judged: slopes need motion.
    """
    missed = []
    for axis, bound_deg in RMS_BOUNDS_DEG[method].items():
        merit, reach = merits[axis], SLOPE_BOUNDS[method][axis]
        if not merit.rms_deg <= bound_deg:
            missed.append(f"{axis} rms {merit.rms_deg:.3f} deg above {bound_deg}")
        if is_moved and not abs(merit.slope - 1.0) <= reach:
            missed.append(f"{axis} slope {merit.slope:.3f} not within 1 +- {reach}")
    missed += [
        f"{axis} truth rms {merits[axis].truth_rms_deg:.3f} deg below {TRUTH_RMS_DEG}: too little moved"
        for axis in AXES
        if is_moved and not merits[axis].truth_rms_deg >= TRUTH_RMS_DEG
    ]
    return missed


#: the method that drives control by default, and the one beside it
METHODS = ("robust", "paper")


def compare_with_live(
    client: ServiceClient, spacecraft_id: str, start: str, stop: str, methods: Sequence[str], version: str
) -> dict[str, int]:
    """Count the rows of a replay that equal the live ones.

    A row that only one of the two has is different; rows before any alignment, of which live operation computed
    nothing, are no part of a replay. JSON carries floats so that they come back bit for bit, hence equal
    documents are equal rows.
    """
    found = {"rows": 0, "rows_equal": 0, "rows_different": 0}
    for method in methods:
        live = {_key(row): row for row in client.attitude_history(spacecraft_id, start, stop, method=method)}
        replayed = client.attitude_history(spacecraft_id, start, stop, method=method, version=version)
        rows = {_key(row): {**row, "version": "live"} for row in replayed}
        equal = sum(live.get(key) == row for key, row in rows.items())
        computed = {key for key, row in live.items() if row["alignment_id"] is not None}
        found["rows"] += len(rows)
        found["rows_equal"] += equal
        found["rows_different"] += len(rows.keys() | computed) - equal
    return found


def _key(row: Attitude) -> tuple[str | None, str | None]:
    return row["epoch"], row["received_at"]


def check_archive(client: ServiceClient, spacecraft_id: str, truth_deg: Mapping[int, object]) -> dict[str, int]:
    """Compare the epochs of the exported measurements with those that the simulator swept.

    Parameters
    ----------
    client : ServiceClient
        Of the service that was fed.
    spacecraft_id : str
        Spacecraft.
    truth_deg : mapping
        Keyed by the epoch, microseconds UTC, of every row swept.
    """
    measured = {format_epoch(epoch_us) for epoch_us in truth_deg}
    window = {"start": format_epoch(min(truth_deg)), "stop": format_epoch(max(truth_deg) + 1)}
    path = f"/spacecraft/{spacecraft_id}/archive/measurements:export"
    text = b"".join(client.download(path, {"format": "csv", **window})).decode()
    archived = [line.partition(",")[0] for line in text.splitlines()[1:]]
    return {
        "rows_measured": len(measured),
        "rows_archived": len(archived),
        "rows_lost": len(measured - set(archived)),
        "rows_not_measured": len(archived) - len(measured & set(archived)),
    }


def check_replay(
    client: ServiceClient, spacecraft_id: str, window: tuple[str, str], methods: Sequence[str]
) -> dict[str, Any]:
    """Replay a stretch of the archive in order of the journal and compare every method with live operation."""
    start, stop = window
    began = time.monotonic()
    started = client.request("POST", f"/spacecraft/{spacecraft_id}/replays", {"start": start, "stop": stop})
    client.wait_job(started["job"])
    elapsed_s = time.monotonic() - began
    found = compare_with_live(client, spacecraft_id, start, stop, methods, started["version"])
    return {
        "replay_rows": found["rows"],
        "replay_rows_different": found["rows_different"],
        "replay_rows_per_s": round(found["rows"] / elapsed_s),
    }


def missed_promises(statistics: Mapping[str, Any]) -> list[str]:
    """Return which promises of the archive the figures break, in words."""
    missed = [
        f"{name} is {statistics[name]}, not 0"
        for name in ("rows_lost", "rows_not_measured", "replay_rows_different")
        if statistics[name] != 0
    ]
    return missed if statistics["replay_rows"] else [*missed, "the replay has no rows"]


#: what the true angles must keep in every run, and what 95 of 100 runs are to keep, deg
TRUTH_BOUNDS_DEG = {"yaw": 0.5, "roll": 0.3, "pitch": 0.3}
USUAL_BOUNDS_DEG = {"yaw": 0.4, "roll": 0.2, "pitch": 0.2}
#: a spacecraft that is left alone has left its bounds long before
_ALONE_DAYS = 0.5


class FlightAlone(NamedTuple):
    """The spacecraft of a story without control; T rows."""

    #: (T,) since operation began
    hours: FloatArray
    #: (T, 3) deg, yaw, roll, pitch
    flown_deg: FloatArray

    def angles_deg(self, hours: float) -> tuple[float, ...] | None:
        """Return yaw, roll and pitch at a time since operation began, deg; None after the flight."""
        if hours > self.hours[-1]:
            return None
        return tuple(self.flown_deg[np.searchsorted(self.hours, hours)].tolist())

    def statistics(self) -> dict[str, Any]:
        """Return its figures, and how long it kept all bounds."""
        is_beyond = (np.abs(self.flown_deg) >= list(TRUTH_BOUNDS_DEG.values())).any(axis=1)
        return {
            **_sizes(self.flown_deg),
            "hours": round(float(self.hours[-1]), 2),
            "hours_within_bounds": round(float(self.hours[is_beyond][0]), 2) if is_beyond.any() else None,
            "missed": missed_bounds(self.flown_deg),
        }


def judge_control(story: Story, log: ControlLog, alone: FlightAlone) -> dict[str, Any]:
    """Return the figures of a closed loop.

    Parameters
    ----------
    story : Story
        What was told, the truth among it.
    log : ControlLog
        What the control centre has done.
    alone : FlightAlone
        The same spacecraft without control.
    """
    start_us = parse_epoch(story.phases["operation"][0])
    flown = np.array([angles for epoch_us, angles in sorted(story.truth_deg.items()) if epoch_us >= start_us])
    return {
        **_sizes(flown),
        "bounds_deg": TRUTH_BOUNDS_DEG,
        "usual_bounds_deg": USUAL_BOUNDS_DEG,
        "impulse_n_m_s": {axis: round(impulse, 5) for axis, impulse in log.impulse_n_m_s.items()},
        "commands": log.counts(),
        "inhibited_share": round(log.inhibited_rows / max(log.rows, 1), 4),
        "inhibited_rows": dict(log.inhibitions),
        "missed": missed_bounds(flown),
        "control_off": alone.statistics(),
    }


def within_bounds_since_us(story: Story) -> int | None:
    """Return since when the true angles have been within their bounds, microseconds UTC; None: they are not."""
    start_us = parse_epoch(story.phases["operation"][0])
    bounds_deg = [TRUTH_BOUNDS_DEG[axis] for axis in AXES]
    since_us = None
    for epoch_us in sorted(story.truth_deg, reverse=True):
        sizes_deg = map(abs, story.truth_deg[epoch_us])
        if epoch_us < start_us or any(size >= bound for size, bound in zip(sizes_deg, bounds_deg, strict=True)):
            break
        since_us = epoch_us
    return since_us


def fly_alone(scenario: str, seed: int, operation_days: float, quiet_days: float | None = None) -> FlightAlone:
    """Fly the spacecraft of a story without control.

    Raises
    ------
    PlantFailedError
        The plant failed.
    """
    options = () if quiet_days is None else ("--quiet-days", str(quiet_days))
    with PlantProcess(scenario, seed, "ideal", min(operation_days, _ALONE_DAYS), options) as plant:
        plant.opening()
        states = []
        for row in plant.rows():
            states.append(row.truth)
            if row.power_dbm is not None:
                plant.send((), None)
    epochs_us = np.array([state.epoch_us for state in states])
    hours = np.asarray((epochs_us - epochs_us[0]) / US_PER_S / 3600.0)
    return FlightAlone(hours, np.array([state.attitude_deg for state in states]))


def missed_control(loop: dict[str, Any] | None) -> list[str]:
    """Return what a closed loop misses, in words; a spacecraft that keeps its bounds without control proves nothing."""
    if loop is None:
        return []
    alone = [] if loop["control_off"]["missed"] else ["the spacecraft keeps its bounds without control"]
    return [*loop["missed"], *alone]


def missed_bounds(flown_deg: FloatArray) -> list[str]:
    """Return which true angles (T, 3) leave their bounds, in words."""
    largest = np.abs(flown_deg).max(axis=0).tolist()
    return [
        f"true {axis} reached {angle:.3f} deg, not below {TRUTH_BOUNDS_DEG[axis]}"
        for axis, angle in zip(AXES, largest, strict=True)
        if not angle < TRUTH_BOUNDS_DEG[axis]
    ]


def _sizes(flown_deg: FloatArray) -> dict[str, dict[str, float]]:
    """Return the largest size of each angle, and the one that 95 % are below."""
    size = np.abs(flown_deg)
    return {
        "largest_deg": _by_axis(size.max(axis=0)),
        "size_95_deg": _by_axis(np.quantile(size, 0.95, axis=0)),
    }


def _by_axis(values: FloatArray) -> dict[str, float]:
    return {axis: round(float(value), 4) for axis, value in zip(AXES, values, strict=True)}


#: the trailing mean and the first slope of the paper method must have filled, us of virtual time
_SETTLING_US = 3_600_000_000


class TrackedAngles(NamedTuple):
    """Estimate and truth of the operation phase, row by row."""

    epochs_us: IntArray
    #: (T, 3) deg, yaw, roll, pitch; NaN = none
    estimate_deg: FloatArray
    sigma_deg: FloatArray
    truth_deg: FloatArray
    is_control_allowed: BoolArray


def tracked_angles(story: Story, client: ServiceClient, method: str) -> TrackedAngles:
    """Return what the service keeps of the operation phase beside the truth."""
    start, stop = story.phases["operation"]
    # angles are looked up by names that are put together
    rows: list[Json] = [{**row} for row in client.attitude_history(story.spacecraft_id, start, stop, method=method)]
    epochs_us = [parse_epoch(row["epoch"]) for row in rows]
    nothing = (float("nan"),) * 3
    return TrackedAngles(
        np.array(epochs_us, dtype=np.int64),
        np.array([[_number(row[f"{axis}_deg"]) for axis in AXES] for row in rows]).reshape(-1, 3),
        np.array([[_number(row["sigma_deg"][axis]) for axis in AXES] for row in rows]).reshape(-1, 3),
        np.array([story.truth_deg.get(epoch_us, nothing) for epoch_us in epochs_us]).reshape(-1, 3),
        np.array([row["control_allowed"] for row in rows], dtype=np.bool_),
    )


class MethodStatistics(NamedTuple):
    """Statistics of one method in the operation phase."""

    rows: int
    rows_judged: int
    availability: float
    merits: dict[str, AxisMerit]
    zeros: dict[str, AxisMerit]


def judge_method(story: Story, client: ServiceClient, method: str) -> MethodStatistics:
    """Return the figures of one method after settling, and those of the answer that never moves."""
    tracked = tracked_angles(story, client, method)
    is_judged = tracked.epochs_us >= parse_epoch(story.phases["operation"][0]) + _SETTLING_US
    estimate, truth = tracked.estimate_deg[is_judged], tracked.truth_deg[is_judged]
    allowed = tracked.is_control_allowed[is_judged]
    return MethodStatistics(
        len(tracked.epochs_us),
        len(truth),
        round(float(allowed.mean()), 4) if len(allowed) else 0.0,
        {axis: judge_axis(estimate[:, k], truth[:, k]) for k, axis in enumerate(AXES)},
        {axis: judge_axis(np.zeros(len(truth)), truth[:, k]) for k, axis in enumerate(AXES)},
    )


def judge_story(story: Story, client: ServiceClient, loop: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the figures of both methods, of the answer that never moves, and of what the archive keeps.

    Where a loop was closed its figures stand beside them, and the true attitude is judged in place of the estimates:
    control takes the estimate to zero, so that its error is the attitude of the spacecraft, and slopes say nothing.
    """
    is_moved = loop is None
    driving, others = (judge_method(story, client, method) for method in METHODS)
    kept = check_archive(client, story.spacecraft_id, story.truth_deg)
    kept |= check_replay(client, story.spacecraft_id, story.phases["operation"], METHODS)
    estimate_misses = missed_figures(driving.merits, METHODS[0], is_moved=is_moved)
    return {
        "method": METHODS[0],
        "rows": driving.rows,
        "rows_judged": driving.rows_judged,
        "availability": driving.availability,
        "axes": {axis: _figures(merit) for axis, merit in driving.merits.items()},
        METHODS[1]: {
            "availability": others.availability,
            "axes": {axis: _figures(merit) for axis, merit in others.merits.items()},
            "missed": missed_figures(others.merits, METHODS[1], is_moved=is_moved),
        },
        "zero_answer": {axis: _figures(merit) for axis, merit in driving.zeros.items()},
        "crlb_deg": story.bound_deg,
        "control": client.status(story.spacecraft_id)["control"],
        **kept,
        "closed_loop": loop,
        "estimate_misses": estimate_misses,
        "missed": [*(estimate_misses if is_moved else ()), *missed_promises(kept), *missed_control(loop)],
        "zero_answer_misses": missed_figures(driving.zeros, METHODS[0], is_moved=is_moved),
    }


def _number(value: float | None) -> float:
    """Return a number, NaN for null."""
    return float("nan") if value is None else value


def _figures(merit: AxisMerit) -> dict[str, float | None]:
    """Return figures that print well; None where there was nothing to judge."""
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in merit._asdict().items()}
