"""Slews as pairs of pulses, rare pulses for a mean torque, and the envelope of a command.

Functions of arrays are compiled as they stand. Pulses are rows of an array (n, 4) there: axis, start, duration, torque.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import BoolArray, FloatArray
from service.core.control.quaternion_law import inverse_of, product_about
from service.core.control.wheel_allocation import allocate_to_wheels

Triple = tuple[float, float, float]

#: share of the horizon that one pulse may take
LONGEST_SHARE = 0.1
_ROUNDING = 1e-9
_AXES = ("yaw", "roll", "pitch")
#: columns of pulses
AXIS, START_S, DURATION_S, TORQUE_N_M = 0, 1, 2, 3


class Drive(NamedTuple):
    """Torque limit, quantum and time step of the wheel drives, about each body axis."""

    limit_n_m: float
    #: pulse torques are whole multiples of it
    quantum_n_m: float
    min_pulse_s: float
    #: grid of durations
    time_step_s: float


def steps_at_limit(drive: Drive) -> int:
    """Return the quanta within the limit."""
    return math.floor(drive.limit_n_m / drive.quantum_n_m * (1.0 + 1e-12))


class AxisPulse(NamedTuple):
    """A torque about one axis that ends by itself."""

    #: 0 yaw, 1 roll, 2 pitch
    axis: int
    #: from the beginning of the schedule
    start_s: float
    duration_s: float
    torque_n_m: float

    @property
    def stop_s(self) -> float:
        """When it ends."""
        return self.start_s + self.duration_s

    @property
    def impulse_n_m_s(self) -> float:
        """Torque times duration."""
        return self.torque_n_m * self.duration_s


def axis_pulses(pulses: FloatArray) -> tuple[AxisPulse, ...]:
    """Return rows of pulses (n, 4) by name."""
    return tuple(AxisPulse(int(axis), *numbers) for axis, *numbers in pulses.tolist())


class PulseTrain(NamedTuple):
    """One pulse an axis and what stays for the next period."""

    #: (3,) N m, 0 = no pulse on this axis
    torque_n_m: FloatArray
    #: (3,) s
    duration_s: FloatArray
    #: (3,) N m s, torque times duration
    impulse_n_m_s: FloatArray
    #: (3,) N m s, wanted but not yet given
    carry_n_m_s: FloatArray
    #: (3,) whether the torque limit cut the wanted impulse
    is_saturated: BoolArray


def shape_pulses(torque_n_m: FloatArray, carry_n_m_s: FloatArray, period_s: float, drive: Drive) -> PulseTrain:
    """Return the pulses that give a mean torque over one command period.

    Parameters
    ----------
    torque_n_m : ndarray, shape (3,), N m
        Wanted mean torque on each axis.
    carry_n_m_s : ndarray, shape (3,), N m s
        Impulse left over from earlier periods.
    period_s : float, s
        Command period; every pulse ends inside it.
    drive : Drive
        Limit, quantum, shortest pulse and grid.

    Returns
    -------
    PulseTrain
        The impulse given plus the new carry equals the wanted impulse plus the old carry wherever nothing saturated;
        where it did, the carry is zero: a saturated wish is not saved up (no wind-up). A limit below the quantum
        allows no pulse at all.
    """
    quantum_n_m, step_s, most = drive.quantum_n_m, drive.time_step_s, steps_at_limit(drive)
    train = PulseTrain(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3, np.bool_))
    longest_s = math.floor(period_s / step_s * (1.0 + 1e-12)) * step_s
    for axis in range(3):
        wanted = torque_n_m[axis] * period_s + carry_n_m_s[axis]
        # a period shorter than the grid of durations has room for no pulse; its wish is carried on
        steps = math.ceil(abs(wanted) / (quantum_n_m * max(longest_s, step_s)))
        is_saturated = steps > most
        steps = min(max(steps, 1), max(most, 1))
        ideal_s = min(abs(wanted) / (steps * quantum_n_m), longest_s)
        duration_s = math.floor(ideal_s / step_s * (1.0 + 1e-12)) * step_s
        if wanted != 0.0 and duration_s >= drive.min_pulse_s and steps <= most:
            train.torque_n_m[axis], train.duration_s[axis] = math.copysign(steps * quantum_n_m, wanted), duration_s
            train.impulse_n_m_s[axis] = train.torque_n_m[axis] * duration_s
        train.carry_n_m_s[axis] = 0.0 if is_saturated else wanted - train.impulse_n_m_s[axis]
        train.is_saturated[axis] = is_saturated
    return train


def plan_slew(
    angle_change_deg: ArrayLike, rate_deg_s: ArrayLike, inertia_kg_m2: FloatArray, horizon_s: float, drive: Drive
) -> tuple[AxisPulse, ...]:
    """Return the pulses that turn a spacecraft by some angles within a time and leave it without a rate.

    Parameters
    ----------
    angle_change_deg : array_like, shape (3,), deg
        Wanted change of yaw, roll, pitch.
    rate_deg_s : array_like, shape (3,), deg/s
        Rate that the spacecraft has and shall lose.
    inertia_kg_m2 : ndarray, shape (3, 3), kg m^2
        Tensor in the order yaw, roll, pitch (`quaternion_law.inertia_about_angles`).
    horizon_s : float, s
        Both pulses lie within it.
    drive : Drive
        Limit, quantum, shortest pulse and grid.

    Returns
    -------
    tuple of AxisPulse
        In order of time. The angle is met by the time between the pulses, so quantum and grid cost no accuracy; a
        wish too small for the shortest pulse is left out. The rate left is below one tick of one quantum.

    Raises
    ------
    ValueError
        A number is not finite, the drive cannot give a pulse, or the time is too short for the torque.
    """
    change, rate = np.asarray(angle_change_deg, dtype=np.float64), np.asarray(rate_deg_s, dtype=np.float64)
    if change.shape != (3,) or rate.shape != (3,) or not (np.isfinite(change).all() and np.isfinite(rate).all()):
        raise ValueError("angle change and rate must be three finite numbers each: yaw, roll, pitch")
    if not all(math.isfinite(each) and each > 0.0 for each in (*drive, horizon_s)):
        raise ValueError("limit, quantum, shortest pulse, grid and horizon must be finite and positive")
    if steps_at_limit(drive) < 1:
        raise ValueError(f"the quantum {drive.quantum_n_m:g} N m exceeds the torque limit {drive.limit_n_m:g} N m")
    if not is_slew_possible(drive, horizon_s):
        raise ValueError(f"{horizon_s:g} s have no room for two pulses of at least {drive.min_pulse_s:g} s")
    inverse, pulses = inverse_of(inertia_kg_m2), np.zeros((6, 4))
    count = write_slew(pulses, np.radians(change), np.radians(rate), inertia_kg_m2, inverse, horizon_s, drive)
    if count < 0:
        axis, _, longest_s, wanted = pulses[0].tolist()
        raise ValueError(
            f"about {_AXES[int(axis)]} {wanted:.3g} N m s within {longest_s:g} s exceed the torque limit "
            f"{drive.limit_n_m:g} N m; allow the slew more time"
        )
    return axis_pulses(pulses[:count])


def is_slew_possible(drive: Drive, horizon_s: float) -> bool:
    """Return whether the drive can give two pulses within a time; no number that is not finite or not positive can."""
    least = min(drive.limit_n_m, drive.quantum_n_m, drive.min_pulse_s, drive.time_step_s, horizon_s)
    if not (least > 0.0 and math.isfinite(drive.limit_n_m) and math.isfinite(horizon_s)):
        return False
    return steps_at_limit(drive) >= 1 and drive.min_pulse_s <= LONGEST_SHARE * horizon_s


def write_slew(
    pulses: FloatArray,
    change_rad: FloatArray,
    rate_rad_s: FloatArray,
    inertia_kg_m2: FloatArray,
    inverse_1_kg_m2: FloatArray,
    horizon_s: float,
    drive: Drive,
) -> int:
    """Write the pulses of `plan_slew`, at most six, and return how many.

    -1: the torque limit is exceeded about the axis of the first row, whose other numbers are the longest duration and
    the wanted impulse.
    """
    longest_s = LONGEST_SHARE * horizon_s
    apart_s = horizon_s - longest_s
    # torque and duration of the first and of the second pulse, by axis
    pairs = np.zeros((2, 3, 2))
    turn, given = np.empty(3), np.zeros(3)
    for second in range(2):
        for axis in range(3):
            sailing = rate_rad_s[axis] + product_about(inverse_1_kg_m2, axis, given)
            turn[axis] = (0.0 if second else change_rad[axis] / apart_s) - sailing
        for axis in range(3):
            wanted = product_about(inertia_kg_m2, axis, turn)
            if not _shape(pairs[second, axis], wanted, drive, longest_s):
                put_pulse(pulses, 0, axis, 0.0, longest_s, abs(wanted))
                return -1
        for axis in range(3):
            given[axis] = pairs[second, axis, 0] * pairs[second, axis, 1]
    count = 0
    for axis in range(3):
        duration_s, last_s, sailing = pairs[0, axis, 1], pairs[1, axis, 1], -turn[axis]
        # what is still to be turned from the middle of the first pulse on, and when that is done
        left_rad = change_rad[axis] - rate_rad_s[axis] * duration_s / 2.0
        middle_s = (duration_s + last_s) / 2.0
        reached_s = left_rad / sailing if sailing != 0.0 else 0.0
        start_s = min(max(reached_s, middle_s), horizon_s - middle_s) + (duration_s - last_s) / 2.0
        count = put_pulse(pulses, count, axis, 0.0, duration_s, pairs[0, axis, 0])
        count = put_pulse(pulses, count, axis, start_s, last_s, pairs[1, axis, 0])
    sort_pulses(pulses, count)
    return count


def _shape(pulse: FloatArray, wanted_n_m_s: float, drive: Drive, longest_s: float) -> bool:
    """Write torque and duration of the pulse of an impulse, zeros where it would be below the shortest one.

    False: it exceeds the torque limit.
    """
    size = abs(wanted_n_m_s)
    steps = max(1, math.ceil(size / (drive.quantum_n_m * longest_s) - _ROUNDING))
    if steps > steps_at_limit(drive):
        return False
    torque = steps * drive.quantum_n_m
    duration_s = round(size / torque / drive.time_step_s) * drive.time_step_s
    # half of the shortest pulse is nearer to it than to nothing
    if drive.min_pulse_s / 2.0 <= duration_s < drive.min_pulse_s:
        duration_s = math.ceil(drive.min_pulse_s / drive.time_step_s - _ROUNDING) * drive.time_step_s
    if duration_s >= drive.min_pulse_s:
        pulse[0], pulse[1] = math.copysign(torque, wanted_n_m_s), duration_s
    return True


def put_pulse(pulses: FloatArray, count: int, axis: int, start_s: float, duration_s: float, torque_n_m: float) -> int:
    """Write a pulse, if it lasts, behind some others and return how many there are now."""
    pulses[count, AXIS], pulses[count, START_S] = axis, start_s
    pulses[count, DURATION_S], pulses[count, TORQUE_N_M] = duration_s, torque_n_m
    return count + 1 if duration_s > 0.0 else count


def copy_pulse(pulses: FloatArray, count: int, number: int) -> int:
    """Write one of some pulses again behind the first of them and return how many these are now."""
    for column in range(4):
        pulses[count, column] = pulses[number, column]
    return count + 1


def sort_pulses(pulses: FloatArray, count: int) -> None:
    """Put the first pulses in order of their beginnings, of one instant in order of axes."""
    for number in range(1, count):
        at = number
        while at > 0 and (
            pulses[at, START_S] < pulses[at - 1, START_S]
            or (pulses[at, START_S] == pulses[at - 1, START_S] and pulses[at, AXIS] < pulses[at - 1, AXIS])
        ):
            for column in range(4):
                pulses[at, column], pulses[at - 1, column] = pulses[at - 1, column], pulses[at, column]
            at -= 1


class Effect(NamedTuple):
    """Effect of a schedule against no command; triples in the order yaw, roll, pitch."""

    impulse_n_m_s: Triple
    #: sum of the sizes of all pulses: a pair that nulls itself counts lost_rad_s
    gross_impulse_n_m_s: Triple
    #: when the horizon ends
    angle_change_deg: Triple
    rate_change_deg_s: Triple
    #: greatest on the way, with sign
    peak_angle_deg: Triple
    peak_rate_deg_s: Triple
    #: (W,) N m s, change of each wheel's momentum
    wheel_momentum_n_m_s: tuple[float, ...]


def predicted_effect(
    pulses: Sequence[AxisPulse], inertia_kg_m2: FloatArray, wheel_axes: FloatArray, horizon_s: float
) -> Effect:
    """Return the effect of a schedule on angles, rates and wheels.

    Parameters
    ----------
    pulses : sequence of AxisPulse
        In any order; those about one axis must not overlap.
    inertia_kg_m2 : ndarray, shape (3, 3), kg m^2
        Tensor in the order yaw, roll, pitch.
    wheel_axes : ndarray, shape (W, 3)
        Unit axes in the same order (`wheel_allocation.Wheels.axes`).
    horizon_s : float, s
        Instant for which the change of the angles is stated; not before the last pulse ends.

    Raises
    ------
    ValueError
        Pulses overlap, are not finite, begin before zero, or end after the horizon.

    Notes
    -----
    Exact for a rigid body at small angles; the exchange of roll and yaw at the orbital rate is left out (at 1e-2 of
    the angle in half an hour it belongs to the filter, not to the command).
    """
    rows, inverse = _schedule(pulses, horizon_s), inverse_of(inertia_kg_m2)
    motion = schedule_motion(rows, inverse, np.array([0.0, horizon_s]))
    angle, rate = greatest(motion)
    impulse, gross = np.zeros(3), np.zeros(3)
    for pulse in pulses:
        impulse[pulse.axis] += pulse.impulse_n_m_s
        gross[pulse.axis] += abs(pulse.impulse_n_m_s)
    return Effect(
        impulse_n_m_s=_triple(impulse),
        gross_impulse_n_m_s=_triple(gross),
        angle_change_deg=_triple(np.degrees(motion.angle_rad[-1])),
        rate_change_deg_s=_triple(np.degrees(inverse @ impulse)),
        peak_angle_deg=_triple(np.degrees(angle)),
        peak_rate_deg_s=_triple(np.degrees(rate)),
        wheel_momentum_n_m_s=tuple(allocate_to_wheels(wheel_axes, impulse).tolist()),
    )


def predicted_angles(
    pulses: Sequence[AxisPulse], inertia_kg_m2: FloatArray, horizon_s: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return instants (count,), s, evenly until the horizon, and the change of the angles there (count, 3), deg.

    Parameters and exceptions are those of `predicted_effect`, whose change of the angles stands at the end.
    """
    instants_s: FloatArray = np.linspace(0.0, horizon_s, count)
    motion = schedule_motion(_schedule(pulses, horizon_s), inverse_of(inertia_kg_m2), instants_s)
    return instants_s, np.degrees(motion.angle_rad[np.searchsorted(motion.at_s, instants_s)])


