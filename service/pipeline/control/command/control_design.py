"""Control design from the catalogue: gains, drives and wheels, computed once for a spacecraft."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.control.gyro_orbitant_design import gyro_orbitant_law
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, Gains, loop_gains
from service.core.control.slew_schedule import Drive
from service.core.control.wheel_allocation import Wheels, wheel_set
from service.core.control.wheels import body_torque_limit_n_m
from service.core.dynamics.orbital_frame_model import Law, OrbitalFrameGains
from service.pipeline.config import TorqueConfig
from service.records.catalogue import Release, Spacecraft
from service.records.levels.attitude import FloatArray

#: a drive without steps is given these shares of its limit as steps: finer than any torque that is asked for
_FINE_SHARE = 1e-6
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


class ControlDesign(NamedTuple):
    """The law of one spacecraft."""

    gains: Gains
    #: (3, 3) inverse of the tensor of inertia in the order yaw, roll, pitch
    inverse_1_kg_m2: FloatArray
    drive: Drive
    wheels: Wheels


@lru_cache(maxsize=64)
def control_design(spacecraft: Spacecraft, config: TorqueConfig) -> ControlDesign:
    """Return the law of a spacecraft; the catalogue hardly ever changes.

    Raises
    ------
    ValueError
        Inertia, wheels, period and damping make no law, or its torque is beyond the limit; the message says why.
    """
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)
    limit_n_m = min(spacecraft.torque_limit_n_m, body_torque_limit_n_m(axes, spacecraft.wheels.torque_limit_n_m))
    gains = loop_gains(
        np.array(spacecraft.inertia_kg_m2),
        period_s=spacecraft.control.period_s,
        damping=spacecraft.control.damping,
        torque_limit_n_m=limit_n_m,
        command_period_s=None,
        orbital_rate_rad_s=GEOSTATIONARY_RATE_RAD_S if spacecraft.onboard.roll_yaw_coupling else 0.0,
    )
    quantum_n_m = spacecraft.wheels.torque_quantum_n_m or _FINE_SHARE * limit_n_m
    wheels = wheel_set(
        axes[:, _ANGLES_FROM_BODY],
        spacecraft.wheels.torque_limit_n_m,
        spacecraft.wheels.momentum_limit_n_m_s,
        min(config.least_wheel_momentum_n_m_s, 0.5 * spacecraft.wheels.momentum_limit_n_m_s),
    )
    drive = Drive(limit_n_m, quantum_n_m, config.min_pulse_s, config.time_step_s)
    inverse = np.asarray(np.linalg.inv(gains.inertia_kg_m2), dtype=np.float64)
    return ControlDesign(gains, inverse, drive, wheels)


def gyro_design(spacecraft: Spacecraft, config: TorqueConfig, period_s: float | None = None) -> Law:
    """Return the gyro-orbitant law of a spacecraft.

    Parameters
    ----------
    spacecraft : Spacecraft
        With the gains of the law.
    config : TorqueConfig
        The period of commands under release ``automatic`` until rows tell it.
    period_s : float, optional, s
        Time between commands; None: as the catalogue has it.

    Raises
    ------
    ValueError
        There are no gains, or they are none for this craft and period; the message says why.
    """
    if period_s is None:
        is_automatic = spacecraft.control.release is Release.AUTOMATIC
        period_s = config.default_period_s if is_automatic else spacecraft.control.command_period_s
    return _gyro_design(spacecraft, math.ceil(period_s))


@lru_cache(maxsize=64)
def _gyro_design(spacecraft: Spacecraft, period_s: int) -> Law:
    reported = spacecraft.control.gyro_orbitant
    if reported is None:
        raise ValueError("the law gyro_orbitant has no gains: state control.gyro_orbitant")
    gains = OrbitalFrameGains(
        roll_stiffness=reported.roll_stiffness_n_m,
        roll_damping=reported.roll_damping_n_m_s,
        pitch_stiffness=reported.pitch_stiffness_n_m,
        pitch_damping=reported.pitch_damping_n_m_s,
        yaw_stiffness=reported.yaw_stiffness_n_m,
        yaw_damping=reported.yaw_damping_n_m_s,
    )
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)
    limit_n_m = min(spacecraft.torque_limit_n_m, body_torque_limit_n_m(axes, spacecraft.wheels.torque_limit_n_m))
    tensor = np.array(spacecraft.inertia_kg_m2)
    return gyro_orbitant_law(tensor, gains, torque_limit_n_m=limit_n_m, command_period_s=float(period_s))
