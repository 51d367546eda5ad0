"""Gains of the gyro-orbitant law that a spacecraft commanded from the ground can have: they settle and do not saturate.

Near zero attitude the law is linear, with p the rates against inertial space less that of the orbit:

    u_yaw  = k1z / (sqrt(2) w0) p_roll - k2z p_yaw      yaw'   = -w0 roll + p_yaw
    u_roll = -k1x / 2 roll - k2x p_roll                 roll'  = w0 yaw + p_roll      I p' = u
    u_pitch = -k1y / 2 pitch - k2y p_pitch              pitch' = p_pitch

k1 N m, k2 N m s, w0 orbital rate, rad/s. From the ground the torque u is the mean of a command period, computed from
values that are up to one period old when it acts; both loops must settle. Order everywhere: yaw, roll, pitch.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, inertia_about_angles
from service.core.dynamics.orbital_frame_model import Law, OrbitalFrameGains

FloatArray = NDArray[np.float64]

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
