"""What of the catalogue the control law needs: gains, drives and wheels, computed once for a spacecraft."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, Gains, loop_gains
from service.core.control.slew_schedule import Drive
from service.core.control.wheel_allocation import Wheels, wheel_set
from service.core.control.wheels import body_torque_limit_n_m
from service.pipeline.config import TorqueConfig
from service.records.catalogue import Spacecraft

#: a drive without steps is given these shares of its limit as steps: finer than any torque that is asked for
_FINE_SHARE = 1e-6
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


class ControlDesign(NamedTuple):
    """The law of one spacecraft."""

    gains: Gains
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
    return ControlDesign(gains, Drive(limit_n_m, quantum_n_m, config.min_pulse_s, config.time_step_s), wheels)
