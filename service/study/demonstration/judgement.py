"""Judgement of both methods in the demonstration's operation, against the truth and the archive."""

import math
from typing import Any, NamedTuple

import numpy as np

from service.client.documents import Json
from service.client.service_client import ServiceClient
from service.records.epoch import parse_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.demonstration.archive_check import METHODS, check_archive, check_replay, missed_promises
from service.study.demonstration.closed_judgement import missed_control
from service.study.demonstration.demonstration import Story
from service.study.demonstration.merit import AXES, AxisMerit, judge_axis, missed_bounds

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
    estimate_misses = missed_bounds(driving.merits, METHODS[0], is_moved=is_moved)
    return {
        "method": METHODS[0],
        "rows": driving.rows,
        "rows_judged": driving.rows_judged,
        "availability": driving.availability,
        "axes": {axis: _figures(merit) for axis, merit in driving.merits.items()},
        METHODS[1]: {
            "availability": others.availability,
            "axes": {axis: _figures(merit) for axis, merit in others.merits.items()},
            "missed": missed_bounds(others.merits, METHODS[1], is_moved=is_moved),
        },
        "zero_answer": {axis: _figures(merit) for axis, merit in driving.zeros.items()},
        "crlb_deg": story.bound_deg,
        "control": client.status(story.spacecraft_id)["control"],
        **kept,
        "closed_loop": loop,
        "estimate_misses": estimate_misses,
        "missed": [*(estimate_misses if is_moved else ()), *missed_promises(kept), *missed_control(loop)],
        "zero_answer_misses": missed_bounds(driving.zeros, METHODS[0], is_moved=is_moved),
    }


def _number(value: float | None) -> float:
    """Return a number, NaN for null."""
    return float("nan") if value is None else value


def _figures(merit: AxisMerit) -> dict[str, float | None]:
    """Return figures that print well; None where there was nothing to judge."""
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in merit._asdict().items()}
