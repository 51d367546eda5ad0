"""Body in closed loop: Euler's equations, wheels, and the fast loop on board."""

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import stream
from analyzer_sim.world.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.spacecraft.hub_tones import HubTone

Vector = tuple[float, float, float]

#: moments of inertia, kg m2, about roll, pitch, yaw
INERTIA_KG_M2 = (2600.0, 1400.0, 2600.0)


class Motion(NamedTuple):
    """Inertial rate in body axes, rad/s, and attitude against the orbital frame, rad."""

    rate_x: float
    rate_y: float
    rate_z: float
    roll: float
    pitch: float
    yaw: float

    @property
    def rate_rad_s(self) -> Vector:
        """Rate about x, y, z."""
        return self.rate_x, self.rate_y, self.rate_z


class Torques(NamedTuple):
    """Torques and wheel momentum of one step, constant over it."""

    #: from outside, N m about x, y, z
    external_n_m: Vector
    #: of the wheels on the body, N m
    wheels_n_m: Vector
    #: of the wheels at the start of the step, N m s
    momentum_n_m_s: Vector


def orbit_normal_in_body(roll: float, pitch: float, yaw: float) -> Vector:
    """Return C e_y, the direction South in body axes."""
    sine_yaw, cosine_yaw = math.sin(yaw), math.cos(yaw)
    sine_roll, cosine_roll = math.sin(roll), math.cos(roll)
    lifted = math.sin(pitch) * sine_yaw
    return (
        math.cos(pitch) * sine_yaw,
        sine_roll * lifted + cosine_roll * cosine_yaw,
        cosine_roll * lifted - sine_roll * cosine_yaw,
    )


def gyroscopic_n_m(rate_rad_s: Vector, inertia_kg_m2: Vector, momentum_n_m_s: Vector) -> Vector:
    """Return w x (J w + h), N m."""
    x, y, z = rate_rad_s
    total_x, total_y, total_z = (j * w + h for j, w, h in zip(inertia_kg_m2, rate_rad_s, momentum_n_m_s, strict=True))
    return y * total_z - z * total_y, z * total_x - x * total_z, x * total_y - y * total_x


def stepped(
    motion: Motion, torques: Torques, inertia_kg_m2: Vector, orbital_rate_rad_s: float, span_s: float
) -> Motion:
    """Return the motion after a step; the error of a step of 2 s is below 1e-13 rad at rates of an orbit."""

    def slope(at: Motion, elapsed_s: float) -> Motion:
        return _slope(at, torques, inertia_kg_m2, orbital_rate_rad_s, elapsed_s)

    half_s = 0.5 * span_s
    first = slope(motion, 0.0)
    second = slope(_moved(motion, first, half_s), half_s)
    third = slope(_moved(motion, second, half_s), half_s)
    fourth = slope(_moved(motion, third, span_s), span_s)
    sixth = span_s / 6.0
    return Motion(
        *(
            value + sixth * (a + 2.0 * (b + c) + d)
            for value, a, b, c, d in zip(motion, first, second, third, fourth, strict=True)
        )
    )


def _moved(motion: Motion, slope: Motion, span_s: float) -> Motion:
    return Motion(*(value + span_s * rate for value, rate in zip(motion, slope, strict=True)))


