"""Limit cycles of the pulse law: fixed points of the succession function, their multipliers and amplitudes."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.flexible.motion import steps_of
from service.core.flexible.propagation import BodyState, brent_root
from service.core.flexible.return_kernels import Follow, OneSided, follow, one_return
from service.core.flexible.spacecraft import SwitchingLaw, WheelDrive, accelerations, require_law

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


class SinglePulseForms(NamedTuple):
    """Cycle of one pulse, by formula."""

    #: at firing, c = 0
    speed_rad_s: float
    period_s: float
    #: below and above the line
    inner_depth_rad: float
    overshoot_rad: float
    #: -(1 + 2 eps_c / eps_a), c = 0
    multiplier_frictionless: float
    #: with viscous loss to first order
    multiplier: float
    #: of the printed (23), which lacks the displacement theta' tau
    multiplier_truncated: float
    #: loss at the momentum limit above which the cycle is stable, N m
    critical_viscous_loss_n_m: float


def single_pulse_forms(drive: WheelDrive, pulse_s: float) -> SinglePulseForms:
    """Return the closed forms of the cycle of one pulse.

    Examples
    --------
    >>> forms = single_pulse_forms(WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0), 1.0)
    >>> [round(value, 6) for value in (forms.multiplier_frictionless, forms.multiplier, forms.multiplier_truncated)]
    [-1.010555, -1.009917, -0.9895]
    """
    passive, pulse, viscous = accelerations(drive)
    ratio = passive / pulse
    speed = 0.5 * pulse * pulse_s
    steepness = -(1.0 + 2.0 * ratio)
    # the loss that stabilises stands beside dry friction alone
    dry = drive.dry_friction_n_m
    dry_ratio = dry / (drive.motor_torque_n_m - dry)
    return SinglePulseForms(
        speed_rad_s=speed,
        period_s=cycle_period_s(drive, pulse_s, 1),
        inner_depth_rad=0.5 * speed**2 / passive,
        overshoot_rad=0.5 * speed**2 / pulse,
        multiplier_frictionless=steepness,
        multiplier=steepness * (1.0 - 4.0 * viscous * speed / (3.0 * passive)),
        multiplier_truncated=-(1.0 - ratio) / (1.0 + ratio),
        critical_viscous_loss_n_m=3.0 * drive.momentum_limit_n_m_s * dry_ratio**2 / pulse_s,
    )


def cycle_period_s(drive: WheelDrive, pulse_s: float, pulses: int) -> float:
    """Return the period of a cycle, s: N pulses make good what friction takes, equation (25); exact for any loss."""
    passive, _, _ = accelerations(drive)
    return pulses * drive.motor_torque_n_m * pulse_s / (passive * drive.inertia_kg_m2)


def truncated_succession(speeds_rad_s: FloatArray, motion: OneSided) -> FloatArray:
    """Return the succession (S,) that follows from (23) as printed, without the displacement theta' tau in a pulse."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    passive_part = motion.passive_rad_s2 * motion.pulse_rad_s2 * motion.pulse_s**2
    return np.sqrt((speeds_rad_s - gained) ** 2 + passive_part)


def one_sided_motion(drive: WheelDrive, law: SwitchingLaw) -> OneSided:
    """Return the numbers of one-sided motion.

    Raises
    ------
    ValueError
        An external torque, no friction, or a relay: none of them has a one-sided cycle of pulses.
    """
    require_law(law)
    passive, pulse, viscous = accelerations(drive)
    if drive.external_torque_n_m != 0.0:
        raise ValueError(
            f"external_torque_n_m is {drive.external_torque_n_m:g}: momentum drifts to its limit and no cycle closes; "
            "set it to 0 here and follow the motion itself instead"
        )
    if passive == 0.0:
        raise ValueError(
            "neither dry nor viscous friction: nothing brings the body back to its line; raise one of them"
        )
    if law.is_relay:
        raise ValueError("pulse_s is infinite: a relay has no cycle of pulses; give the length of a pulse")
    lines = (law.alpha_rad, law.beta_rad, law.pulse_s, law.pulse_count, law.line_step_rad)
    return OneSided(passive, pulse, viscous, *lines)


def succession(speeds_rad_s: FloatArray, motion: OneSided) -> FloatArray:
    """Return the speeds (S,) of the next arrivals after arrivals at some speeds (S,); NaN where there is none."""
    return follow(np.asarray(speeds_rad_s, dtype=np.float64), 1, motion)[:, 1]


def koenigs_lamerey(speed_rad_s: float, returns: int, motion: OneSided, follower: Follow = follow) -> FloatArray:
    """Return the ladder (2 R + 1, 2) of Koenigs and Lamerey from one arrival: corners (w_k, w_k), (w_k, w_k+1).

    Parameters
    ----------
    speed_rad_s : float, rad/s
        First arrival.
    returns : int
        R; the ladder is shorter where the motion does not return.
    motion : OneSided
        Its numbers.
    follower : callable
        `follow` or its compiled form.
    """
    speeds = follower(np.array([speed_rad_s]), returns, motion)[0]
    speeds = speeds[np.isfinite(speeds)]
    corners = np.repeat(speeds, 2)
    return np.column_stack([corners[:-1], corners[1:]])[: 2 * len(speeds) - 1]


