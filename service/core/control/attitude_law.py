"""Proportional-derivative attitude control law.

The closed loop about each axis is a damped oscillator: with w = 2 pi / period,
``torque = -I (w^2 angle + 2 damping w rate)``; I the principal inertia of the axis (kg m^2), angle in rad, rate in
rad/s, torque on the body in N m.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def proportional_derivative_torque(
    attitude_deg: FloatArray,
    rate_deg_s: FloatArray,
    inertia_kg_m2: FloatArray,
    period_s: float,
    damping: float,
) -> FloatArray:
    """Return the torque on the body that brings an attitude back to zero.

    Parameters
    ----------
    attitude_deg : ndarray, shape (3,), deg
        Yaw, roll, pitch.
    rate_deg_s : ndarray, shape (3,), deg/s
        Rates of the same angles.
    inertia_kg_m2 : ndarray, shape (3,), kg m^2
        Principal inertia about the yaw, roll and pitch axis.
    period_s : float, s
        Undamped period of the closed loop, > 0.
    damping : float
        Damping ratio, > 0.

    Returns
    -------
    ndarray, shape (3,), N m
        Torque about yaw, roll, pitch.

    Examples
    --------
    >>> torque = proportional_derivative_torque(
    ...     np.array([0.0, 0.1, 0.0]), np.zeros(3), np.array([2600.0, 2600.0, 1400.0]), 7200.0, 0.9
    ... )
    >>> bool(torque[1] < 0.0)
    True
    """
    omega_rad_s = 2.0 * np.pi / period_s
    stiffness = omega_rad_s**2 * np.deg2rad(attitude_deg)
    friction = 2.0 * damping * omega_rad_s * np.deg2rad(rate_deg_s)
    return -inertia_kg_m2 * (stiffness + friction)
