"""The pulses of one command: a slew that ends without a rate, then rare pulses against a torque that is known.

A spacecraft behind a link cannot be asked again at once, so a command holds for its whole horizon: the slew of
`quaternion_law.tracking_request` within its first part, and from there on pulses that hold the spacecraft where the
slew has left it. What is too much for the envelope is asked for in smaller steps: first the horizon becomes shorter,
then the slew. Nothing is cut afterwards, but where a wheel has no room. Order everywhere: yaw, roll, pitch. Functions
of arrays are compiled as they stand.
"""

import math
import sys
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.compiled_entry import CompiledEntry
from service.core.control import quaternion_law, slew_schedule, wheel_allocation
from service.core.control.quaternion_law import Gains, product_about, tracking_request
from service.core.control.slew_schedule import (
    AXIS,
    DURATION_S,
    LONGEST_SHARE,
    START_S,
    TORQUE_N_M,
    Drive,
    Envelope,
    copy_pulse,
    is_slew_possible,
    is_within_envelope,
    last_stop_s,
    overlapping_axis,
    put_pulse,
    shape_pulses,
    sort_pulses,
    steps_at_limit,
    write_slew,
)
from service.core.control.wheel_allocation import Allocation, Wheels, allocate

#: yaw beyond it settles with roll and pitch how long a command holds, deg
_YAW_COUNTS_DEG = 0.3
#: shares of the envelope to plan with where rounded pulses pass a limit; the last one leaves no pulse
_SMALLER_SHARES = (0.7, 0.4, 0.0)


class Situation(NamedTuple):
    """The spacecraft as a row knows it; (3,) each."""

    attitude_deg: FloatArray
    rates_deg_s: FloatArray
    #: axes about which nothing may be commanded are False
    is_allowed: BoolArray
    #: from then until the command begins
    ahead_s: float = 0.0


class KnownTorque(NamedTuple):
    """Disturbance torque that is expected."""

    #: (3, 3) N m: constant, cosine and sine, each by axis
    parts_n_m: FloatArray
    period_s: float
    #: when the command begins, since the phase was zero
    since_s: float


class Horizon(NamedTuple):
    """Division of a command in time."""

    slew_s: float
    slice_s: float
    #: after the slew
    slices: int
    #: the envelope holds until then also where fewer slices follow the slew
    least_s: float = 0.0


class PlannedPulses(NamedTuple):
    """Pulses of a command."""

    #: (n, 4) axis, start, duration, torque, in order of time
    pulses: FloatArray
    #: until then it holds; NaN: a number is not finite, or the drive cannot give the slew in its time
    horizon_s: float
    #: whether the envelope made the slew smaller than the law wanted it
    is_shortened: bool


def plan_command(
    gains: Gains,
    drive: Drive,
    situation: Situation,
    torque: KnownTorque,
    horizon: Horizon,
    envelope: Envelope,
    own_share: float,
) -> PlannedPulses:
    """Return the pulses of a command.

    Parameters
    ----------
    gains : Gains
        Of `quaternion_law.loop_gains`.
    drive : Drive
        Limit, quantum, shortest pulse and grid.
    situation : Situation
        Angles, rates and what may be commanded.
    torque : KnownTorque
        The torque to be balanced.
    horizon : Horizon
        The slew's time and what follows.
    envelope : Envelope
        What the command may change at most against no command, until its horizon ends.
    own_share : float
        Share of the envelope with which pulses are planned; smaller ones where their rounding passes a limit.

    Notes
    -----
    When the slew ends the spacecraft has no rate and the torque has been balanced until then; after each slice angle
    and rate are back, but for what the shortest pulse cannot express, which the next slice takes.
    """
    pulses, fitted = np.empty((3 * horizon.slices + 9, 4)), np.empty((2, 3))
    # mean over the slew and over each slice after it
    expected = np.empty((1 + horizon.slices, 3))
    for part in range(1 + horizon.slices):
        middle_s = 0.5 * horizon.slew_s if part == 0 else horizon.slew_s + horizon.slice_s * (part - 0.5)
        _write_torque(expected[part], torque, middle_s)
    request = _write_request(gains, situation, torque, expected[0], horizon)
    is_yaw_far, attempts = abs(request[2, 0]) > _YAW_COUNTS_DEG, 1 + len(_SMALLER_SHARES)
    if not (is_slew_possible(drive, horizon.slew_s) and _are_finite(request, expected)):
        attempts = 0
    for attempt in range(attempts):
        limits = _part_of(envelope, own_share if attempt == 0 else _SMALLER_SHARES[attempt - 1])
        slices = _fit(fitted, request, gains.inertia_kg_m2, expected, horizon, limits, is_yaw_far)
        count = _write_pulses(pulses, fitted, gains, drive, situation.is_allowed, expected, horizon, slices)
        if count < 0 or overlapping_axis(pulses[:count]) >= 0:
            break
        horizon_s = horizon.slew_s + slices * horizon.slice_s
        stop_s = last_stop_s(pulses[:count], max(horizon.least_s, horizon_s))
        if is_within_envelope(pulses[:count], gains.inverse_1_kg_m2, stop_s, envelope):
            return PlannedPulses(pulses[:count], horizon_s, _is_other(fitted[0], request[0]))
    return PlannedPulses(pulses[:0], math.nan, False)


