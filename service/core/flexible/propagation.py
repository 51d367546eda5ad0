"""Exact motion between two events on both sheets of the phase bi-plane.

While switch F and friction's sign stand, the wheel's torque decays as h exp(-c t), and with phi1(z) = (1 - e^-z) / z,
phi2(z) = (z - 1 + e^-z) / z^2

    H = H0 + h t phi1(ct),  thT' = v + (M_B t + h t phi1(ct)) / I,  thT = x + v t + (M_B t^2 / 2 + h t^2 phi2(ct)) / I
    thU = a0 + a1 e^-ct + e^(-xi w t) (q cos w nu t + b sin w nu t),  nu = sqrt(1 - xi^2)

x, v (rad, rad/s) and h (N m) are values at the start of the leg, t (s) counts from there; a0 = kn M_B / (I w^2),
a1 = kn h / (I (w^2 - 2 xi w c + c^2)).

Against an integrator of eighth order with relative tolerance 1e-12 every component agrees within 2e-14 after 60 s
(`tests/regression/flexible/test_limit_cycles.py`).
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.flexible.phi_functions import FloatArray, phi1, phi2, phi2_scalar
from service.core.flexible.spacecraft import HubMode


class BodyState(NamedTuple):
    """State of one axis."""

    #: thT and its rate: the body as a rigid one
    angle_rad: float
    rate_rad_s: float
    #: thU and its rate: what the flexible mode adds at the hub
    deflection_rad: float = 0.0
    deflection_rate_rad_s: float = 0.0
    #: H
    momentum_n_m_s: float = 0.0


class MotionLeg(NamedTuple):
    """Motion between two events: its start and the constants of the solution."""

    start: BodyState
    inertia_kg_m2: float
    external_torque_n_m: float
    #: h, torque between wheel and body at the start
    wheel_torque_n_m: float
    #: c, at which it decays
    decay_1_s: float
    #: xi w and w nu
    damping_1_s: float
    frequency_rad_s: float
    #: a0, a1, q, b
    offset_rad: float
    decaying_rad: float
    cosine_rad: float
    sine_rad: float


def start_leg(
    start: BodyState,
    mode: HubMode | None,
    *,
    inertia_kg_m2: float,
    wheel_torque_n_m: float,
    decay_1_s: float = 0.0,
    external_torque_n_m: float = 0.0,
) -> MotionLeg:
    """Return the leg that begins in a state under a torque.

    Parameters
    ----------
    start : BodyState
        State at t = 0.
    mode : HubMode or None
        None for a rigid body.
    inertia_kg_m2 : float, kg m^2
        Inertia of the axis.
    wheel_torque_n_m : float, N m
        M_y at the start.
    decay_1_s : float, 1/s
        c; the torque decays as the momentum comes to its own end.
    external_torque_n_m : float, N m
        M_B, constant.
    """
    if mode is None:
        return MotionLeg(start, inertia_kg_m2, external_torque_n_m, wheel_torque_n_m, decay_1_s, 0, 0, 0, 0, 0, 0)
    omega, xi = mode.omega_rad_s, mode.damping_ratio
    frequency = omega * math.sqrt(1.0 - xi * xi)
    gain = mode.coupling / inertia_kg_m2
    offset = gain * external_torque_n_m / omega**2
    decaying = gain * wheel_torque_n_m / (omega**2 - 2.0 * xi * omega * decay_1_s + decay_1_s**2)
    cosine = start.deflection_rad - offset - decaying
    rate = start.deflection_rate_rad_s + decay_1_s * decaying
    sine = (rate + xi * omega * cosine) / frequency
    constants = (xi * omega, frequency, offset, decaying, cosine, sine)
    return MotionLeg(start, inertia_kg_m2, external_torque_n_m, wheel_torque_n_m, decay_1_s, *constants)


def state_at(leg: MotionLeg, elapsed_s: float) -> BodyState:
    """Return the state some time after the start of a leg."""
    states = states_at(leg, np.array([elapsed_s]))
    return BodyState(*(float(value) for value in states[0]))


def angle_and_rate_at(leg: MotionLeg, t: float) -> tuple[float, float]:
    """Return theta and its rate, what `state_at` gives in sum, ten times as fast: searches for events live on it."""
    start, c = leg.start, leg.decay_1_s
    half = phi2_scalar(c * t)
    gained = leg.wheel_torque_n_m * t * (1.0 - c * t * half)
    rate = start.rate_rad_s + (leg.external_torque_n_m * t + gained) / leg.inertia_kg_m2
    turned = (0.5 * leg.external_torque_n_m + leg.wheel_torque_n_m * half) * t * t / leg.inertia_kg_m2
    angle = start.angle_rad + start.rate_rad_s * t + turned
    if leg.frequency_rad_s == 0.0:
        return angle, rate
    fading = leg.decaying_rad * math.exp(-c * t)
    envelope = math.exp(-leg.damping_1_s * t)
    cosine, sine = math.cos(leg.frequency_rad_s * t), math.sin(leg.frequency_rad_s * t)
    swing = envelope * (leg.cosine_rad * cosine + leg.sine_rad * sine)
    swing_rate = envelope * leg.frequency_rad_s * (leg.sine_rad * cosine - leg.cosine_rad * sine)
    swing_rate -= leg.damping_1_s * swing + c * fading
    return angle + leg.offset_rad + fading + swing, rate + swing_rate


def states_at(leg: MotionLeg, elapsed_s: FloatArray) -> FloatArray:
    """Return states (T, 5), columns those of `BodyState`, at some times (T,) after the start of a leg."""
    t, start = elapsed_s, leg.start
    z = leg.decay_1_s * t
    gained = leg.wheel_torque_n_m * t * phi1(z)
    rate = start.rate_rad_s + (leg.external_torque_n_m * t + gained) / leg.inertia_kg_m2
    turned = (0.5 * leg.external_torque_n_m + leg.wheel_torque_n_m * phi2(z)) * t * t / leg.inertia_kg_m2
    angle = start.angle_rad + start.rate_rad_s * t + turned
    deflection, deflection_rate = _deflection(leg, t)
    return np.column_stack([angle, rate, deflection, deflection_rate, start.momentum_n_m_s + gained])


def _deflection(leg: MotionLeg, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return thU and its rate."""
    fading = leg.decaying_rad * np.exp(-leg.decay_1_s * t)
    envelope = np.exp(-leg.damping_1_s * t)
    cosine, sine = np.cos(leg.frequency_rad_s * t), np.sin(leg.frequency_rad_s * t)
    swing = envelope * (leg.cosine_rad * cosine + leg.sine_rad * sine)
    swing_rate = envelope * leg.frequency_rad_s * (leg.sine_rad * cosine - leg.cosine_rad * sine)
    return leg.offset_rad + fading + swing, swing_rate - leg.damping_1_s * swing - leg.decay_1_s * fading
