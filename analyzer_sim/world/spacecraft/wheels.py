"""Wheels: one along each body axis, driven in whole quanta of torque against the friction of its bearing.

    h' = m - f(h),   f(h) = c tanh(h / h0) + v h        m = motor torque, a multiple of the quantum

The drive carries what a quantum cannot express from tick to tick (first-order sigma-delta), so the mean is the torque
asked for. The loop on board knows the friction to a tenth. A wheel at its limit of momentum takes no more.
"""

import math
from dataclasses import dataclass

from analyzer_sim.streams import stream
from analyzer_sim.world.spacecraft.body_dynamics import Vector

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
