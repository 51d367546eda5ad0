"""Figures of merit of closed loops and what was asked of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.run import FlownRun, LoopResult

#: deg, yaw, roll, pitch: 95 % of the runs within the first, all of them within the second
NARROW_DEG = (0.4, 0.2, 0.2)
WIDE_DEG = (0.5, 0.3, 0.3)
NARROW_SHARE = 0.95
#: roll and pitch of a fade in mid-slew: throughout, and reached so long after the fade, deg and h
FADE_LIMIT_DEG, FADE_SETTLED_DEG, FADE_SETTLE_H = 0.4, 0.1, 3.0
#: the scenario that begins off zero and is judged by the fade's limits
FADE_SCENARIO = "slew_fade"
#: deg, yaw, roll, pitch, and h: under a torque that the catalogue does not know all runs stay within the angles, and no
#: inhibition lasts longer
UNKNOWN_TORQUE_DEG = (1.0, 0.3, 0.3)
UNKNOWN_TORQUE_INHIBITED_H = 0.25 + 1e-9
UNKNOWN_TORQUE_SCENARIOS = ("unknown_residual_constant", "unknown_residual_daily")
#: deg: yaw of 95 % of the runs where the wheels are reported and nobody states the torque that gathers in them
MEASURED_YAW_DEG = 0.25
MEASURED_SCENARIO = "wheels_unstated"
PERCENTILES = (50, 95, 100)


class RunMerit(NamedTuple):
    """Figures of one run; triples in the order yaw, roll, pitch."""

    largest_deg: tuple[float, float, float]
    rms_deg: tuple[float, float, float]
    impulse_n_m_s: tuple[float, float, float]
    inhibited_h: float
    #: h, the longest inhibition without a break
    longest_inhibited_h: float
    #: h after the end of the fade until roll and pitch are both small; inf = never, None = no fade
    settled_h: float | None

    @property
    def is_narrow(self) -> bool:
        """Return whether every angle stays within the limits of 95 % of the runs."""
        return all(angle < limit for angle, limit in zip(self.largest_deg, NARROW_DEG, strict=True))

    @property
    def is_wide(self) -> bool:
        """Return whether every angle stays within the limits of all runs."""
        return all(angle < limit for angle, limit in zip(self.largest_deg, WIDE_DEG, strict=True))

    @property
    def is_level(self) -> bool:
        """Return whether roll and pitch alone stay within the limits of 95 % of the runs."""
        return all(angle < limit for angle, limit in zip(self.largest_deg[1:], NARROW_DEG[1:], strict=True))

    @property
    def is_unknown_torque_held(self) -> bool:
        """Return whether the limits under a torque that nobody knows are kept."""
        return all(angle < limit for angle, limit in zip(self.largest_deg, UNKNOWN_TORQUE_DEG, strict=True))

    @property
    def is_unknown_torque_survived(self) -> bool:
        """Return whether these limits are kept, and control is never lost."""
        return self.is_unknown_torque_held and self.longest_inhibited_h <= UNKNOWN_TORQUE_INHIBITED_H

    @property
    def is_measured_yaw_held(self) -> bool:
        """Return whether yaw stays within the limit of reported wheels, roll and pitch within those of 95 %."""
        return self.largest_deg[0] <= MEASURED_YAW_DEG and self.is_level

    @property
    def is_fade_survived(self) -> bool:
        """Return whether roll and pitch stay within the fade's limit and come back in time."""
        is_settled = self.settled_h is not None and self.settled_h <= FADE_SETTLE_H
        return max(self.largest_deg[1:]) < FADE_LIMIT_DEG and is_settled


class OwnLimits(NamedTuple):
    """Limits of a scenario in place of those of all others, and the share of the runs that must keep them."""

    is_kept: Callable[[RunMerit], bool]
    needed_share: float = 1.0


OWN_LIMITS = {
    FADE_SCENARIO: OwnLimits(lambda merit: merit.is_fade_survived),
    **dict.fromkeys(UNKNOWN_TORQUE_SCENARIOS, OwnLimits(lambda merit: merit.is_unknown_torque_survived)),
    # thrusters that nobody declares take control away for a while
    "plant_varied": OwnLimits(lambda merit: merit.is_unknown_torque_held),
    MEASURED_SCENARIO: OwnLimits(lambda merit: merit.is_measured_yaw_held, NARROW_SHARE),
}


