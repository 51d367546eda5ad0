"""Motion of one axis under its switching law, exactly from event to event.

Events: end of a pulse, lines of the law, momentum at zero (friction changes its sign, or holds the rotor where the
motor is off) and at its limit (torque that would raise it further is cut).
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.flexible.propagation import (
    BodyState,
    Line,
    MotionLeg,
    crossing_time,
    momentum_time,
    start_leg,
    state_at,
    states_at,
)
from service.core.flexible.spacecraft import (
    WATCHES,
    Arm,
    CrossingWatch,
    HubMode,
    SwitchingLaw,
    WheelDrive,
    arm_after_pulse,
    counter_after,
    require_drive,
    require_law,
    require_mode,
    require_positive,
)

#: more events than this in one call: the law chatters, or the time asked for is too long
MOST_EVENTS = 200_000
#: a momentum nearer to zero or to the limit is there, relative to the limit
_AT_MOMENTUM = 1e-13


class Regulator(NamedTuple):
    """State of the law."""

    arm: Arm = Arm.NEUTRAL
    #: lines used
    counter: int = 0
    #: side of the present visit, +1 or -1
    side: float = 1.0
    #: s left of a pulse
    timer_s: float = math.inf

    @property
    def is_on(self) -> bool:
        """Return whether the motor runs."""
        return self.arm in {Arm.FIRING, Arm.RELAY_ON}


class FlexibleMotion(NamedTuple):
    """Motion of a run, leg by leg."""

    #: (L,) s, start of each leg
    times_s: FloatArray
    legs: tuple[MotionLeg, ...]
    #: state of the law on each leg
    regulators: tuple[Regulator, ...]
    #: (F,) s, when the motor was switched on, and (R,) s, when the law came back to neutral
    firing_times_s: FloatArray
    release_times_s: FloatArray
    end_s: float
    end: BodyState

    def states(self, times_s: FloatArray) -> FloatArray:
        """Return states (T, 5), columns of `BodyState`, at some times (T,) within the run."""
        positions = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.legs) - 1)
        states = np.empty((len(times_s), len(BodyState._fields)))
        for position in np.unique(positions):
            chosen = positions == position
            states[chosen] = states_at(self.legs[position], times_s[chosen] - self.times_s[position])
        return states


def follow_motion(
    start: BodyState,
    drive: WheelDrive,
    mode: HubMode | None,
    law: SwitchingLaw,
    duration_s: float,
    regulator: Regulator | None = None,
) -> FlexibleMotion:
    """Return the motion of one axis under its law.

    Parameters
    ----------
    start : BodyState
        Its momentum is the wheel's at the start: that at rest plus inertia times rate.
    drive, mode, law
        The axis; a mode of None is a rigid body.
    duration_s : float, s
        How long to follow it.
    regulator : Regulator or None
        State of the law at the start; default neutral: on a line and moving outward, or beyond one, it fires at once.

    Raises
    ------
    ValueError
        Something is not physical, or the law switches more than `MOST_EVENTS` times.

    Notes
    -----
    Exact between events; events to a few units of the last digit of their time. Dry friction that is stronger than the
    motor holds a rotor at rest, so does the limit of momentum hold one that the motor drives against it.
    """
    require_drive(drive)
    require_law(law)
    require_positive("duration_s", duration_s)
    if mode is not None:
        require_mode(mode)
    record, end_s, end = _Record(), 0.0, start
    for step in steps_of(start, drive, mode, law, duration_s, regulator):
        record.add(step)
        end_s, end = step.end_s, step.end
        if record.events > MOST_EVENTS:
            raise ValueError(
                f"more than {MOST_EVENTS} events in {step.end_s:g} s of {duration_s:g}: the law chatters; widen the "
                "distance between alpha and beta, lengthen the pulse, or ask for a shorter time"
            )
    return record.motion(end_s, end)


def steps_of(
    start: BodyState,
    drive: WheelDrive,
    mode: HubMode | None,
    law: SwitchingLaw,
    duration_s: float,
    regulator: Regulator | None = None,
) -> Iterator["MotionStep"]:
    """Yield the motion of one axis, event by event, as `follow_motion` records it; what is given is not checked."""
    now_s, state, waiting = 0.0, start, regulator or Regulator()
    while now_s < duration_s:
        leg = _leg(state, waiting, drive, mode)
        event = _next_event(leg, waiting, drive, law, duration_s - now_s)
        state = _state_after(leg, event)
        yield MotionStep(now_s, leg, waiting, event, now_s + event.after_s, state)
        now_s, waiting = now_s + event.after_s, event.regulator


class _Event(NamedTuple):
    """End of a leg."""

    after_s: float
    #: state of the law from then on
    regulator: Regulator
    #: the motor is switched on, or control is released
    is_firing: bool = False
    is_release: bool = False
    #: the momentum that was come to
    momentum_n_m_s: float | None = None


class MotionStep(NamedTuple):
    """One leg, what ended it, and where."""

    start_s: float
    leg: MotionLeg
    #: state of the law on the leg
    regulator: Regulator
    event: _Event
    end_s: float
    end: BodyState


class _Record:
    """Legs and switchings of a run."""

    def __init__(self) -> None:
        self.events = 0
        self._legs: list[tuple[float, MotionLeg, Regulator]] = []
        self._firings: list[float] = []
        self._releases: list[float] = []

    def add(self, step: MotionStep) -> None:
        """Keep a leg and what ended it."""
        self.events += 1
        if step.event.after_s > 0.0:
            self._legs.append((step.start_s, step.leg, step.regulator))
        if step.event.is_firing:
            self._firings.append(step.end_s)
        if step.event.is_release:
            self._releases.append(step.end_s)

    def motion(self, end_s: float, end: BodyState) -> FlexibleMotion:
        """Return everything kept."""
        starts, legs, regulators = zip(*self._legs, strict=True)
        return FlexibleMotion(
            np.array(starts), legs, regulators, np.array(self._firings), np.array(self._releases), end_s, end
        )


def _leg(state: BodyState, regulator: Regulator, drive: WheelDrive, mode: HubMode | None) -> MotionLeg:
    """Return the leg that begins in a state of body and law."""
    motor_n_m = -regulator.side * drive.motor_torque_n_m if regulator.is_on else 0.0
    momentum, limit = state.momentum_n_m_s, drive.momentum_limit_n_m_s
    viscous_rate_1_s = drive.viscous_loss_n_m / limit
    is_at_rest = abs(momentum) <= _AT_MOMENTUM * limit
    # a rotor at rest turns the way of the motor, where that is stronger than dry friction
    turning = math.copysign(1.0, motor_n_m if is_at_rest else momentum)
    torque_n_m = motor_n_m - drive.dry_friction_n_m * turning - viscous_rate_1_s * momentum
    is_stuck = is_at_rest and abs(motor_n_m) <= drive.dry_friction_n_m
    is_cut = abs(momentum) >= (1.0 - _AT_MOMENTUM) * limit and torque_n_m * momentum > 0.0
    if is_stuck or is_cut:
        torque_n_m = viscous_rate_1_s = 0.0
    return start_leg(
        state,
        mode,
        inertia_kg_m2=drive.inertia_kg_m2,
        wheel_torque_n_m=torque_n_m,
        decay_1_s=viscous_rate_1_s,
        external_torque_n_m=drive.external_torque_n_m,
    )


def _next_event(leg: MotionLeg, regulator: Regulator, drive: WheelDrive, law: SwitchingLaw, left_s: float) -> _Event:
    """Return the event that ends a leg: the end of the run, a pulse's end, the momentum, or a line."""
    soonest = _Event(left_s, regulator._replace(timer_s=regulator.timer_s - left_s))
    if regulator.timer_s <= left_s:
        arm = arm_after_pulse(regulator.counter, law)
        soonest = _Event(regulator.timer_s, regulator._replace(arm=arm, timer_s=math.inf))
    for momentum in (0.0, drive.momentum_limit_n_m_s, -drive.momentum_limit_n_m_s):
        after_s = momentum_time(leg, momentum)
        if after_s < soonest.after_s:
            same = regulator._replace(timer_s=regulator.timer_s - after_s)
            soonest = _Event(after_s, same, momentum_n_m_s=momentum)
    for watch in WATCHES[regulator.arm]:
        for side, line in _lines(watch, regulator, law):
            after_s = crossing_time(leg, line, soonest.after_s)
            if after_s < soonest.after_s:
                soonest = _switched(after_s, watch, regulator._replace(side=side), law)
    return soonest