def _slope(at: Motion, torques: Torques, inertia_kg_m2: Vector, orbital_rate_rad_s: float, elapsed_s: float) -> Motion:
    given, wheels = torques.external_n_m, torques.wheels_n_m
    stored = torques.momentum_n_m_s
    momentum = (
        stored[0] - wheels[0] * elapsed_s,
        stored[1] - wheels[1] * elapsed_s,
        stored[2] - wheels[2] * elapsed_s,
    )
    turned = gyroscopic_n_m((at.rate_x, at.rate_y, at.rate_z), inertia_kg_m2, momentum)
    south = orbit_normal_in_body(at.roll, at.pitch, at.yaw)
    x = at.rate_x + orbital_rate_rad_s * south[0]
    y = at.rate_y + orbital_rate_rad_s * south[1]
    z = at.rate_z + orbital_rate_rad_s * south[2]
    sine, cosine = math.sin(at.roll), math.cos(at.roll)
    across = y * sine + z * cosine
    return Motion(
        (given[0] + wheels[0] - turned[0]) / inertia_kg_m2[0],
        (given[1] + wheels[1] - turned[1]) / inertia_kg_m2[1],
        (given[2] + wheels[2] - turned[2]) / inertia_kg_m2[2],
        x + across * math.tan(at.pitch),
        y * cosine - z * sine,
        across / math.cos(at.pitch),
    )


#: terms of the series; of a step of an hour (w0 h = 0.26) the thirteenth is below 1e-17
_TERMS = 13

Triple = tuple[float, float, float]


class BodyState(NamedTuple):
    """Attitude and rates of the body."""

    attitude_deg: Triple
    rate_deg_s: Triple


@dataclass(frozen=True, slots=True)
class TorqueElement:
    """A constant torque on the body over [start, stop), N m, order yaw, roll, pitch."""

    start_us: int
    stop_us: int
    torque_n_m: Triple


@dataclass(frozen=True, slots=True)
class RigidBody:
    """Moments of inertia about yaw, roll and pitch, kg m2, and the rate at which roll and yaw exchange, rad/s."""

    inertia_kg_m2: Triple
    orbital_rate_rad_s: float

    def fly(
        self,
        state: BodyState,
        span_us: tuple[int, int],
        schedule: Sequence[TorqueElement],
        drift_deg_s: Triple = (0.0, 0.0, 0.0),
        disturbance_n_m: Triple = (0.0, 0.0, 0.0),
    ) -> BodyState:
        """Return the state after a span [start, stop) under overlapping elements; torques of one instant add up.

        Examples
        --------
        >>> body = RigidBody((2600.0, 2600.0, 1400.0), 0.0)
        >>> pulse = TorqueElement(0, 10_000_000, (0.0, 0.0, 0.14))
        >>> still = BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        >>> [round(math.radians(x), 9) for x in body.fly(still, (0, 20_000_000), [pulse]).rate_deg_s]
        [0.0, 0.0, 0.001]
        """
        start_us, stop_us = span_us
        inside = {edge for element in schedule for edge in (element.start_us, element.stop_us)}
        edges_us = sorted({start_us, stop_us, *(edge for edge in inside if start_us < edge < stop_us)})
        for begin_us, end_us in pairwise(edges_us):
            acting = [e.torque_n_m for e in schedule if e.start_us <= begin_us and e.stop_us >= end_us]
            torque = [sum(parts) for parts in zip(disturbance_n_m, *acting, strict=True)]
            yaw, roll, pitch = (
                math.degrees(t / inertia) for t, inertia in zip(torque, self.inertia_kg_m2, strict=True)
            )
            state = self._step(state, (end_us - begin_us) / US_PER_S, drift_deg_s, (yaw, roll, pitch))
        return state

    def _step(self, state: BodyState, span_s: float, drift: Triple, acceleration: Triple) -> BodyState:
        """Return the state after a span of constant torque; accelerations in deg/s2."""
        (yaw, roll, pitch), rate = state
        push = [d + r for d, r in zip(drift, rate, strict=True)]
        turn = 1j * self.orbital_rate_rad_s * span_s
        across = cmath.exp(turn) * complex(yaw, roll)
        across += complex(push[0], push[1]) * span_s * _phi(1, turn)
        across += complex(acceleration[0], acceleration[1]) * span_s**2 * _phi(2, turn)
        along = pitch + push[2] * span_s + 0.5 * acceleration[2] * span_s**2
        yaw_rate, roll_rate, pitch_rate = (r + a * span_s for r, a in zip(rate, acceleration, strict=True))
        return BodyState((across.real, across.imag, along), (yaw_rate, roll_rate, pitch_rate))


