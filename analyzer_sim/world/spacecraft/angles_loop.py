"""Loop on board that takes angles from the ground: the second way of control of the paper.

The spacecraft carries its angles on with the rate that its own torques have given and a bias that it learns; each
product of the ground corrects both, at the epoch for which it is told. Products are taken once, in the order of their
counters, and never after their end. Older than the age limit, the newest one is no longer acted on: the loop holds, it
takes away the rate that it knows of and nothing else, and goes on with the next product.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.world.spacecraft.rigid_body import TorqueElement, Triple
from analyzer_sim.world.spacecraft.wheels import QUANTUM_N_M

#: natural frequency of the loop, rad/s, and damping
_LOOP_RAD_S, _DAMPING = 2.0 * math.pi / 2400.0, 0.9
#: share of what a product corrects in the angles, and in the bias, 1/s
_ANGLE_GAIN, _BIAS_GAIN_1_S = 0.1, 4e-5
#: rows of the past whose angles are remembered, and the shortest pulse, s
_REMEMBERED, _SHORTEST_S = 10, 0.1
_AXES = 3


class Angles(NamedTuple):
    """A product of the ground; yaw, roll, pitch."""

    counter: int
    epoch_us: int
    valid_until_us: int
    attitude_deg: Triple


@dataclass(slots=True)
class AnglesLoop:
    """State of the loop; triples in the order yaw, roll, pitch."""

    inertia_kg_m2: Triple
    #: at which roll and yaw exchange, rad/s
    exchange_rad_s: float
    age_limit_s: float
    angles_deg: list[float] = field(default_factory=lambda: [0.0] * _AXES)
    bias_deg_s: list[float] = field(default_factory=lambda: [0.0] * _AXES)
    newest: Angles | None = None
    _past: dict[int, tuple[float, ...]] = field(default_factory=dict)

    def consume(self, reported: Angles, now_us: int) -> None:
        """Correct the estimate by a product, or leave it out: one that came before, is over, or is too old to place."""
        is_new = self.newest is None or reported.counter > self.newest.counter
        if not is_new or now_us >= reported.valid_until_us:
            return
        before = reported.attitude_deg if self.newest is None else self._past.get(reported.epoch_us)
        if before is None:
            return
        if self.newest is None:
            self.angles_deg = list(reported.attitude_deg)
        self.newest = reported
        for k in range(_AXES):
            missed = reported.attitude_deg[k] - before[k]
            self.angles_deg[k] += _ANGLE_GAIN * missed
            self.bias_deg_s[k] += _BIAS_GAIN_1_S * missed

    def is_holding(self, now_us: int) -> bool:
        """Return whether the newest product is older than the limit, or none has come."""
        # a limit that is no number is never kept
        return self.newest is None or not now_us - self.newest.epoch_us <= self.age_limit_s * US_PER_S

    def command(self, span_us: tuple[int, int], rate_deg_s: Triple) -> tuple[TorqueElement, ...]:
        """Return the pulses of a span under the rate that torques have given, and carry the angles on to its end."""
        start_us, stop_us = span_us
        span_s = (stop_us - start_us) / US_PER_S
        yaw, roll, _ = self.angles_deg
        exchange = (-self.exchange_rad_s * roll, self.exchange_rad_s * yaw, 0.0)
        rates = [r + b + x for r, b, x in zip(rate_deg_s, self.bias_deg_s, exchange, strict=True)]
        pulses: list[TorqueElement] = []
        if self.newest is not None:
            stiffness = 0.0 if self.is_holding(start_us) else _LOOP_RAD_S**2
            for k, (angle, rate, inertia) in enumerate(zip(self.angles_deg, rates, self.inertia_kg_m2, strict=True)):
                wanted = stiffness * angle + 2.0 * _DAMPING * _LOOP_RAD_S * rate
                pulses += _pulse(start_us, span_s, k, -inertia * math.radians(wanted))
        self._past[start_us] = tuple(self.angles_deg)
        self._past = dict(list(self._past.items())[-_REMEMBERED:])
        self.angles_deg = [angle + rate * span_s for angle, rate in zip(self.angles_deg, rates, strict=True)]
        return tuple(pulses)


def _pulse(start_us: int, span_s: float, axis: int, torque_n_m: float) -> list[TorqueElement]:
    """Return the pulse of whole quanta that gives the impulse of a mean torque; none where it would be too short."""
    quanta = max(1, math.ceil(abs(torque_n_m) / QUANTUM_N_M))
    duration_s = abs(torque_n_m) * span_s / (quanta * QUANTUM_N_M)
    if duration_s < _SHORTEST_S:
        return []
    torque = [0.0] * _AXES
    torque[axis] = math.copysign(quanta * QUANTUM_N_M, torque_n_m)
    yaw, roll, pitch = torque
    return [TorqueElement(start_us, start_us + round(duration_s * US_PER_S), (yaw, roll, pitch))]
