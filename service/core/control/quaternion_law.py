"""Attitude control law by quaternion error, and the slew request that follows from it in tracking.

Functions of arrays are compiled as they stand; they refuse nothing: what is not finite gives what is not finite.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import FloatArray

#: rad/s, one turn in a sidereal day
GEOSTATIONARY_RATE_RAD_S = 7.2921159e-5
#: places of yaw, roll, pitch among the body axes x roll, y pitch, z yaw
ANGLES_FROM_BODY = (2, 0, 1)
#: relative departure from symmetry and from the triangle rule that rounding of a catalogue explains
_ROUNDING = 1e-9
#: a loop sampled more coarsely than this many times a period is not the loop that was designed
_LEAST_SAMPLES = 10.0


class Gains(NamedTuple):
    """Gains of the law about yaw, roll, pitch."""

    #: (3, 3) kg m^2 in the order yaw, roll, pitch
    inertia_kg_m2: FloatArray
    #: (3, 3)
    inverse_1_kg_m2: FloatArray
    #: 1/s^2, of the angle
    stiffness_1_s2: float
    #: 1/s, of the rate
    friction_1_s: float
    #: 0 where the on-board mode does not follow the orbit
    orbital_rate_rad_s: float


def inertia_about_angles(inertia_kg_m2: ArrayLike) -> FloatArray:
    """Return the tensor (3, 3), kg m^2, of axes x, y, z in the order yaw, roll, pitch.

    Raises
    ------
    ValueError
        Not finite, not symmetric, a principal moment not positive, or one above the sum of the others.

    Examples
    --------
    >>> inertia_about_angles(np.diag([2600.0, 1400.0, 2500.0])).diagonal().tolist()
    [2500.0, 2600.0, 1400.0]
    """
    tensor = np.asarray(inertia_kg_m2, dtype=np.float64)
    if tensor.shape != (3, 3) or not np.isfinite(tensor).all():
        raise ValueError("the inertia must be a 3 x 3 tensor of finite numbers, kg m^2")
    if np.abs(tensor - tensor.T).max() > _ROUNDING * np.abs(tensor).max():
        raise ValueError("the inertia tensor is not symmetric; state both products of inertia alike")
    least, middle, greatest = np.linalg.eigvalsh(tensor).tolist()
    if least <= 0.0:
        raise ValueError(f"a principal moment of inertia is {least:g} kg m^2; all three must be positive")
    if greatest > (least + middle) * (1.0 + _ROUNDING):
        raise ValueError(
            f"the principal moment {greatest:g} exceeds the sum of the others, {least + middle:g} kg m^2; no body is so"
        )
    return np.ascontiguousarray(tensor[np.ix_(ANGLES_FROM_BODY, ANGLES_FROM_BODY)])


def inverse_of(inertia_kg_m2: FloatArray) -> FloatArray:
    """Return the inverse of a tensor (3, 3)."""
    return np.asarray(np.linalg.inv(inertia_kg_m2), dtype=np.float64)


def loop_gains(
    inertia_kg_m2: ArrayLike,
    *,
    period_s: float,
    damping: float,
    torque_limit_n_m: float,
    command_period_s: float | None,
    angle_deg: float = 0.4,
    orbital_rate_rad_s: float = GEOSTATIONARY_RATE_RAD_S,
) -> Gains:
    """Return the gains of a closed loop of some period and damping.

    Parameters
    ----------
    inertia_kg_m2 : array_like, shape (3, 3), kg m^2
        Tensor about x roll, y pitch, z yaw.
    period_s : float, s
        Undamped period of the closed loop.
    damping : float
        Damping ratio.
    torque_limit_n_m : float, N m
        Greatest torque on an axis.
    command_period_s : float or None, s
        Time between commands; None where each command takes away the rate that it gives, which no sampling upsets.
    angle_deg : float, deg
        Greatest angle from which the loop must work without meeting the limit.
    orbital_rate_rad_s : float, rad/s
        0 where roll and yaw do not exchange.

    Raises
    ------
    ValueError
        A number is not finite or not positive, the inertia is no body's, the gains saturate, or commands come too
        rarely for the period. The message says what to change.

    Examples
    --------
    >>> inertia = np.diag([2600.0, 1400.0, 2600.0])
    >>> gains = loop_gains(inertia, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=60.0)
    >>> f"{gains.stiffness_1_s2:.3e} {gains.friction_1_s:.3e}"
    '7.615e-07 1.571e-03'
    """
    tensor = inertia_about_angles(inertia_kg_m2)
    named = {"period_s": period_s, "damping": damping, "torque_limit_n_m": torque_limit_n_m}
    sampled_s = period_s / _LEAST_SAMPLES if command_period_s is None else command_period_s
    for name, value in {**named, "command_period_s": sampled_s, "angle_deg": angle_deg}.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is {value:g}; it must be finite and positive")
    if not math.isfinite(orbital_rate_rad_s):
        raise ValueError("orbital_rate_rad_s must be finite")
    if period_s < _LEAST_SAMPLES * sampled_s * (1.0 - _ROUNDING):
        raise ValueError(
            f"a period of {period_s:g} s is too short for commands every {sampled_s:g} s; "
            f"take at least {_LEAST_SAMPLES * sampled_s:g} s"
        )
    omega_rad_s = 2.0 * math.pi / period_s
    torque_n_m = float(np.abs(tensor).sum(axis=1).max()) * omega_rad_s**2 * math.radians(angle_deg)
    if torque_n_m > torque_limit_n_m:
        longer_s = period_s * math.sqrt(torque_n_m / torque_limit_n_m)
        raise ValueError(
            f"the gains saturate: {angle_deg:g} deg would ask for {torque_n_m:.3g} N m of {torque_limit_n_m:g}; "
            f"take a period of at least {math.ceil(longer_s):d} s"
        )
    return Gains(tensor, inverse_of(tensor), omega_rad_s**2, 2.0 * damping * omega_rad_s, orbital_rate_rad_s)


def error_angles_rad(attitude_deg: FloatArray, target_deg: FloatArray) -> FloatArray:
    """Return twice the vector part (3,) of the quaternion from target to body, by the shorter way, rad.

    Order yaw, roll, pitch; equal to the angles of rotation to third order.

    Examples
    --------
    >>> np.degrees(error_angles_rad(np.array([0.0, 0.1, 0.0]), np.zeros(3))).round(6).tolist()
    [0.0, 0.1, 0.0]
    """
    x, y, z, w = _quaternion(attitude_deg)
    tx, ty, tz, tw = _quaternion(target_deg)
    # frame rotations follow one another as body = error after target: q_error = conj(q_target) * q_body
    scalar = tw * w + tx * x + ty * y + tz * z
    roll = tw * x - w * tx - (ty * z - tz * y)
    pitch = tw * y - w * ty - (tz * x - tx * z)
    yaw = tw * z - w * tz - (tx * y - ty * x)
    twice = math.copysign(2.0, scalar)
    return np.array((twice * yaw, twice * roll, twice * pitch))


def _quaternion(attitude_deg: FloatArray) -> tuple[float, float, float, float]:
    """Return the quaternion of yaw, roll, pitch in this order (3-2-1), scalar last."""
    yaw, roll, pitch = math.radians(attitude_deg[0]), math.radians(attitude_deg[1]), math.radians(attitude_deg[2])
    cy, cr, cp = math.cos(0.5 * yaw), math.cos(0.5 * roll), math.cos(0.5 * pitch)
    sy, sr, sp = math.sin(0.5 * yaw), math.sin(0.5 * roll), math.sin(0.5 * pitch)
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return x, y, z, cr * cp * cy + sr * sp * sy


def body_rate_rad_s(attitude_deg: FloatArray, rates_deg_s: FloatArray) -> FloatArray:
    """Return the rate of the body against the orbit (3,) about its own axes, of the rates of its angles (3,)."""
    roll, pitch = math.radians(attitude_deg[1]), math.radians(attitude_deg[2])
    yaw_rate, roll_rate = math.radians(rates_deg_s[0]), math.radians(rates_deg_s[1])
    pitch_rate = math.radians(rates_deg_s[2])
    about_yaw = yaw_rate * math.cos(pitch) * math.cos(roll) - pitch_rate * math.sin(roll)
    about_roll = roll_rate - yaw_rate * math.sin(pitch)
    about_pitch = yaw_rate * math.cos(pitch) * math.sin(roll) + pitch_rate * math.cos(roll)
    return np.array((about_yaw, about_roll, about_pitch))


def feedback_torque(
    gains: Gains, attitude_deg: FloatArray, rates_deg_s: FloatArray, target_deg: FloatArray, disturbance_n_m: FloatArray
) -> FloatArray:
    """Return the torque on the body about yaw, roll, pitch (3,), N m, not yet limited.

    Parameters
    ----------
    gains : Gains
        Of `loop_gains`.
    attitude_deg, rates_deg_s : ndarray, shape (3,), deg and deg/s
        Filtered angles and their rates: yaw, roll, pitch.
    target_deg : ndarray, shape (3,), deg
        Attitude to hold.
    disturbance_n_m : ndarray, shape (3,), N m
        Estimated torque on the body that nobody commanded; it is cancelled.

    Examples
    --------
    >>> inertia = np.diag([2600.0, 1400.0, 2600.0])
    >>> gains = loop_gains(inertia, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=60.0)
    >>> roll = np.array([0.0, 0.1, 0.0])
    >>> feedback_torque(gains, roll, np.zeros(3), np.zeros(3), np.zeros(3)).round(9).tolist()
    [0.0, -3.456e-06, 0.0]
    """
    rate, error = body_rate_rad_s(attitude_deg, rates_deg_s), error_angles_rad(attitude_deg, target_deg)
    wanted = np.empty(3)
    for axis in range(3):
        wanted[axis] = -gains.stiffness_1_s2 * error[axis] - gains.friction_1_s * rate[axis]
    wanted[0] += gains.orbital_rate_rad_s * rate[1]
    wanted[1] -= gains.orbital_rate_rad_s * rate[0]
    torque = np.empty(3)
    for axis in range(3):
        torque[axis] = product_about(gains.inertia_kg_m2, axis, wanted) - disturbance_n_m[axis] + 0.0
    return torque


def product_about(tensor: FloatArray, axis: int, values: FloatArray) -> float:
    """Return one element of the product of a tensor (3, 3) and values (3,)."""
    return float(tensor[axis, 0] * values[0] + tensor[axis, 1] * values[1] + tensor[axis, 2] * values[2])


class SlewRequest(NamedTuple):
    """Request to `slew_schedule.plan_slew`; (3,) in the order yaw, roll, pitch."""

    angle_change_rad: FloatArray
    rate_rad_s: FloatArray


def tracking_request(gains: Gains, attitude_deg: FloatArray, rates_deg_s: FloatArray, horizon_s: float) -> SlewRequest:
    """Return the slew that takes a share of the error within a command period.

    Parameters
    ----------
    gains : Gains
        Of `quaternion_law.loop_gains`.
    attitude_deg, rates_deg_s : ndarray, shape (3,), deg and deg/s
        Filtered angles and rates.
    horizon_s : float, s
        Command period.

    Examples
    --------
    >>> inertia = np.diag([2600.0, 1400.0, 2600.0])
    >>> gains = loop_gains(inertia, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=60.0)
    >>> request = tracking_request(gains, np.array([0.0, 0.1, 0.0]), np.zeros(3), 600.0)
    >>> np.degrees(request.angle_change_rad).round(4).tolist()
    [0.0, -0.0252, 0.0]
    """
    change = error_angles_rad(attitude_deg, np.zeros(3))
    share = 1.0 - math.exp(-gains.stiffness_1_s2 / gains.friction_1_s * horizon_s)
    rate = np.empty(3)
    for axis in range(3):
        change[axis] = -share * change[axis] + 0.0
        rate[axis] = math.radians(rates_deg_s[axis])
    # of the present rate, that which holds the spacecraft where it stands turns into that which holds it where it will
    # be
    rate[0] -= gains.orbital_rate_rad_s * change[1]
    rate[1] += gains.orbital_rate_rad_s * change[0]
    return SlewRequest(change, rate)