def _triple(values: FloatArray) -> Triple:
    """Return an array (3,) as a tuple of plain numbers."""
    yaw, roll, pitch = values.tolist()
    return yaw, roll, pitch


def _schedule(pulses: Sequence[AxisPulse], horizon_s: float) -> FloatArray:
    """Return pulses as rows in order; refused where they overlap or do not lie within the horizon."""
    rows = np.array(sorted(pulses, key=lambda pulse: (pulse.start_s, pulse.axis)), dtype=np.float64).reshape(-1, 4)
    if not (np.isfinite(rows).all() and math.isfinite(horizon_s)):
        raise ValueError("pulses and horizon must be finite")
    if (rows[:, START_S] < 0.0).any() or (rows[:, DURATION_S] <= 0.0).any():
        raise ValueError("a pulse begins before the schedule or does not last")
    if last_stop_s(rows, 0.0) > horizon_s * (1.0 + _ROUNDING):
        raise ValueError(f"a pulse ends after the horizon of {horizon_s:g} s")
    axis = overlapping_axis(rows)
    if axis >= 0:
        raise ValueError(f"two pulses about {_AXES[axis]} overlap")
    return rows


def last_stop_s(pulses: FloatArray, least_s: float) -> float:
    """Return when the last of pulses (n, 4) has ended, not before another instant."""
    for number in range(len(pulses)):
        least_s = max(least_s, pulses[number, START_S] + pulses[number, DURATION_S])
    return least_s


