"""Craft: body, wheels and the fast loop on board that makes it answer the ground's slow torques.

The loop holds a reference rate, tick by tick:

    w_ref  = (0, -w0, 0) + r,  J r' = response * T_command        r = what the ground has commanded so far
    T      = T_command + w x (J w + h) - T_fed + J (2 zeta n (w_ref - w_m) + n^2 integral of (w_ref - w_m))
    w_m    = w - e - d,        J e' = T_external - T_fed

``w_m`` is the rate of the inertial model: it knows neither the external torque that is not fed forward (whose rate is
e) nor its own drift d, so both move the spacecraft although the loop is closed: this is what the ground has to take
away. Held against a fixed inertial rate, roll and yaw exchange at the orbital rate; a mode that follows the orbit
turns its reference with the body. Simplification: stored momentum and rate are known when w x (J w + h) is taken
away; what is left of it would be taken by the feedback.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.spacecraft.body_dynamics import (
    Motion,
    Torques,
    Vector,
    gyroscopic_n_m,
    orbit_normal_in_body,
    stepped,
)
from analyzer_sim.world.spacecraft.hub_tones import HubTone
from analyzer_sim.world.spacecraft.rigid_body import BodyState, TorqueElement, Triple
from analyzer_sim.world.spacecraft.wheels import Wheel

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