def _phi(order: int, turn: complex) -> complex:
    """Return sum over k of turn^k / (k + order)!."""
    total, term = 0j, complex(1.0 / math.factorial(order))
    for k in range(_TERMS):
        total += term
        term *= turn / (k + 1 + order)
    return total


#: drag of a bearing at rest, N m, the momentum within which it reverses, N m s, and drag per momentum, 1/s
COULOMB_N_M = 1.0e-3
REVERSAL_N_M_S = 0.02
VISCOUS_PER_S = 1.0e-4
#: one sigma of what the loop on board believes of the friction, relative
FRICTION_ERROR = 0.1
QUANTUM_N_M = 0.002
TORQUE_LIMIT_N_M = 0.05
MOMENTUM_LIMIT_N_M_S = 20.0
#: moment of inertia of a rotor, kg m2
ROTOR_KG_M2 = 0.04
AXES = ("roll", "pitch", "yaw")


def friction_n_m(momentum_n_m_s: float) -> float:
    """Return the drag that slows a wheel down."""
    return COULOMB_N_M * math.tanh(momentum_n_m_s / REVERSAL_N_M_S) + VISCOUS_PER_S * momentum_n_m_s


def rotor_speed_rpm(momentum_n_m_s: float) -> float:
    """Return the speed of a rotor."""
    return momentum_n_m_s / ROTOR_KG_M2 * 30.0 / math.pi


@dataclass(slots=True)
class Wheel:
    """One wheel and its drive."""

    momentum_n_m_s: float
    #: what the loop believes of the friction, relative to the truth
    known_friction: float = 1.0
    #: N m s, asked for and not yet given
    carry_n_m_s: float = 0.0

    @property
    def unknown_friction_n_m(self) -> float:
        """Friction that the loop has to take away by feedback."""
        return (1.0 - self.known_friction) * friction_n_m(self.momentum_n_m_s)

    def motor_n_m(self, body_torque_n_m: float, span_s: float) -> float:
        """Return the motor torque, whole quanta, that gives a mean torque to the body for a tick."""
        wanted = -body_torque_n_m + self.known_friction * friction_n_m(self.momentum_n_m_s)
        steps = round((wanted + self.carry_n_m_s / span_s) / QUANTUM_N_M)
        most = round(TORQUE_LIMIT_N_M / QUANTUM_N_M)
        motor_n_m = max(-most, min(most, steps)) * QUANTUM_N_M
        most_n_m_s = 2.0 * QUANTUM_N_M
        self.carry_n_m_s += (wanted - motor_n_m) * span_s
        self.carry_n_m_s = max(-most_n_m_s, min(most_n_m_s, self.carry_n_m_s))
        return motor_n_m

    def body_torque_n_m(self, motor_n_m: float, span_s: float) -> float:
        """Return the torque on the body while a motor torque acts, and spin the wheel up by it."""
        before = self.momentum_n_m_s
        after = before + (motor_n_m - friction_n_m(before)) * span_s
        self.momentum_n_m_s = max(-MOMENTUM_LIMIT_N_M_S, min(MOMENTUM_LIMIT_N_M_S, after))
        return (before - self.momentum_n_m_s) / span_s


def wheel_set(seed: int, momentum_n_m_s: Vector) -> tuple[Wheel, ...]:
    """Return wheels along roll, pitch and yaw with drawn knowledge of their friction."""
    return tuple(
        Wheel(momentum, 1.0 + FRICTION_ERROR * float(stream(seed, "wheel friction", axis).normal()))
        for axis, momentum in zip(AXES, momentum_n_m_s, strict=True)
    )