def overlapping_axis(pulses: FloatArray) -> int:
    """Return the axis of a pulse, of some in order, that begins before another about it has ended; -1: none."""
    stop_s = np.zeros(3)
    for number in range(len(pulses)):
        axis, start_s = int(pulses[number, AXIS]), pulses[number, START_S]
        if start_s < stop_s[axis] * (1.0 - _ROUNDING):
            return axis
        stop_s[axis] = start_s + pulses[number, DURATION_S]
    return -1


class ScheduleMotion(NamedTuple):
    """Motion that pulses bring about, at K instants in order."""

    #: (K,) from the beginning of the schedule
    at_s: FloatArray
    #: (K, 3)
    angle_rad: FloatArray
    rate_rad_s: FloatArray


def schedule_motion(pulses: FloatArray, inverse_1_kg_m2: FloatArray, instants_s: FloatArray) -> ScheduleMotion:
    """Return the motion from rest at some instants, the last of them the horizon, and at every edge of a pulse."""
    at_s, count = np.empty(len(instants_s) + 2 * len(pulses)), 0
    for number in range(len(instants_s)):
        count = _insert(at_s, count, instants_s[number])
    for number in range(len(pulses)):
        count = _insert(at_s, count, pulses[number, START_S])
        stop_s = pulses[number, START_S] + pulses[number, DURATION_S]
        count = _insert(at_s, count, min(stop_s, instants_s[-1]))
    rate, angle, torque = np.zeros((count, 3)), np.zeros((count, 3)), np.empty(3)
    for k in range(1, count):
        middle_s, step_s = 0.5 * (at_s[k - 1] + at_s[k]), at_s[k] - at_s[k - 1]
        torque[0], torque[1], torque[2] = 0.0, 0.0, 0.0
        for number in range(len(pulses)):
            start_s = pulses[number, START_S]
            if start_s <= middle_s < start_s + pulses[number, DURATION_S]:
                torque[int(pulses[number, AXIS])] += pulses[number, TORQUE_N_M]
        for axis in range(3):
            rate[k, axis] = rate[k - 1, axis] + product_about(inverse_1_kg_m2, axis, torque) * step_s
            angle[k, axis] = angle[k - 1, axis] + 0.5 * (rate[k - 1, axis] + rate[k, axis]) * step_s
    return ScheduleMotion(at_s[:count], angle, rate)


