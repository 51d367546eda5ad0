"""Body: Euler's equations with wheels that store momentum, in a frame that turns with the orbit.

    J w' = T_ext + T_wheels - w x (J w + h)      w = inertial rate in body axes x roll, y pitch, z yaw, rad/s
    h'   = -T_wheels                             h = momentum of the wheels along body axes, N m s
    w_rel = w + w0 C e_y                         C from the orbital frame (x East, y South, z nadir) to the body, 3-2-1

The orbit turns about -y at w0. The angles follow w_rel by the exact kinematics of the sequence yaw, pitch, roll.
Classical Runge-Kutta of fourth order; over a step all torques are constant.
"""

import math
from typing import NamedTuple

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
    """Return the rates of change of a motion."""
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