def _are_finite(request: FloatArray, expected_n_m: FloatArray) -> bool:
    total = 0.0
    for axis in range(3):
        for row in range(3):
            total += request[row, axis]
        for row in range(len(expected_n_m)):
            total += expected_n_m[row, axis]
    return math.isfinite(total)


def _is_other(fitted: FloatArray, request: FloatArray) -> bool:
    is_other = False
    for axis in range(3):
        is_other |= abs(fitted[axis] - request[axis]) > 1e-12
    return is_other


def _part_of(envelope: Envelope, share: float) -> Envelope:
    angle_deg, rate_deg_s, impulse_n_m_s, an_hour_n_m_s = envelope
    return Envelope(share * angle_deg, share * rate_deg_s, share * impulse_n_m_s, share * an_hour_n_m_s)


def _write_torque(expected_n_m: FloatArray, torque: KnownTorque, at_s: float) -> None:
    """Write the torque (3,) expected at an instant after the beginning of the command."""
    phase = 2.0 * math.pi * (torque.since_s + at_s) / torque.period_s
    cosine, sine = math.cos(phase), math.sin(phase)
    for axis in range(3):
        constant, along, across = torque.parts_n_m[0, axis], torque.parts_n_m[1, axis], torque.parts_n_m[2, axis]
        expected_n_m[axis] = constant + along * cosine + across * sine


def _write_request(
    gains: Gains, situation: Situation, torque: KnownTorque, expected_n_m: FloatArray, horizon: Horizon
) -> FloatArray:
    """Return the request (3, 3): change, rad, and rate, rad/s, of the slew's pulses, and angles, deg, before them.

    The law's slew, and the effect of the disturbance torque until its end.
    """
    request, pushed, rates = np.zeros((3, 3)), np.empty(3), np.empty(3)
    ahead_s = situation.ahead_s
    _write_torque(pushed, torque, -0.5 * ahead_s)
    for axis in range(3):
        pushed_deg_s2 = math.degrees(product_about(gains.inverse_1_kg_m2, axis, pushed))
        turned_deg = situation.rates_deg_s[axis] * ahead_s + 0.5 * pushed_deg_s2 * ahead_s**2
        request[2, axis] = situation.attitude_deg[axis] + turned_deg
        rates[axis] = situation.rates_deg_s[axis] + pushed_deg_s2 * ahead_s
    slew = tracking_request(gains, request[2], rates, horizon.slew_s)
    for axis in range(3):
        pushed_rad_s2 = product_about(gains.inverse_1_kg_m2, axis, expected_n_m)
        if situation.is_allowed[axis]:
            request[0, axis] = slew.angle_change_rad[axis] + 0.5 * pushed_rad_s2 * horizon.slew_s**2
            request[1, axis] = slew.rate_rad_s[axis] + pushed_rad_s2 * horizon.slew_s
        elif not math.isfinite(slew.angle_change_rad[axis] + slew.rate_rad_s[axis]):
            request[0, axis] = math.nan
    return request


