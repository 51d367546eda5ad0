"""Slews as pairs of pulses, rare pulses for a mean torque, and the envelope of a command."""

import math
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import BoolArray, FloatArray
from service.core.control.wheel_allocation import allocate_to_wheels


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


def shape_pulses(
    torque_n_m: FloatArray,
    carry_n_m_s: FloatArray,
    *,
    period_s: float,
    limit_n_m: float,
    quantum_n_m: float,
    min_pulse_s: float,
    time_step_s: float,
) -> PulseTrain:
    """Return the pulses that give a mean torque over one command period.

    Parameters
    ----------
    torque_n_m : ndarray, shape (3,), N m
        Wanted mean torque on each axis.
    carry_n_m_s : ndarray, shape (3,), N m s
        Impulse left over from earlier periods.
    period_s : float, s
        Command period; every pulse ends inside it.
    limit_n_m : float, N m
        Greatest torque on an axis.
    quantum_n_m : float, N m
        Smallest step of the drive; pulse torques are whole multiples of it.
    min_pulse_s, time_step_s : float, s
        Shortest pulse and the grid of durations.

    Returns
    -------
    PulseTrain
        The impulse given plus the new carry equals the wanted impulse plus the old carry wherever nothing saturated;
        where it did, the carry is zero: a saturated wish is not saved up (no wind-up). A limit below the quantum
        allows no pulse at all.
    """
    wanted = torque_n_m * period_s + carry_n_m_s
    steps_at_limit = np.floor(limit_n_m / quantum_n_m * (1.0 + 1e-12))
    longest_s = np.floor(period_s / time_step_s * (1.0 + 1e-12)) * time_step_s
    # a period shorter than the grid of durations has room for no pulse; its wish is carried on
    steps = np.ceil(np.abs(wanted) / (quantum_n_m * max(longest_s, time_step_s)))
    is_saturated = steps > steps_at_limit
    steps = np.clip(steps, 1.0, max(steps_at_limit, 1.0))
    ideal_s = np.minimum(np.abs(wanted) / (steps * quantum_n_m), longest_s)
    duration_s = np.floor(ideal_s / time_step_s * (1.0 + 1e-12)) * time_step_s
    is_given = (duration_s >= min_pulse_s) & (steps <= steps_at_limit)
    duration_s = np.where(is_given, duration_s, 0.0)
    torque = np.where(is_given, np.sign(wanted) * steps * quantum_n_m, 0.0)
    impulse = torque * duration_s
    carry = np.where(is_saturated, 0.0, wanted - impulse)
    return PulseTrain(torque, duration_s, impulse, carry, is_saturated)


Triple = tuple[float, float, float]

#: share of the horizon that one pulse may take
LONGEST_SHARE = 0.1
_ROUNDING = 1e-9
_AXES = ("yaw", "roll", "pitch")


class Drive(NamedTuple):
    """Torque limit, quantum and time step of the wheel drives, about each body axis."""

    limit_n_m: float
    #: pulse torques are whole multiples of it
    quantum_n_m: float
    min_pulse_s: float
    #: grid of durations
    time_step_s: float

    @property
    def steps_at_limit(self) -> int:
        """Quanta within the limit."""
        return math.floor(self.limit_n_m / self.quantum_n_m * (1.0 + 1e-12))


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
    change, rate = _finite_triples(angle_change_deg, rate_deg_s)
    _require_drive(drive, horizon_s)
    longest_s = LONGEST_SHARE * horizon_s
    apart_s = horizon_s - longest_s
    first = _shaped(inertia_kg_m2 @ (change / apart_s - rate), drive, longest_s)
    given = np.array([torque * duration for torque, duration in first])
    sailing = rate + np.linalg.solve(inertia_kg_m2, given)
    second = _shaped(-(inertia_kg_m2 @ sailing), drive, longest_s)
    pulses: list[AxisPulse] = []
    for axis in range(3):
        (torque, duration_s), (_, last_s) = first[axis], second[axis]
        # what is still to be turned from the middle of the first pulse on, and when that is done
        left_rad = float(change[axis] - rate[axis] * duration_s / 2.0)
        middle_s = (duration_s + last_s) / 2.0
        reached_s = left_rad / float(sailing[axis]) if sailing[axis] else 0.0
        between_s = min(max(reached_s, middle_s), horizon_s - middle_s)
        if duration_s:
            pulses.append(AxisPulse(axis, 0.0, duration_s, torque))
        if last_s:
            pulses.append(AxisPulse(axis, between_s + (duration_s - last_s) / 2.0, last_s, second[axis][0]))
    return tuple(sorted(pulses, key=lambda pulse: (pulse.start_s, pulse.axis)))