@dataclass(frozen=True)
class GroupMerit:
    """Figures of the runs of one scenario under one sensing; refused runs count as missed."""

    scenario: str
    sensing: Sensing
    runs: int
    refused: int
    narrow_share: float
    wide_share: float
    #: roll and pitch alone within the narrow limits
    level_share: float
    #: of 50, 95 and 100 % of the runs; (3,) yaw, roll, pitch each
    largest_deg: tuple[tuple[float, float, float], ...]
    impulse_n_m_s: tuple[tuple[float, float, float], ...]
    inhibited_h: tuple[float, ...]
    longest_inhibited_h: float
    #: share of the runs that keep the limits of the scenario's own; None = it has none
    survived_share: float | None
    #: longest time to come back after the fade; None = no such story
    settled_h: float | None

    @property
    def is_met(self) -> bool:
        """Return whether what was asked is reached; without control it must not be."""
        if self.survived_share is not None:
            return self.survived_share >= OWN_LIMITS[self.scenario].needed_share
        return self.narrow_share >= NARROW_SHARE and self.wide_share == 1.0


def run_merit(flight: FlownRun) -> RunMerit:
    """Return the figures of one flight."""
    size = np.abs(flight.truth_deg)
    step_h = float(np.median(np.diff(flight.hours)))
    return RunMerit(
        _triple(size.max(axis=0)),
        _triple(np.sqrt(np.mean(size**2, axis=0))),
        flight.impulse_n_m_s,
        float(flight.is_inhibited.sum()) * step_h,
        _longest_run(flight.is_inhibited) * step_h,
        _settled_h(flight),
    )


def group_merit(results: Sequence[LoopResult]) -> GroupMerit:
    """Return the figures of the runs of one scenario under one sensing."""
    unit, runs = results[0].unit, len(results)
    merits = [run_merit(result.flight) for result in results if result.flight is not None]
    is_fade, own = unit.scenario == FADE_SCENARIO, OWN_LIMITS.get(unit.scenario)

    def share(is_kept: Callable[[RunMerit], bool]) -> float:
        return sum(map(is_kept, merits)) / runs

    return GroupMerit(
        scenario=unit.scenario,
        sensing=unit.sensing,
        runs=runs,
        refused=runs - len(merits),
        narrow_share=share(lambda merit: merit.is_narrow),
        wide_share=share(lambda merit: merit.is_wide),
        level_share=share(lambda merit: merit.is_level),
        largest_deg=_percentiles([merit.largest_deg for merit in merits]),
        impulse_n_m_s=_percentiles([merit.impulse_n_m_s for merit in merits]),
        inhibited_h=tuple(triple[0] for triple in _percentiles([(merit.inhibited_h,) * 3 for merit in merits])),
        longest_inhibited_h=max((merit.longest_inhibited_h for merit in merits), default=float("inf")),
        survived_share=None if own is None else share(own.is_kept),
        settled_h=max((merit.settled_h or 0.0 for merit in merits), default=float("inf")) if is_fade else None,
    )


def _percentiles(values: Sequence[tuple[float, float, float]]) -> tuple[tuple[float, float, float], ...]:
    """Return the percentiles over the runs, one triple each; NaN where none was flown."""
    if not values:
        return ((float("nan"),) * 3,) * len(PERCENTILES)
    # the next run that was flown, nothing in between: a percentile of few runs is a run
    table = np.percentile(np.array(values), PERCENTILES, axis=0, method="higher")
    return tuple(_triple(row) for row in table)


def _longest_run(is_set: BoolArray) -> int:
    """Return the length of the longest run of rows that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_set, [False]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _settled_h(flight: FlownRun) -> float | None:
    """Return the time from the end of the fade until roll and pitch are both small."""
    wet = np.flatnonzero(flight.is_faded)
    if not len(wet):
        return None
    end = int(wet[-1])
    small = np.flatnonzero((np.abs(flight.truth_deg[end:, 1:]) < FADE_SETTLED_DEG).all(axis=1))
    return float(flight.hours[end + int(small[0])] - flight.hours[end]) if len(small) else float("inf")


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
