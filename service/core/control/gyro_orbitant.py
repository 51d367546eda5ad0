"""The gyro-orbitant law in the service's axes, and gains that settle and do not saturate."""

import math

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import FloatArray
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, inertia_about_angles
from service.core.dynamics.orbital_frame_model import Law, OrbitalFrameGains
from service.core.dynamics.orbital_frame_step import wanted_torque


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


#: attitude at which the law must not saturate, deg
_ANGLE_DEG = 0.4
#: terms of the exponential of one period's motion: angles and rates in units of a period are of order one
_TERMS = 16


def gyro_orbitant_law(
    inertia_kg_m2: ArrayLike,
    gains: OrbitalFrameGains,
    *,
    torque_limit_n_m: float,
    command_period_s: float,
    orbital_rate_rad_s: float = GEOSTATIONARY_RATE_RAD_S,
) -> Law:
    """Return the law of some gains.

    Parameters
    ----------
    inertia_kg_m2 : array_like, shape (3, 3), kg m^2
        Tensor about x roll, y pitch, z yaw.
    gains : OrbitalFrameGains
        Stiffness, N m a unit of half-angle, and damping, N m s, about each axis.
    torque_limit_n_m : float, N m
        Greatest torque on an axis.
    command_period_s : float, s
        Time between commands.
    orbital_rate_rad_s : float, rad/s
        Of the spacecraft.

    Raises
    ------
    ValueError
        A gain is not finite and positive, the inertia is no body's, the torque at 0.4 deg and a roll rate of the
        orbital rate is beyond the limit, or the sampled loop does not settle. The message says what to change.

    Examples
    --------
    >>> inertia = np.diag([2600.0, 1400.0, 2600.0])
    >>> gains = OrbitalFrameGains(0.02, 6.0, 0.01, 3.0, 2e-3, 6.0)
    >>> law = gyro_orbitant_law(inertia, gains, torque_limit_n_m=0.05, command_period_s=60.0)
    >>> round(law.orbital_rate_rad_s, 9)
    7.2921e-05
    """
    tensor = inertia_about_angles(inertia_kg_m2)
    for name, value in gains._asdict().items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is {value:g}; it must be finite and positive")
    if not (math.isfinite(command_period_s) and command_period_s > 0.0):
        raise ValueError(f"command_period_s is {command_period_s:g}; it must be finite and positive")
    _check_torque(gains, torque_limit_n_m, orbital_rate_rad_s)
    growth = sampled_growth(tensor, gains, orbital_rate_rad_s, command_period_s)
    if growth >= 1.0:
        raise ValueError(
            f"commands every {command_period_s:g} s do not settle with these gains: an error grows {growth:.3g} times "
            "from one to the next; take smaller ones, or more damping for the stiffness"
        )
    return Law(gains=gains, orbital_rate_rad_s=orbital_rate_rad_s)


def sampled_growth(
    tensor_kg_m2: FloatArray, gains: OrbitalFrameGains, orbital_rate_rad_s: float, period_s: float
) -> float:
    """Return by how much an error grows at most from one command to the next; below 1 the loop settles.

    ``tensor_kg_m2`` (3, 3) stands in the order yaw, roll, pitch. The greater of two: values that are new when the
    torque begins to act, and values that are one period old.
    """
    free, forced = _motion(tensor_kg_m2, orbital_rate_rad_s, period_s)
    feedback = forced @ _feedback(gains, orbital_rate_rad_s, period_s)
    nothing, same = np.zeros((6, 6)), np.eye(6)
    at_once = free + feedback
    one_late = np.block([[free, feedback], [same, nothing]])
    return max(float(np.abs(np.linalg.eigvals(matrix)).max()) for matrix in (at_once, one_late))


def _motion(tensor_kg_m2: FloatArray, w0: float, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition over a period of angles and rates (6, 6), and of a torque (6, 3); rates a period."""
    turn = np.zeros((9, 9))
    turn[:3, 3:6] = np.eye(3)
    turn[0, 1], turn[1, 0] = -w0 * period_s, w0 * period_s
    turn[3:6, 6:] = period_s**2 * np.linalg.inv(tensor_kg_m2)
    term = whole = np.eye(9)
    for n in range(1, _TERMS):
        term = term @ turn / n
        whole = whole + term
    return whole[:6, :6], whole[:6, 6:]


def _feedback(gains: OrbitalFrameGains, w0: float, period_s: float) -> FloatArray:
    """Return the torque (3, 6) of the linear law on angles and on rates a period."""
    stiffness = np.diag([0.0, -0.5 * gains.roll_stiffness, -0.5 * gains.pitch_stiffness])
    damping = -np.diag([gains.yaw_damping, gains.roll_damping, gains.pitch_damping])
    damping[0, 1] = gains.yaw_stiffness / (math.sqrt(2.0) * w0)
    return np.hstack([stiffness, damping / period_s])


def _check_torque(gains: OrbitalFrameGains, torque_limit_n_m: float, w0: float) -> None:
    """Raise ValueError where the law saturates at an angle and a rate that it must bear."""
    angle_rad = math.radians(_ANGLE_DEG)
    # the roll rate tells yaw up to the orbital rate
    asked_n_m = {
        "roll": 0.5 * gains.roll_stiffness * angle_rad + gains.roll_damping * w0,
        "pitch": 0.5 * gains.pitch_stiffness * angle_rad + gains.pitch_damping * w0,
        "yaw": 0.5 * gains.yaw_stiffness + gains.yaw_damping * w0,
    }
    for axis, torque_n_m in asked_n_m.items():
        if not torque_n_m <= torque_limit_n_m:
            raise ValueError(
                f"the gains saturate: {axis} would ask for {torque_n_m:.3g} N m of {torque_limit_n_m:g} at "
                f"{_ANGLE_DEG:g} deg and a rate of {math.degrees(w0) * 3600.0:.3g} deg/h; take smaller ones"
            )