def _fit(
    fitted: FloatArray,
    request: FloatArray,
    inertia_kg_m2: FloatArray,
    expected_n_m: FloatArray,
    horizon: Horizon,
    envelope: Envelope,
    is_yaw_far: bool,  # noqa: FBT001 numba knows no arguments by keyword alone
) -> int:
    """Write change and rate (2, 3) of a wish inside the envelope and return how many slices may follow it.

    Yaw, known ten times worse than roll and pitch, makes do with what is left until it is far off: a torque of 1e-6 N m
    leaves nothing to it in an hour.
    """
    slices, has_room = horizon.slices, False
    angle, step = math.radians(envelope.angle_change_deg), math.radians(envelope.rate_change_deg_s)
    while not has_room:
        has_room = True
        stop_s = max(horizon.slew_s + slices * horizon.slice_s, horizon.least_s)
        for axis in range(3):
            # sum of the rates that balancing gives, and what they turn until the horizon
            gross, turned = 0.0, 0.0
            for number in range(slices):
                given = expected_n_m[1 + number, axis] * horizon.slice_s / inertia_kg_m2[axis, axis]
                gross += abs(given)
                turned += given * (stop_s - (horizon.slew_s + horizon.slice_s * (number + 0.5)))
            room = envelope.impulse_n_m_s / inertia_kg_m2[axis, axis] - gross
            change, rate = request[0, axis], request[1, axis]
            if axis == 0 and not is_yaw_far:
                has_room &= room >= 0.0 and abs(turned) <= angle
            else:
                lower, upper = _bounds(rate, turned, room, angle, step, stop_s, horizon.slew_s)
                has_room &= lower <= change <= upper
            # the greatest rate that any slew may lose
            most = max(min(step, room, (angle - abs(turned)) / stop_s), 0.0)
            rate = min(max(rate, -most), most)
            lower, upper = _bounds(rate, turned, room, angle, step, stop_s, horizon.slew_s)
            fitted[0, axis], fitted[1, axis] = min(max(change, lower), max(lower, upper)), rate
        if not has_room and slices > 0:
            slices -= 1
        else:
            has_room = True
    return slices


def _bounds(
    rate: float, turned: float, room: float, angle: float, step: float, horizon_s: float, slew_s: float
) -> tuple[float, float]:
    """Return the least and greatest change of the slew, rad, with which a command keeps to the envelope.

    With x = change over the time between its pulses, the first one gives the rate x - rate, the second one takes x;
    until the horizon ends they turn the spacecraft by change - rate * horizon, the slices by their own part.
    """
    apart_s = (1.0 - LONGEST_SHARE) * slew_s
    at_end, at_slew = rate * horizon_s + turned, rate * slew_s
    lower = max(-angle + at_end, -angle + at_slew, apart_s * (rate - step), apart_s * (rate - room) / 2.0)
    upper = min(angle + at_end, angle + at_slew, apart_s * (rate + step), apart_s * (rate + room) / 2.0)
    return lower, upper


def _write_pulses(
    pulses: FloatArray,
    fitted: FloatArray,
    gains: Gains,
    drive: Drive,
    is_allowed: BoolArray,
    expected_n_m: FloatArray,
    horizon: Horizon,
    slices: int,
) -> int:
    """Write the pulses of a slew and of the slices after it, and return how many; -1: the drive cannot."""
    slew = write_slew(pulses, fitted[0], fitted[1], gains.inertia_kg_m2, gains.inverse_1_kg_m2, horizon.slew_s, drive)
    if slew < 0:
        return slew
    count = 0
    for number in range(slew):
        if is_allowed[int(pulses[number, AXIS])]:
            count = copy_pulse(pulses, count, number)
    slew = count
    for axis in range(3):
        if is_allowed[axis] and slices > 0:
            momentum = product_about(gains.inertia_kg_m2, axis, fitted[1])
            for number in range(slew):
                if pulses[number, AXIS] == axis:
                    momentum += pulses[number, TORQUE_N_M] * pulses[number, DURATION_S]
            torques = expected_n_m[1 : 1 + slices, axis]
            count = _put_balancing(pulses, count, axis, momentum, torques, horizon, drive)
    sort_pulses(pulses, count)
    return count


def _put_balancing(
    pulses: FloatArray,
    count: int,
    axis: int,
    momentum_n_m_s: float,
    torques_n_m: FloatArray,
    horizon: Horizon,
    drive: Drive,
) -> int:
    """Write the pulses that hold an axis against a torque, one at the beginning of each slice and one at the end."""
    slice_s, angle = horizon.slice_s, 0.0
    for number in range(len(torques_n_m)):
        torque = torques_n_m[number]
        wanted = -0.5 * torque * slice_s - angle / slice_s - momentum_n_m_s
        duration_s, strength = _nearest_pulse(wanted, slice_s, drive)
        count = put_pulse(pulses, count, axis, horizon.slew_s + number * slice_s, duration_s, strength)
        momentum_n_m_s += strength * duration_s
        angle += momentum_n_m_s * slice_s + 0.5 * torque * slice_s**2
        momentum_n_m_s += torque * slice_s
    duration_s, strength = _nearest_pulse(-momentum_n_m_s, slice_s, drive)
    stop_s = horizon.slew_s + len(torques_n_m) * slice_s
    return put_pulse(pulses, count, axis, stop_s - duration_s, duration_s, strength)