def _finite_triples(change_deg: ArrayLike, rate_deg_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return both in rad; refused where one is not three finite numbers."""
    change, rate = np.asarray(change_deg, dtype=np.float64), np.asarray(rate_deg_s, dtype=np.float64)
    if change.shape != (3,) or rate.shape != (3,) or not (np.isfinite(change).all() and np.isfinite(rate).all()):
        raise ValueError("angle change and rate must be three finite numbers each: yaw, roll, pitch")
    return np.radians(change), np.radians(rate)


def _require_drive(drive: Drive, horizon_s: float) -> None:
    """Refuse a drive that cannot give a pulse within the horizon."""
    if not all(math.isfinite(each) and each > 0.0 for each in (*drive, horizon_s)):
        raise ValueError("limit, quantum, shortest pulse, grid and horizon must be finite and positive")
    if drive.steps_at_limit < 1:
        raise ValueError(f"the quantum {drive.quantum_n_m:g} N m exceeds the torque limit {drive.limit_n_m:g} N m")
    if drive.min_pulse_s > LONGEST_SHARE * horizon_s:
        raise ValueError(f"{horizon_s:g} s have no room for two pulses of at least {drive.min_pulse_s:g} s")


def _shaped(impulse_n_m_s: FloatArray, drive: Drive, longest_s: float) -> list[tuple[float, float]]:
    """Return torque and duration of the pulse on each axis, zeros where it would be below the shortest one."""
    shaped = []
    for axis, wanted in enumerate(impulse_n_m_s.tolist()):
        steps = max(1, math.ceil(abs(wanted) / (drive.quantum_n_m * longest_s) - _ROUNDING))
        if steps > drive.steps_at_limit:
            raise ValueError(
                f"about {_AXES[axis]} {abs(wanted):.3g} N m s within {longest_s:g} s exceed the torque limit "
                f"{drive.limit_n_m:g} N m; allow the slew more time"
            )
        torque = math.copysign(steps * drive.quantum_n_m, wanted)
        ticks = round(abs(wanted) / abs(torque) / drive.time_step_s)
        duration_s = ticks * drive.time_step_s
        # half of the shortest pulse is nearer to it than to nothing
        if drive.min_pulse_s / 2.0 <= duration_s < drive.min_pulse_s:
            duration_s = math.ceil(drive.min_pulse_s / drive.time_step_s - _ROUNDING) * drive.time_step_s
        shaped.append((torque, duration_s) if duration_s >= drive.min_pulse_s else (0.0, 0.0))
    return shaped


def predicted_effect(
    pulses: tuple[AxisPulse, ...], inertia_kg_m2: FloatArray, wheel_axes: FloatArray, horizon_s: float
) -> Effect:
    """Return the effect of a schedule on angles, rates and wheels.

    Parameters
    ----------
    pulses : tuple of AxisPulse
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
    _require_schedule(pulses, horizon_s)
    motion = _motion(pulses, inertia_kg_m2, [0.0, horizon_s])
    peaks = np.concatenate([motion.angle_rad, _turning_points(motion)])
    impulse, gross = np.zeros(3), np.zeros(3)
    for pulse in pulses:
        impulse[pulse.axis] += pulse.impulse_n_m_s
        gross[pulse.axis] += abs(pulse.impulse_n_m_s)
    columns = np.arange(3)
    return Effect(
        impulse_n_m_s=triple_of(impulse),
        gross_impulse_n_m_s=triple_of(gross),
        angle_change_deg=triple_of(np.degrees(motion.angle_rad[-1])),
        rate_change_deg_s=triple_of(np.degrees(np.linalg.solve(inertia_kg_m2, impulse))),
        peak_angle_deg=triple_of(np.degrees(peaks[np.abs(peaks).argmax(axis=0), columns])),
        peak_rate_deg_s=triple_of(np.degrees(motion.rate_rad_s[np.abs(motion.rate_rad_s).argmax(axis=0), columns])),
        wheel_momentum_n_m_s=tuple(allocate_to_wheels(wheel_axes, impulse).tolist()),
    )


def predicted_angles(
    pulses: tuple[AxisPulse, ...], inertia_kg_m2: FloatArray, horizon_s: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return instants (count,), s, evenly until the horizon, and the change of the angles there (count, 3), deg.

    Parameters and exceptions are those of `predicted_effect`, whose change of the angles stands at the end.
    """
    _require_schedule(pulses, horizon_s)
    instants_s: FloatArray = np.linspace(0.0, horizon_s, count)
    motion = _motion(pulses, inertia_kg_m2, instants_s.tolist())
    return instants_s, np.degrees(motion.angle_rad[np.searchsorted(motion.at_s, instants_s)])


def triple_of(values: FloatArray) -> Triple:
    """Return an array (3,) as a tuple of plain numbers."""
    yaw, roll, pitch = values.tolist()
    return yaw, roll, pitch


def _require_schedule(pulses: tuple[AxisPulse, ...], horizon_s: float) -> None:
    """Refuse pulses that overlap or that do not lie within the horizon."""
    numbers = [horizon_s, *(number for pulse in pulses for number in pulse[1:])]
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError("pulses and horizon must be finite")
    if any(pulse.start_s < 0.0 or pulse.duration_s <= 0.0 for pulse in pulses):
        raise ValueError("a pulse begins before the schedule or does not last")
    if max((pulse.stop_s for pulse in pulses), default=0.0) > horizon_s * (1.0 + _ROUNDING):
        raise ValueError(f"a pulse ends after the horizon of {horizon_s:g} s")
    for axis in range(3):
        own = sorted((pulse for pulse in pulses if pulse.axis == axis), key=lambda pulse: pulse.start_s)
        if any(latter.start_s < former.stop_s * (1.0 - _ROUNDING) for former, latter in pairwise(own)):
            raise ValueError(f"two pulses about {_AXES[axis]} overlap")


class _Motion(NamedTuple):
    """Motion that pulses bring about, at K instants in order."""

    #: (K,) from the beginning of the schedule
    at_s: FloatArray
    #: (K, 3)
    angle_rad: FloatArray
    rate_rad_s: FloatArray


def _motion(pulses: tuple[AxisPulse, ...], inertia_kg_m2: FloatArray, instants_s: list[float]) -> _Motion:
    """Return the motion from rest at some instants, the last of them the horizon, and at every edge of a pulse."""
    edges_s = (edge for pulse in pulses for edge in (pulse.start_s, min(pulse.stop_s, instants_s[-1])))
    at_s = np.array(sorted({*instants_s, *edges_s}))
    middle_s, step_s = 0.5 * (at_s[:-1] + at_s[1:]), np.diff(at_s)[:, None]
    torque = np.zeros((len(middle_s), 3))
    for pulse in pulses:
        torque[(pulse.start_s <= middle_s) & (middle_s < pulse.stop_s), pulse.axis] += pulse.torque_n_m
    rate, angle = np.zeros((2, len(at_s), 3))
    rate[1:] = np.cumsum(np.linalg.solve(inertia_kg_m2, torque.T).T * step_s, axis=0)
    angle[1:] = np.cumsum(0.5 * (rate[:-1] + rate[1:]) * step_s, axis=0)
    return _Motion(at_s, angle, rate)


def _turning_points(motion: _Motion) -> FloatArray:
    """Return the angle (K - 1, 3) at which each axis turns back between two instants; where it does not, the first."""
    before, after = motion.rate_rad_s[:-1], motion.rate_rad_s[1:]
    is_turning = before * after < 0.0
    # v^2 / 2a further on it turns back
    lost_rad_s = np.where(is_turning, before - after, 1.0)
    further: FloatArray = 0.5 * before**2 * np.diff(motion.at_s)[:, None] / lost_rad_s
    return motion.angle_rad[:-1] + np.where(is_turning, further, 0.0)


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