#: speeds tried between 0 and the gain of one pulse; narrower branches between two jumps are not seen
SCANNED_SPEEDS = 400
#: pulses of a cycle at most
MOST_PULSES = 200
#: step of the central difference, in gains of one pulse
_SUCCESSION_STEP = 1e-4
_HALVINGS = 10


class LimitCycle(NamedTuple):
    """One periodic motion."""

    #: w*, at the first line
    speed_rad_s: float
    period_s: float
    #: least and greatest angle from zero
    inner_rad: float
    outer_rad: float
    #: greatest rate at a switching
    rate_rad_s: float
    pulses: int
    #: slope of the succession function at w*
    multiplier: float
    is_stable: bool
    #: (least, greatest)
    momentum_n_m_s: tuple[float, float]
    #: the momentum keeps its sign and its limit; otherwise friction does not act as was assumed and the figures do not
    #: belong to this drive
    is_momentum_consistent: bool


def find_limit_cycles(drive: WheelDrive, law: SwitchingLaw) -> tuple[LimitCycle, ...]:
    """Return the cycles that return to the first line after one visit of at most `MOST_PULSES` pulses, by speed.

    Cycles that close after several visits are not looked for.

    Raises
    ------
    ValueError
        No one-sided motion (see `one_sided_motion`).

    Examples
    --------
    >>> drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)
    >>> (cycle,) = find_limit_cycles(drive, SwitchingLaw(0.0175, 0.0349, 1.0))
    >>> round(cycle.period_s, 4), round(cycle.multiplier, 4), cycle.is_stable
    (190.4762, -1.0099, False)
    """
    motion = one_sided_motion(drive, law)._replace(most_pulses=MOST_PULSES)
    return tuple(_describe(speed, motion, drive) for speed in _fixed_speeds(motion))


def cycle_multiplier(speed_rad_s: float, motion: OneSided) -> float:
    """Return the slope of the succession function; NaN where a jump is too near on both sides of every step tried."""
    step = _SUCCESSION_STEP * motion.pulse_rad_s2 * motion.pulse_s
    pulses = one_return(speed_rad_s, motion).pulses
    for _ in range(_HALVINGS):
        low, high = one_return(speed_rad_s - step, motion), one_return(speed_rad_s + step, motion)
        if low.pulses == pulses == high.pulses:
            return (high.rate_rad_s - low.rate_rad_s) / (2.0 * step)
        step *= 0.5
    return math.nan


def critical_viscous_loss_n_m(drive: WheelDrive, law: SwitchingLaw) -> float:
    """Return the viscous loss M_v above which the cycle of one pulse is stable, N m: exact multiplier -1.

    The formula of `single_pulse_forms` gives the first guess; the sign of the momentum is taken as kept.
    """
    guess = single_pulse_forms(drive, law.pulse_s).critical_viscous_loss_n_m

    def above_minus_one(loss_n_m: float) -> float:
        motion = one_sided_motion(drive._replace(viscous_loss_n_m=loss_n_m), law)
        return cycle_multiplier(_single_pulse_speed(motion), motion) + 1.0

    return brent_root(above_minus_one, 0.5 * guess, 2.0 * guess, 1e-12)


def _single_pulse_speed(motion: OneSided) -> float:
    """Return the fixed point near half the gain of one pulse."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    return brent_root(lambda speed: one_return(speed, motion).rate_rad_s - speed, 0.4 * gained, 0.6 * gained)


def _fixed_speeds(motion: OneSided) -> list[float]:
    """Return the fixed points of the succession function between 0 and the gain of one pulse."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    speeds = np.linspace(0.0, gained, SCANNED_SPEEDS + 2)[1:-1]
    excess = succession(speeds, motion) - speeds
    found = []
    for k in np.flatnonzero(excess[:-1] * excess[1:] <= 0.0):
        speed = brent_root(lambda w: one_return(w, motion).rate_rad_s - w, float(speeds[k]), float(speeds[k + 1]))
        if abs(one_return(speed, motion).rate_rad_s - speed) <= _JUMP * gained:
            found.append(speed)
    return found


def _describe(speed: float, motion: OneSided, drive: WheelDrive) -> LimitCycle:
    """Return the limit cycle of a fixed point, by one return from it."""
    visit = one_return(speed, motion)
    multiplier = cycle_multiplier(speed, motion)
    # outward is against the momentum: the body's rate is minus u times its sign
    side = math.copysign(1.0, drive.momentum_n_m_s)
    ends = [drive.momentum_n_m_s - side * drive.inertia_kg_m2 * u for u in (visit.rate_min_rad_s, visit.rate_max_rad_s)]
    low, high = min(ends), max(ends)
    is_consistent = low * high > 0.0 and max(-low, high) <= drive.momentum_limit_n_m_s
    return LimitCycle(
        speed_rad_s=speed,
        period_s=visit.elapsed_s,
        inner_rad=visit.inner_rad,
        outer_rad=visit.outer_rad,
        rate_rad_s=max(-visit.rate_min_rad_s, visit.rate_max_rad_s),
        pulses=visit.pulses,
        multiplier=multiplier,
        is_stable=abs(multiplier) < 1.0,
        momentum_n_m_s=(low, high),
        is_momentum_consistent=is_consistent,
    )