#: tick of the loop on board, s, its natural frequency, rad/s, and damping
TICK_S = 2.0
LOOP_RAD_S = 0.05
LOOP_DAMPING = 0.9
_ZERO = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class OrbitalFrameSpacecraft:
    """A spacecraft in flight; vectors about x roll, y pitch, z yaw unless said otherwise."""

    inertia_kg_m2: Vector
    motion: Motion
    wheels: Sequence[Wheel]
    #: whether the loop holds a fixed inertial rate, so that roll and yaw exchange
    is_coupled: bool = True
    #: without it the wheels give the commanded torque and nothing else
    has_fast_loop: bool = True
    #: what a commanded torque does about each axis: 1 = what it says, -1 = the opposite, 0 = nothing
    response: Vector = (1.0, 1.0, 1.0)
    tones: Sequence[HubTone] = ()
    orbital_rate_rad_s: float = EARTH_RATE_RAD_S
    #: r, e and the integral of the loop
    commanded_rad_s: Vector = _ZERO
    unseen_rad_s: Vector = _ZERO
    held_rad: Vector = field(default=_ZERO)

    def __post_init__(self) -> None:
        """Let the integral of the loop begin where it takes the friction away that is not known."""
        if self.has_fast_loop and self.held_rad == _ZERO:
            left = zip(self.wheels, self.inertia_kg_m2, strict=True)
            x, y, z = (-wheel.unknown_friction_n_m / (j * LOOP_RAD_S**2) for wheel, j in left)
            self.held_rad = (x, y, z)

    @property
    def state(self) -> BodyState:
        """Attitude of the hub and rate that torques have given, ripple of the drives apart; yaw, roll, pitch, deg."""
        hub = [self.motion.roll, self.motion.pitch, self.motion.yaw]
        for tone in self.tones:
            hub[tone.axis] += tone.angle_rad
        x, y, z = (math.degrees(r + e) for r, e in zip(self.commanded_rad_s, self.unseen_rad_s, strict=True))
        return BodyState((math.degrees(hub[2]), math.degrees(hub[0]), math.degrees(hub[1])), (z, x, y))

    def fly(
        self,
        span_us: tuple[int, int],
        schedule: Sequence[TorqueElement],
        drift_deg_s: Triple,
        external_n_m: Triple,
        unseen_n_m: Triple,
    ) -> None:
        """Fly a span; drift, external torque and what of it is not fed forward in the order yaw, roll, pitch."""
        drift = _body([math.radians(rate) for rate in drift_deg_s])
        external, unseen = _body(external_n_m), _body(unseen_n_m)
        for start_us, stop_us in _ticks(span_us, schedule):
            acting = [e.torque_n_m for e in schedule if e.start_us <= start_us and e.stop_us >= stop_us]
            reported = _body([sum(parts) for parts in zip(_ZERO, *acting, strict=True)])
            answered = (reported[0] * self.response[0], reported[1] * self.response[1], reported[2] * self.response[2])
            self._tick((stop_us - start_us) / US_PER_S, answered, drift, external, unseen)

    def _tick(
        self, span_s: float, command_n_m: Vector, drift_rad_s: Vector, external_n_m: Vector, unseen_n_m: Vector
    ) -> None:
        """Fly a tick with a constant command."""
        momentum = self._momentum_n_m_s()
        if self.has_fast_loop:
            fed = _vector(whole - part for whole, part in zip(external_n_m, unseen_n_m, strict=True))
            wanted = self._demand_n_m(command_n_m, drift_rad_s, fed, momentum, span_s)
            given = _vector(
                wheel.body_torque_n_m(wheel.motor_n_m(torque, span_s), span_s)
                for wheel, torque in zip(self.wheels, wanted, strict=True)
            )
        else:
            given = command_n_m
            for wheel, torque in zip(self.wheels, given, strict=True):
                wheel.momentum_n_m_s -= torque * span_s
        before = self.motion
        torques = Torques(external_n_m, given, momentum)
        self.motion = stepped(before, torques, self.inertia_kg_m2, self.orbital_rate_rad_s, span_s)
        inertia = self.inertia_kg_m2
        self.commanded_rad_s = _grown(self.commanded_rad_s, command_n_m, inertia, span_s)
        self.unseen_rad_s = _grown(self.unseen_rad_s, unseen_n_m, inertia, span_s)
        for tone in self.tones:
            tone.push((self.motion[tone.axis] - before[tone.axis]) / span_s, span_s)

    def _demand_n_m(
        self, command_n_m: Vector, drift_rad_s: Vector, fed_n_m: Vector, momentum_n_m_s: Vector, span_s: float
    ) -> Vector:
        """Return the torque that the loop wants on the body, and let its integral grow."""
        rate, base = self.motion.rate_rad_s, self.reference_rad_s()
        turned = gyroscopic_n_m(rate, self.inertia_kg_m2, momentum_n_m_s)
        wanted, held = [], []
        for k, inertia in enumerate(self.inertia_kg_m2):
            seen = rate[k] - self.unseen_rad_s[k] - drift_rad_s[k]
            error = base[k] + self.commanded_rad_s[k] - seen
            back = inertia * (2.0 * LOOP_DAMPING * LOOP_RAD_S * error + LOOP_RAD_S**2 * self.held_rad[k])
            wanted.append(command_n_m[k] + turned[k] - fed_n_m[k] + back)
            held.append(self.held_rad[k] + error * span_s)
        self.held_rad = _vector(held)
        return _vector(wanted)

    def reference_rad_s(self) -> Vector:
        """Return the rate that the mode holds without a command."""
        if self.is_coupled:
            return 0.0, -self.orbital_rate_rad_s, 0.0
        south = orbit_normal_in_body(self.motion.roll, self.motion.pitch, self.motion.yaw)
        return _vector(-self.orbital_rate_rad_s * part for part in south)

    def _momentum_n_m_s(self) -> Vector:
        return _vector(wheel.momentum_n_m_s for wheel in self.wheels)