def _lines(watch: CrossingWatch, regulator: Regulator, law: SwitchingLaw) -> list[tuple[float, Line]]:
    """Return the lines of a watch with their sides."""
    side = regulator.side
    if watch.line == "line":
        angle = law.next_line_rad(regulator.counter)
        sides = (1.0, -1.0) if regulator.arm is Arm.NEUTRAL else (side,)
        return [(one, Line(one * angle, one)) for one in sides if math.isfinite(angle)]
    angle = {"alpha": law.alpha_rad, "beta": law.beta_rad, "last": law.last_line_rad}[watch.line]
    return [(side, Line(side * angle, -side))]


def _switched(after_s: float, watch: CrossingWatch, regulator: Regulator, law: SwitchingLaw) -> _Event:
    """Return the crossing of a line: the law's next state."""
    is_firing = watch.to is Arm.FIRING
    arm = Arm.RELAY_ON if is_firing and law.is_relay else watch.to
    counter = counter_after(arm, regulator.counter, law)
    timer_s = law.pulse_s if is_firing else math.inf
    return _Event(after_s, Regulator(arm, counter, regulator.side, timer_s), is_firing, arm is Arm.NEUTRAL)


def _state_after(leg: MotionLeg, event: _Event) -> BodyState:
    """Return the state at the end of a leg; the momentum that was come to is that exactly."""
    state = state_at(leg, event.after_s) if event.after_s > 0.0 else leg.start
    return state if event.momentum_n_m_s is None else state._replace(momentum_n_m_s=event.momentum_n_m_s)
