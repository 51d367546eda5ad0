"""Rigid body: attitude and rates under torques, integrated exactly between the edges of a torque schedule.

    yaw'   = -w0 roll + d_yaw + r_yaw         r' = torque / inertia
    roll'  =  w0 yaw + d_roll + r_roll        d  = drift of the inertial model, constant within a step
    pitch' =  d_pitch + r_pitch               w0 = orbital rate, 0 where the on-board mode does not follow it

With z = yaw + i roll the first two are z' = i w0 z + d + r, whose solution over h with constant d and r' = a is

    z(h) = exp(i w0 h) z + (d + r) h phi1 + a h^2 phi2,   phi_n = sum over k of (i w0 h)^k / (k + n)!

Angles in deg, rates in deg/s, order yaw, roll, pitch. The fast loop on board takes gyroscopic torques away.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S

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
