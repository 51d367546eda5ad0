"""Slew request in tracking: the law's motion over one command period, as an angle to turn and a rate to lose.

A pair of pulses cannot follow a torque that changes; it sails at one rate and stops. Over a time T it therefore takes
the share ``1 - exp(-w T / 2 z)`` of the error, w = 2 pi / period, z damping: the slow motion of the law's oscillator,
which for T towards zero is its steady approach ``w / 2 z`` and never overshoots. After the slew the spacecraft stands
where roll and yaw exchange at the orbital rate; the rate that holds it there is left to it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.core.control.quaternion_law import Gains, error_angles_rad

FloatArray = NDArray[np.float64]


class SlewRequest(NamedTuple):
    """Request to `slew_schedule.plan_slew`; (3,) in the order yaw, roll, pitch."""

    angle_change_deg: FloatArray
    rate_deg_s: FloatArray


def tracking_request(gains: Gains, attitude_deg: ArrayLike, rates_deg_s: ArrayLike, horizon_s: float) -> SlewRequest:
    """Return the slew that takes a share of the error within a command period.

    Parameters
    ----------
    gains : Gains
        Of `quaternion_law.loop_gains`.
    attitude_deg, rates_deg_s : array_like, shape (3,), deg and deg/s
        Filtered angles and rates.
    horizon_s : float, s
        Command period.

    Raises
    ------
    ValueError
        A number is not finite, or the horizon is not positive.

    Examples
    --------
    >>> from service.core.control.quaternion_law import loop_gains
    >>> inertia = np.diag([2600.0, 1400.0, 2600.0])
    >>> gains = loop_gains(inertia, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=60.0)
    >>> tracking_request(gains, [0.0, 0.1, 0.0], [0.0, 0.0, 0.0], 600.0).angle_change_deg.round(4).tolist()
    [0.0, -0.0252, 0.0]
    """
    angles_deg, present_deg_s = np.array([attitude_deg, rates_deg_s], dtype=np.float64)
    if angles_deg.shape != (3,) or not (np.isfinite(angles_deg).all() and np.isfinite(present_deg_s).all()):
        raise ValueError("attitude and rates must each be three finite numbers: yaw, roll, pitch")
    if not (math.isfinite(horizon_s) and horizon_s > 0.0):
        raise ValueError("the horizon must be finite and positive")
    error_deg = np.degrees(error_angles_rad(angles_deg, np.zeros(3)))
    share = 1.0 - math.exp(-gains.stiffness_1_s2 / gains.friction_1_s * horizon_s)
    change_deg = -share * error_deg + 0.0
    # of the present rate, that which holds the spacecraft where it stands turns into that which holds it where it will
    # be
    yaw_deg, roll_deg, _ = change_deg.tolist()
    exchanged_deg_s = gains.orbital_rate_rad_s * np.array([-roll_deg, yaw_deg, 0.0])
    return SlewRequest(change_deg, present_deg_s + exchanged_deg_s)
