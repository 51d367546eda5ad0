"""May a computed schedule go without exciting the flexible modes: the check of each axis, the worst one told.

Panels swing for hours (damping 0.003 at 0.6 rad/s: 9 min to a third), so what schedules left behind is carried to the
next one; the motion itself is never seen in rows a minute apart.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.core.flexible.schedule import (
    ScheduleCheck,
    ScheduleLimits,
    Suggestion,
    TorquePulse,
    carry_phasor,
    check_schedule,
    ordered_schedule,
    schedule_response,
)
from service.core.flexible.spacecraft import HubMode
from service.pipeline.config import TorqueConfig
from service.records import catalogue
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Pulse, ScheduleVerdict

#: places of the axes in the order yaw, roll, pitch, and of each among the body axes
_POSITIONS = {"yaw": 0, "roll": 1, "pitch": 2}
_BODY = {"yaw": 2, "roll": 0, "pitch": 1}
#: every panel damps; a catalogue that says nothing of it is given this
_LEAST_DAMPING = 1e-4
_WORDS = {
    "split": "split each pulse into two halves {:.3g} s apart",
    "width": "make each pulse {:.3g} s long with the same impulse",
    "interval": "space the pulses {:.3g} s apart",
    "wait": "send it {:.3g} s later",
}


@dataclass(frozen=True, slots=True)
class PanelSwing:
    """Oscillation of the modes of the catalogue after earlier schedules, in their order."""

    at_us: int
    #: hub angle, rad; turns and decays from `at_us` on
    phasor_rad: tuple[complex, ...]


def schedule_verdict(
    schedule: Sequence[Pulse], spacecraft: Spacecraft, config: TorqueConfig, swing: PanelSwing | None = None
) -> ScheduleVerdict | None:
    """Return the verdict on a schedule; None without modes or without pulses.

    Parameters
    ----------
    schedule : sequence of Pulse
        Not empty for a verdict.
    spacecraft : Spacecraft
        Modes and inertia.
    config : TorqueConfig
        What panels may add.
    swing : PanelSwing, optional
        What earlier schedules have left; none: at rest.

    Notes
    -----
    Each axis is judged by its own peak; the greatest one counts. The jitter of the hub is the only limit.
    """
    if not spacecraft.modes or not schedule:
        return None
    start_us = min(pulse.start_us for pulse in schedule)
    found = [
        (check, positions)
        for axis, positions in _modes_by_axis(spacecraft).items()
        if (check := _checked(schedule, axis, positions, spacecraft, config, swing, start_us)) is not None
    ]
    if not found:
        return None
    check, positions = max(found, key=lambda one: one[0].metrics.peak_rad)
    worst = check.metrics
    return ScheduleVerdict(
        verdict=check.verdict,
        peak_deg=math.degrees(worst.peak_rad),
        residual_deg=math.degrees(worst.residual_rad),
        margin=1.0 - math.degrees(worst.peak_rad) / config.panel_peak_limit_deg,
        worst_mode=positions[worst.worst_mode],
        suggestion=_in_words(check.suggestions),
    )


def swing_after(swing: PanelSwing | None, schedule: Sequence[Pulse], spacecraft: Spacecraft) -> PanelSwing | None:
    """Return the oscillation of the modes after a schedule that counts as executed; None without modes."""
    if not spacecraft.modes:
        return None
    if not schedule:
        return swing
    start_us = min(pulse.start_us for pulse in schedule)
    stop_us = max(pulse.start_us + round(pulse.duration_s * US_PER_S) for pulse in schedule)
    left = []
    for position, mode in enumerate(spacecraft.modes):
        tone, carried = _tone(mode), _carried(swing, spacecraft, position, start_us)
        pulses = _pulses(schedule, mode.axis, start_us)
        response = schedule_response(pulses, tone, _inertia(spacecraft, mode.axis), carried_rad=carried)
        rest_s = (stop_us - start_us) / US_PER_S - response.end_s
        left.append(carry_phasor(complex(response.phasor_rad[0]), tone, rest_s))
    return PanelSwing(stop_us, tuple(left))


def _checked(
    schedule: Sequence[Pulse],
    axis: str,
    positions: list[int],
    spacecraft: Spacecraft,
    config: TorqueConfig,
    swing: PanelSwing | None,
    start_us: int,
) -> ScheduleCheck | None:
    """Return the check of one axis; None where nothing is commanded about it."""
    pulses = _pulses(schedule, axis, start_us)
    if not pulses:
        return None
    limits = ScheduleLimits(
        _inertia(spacecraft, axis),
        tuple(_tone(spacecraft.modes[position]) for position in positions),
        math.radians(config.panel_peak_limit_deg),
    )
    carried = tuple(_carried(swing, spacecraft, position, start_us) for position in positions)
    return check_schedule(pulses, limits, carried)


def _modes_by_axis(spacecraft: Spacecraft) -> dict[str, list[int]]:
    """Return the places of the modes of each axis that has one."""
    positions: dict[str, list[int]] = {}
    for position, mode in enumerate(spacecraft.modes):
        positions.setdefault(mode.axis, []).append(position)
    return positions


def _pulses(schedule: Sequence[Pulse], axis: str, start_us: int) -> tuple[TorquePulse, ...]:
    """Return the pulses about one axis."""
    position = _POSITIONS[axis]
    return ordered_schedule(
        tuple(
            TorquePulse((pulse.start_us - start_us) / US_PER_S, pulse.duration_s, pulse.torque_n_m[position])
            for pulse in schedule
            if pulse.torque_n_m[position] and pulse.duration_s > 0.0
        )
    )


def _carried(swing: PanelSwing | None, spacecraft: Spacecraft, position: int, at_us: int) -> complex:
    """Return the oscillation of one mode at an instant, not before the end of the last schedule; 0 for other modes."""
    if swing is None or len(swing.phasor_rad) != len(spacecraft.modes):
        return 0j
    elapsed_s = max(0.0, (at_us - swing.at_us) / US_PER_S)
    return carry_phasor(swing.phasor_rad[position], _tone(spacecraft.modes[position]), elapsed_s)


def _tone(mode: "catalogue.FlexibleMode") -> HubMode:
    return HubMode(mode.omega_rad_s, max(mode.damping_ratio, _LEAST_DAMPING), mode.coupling)


def _inertia(spacecraft: Spacecraft, axis: str) -> float:
    return float(np.array(spacecraft.inertia_kg_m2)[_BODY[axis], _BODY[axis]])


def _in_words(suggestions: tuple[Suggestion, ...]) -> str | None:
    """Return the best suggestion."""
    if not suggestions:
        return None
    best = suggestions[0]
    return f"{_WORDS[best.kind].format(best.value_s)}: {best.verdict}"