def _insert(at_s: FloatArray, count: int, instant_s: float) -> int:
    """Put an instant among some in order and return how many there are now."""
    at = count
    while at > 0 and at_s[at - 1] > instant_s:
        at -= 1
    if at > 0 and at_s[at - 1] == instant_s:
        return count
    for number in range(count, at, -1):
        at_s[number] = at_s[number - 1]
    at_s[at] = instant_s
    return count + 1


def greatest(motion: ScheduleMotion) -> tuple[FloatArray, FloatArray]:
    """Return the greatest angle and rate (3,) on the way, with sign; where an axis turns back between two instants too.

    Exact: v^2 / 2a after an instant it turns back.
    """
    angle, rate = np.zeros(3), np.zeros(3)
    for axis in range(3):
        for k in range(len(motion.at_s)):
            before = motion.rate_rad_s[k, axis]
            if abs(before) > abs(rate[axis]):
                rate[axis] = before
            if abs(motion.angle_rad[k, axis]) > abs(angle[axis]):
                angle[axis] = motion.angle_rad[k, axis]
            if k + 1 == len(motion.at_s):
                continue
            after = motion.rate_rad_s[k + 1, axis]
            if before * after < 0.0:
                step_s = motion.at_s[k + 1] - motion.at_s[k]
                turning = motion.angle_rad[k, axis] + 0.5 * before**2 * step_s / (before - after)
                if abs(turning) > abs(angle[axis]):
                    angle[axis] = turning
    return angle, rate


