"""Parameters of the spacecraft that flies in the orbital frame: body, law, computer, sensors, wheels, flexible tones.

Every component can be ideal (``is_real`` false): the sensor shows the truth, the wheel gives what it is told, the
computer is continuous. Defaults are those with which the figures of Belenkii, Vasilev and Semenov (Meteor-M No. 2)
reproduce; where they come from stands in docs/explanations/orbital-frame-control.md. Nothing but numbers is kept here,
so that the kernel compiles. Axes: see the package.
"""

import math
from typing import NamedTuple

#: rad/s, of an orbit of 101.35 min
ORBITAL_RATE_RAD_S = 2.0 * math.pi / (101.35 * 60.0)
#: rounding of the torque to its quantum
NEAREST, TO_ZERO, DOWN = 0, 1, 2
#: which product of the tilt and the yaw quaternion the law takes: L1 o L2 corrected, as printed, or L2 o L1
TILT_FIRST, AS_PRINTED, YAW_FIRST = 0, 1, 2

Triple = tuple[float, float, float]


class Inertia(NamedTuple):
    """Inertia tensor of the spacecraft, kg m^2; products are tensor elements."""

    xx: float = 8000.0
    yy: float = 6000.0
    zz: float = 5000.0
    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0


#: products that give the published roll and yaw at the orbital frequency
NOMINAL_INERTIA = Inertia(xy=100.0, xz=60.0, yz=114.0)


class OrbitalFrameGains(NamedTuple):
    """Gains of the law: N m a unit of half-angle, and N m s."""

    roll_stiffness: float = 40.0
    roll_damping: float = 1000.0
    pitch_stiffness: float = 80.0
    pitch_damping: float = 2000.0
    yaw_stiffness: float = 2.5
    yaw_damping: float = 500.0


MAX_GAINS = OrbitalFrameGains()
MIN_GAINS = OrbitalFrameGains(yaw_stiffness=0.625, yaw_damping=125.0)


class Law(NamedTuple):
    """The gyro-orbitant law and its readings."""

    gains: OrbitalFrameGains = MAX_GAINS
    orbital_rate_rad_s: float = ORBITAL_RATE_RAD_S
    #: share of the roll rate over the orbital rate in the yaw quaternion
    slope: float = 1.0 / math.sqrt(2.0)
    product: int = TILT_FIRST
    #: take the second branch where the roll rate exceeds the orbital rate, which the print forgets
    is_guarded: bool = True


class Computer(NamedTuple):
    """On-board computer and the torque it can ask for."""

    is_sampled: bool = True
    period_s: float = 0.125
    torque_limit_n_m: float = 0.25
    torque_quantum_n_m: float = 0.25 / 127.0
    rounding: int = NEAREST
    #: added to the measured yaw rate, rad/s
    yaw_rate_correction_rad_s: float = 0.0


class VerticalSensor(NamedTuple):
    """Sensor of the local vertical: roll and pitch, rad and s."""

    is_real: bool = True
    limit_rad: float = 0.035
    lag_s: float = 0.5
    quantum_rad: float = math.radians(15.0 / 3600.0)
    noise_rad: float = 1.5e-4
    noise_time_s: float = 1.0
    roll_bias_rad: float = 0.0
    pitch_bias_rad: float = 0.0


class RateSensor(NamedTuple):
    """Sensors of the three rates, rad/s; their output is some periods of the computer old."""

    is_real: bool = True
    limit_rad_s: float = 0.05
    quantum_rad_s: float = 1e-7
    null_rad_s: Triple = (1.8e-7, 0.0, 0.0)
    noise_rad_s: float = 2e-7
    delay_periods: int = 1


class AxisWheels(NamedTuple):
    """One reaction wheel an axis."""

    is_real: bool = True
    #: torque given over torque asked for, at rest
    slope: float = 1.0
    no_load_rad_s: float = 600.0
    inertia_kg_m2: float = 0.064
    momentum_limit_n_m_s: float = 20.0
    dry_friction_n_m: float = 2e-3
    viscous_friction_n_m_s: float = 4e-5
    cogging_n_m: float = 5e-4
    cogging_periods: float = 12.0


