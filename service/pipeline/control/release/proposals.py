"""Commands before they are prepared: computed schedules with their predicted effect."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles
from service.core.control.slew_schedule import AxisPulse, Effect, FloatArray, predicted_effect
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes
from service.records.levels.command import Pulse, ScheduleVerdict, TorqueCommand
from service.records.operations.release import Command, Purpose

#: parts of an effect with one value an axis
_BY_AXIS = tuple(name for name in Effect._fields if name != "wheel_momentum_n_m_s")
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


def proposed(
    spacecraft: Spacecraft,
    attitude_epoch_us: int,
    start_us: int,
    pulses: tuple[AxisPulse, ...],
    effect: Effect,
    checked: ScheduleVerdict | None,
    *,
    reason: str,
    purpose: Purpose = Purpose.CONTROL,
    computed: TorqueCommand | None = None,
) -> Command:
    """Return a command that waits for its preparation; `checked` is None where no flexible mode is known."""
    schedule = schedule_of(pulses, start_us)
    by_axis: dict[str, Any] = {name: Axes(*getattr(effect, name)) for name in _BY_AXIS}
    return Command(
        purpose=purpose,
        is_simulated=spacecraft.simulated,
        reason=reason,
        attitude_epoch_us=attitude_epoch_us,
        start_us=start_us,
        stop_us=max((pulse.stop_us for pulse in schedule), default=start_us),
        schedule=schedule,
        schedule_verdict="accept" if checked is None else checked.verdict,
        computed=computed,
        wheel_momentum_n_m_s=effect.wheel_momentum_n_m_s,
        **by_axis,
    )


def proposal_of(command: TorqueCommand, spacecraft: Spacecraft, reason: str) -> Command:
    """Return a command of the law as a proposal; ValueError where pulses overlap or the inertia is that of no body."""
    pulses, checked = pulses_of(command.schedule, command.epoch_us), command.schedule_check
    effect = effect_of_pulses(pulses, spacecraft, command.command_period_s)
    epochs_us = command.attitude_epoch_us, command.epoch_us
    return proposed(spacecraft, *epochs_us, pulses, effect, checked, reason=reason, computed=command)


def effect_of_law(command: TorqueCommand, spacecraft: Spacecraft) -> Effect:
    """Return the effect of a command of the law on angles, rates and wheels; ValueError as `proposal_of`."""
    return effect_of_pulses(pulses_of(command.schedule, command.epoch_us), spacecraft, command.command_period_s)


def effect_of_pulses(pulses: tuple[AxisPulse, ...], spacecraft: Spacecraft, least_horizon_s: float) -> Effect:
    """Return the effect of pulses until the horizon, or until the last of them ends."""
    inertia, wheels = _mechanics(spacecraft)
    horizon_s = max([least_horizon_s, *(pulse.stop_s for pulse in pulses)])
    return predicted_effect(pulses, inertia, wheels, horizon_s)


def pulses_of(schedule: Sequence[Pulse], start_us: int) -> tuple[AxisPulse, ...]:
    """Return the elements of a schedule about each axis, in order of time."""
    pulses = [
        AxisPulse(axis, (element.start_us - start_us) / US_PER_S, element.duration_s, torque_n_m)
        for element in schedule
        for axis, torque_n_m in enumerate(element.torque_n_m)
        if torque_n_m
    ]
    return tuple(sorted(pulses, key=lambda pulse: (pulse.start_s, pulse.axis)))


def schedule_of(pulses: Sequence[AxisPulse], start_us: int) -> tuple[Pulse, ...]:
    """Return pulses by the calendar, one element a pulse.

    Examples
    --------
    >>> schedule_of((AxisPulse(1, 2.0, 5.0, 0.01),), 7_000_000)
    (Pulse(start_us=9000000, duration_s=5.0, torque_n_m=Axes(yaw=0.0, roll=0.01, pitch=0.0)),)
    """
    return tuple(
        Pulse(
            start_us + round(pulse.start_s * US_PER_S),
            pulse.duration_s,
            Axes(*(pulse.torque_n_m if axis == pulse.axis else 0.0 for axis in range(3))),
        )
        for pulse in pulses
    )


@lru_cache(maxsize=64)
def _mechanics(spacecraft: Spacecraft) -> tuple[FloatArray, FloatArray]:
    """Return inertia (3, 3) and wheel axes (W, 3) in the order yaw, roll, pitch; nobody may write them."""
    inertia = inertia_about_angles(np.array(spacecraft.inertia_kg_m2))
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)[:, _ANGLES_FROM_BODY]
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    for array in (inertia, axes):
        array.setflags(write=False)
    return inertia, axes