class Envelope(NamedTuple):
    """Limits about each axis."""

    #: greatest change of an angle, on the way or at the end
    angle_change_deg: float = 0.2
    rate_change_deg_s: float = 3e-4
    impulse_n_m_s: Annotated[float, "Sum of the sizes of a command's pulses."] = 0.02
    impulse_an_hour_n_m_s: Annotated[float, "The same over everything that was sent within an hour."] = 0.1

    def is_within(self, other: "Envelope") -> bool:
        """Return whether no limit is wider than another envelope's, and each is a positive number."""
        return all(0.0 < own <= limit for own, limit in zip(self, other, strict=True))


def is_within_envelope(pulses: FloatArray, inverse_1_kg_m2: FloatArray, horizon_s: float, envelope: Envelope) -> bool:
    """Return whether pulses (n, 4), in order and without an overlap, exceed no limit, nothing sent before them."""
    angle, rate = greatest(schedule_motion(pulses, inverse_1_kg_m2, np.array((0.0, horizon_s))))
    gross, wider = np.zeros(3), 1.0 + _ROUNDING
    for number in range(len(pulses)):
        gross[int(pulses[number, AXIS])] += abs(pulses[number, TORQUE_N_M] * pulses[number, DURATION_S])
    for axis in range(3):
        if not (
            math.degrees(abs(angle[axis])) <= envelope.angle_change_deg * wider
            and math.degrees(abs(rate[axis])) <= envelope.rate_change_deg_s * wider
            and gross[axis] <= min(envelope.impulse_n_m_s, envelope.impulse_an_hour_n_m_s) * wider
        ):
            return False
    return True