class Tones(NamedTuple):
    """Flexible tones that the sensors see; the body does not feel them."""

    is_real: bool = True
    roll_hz: Triple = (0.30, 0.55, 0.90)
    yaw_hz: Triple = (0.25, 0.50, 0.80)
    damping_ratio: float = 0.005
    gains: Triple = (0.15, 0.08, 0.04)


class OrbitalFrameSpacecraft(NamedTuple):
    """Spacecraft in the orbital frame: inertia, law, computer, wheels and sensors."""

    inertia: Inertia = NOMINAL_INERTIA
    law: Law = Law()
    computer: Computer = Computer()
    vertical_sensor: VerticalSensor = VerticalSensor()
    rate_sensor: RateSensor = RateSensor()
    wheels: AxisWheels = AxisWheels()
    tones: Tones = Tones()
    has_gravity_torque: bool = True
    #: Runge-Kutta steps in a period of the computer
    steps: int = 1


#: sensors show the truth, wheels obey, no tones
_IDEAL = OrbitalFrameSpacecraft(
    vertical_sensor=VerticalSensor(is_real=False),
    rate_sensor=RateSensor(is_real=False),
    wheels=AxisWheels(is_real=False),
    tones=Tones(is_real=False),
)


def rigid_spacecraft(
    gains: OrbitalFrameGains = MAX_GAINS, inertia: Inertia | None = None, *, is_sampled: bool = False, steps: int = 1
) -> OrbitalFrameSpacecraft:
    """Return a spacecraft of ideal components: continuous, or with the computer's period and quantum."""
    return _IDEAL._replace(
        inertia=Inertia() if inertia is None else inertia,
        law=Law(gains=gains),
        computer=Computer(is_sampled=is_sampled),
        steps=steps,
    )


def refusals(spacecraft: OrbitalFrameSpacecraft) -> list[str]:
    """Return the impossible parameters of a spacecraft, each with its value; an empty list when it can fly."""
    j, w = spacecraft.inertia, spacecraft.wheels
    minors = (
        j.xx,
        j.xx * j.yy - j.xy**2,
        j.xx * (j.yy * j.zz - j.yz**2) - j.xy * (j.xy * j.zz - j.yz * j.xz) + j.xz * (j.xy * j.yz - j.yy * j.xz),
    )
    positive = {
        "law.orbital_rate_rad_s": spacecraft.law.orbital_rate_rad_s,
        "computer.period_s": spacecraft.computer.period_s,
        "computer.torque_limit_n_m": spacecraft.computer.torque_limit_n_m,
        "computer.torque_quantum_n_m": spacecraft.computer.torque_quantum_n_m,
        "vertical_sensor.lag_s": spacecraft.vertical_sensor.lag_s,
        "vertical_sensor.noise_time_s": spacecraft.vertical_sensor.noise_time_s,
        "vertical_sensor.quantum_rad": spacecraft.vertical_sensor.quantum_rad,
        "rate_sensor.quantum_rad_s": spacecraft.rate_sensor.quantum_rad_s,
        "wheels.inertia_kg_m2": w.inertia_kg_m2,
        "wheels.no_load_rad_s": w.no_load_rad_s,
        "tones.damping_ratio": spacecraft.tones.damping_ratio,
        "steps": float(spacecraft.steps),
    }
    found = [f"{name} is {value:g}; it must be above zero" for name, value in positive.items() if not value > 0.0]
    if spacecraft.rate_sensor.delay_periods < 0:
        found.append(f"rate_sensor.delay_periods is {spacecraft.rate_sensor.delay_periods}; it must not be negative")
    if not all(minor > 0.0 for minor in minors):
        found.append("the inertia tensor is not positive definite; products are tensor elements, not integrals")
    elif not (j.xx + j.yy > j.zz and j.yy + j.zz > j.xx and j.zz + j.xx > j.yy):
        found.append("the moments of inertia break the triangle rule; no body has them")
    return found
