"""Result of the demonstration's control: the true attitude, what it cost, and the same spacecraft left alone."""

from typing import Any, NamedTuple

import numpy as np

from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.attitude import FloatArray
from service.study.closed_loop.plant_process import PlantProcess
from service.study.demonstration.control_centre import ControlLog
from service.study.demonstration.demonstration import Story
from service.study.demonstration.merit import AXES

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
            **_figures(self.flown_deg),
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
        **_figures(flown),
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


def _figures(flown_deg: FloatArray) -> dict[str, dict[str, float]]:
    """Return the largest size of each angle, and the one that 95 % are below."""
    size = np.abs(flown_deg)
    return {
        "largest_deg": _by_axis(size.max(axis=0)),
        "size_95_deg": _by_axis(np.quantile(size, 0.95, axis=0)),
    }


def _by_axis(values: FloatArray) -> dict[str, float]:
    return {axis: round(float(value), 4) for axis, value in zip(AXES, values, strict=True)}
