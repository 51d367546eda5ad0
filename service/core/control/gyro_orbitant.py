"""The gyro-orbitant law in the service's axes: roll and pitch measured, yaw taken from the roll rate.

A spacecraft that follows its orbit turns once a revolution about the orbit normal; when it is turned by yaw, a part
``-w0 yaw`` of that rate shows about its roll axis. Its rate sensor therefore tells yaw where nothing else does. The
law is that of ``core/dynamics`` (axes: z up, y along the orbit normal); the service has z nadir and y South, half
a turn about x: roll stays, pitch and yaw change sign, and so do their torques and rates.
"""

import math

import numpy as np
from numpy.typing import NDArray

from service.core.dynamics.orbital_frame_model import Law
from service.core.dynamics.orbital_frame_step import wanted_torque

FloatArray = NDArray[np.float64]


def gyro_orbitant_torque(
    roll_deg: float, pitch_deg: float, body_rate_deg_s: FloatArray, law: Law, torque_limit_n_m: float
) -> FloatArray:
    """Return the torque on the body that brings an orbit-following craft to zero attitude.

    Parameters
    ----------
    roll_deg, pitch_deg : float, deg
        As a sensor of the vertical or the estimator gives them; within a few degrees.
    body_rate_deg_s : ndarray, shape (3,), deg/s
        Inertial rate about yaw, roll, pitch; at zero attitude ``(0, 0, -w0)``.
    law : Law
        Gains and orbital rate; of a geostationary craft 7.292e-5 rad/s.
    torque_limit_n_m : float, N m
        Above it an axis is cut, as the law's own computer does.

    Returns
    -------
    ndarray, shape (3,), N m
        Torque about yaw, roll, pitch.

    Raises
    ------
    ValueError
        A value is not finite, or the roll rate leaves an unguarded law without a yaw.

    Notes
    -----
    Belenkii, Vasilev, Semenov: Orientation and stabilization of Meteor-M No. 2 in orbital coordinate system.
    """
    torque = wanted_torque(law, *_in_model_axes(roll_deg, pitch_deg, body_rate_deg_s))
    if not all(math.isfinite(part) for part in torque):
        raise ValueError(
            f"roll {roll_deg:g} deg, pitch {pitch_deg:g} deg, rates {np.asarray(body_rate_deg_s).tolist()} deg/s give "
            "no torque: a value is not finite, or the roll rate exceeds the orbital rate and the law is not guarded"
        )
    limited = np.clip(torque, -torque_limit_n_m, torque_limit_n_m)
    return np.array([-limited[2], limited[0], -limited[1]])


def does_rate_show_yaw(body_rate_deg_s: FloatArray, orbital_rate_rad_s: float) -> bool:
    """Return whether rates (3,) are within the law: |c| <= 1, and the spacecraft turns with its orbit, not against it.

    Beyond, the guarded law takes any yaw for 45 degrees of half-angle: a spacecraft that is not near its frame, or a
    sensor that does not measure against inertial space. From the ground that is no ground for a torque.

    Examples
    --------
    >>> does_rate_show_yaw(np.array([0.0, 0.002, -0.004]), 7.292e-5)
    True
    >>> does_rate_show_yaw(np.array([0.0, 0.005, -0.004]), 7.292e-5)
    False
    """
    _, roll_rate, pitch_rate = np.radians(np.asarray(body_rate_deg_s, dtype=np.float64)).tolist()
    return bool(np.isfinite(body_rate_deg_s).all() and abs(roll_rate) <= orbital_rate_rad_s and pitch_rate <= 0.0)


def _in_model_axes(
    roll_deg: float, pitch_deg: float, body_rate_deg_s: FloatArray
) -> tuple[float, float, tuple[float, float, float]]:
    """Return roll and pitch, rad, and rates about roll, pitch, yaw, rad/s, in the law's own axes."""
    yaw_rate, roll_rate, pitch_rate = (math.radians(float(each)) for each in body_rate_deg_s)
    return math.radians(roll_deg), -math.radians(pitch_deg), (roll_rate, -pitch_rate, -yaw_rate)
