"""Limit cycles that visit both lines, equation (24): fixed points of the map from one arrival to the next like it.

An arrival is one at the first line of the side to which friction turns the body, after a visit to the other side. The
motion between two arrivals is followed event by event, so friction changes its sign where the rotor does.

Equation (24) adds fourteen legs: a side has three pulses, two drifts between them, a drift to alpha, the neutral zone.
With friction of one sign the changes of rate sum to zero only where ``(N - N') M_n tau = I eps_c T``: the side to which
friction turns the body fires more pulses than the other. As many on both sides need a rotor that passes through rest,
whose friction then opposes the motion, and pulses that adjoin: a drift outward after two of three takes twice the gain
of a pulse at arrival, and what leaves after the third has less than one. So (24) as printed has no solution here.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.flexible.motion import steps_of
from service.core.flexible.propagation import BodyState
from service.core.flexible.roots import brent_root
from service.core.flexible.spacecraft import WheelDrive, accelerations
from service.core.flexible.switching_law import SwitchingLaw

#: speeds tried; narrower branches between two jumps are not seen
_SCANNED_SPEEDS = 80
#: pulses between two arrivals at most
_MOST_PULSES = 20
#: a return takes less, s
_LONGEST_S = 1e6
#: what a root of f(w) - w may leave, and the step of the slope, in gains of one pulse
_JUMP, _DIFFERENCE_STEP = 1e-9, 1e-5


class Return(NamedTuple):
    """Motion from one arrival to the next one like it."""

    speed_rad_s: float
    period_s: float
    #: on the side of the arrival, on the other side
    pulses: tuple[int, int]
    #: greatest distance from zero at an event, and greatest rate
    outer_rad: float
    rate_rad_s: float


class CycleOverBothLines(NamedTuple):
    """A return that ends as it began."""

    motion: Return
    multiplier: float
    is_stable: bool


def crossing_speed_rad_s(drive: WheelDrive, law: SwitchingLaw) -> float:
    """Return the inward speed at the first line from which the body comes through neutral against friction."""
    return math.sqrt(4.0 * accelerations(drive).passive_rad_s2 * law.beta_rad)


def find_cycles_over_both_lines(drive: WheelDrive, law: SwitchingLaw) -> tuple[CycleOverBothLines, ...]:
    """Return the cycles that visit both lines once, by speed; rigid body, pulses, no external torque.

    Examples
    --------
    >>> drive = WheelDrive(1000.0, 0.2, 3e-4, 1e-4, momentum_n_m_s=10.0)
    >>> (cycle,) = find_cycles_over_both_lines(drive, SwitchingLaw(0.0175, 0.0349, 2.0))
    >>> cycle.motion.pulses, round(cycle.motion.period_s, 3), cycle.is_stable
    ((2, 1), 1142.857, False)
    """
    gained = drive.motor_torque_n_m * law.pulse_s / drive.inertia_kg_m2
    crossing = crossing_speed_rad_s(drive, law)
    if gained <= crossing:
        return ()

    def excess(speed: float) -> float:
        found = return_over_both_lines(speed, drive, law)
        return math.nan if found is None else found.speed_rad_s - speed

    speeds = np.linspace(0.0, math.hypot(law.pulse_count * gained, crossing), _SCANNED_SPEEDS + 2)[1:-1]
    values = np.array([excess(float(speed)) for speed in speeds])
    cycles = []
    for k in np.flatnonzero(values[:-1] * values[1:] <= 0.0):
        speed = brent_root(excess, float(speeds[k]), float(speeds[k + 1]))
        motion = return_over_both_lines(speed, drive, law)
        if motion is not None and abs(motion.speed_rad_s - speed) <= _JUMP * gained:
            step = _DIFFERENCE_STEP * gained
            multiplier = 1.0 + (excess(speed + step) - excess(speed - step)) / (2.0 * step)
            cycles.append(CycleOverBothLines(motion, multiplier, abs(multiplier) < 1.0))
    return tuple(cycles)


def return_over_both_lines(speed_rad_s: float, drive: WheelDrive, law: SwitchingLaw) -> Return | None:
    """Return the motion from an arrival at a speed to the next one; None where there is none."""
    # friction turns the body against the sign of the momentum
    side = -math.copysign(1.0, drive.momentum_n_m_s)
    rate = side * speed_rad_s
    start = BodyState(side * law.beta_rad, rate, momentum_n_m_s=drive.momentum_n_m_s + drive.inertia_kg_m2 * rate)
    pulses, outer, fastest = [0, 0], law.beta_rad, speed_rad_s
    for step in steps_of(start, drive, None, law, _LONGEST_S):
        outer, fastest = max(outer, abs(step.end.angle_rad)), max(fastest, abs(step.end.rate_rad_s))
        if not step.event.is_firing:
            continue
        is_other = step.event.regulator.side != side
        if not is_other and pulses[1]:
            return Return(abs(step.end.rate_rad_s), step.end_s, (pulses[0], pulses[1]), outer, fastest)
        pulses[is_other] += 1
        if sum(pulses) > _MOST_PULSES:
            break
    return None