def _nearest_pulse(impulse_n_m_s: float, slice_s: float, drive: Drive) -> tuple[float, float]:
    """Return duration and torque of the pulse nearest to an impulse; where that is none it does not last."""
    # of two pulses in a slice, at its beginning and at its end, none may reach the other
    steps = max(1, math.ceil(abs(impulse_n_m_s) / (drive.quantum_n_m * LONGEST_SHARE * slice_s)))
    torque = min(steps, steps_at_limit(drive)) * drive.quantum_n_m
    ideal_s = min(abs(impulse_n_m_s) / torque, LONGEST_SHARE * slice_s)
    duration_s = round(ideal_s / drive.time_step_s) * drive.time_step_s
    if duration_s < drive.min_pulse_s / 2.0:
        return 0.0, 0.0
    return max(duration_s, drive.min_pulse_s), math.copysign(torque, impulse_n_m_s)


class MeanPulses(NamedTuple):
    """Pulses whose mean is a torque."""

    #: (n, 4) axis, start, duration, torque
    pulses: FloatArray
    #: (3,) N m s, what they leave for later
    carry_n_m_s: FloatArray
    #: whether the law wanted more
    is_cut: bool


def mean_command(
    gains: Gains,
    drive: Drive,
    torque_n_m: FloatArray,
    carry_n_m_s: FloatArray,
    is_allowed: BoolArray,
    period_s: float,
    envelope: Envelope,
    are_axes_together: bool,  # noqa: FBT001 numba knows no arguments by keyword alone
) -> MeanPulses:
    """Return the pulses of a mean torque of which every command of an hour may give its share of the envelope.

    Parameters
    ----------
    gains : Gains
        Of `quaternion_law.loop_gains`.
    drive : Drive
        Limit, quantum, shortest pulse and grid.
    torque_n_m, carry_n_m_s : ndarray, shape (3,)
        Torque that the law wants, and impulse left over from earlier commands.
    is_allowed : ndarray, shape (3,)
        Axes about which something may be commanded.
    period_s : float, s
        Until the next command.
    envelope : Envelope
        Whenever the command acts; infinite limits: none.
    are_axes_together : bool
        Whether a cut about one axis cuts the others alike.
    """
    pulses, count = np.empty((3, 4)), 0
    wanted, carry, shares = np.zeros(3), np.zeros(3), np.empty(3)
    for axis in range(3):
        if is_allowed[axis]:
            wanted[axis], carry[axis] = torque_n_m[axis], carry_n_m_s[axis]
    an_hour, least = max(1.0, _HOUR_S / period_s), 1.0
    for axis in range(3):
        rate = 0.0
        for other in range(3):
            rate += abs(gains.inverse_1_kg_m2[axis, other]) * abs(wanted[other]) * period_s
        rate_deg_s, impulse = math.degrees(rate), abs(wanted[axis]) * period_s
        shares[axis] = min(
            _share(envelope.angle_change_deg, rate_deg_s * period_s),
            _share(envelope.rate_change_deg_s, rate_deg_s),
            _share(envelope.impulse_n_m_s, impulse),
            _share(envelope.impulse_an_hour_n_m_s, impulse * an_hour),
        )
        least = min(least, shares[axis])
    for axis in range(3):
        wanted[axis] *= least if are_axes_together else shares[axis]
    train, is_cut = shape_pulses(wanted, carry, period_s, drive), least < 1.0
    for axis in range(3):
        is_cut |= train.is_saturated[axis]
        count = put_pulse(pulses, count, axis, 0.0, train.duration_s[axis], train.torque_n_m[axis])
    return MeanPulses(pulses[:count], train.carry_n_m_s, is_cut)


_HOUR_S = 3600.0


def _share(limit: float, asked: float) -> float:
    return limit / asked if asked > limit else 1.0


class AllocatedPulses(NamedTuple):
    """Pulses for which the wheels have room, and what they change when the period ends."""

    #: (n, 4) axis, start, duration, torque
    pulses: FloatArray
    #: (W,) N m, each wheel's share of the mean torque, null motion included
    wheels_n_m: FloatArray
    #: (3, 3) impulse, N m s, change of the angles, deg, and of the rates, deg/s
    effect: FloatArray
    #: whether a wheel at its limit of momentum made the pulses shorter
    is_cut: bool