def spacecraft_at_rest(
    inertia_kg_m2: Vector, attitude_deg: Triple, wheels: Sequence[Wheel], *, is_coupled: bool = True
) -> OrbitalFrameSpacecraft:
    """Return a spacecraft whose loop has settled at an attitude, yaw, roll, pitch."""
    yaw, roll, pitch = (math.radians(angle) for angle in attitude_deg)
    flown = OrbitalFrameSpacecraft(
        inertia_kg_m2, Motion(0.0, 0.0, 0.0, roll, pitch, yaw), wheels, is_coupled=is_coupled
    )
    flown.motion = Motion(*flown.reference_rad_s(), roll, pitch, yaw)
    return flown


def _ticks(span_us: tuple[int, int], schedule: Sequence[TorqueElement]) -> Iterator[tuple[int, int]]:
    """Yield ticks, cut at the edges of the schedule."""
    start_us, stop_us = span_us
    inside = {edge for element in schedule for edge in (element.start_us, element.stop_us)}
    tick_us = round(TICK_S * US_PER_S)
    edges = sorted({*range(start_us, stop_us, tick_us), stop_us, *(e for e in inside if start_us < e < stop_us)})
    yield from pairwise(edges)


def _grown(rate_rad_s: Vector, torque_n_m: Vector, inertia_kg_m2: Vector, span_s: float) -> Vector:
    """Return a rate after a torque has acted for a span."""
    return (
        rate_rad_s[0] + torque_n_m[0] / inertia_kg_m2[0] * span_s,
        rate_rad_s[1] + torque_n_m[1] / inertia_kg_m2[1] * span_s,
        rate_rad_s[2] + torque_n_m[2] / inertia_kg_m2[2] * span_s,
    )


def _body(values: Sequence[float]) -> Vector:
    """Return yaw, roll, pitch about x roll, y pitch, z yaw."""
    return values[1], values[2], values[0]


def _vector(values: "Iterator[float] | Sequence[float]") -> Vector:
    x, y, z = values
    return x, y, z