class Excess(NamedTuple):
    """One limit that a command exceeds."""

    #: yaw, roll or pitch
    axis: str
    #: name of the limit
    quantity: str
    value: float
    limit: float

    def __str__(self) -> str:
        """Return the excess in words."""
        return f"{self.axis} {self.quantity} {self.value:.3g} of {self.limit:g}"


def envelope_excesses(effect: Effect, sent_n_m_s: Triple, envelope: Envelope) -> tuple[Excess, ...]:
    """Return the limits of the envelope that a command exceeds; none: it may be released.

    Parameters
    ----------
    effect : Effect
        Of `slew_schedule.predicted_effect`.
    sent_n_m_s : tuple of float, N m s
        Yaw, roll, pitch: sum of the sizes of the impulses sent within the hour before.
    envelope : Envelope
        The limits.

    Notes
    -----
    Each change is taken at its greatest, on the way as well as at the end: a pair of pulses that nulls itself would
    otherwise count for nothing. What is not a number is beyond every limit.
    """
    measured = {
        "angle_change_deg": np.maximum(np.abs(effect.peak_angle_deg), np.abs(effect.angle_change_deg)),
        "rate_change_deg_s": np.maximum(np.abs(effect.peak_rate_deg_s), np.abs(effect.rate_change_deg_s)),
        "impulse_n_m_s": np.array(effect.gross_impulse_n_m_s),
        "impulse_an_hour_n_m_s": np.add(sent_n_m_s, effect.gross_impulse_n_m_s),
    }
    found = []
    for (quantity, values), limit in zip(measured.items(), envelope, strict=True):
        for axis, value in zip(_AXES, values.tolist(), strict=True):
            # negated, so that a value that is no number is beyond
            if not value <= limit * (1.0 + _ROUNDING):
                found.append(Excess(axis, quantity, value, limit))
    return tuple(found)