def allocate_pulses(
    pulses: FloatArray, gains: Gains, drive: Drive, wheels: Wheels, momentum_n_m_s: FloatArray, period_s: float
) -> AllocatedPulses:
    """Return each wheel's share of the mean torque of pulses; one at its limit of momentum makes all of them shorter.

    Parameters
    ----------
    pulses : ndarray, shape (n, 4)
        Of `plan_command` or `mean_command`.
    gains : Gains
        Of `quaternion_law.loop_gains`.
    drive : Drive
        Shortest pulse and grid of durations.
    wheels : Wheels
        Of `wheel_allocation.wheel_set`.
    momentum_n_m_s : ndarray, shape (W,), N m s
        Of each wheel at the beginning.
    period_s : float, s
        How long the command lasts.

    Notes
    -----
    Each pulse's rate turns the body from its middle on.
    """
    pulses, effect, torque, turned = pulses.copy(), np.empty((3, 3)), np.empty(3), np.empty(3)
    count = len(pulses)
    allocation = _allocation(effect[0], torque, turned, pulses, wheels, momentum_n_m_s, period_s)
    share = allocation.share
    if share < 1.0:
        count = _shorten(pulses, share, drive)
        allocation = _allocation(effect[0], torque, turned, pulses[:count], wheels, momentum_n_m_s, period_s)
    for axis in range(3):
        effect[1, axis] = math.degrees(product_about(gains.inverse_1_kg_m2, axis, turned))
        effect[2, axis] = math.degrees(product_about(gains.inverse_1_kg_m2, axis, effect[0]))
    return AllocatedPulses(pulses[:count], allocation.wheels_n_m, effect, share < 1.0)


def _allocation(
    impulse_n_m_s: FloatArray,
    torque_n_m: FloatArray,
    turned: FloatArray,
    pulses: FloatArray,
    wheels: Wheels,
    momentum_n_m_s: FloatArray,
    period_s: float,
) -> Allocation:
    """Return the allocation of the mean torque of pulses; write their impulse, it and the impulse times its time left.

    All are (3,), the last one in N m s^2.
    """
    for axis in range(3):
        impulse_n_m_s[axis], turned[axis] = 0.0, 0.0
    for number in range(len(pulses)):
        impulse, axis = pulses[number, TORQUE_N_M] * pulses[number, DURATION_S], int(pulses[number, AXIS])
        impulse_n_m_s[axis] += impulse
        turned[axis] += impulse * (period_s - pulses[number, START_S] - 0.5 * pulses[number, DURATION_S])
    for axis in range(3):
        torque_n_m[axis] = impulse_n_m_s[axis] / period_s
    return allocate(wheels, torque_n_m, momentum_n_m_s, period_s)


def _shorten(pulses: FloatArray, share: float, drive: Drive) -> int:
    """Make pulses shorter and return how many are not too short then."""
    count = 0
    for number in range(len(pulses)):
        duration_s = int(pulses[number, DURATION_S] * share / drive.time_step_s) * drive.time_step_s
        if duration_s >= drive.min_pulse_s:
            count = copy_pulse(pulses, count, number)
            pulses[count - 1, DURATION_S] = duration_s
    return count


def plan_allocated(
    gains: Gains,
    drive: Drive,
    wheels: Wheels,
    situation: Situation,
    torque: KnownTorque,
    horizon: Horizon,
    envelope: Envelope,
    own_share: float,
    momentum_n_m_s: FloatArray,
    period_s: float,
) -> tuple[AllocatedPulses, float]:
    """Return the pulses of `plan_command` as `allocate_pulses` leaves them, and until when they hold, s; NaN: none are.

    They hold for `period_s` where the horizon has a least length, else as long as was planned.
    """
    plan = plan_command(gains, drive, situation, torque, horizon, envelope, own_share)
    if math.isnan(plan.horizon_s):
        return AllocatedPulses(plan.pulses, momentum_n_m_s, np.zeros((3, 3)), plan.is_shortened), plan.horizon_s
    held_s = period_s if horizon.least_s > 0.0 else plan.horizon_s
    pulses, wheels_n_m, effect, is_cut = allocate_pulses(plan.pulses, gains, drive, wheels, momentum_n_m_s, held_s)
    return AllocatedPulses(pulses, wheels_n_m, effect, is_cut or plan.is_shortened), held_s


_MODULES = (quaternion_law, wheel_allocation, slew_schedule, sys.modules[__name__])
#: the same functions compiled, with `quaternion_law.feedback_torque`
compiled_plan, compiled_mean, compiled_allocation, compiled_law = (
    CompiledEntry(run, _MODULES)
    for run in (plan_allocated, mean_command, allocate_pulses, quaternion_law.feedback_torque)
)
