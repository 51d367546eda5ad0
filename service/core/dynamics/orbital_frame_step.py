"""Equations of the spacecraft in the orbital frame, in scalars: one source serves the compiler and Python.

    dk/dt = k x w + M_gg     w = J^-1 (k - H)     dH/dt = -u     dq/dt = 1/2 q o (0, w - conj(q) o w0 o q)
    M_gg  = 3 w0^2 r x (J r),  r the third column of A, the matrix from the orbital to the body frame

The law of this file: numbers and tuples of numbers only; no name of another module but numbers' own functions.
Quaternions are scalar first here. A state is ``(q0 q1 q2 q3 kx ky kz Hx Hy Hz)``. The printed ``w x k`` would not keep
the momentum; see docs/explanations/orbital-frame-control.md for every correction.
"""

import math

from service.core.dynamics.orbital_frame_model import Law

State = tuple[float, float, float, float, float, float, float, float, float, float]
Triple = tuple[float, float, float]
#: inverse of the inertia tensor: xx yy zz xy xz yz
Inverse = tuple[float, float, float, float, float, float]


def inverse_inertia(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> Inverse:
    """Return the six elements of the inverse of a symmetric tensor."""
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    return (
        (yy * zz - yz * yz) / det,
        (xx * zz - xz * xz) / det,
        (xx * yy - xy * xy) / det,
        (xz * yz - xy * zz) / det,
        (xy * yz - xz * yy) / det,
        (xy * xz - xx * yz) / det,
    )


def times(m: Inverse, v: Triple) -> Triple:
    """Return the product of a symmetric matrix (xx yy zz xy xz yz) and a vector."""
    return (
        m[0] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[3] * v[0] + m[1] * v[1] + m[5] * v[2],
        m[4] * v[0] + m[5] * v[1] + m[2] * v[2],
    )


def body_rate(state: State, inverse: Inverse) -> Triple:
    """Return the inertial rate of the body, rad/s."""
    return times(inverse, (state[4] - state[7], state[5] - state[8], state[6] - state[9]))


def vertical(state: State) -> Triple:
    """Return the radius vector's direction in the body frame."""
    q0, q1, q2, q3 = state[0], state[1], state[2], state[3]
    return (2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)


def normal(state: State) -> Triple:
    """Return the orbit normal's direction in the body frame."""
    q0, q1, q2, q3 = state[0], state[1], state[2], state[3]
    return (2.0 * (q1 * q2 + q0 * q3), q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3, 2.0 * (q2 * q3 - q0 * q1))


def angles(state: State) -> Triple:
    """Return roll, pitch, yaw, rad: yaw first, then pitch, then roll."""
    q0, q1, q2, q3 = state[0], state[1], state[2], state[3]
    a11 = q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3
    a12 = 2.0 * (q1 * q2 + q0 * q3)
    up = vertical(state)
    return (math.atan2(up[1], up[2]), -math.asin(min(1.0, max(-1.0, up[0]))), math.atan2(a12, a11))


def tilt(state: State) -> tuple[float, float]:
    """Return roll and pitch as the sensor of the vertical measures them, rad."""
    up = vertical(state)
    return (math.atan2(up[1], up[2]), math.atan2(-up[0], up[2]))


def half_angles(law: Law, roll_rad: float, pitch_rad: float, rate: Triple) -> tuple[float, float, float, float]:
    """Return the quaternion that the law takes for the attitude, scalar first; unit length, NaN where it has none.

    The tilt is measured, the yaw comes from the roll rate: a spacecraft that is turned by yaw while it follows the
    orbit rolls at w0 sin(yaw). The tilt's form is the paper's, exact to 1e-7 within the sensor's zone; from a tilt of
    sqrt(8) rad on, where the form is that of a half turn, it stays one.
    """
    size = roll_rad * roll_rad + pitch_rad * pitch_rad
    if size > 8.0:
        shrink = math.sqrt(8.0 / size)
        roll_rad, pitch_rad = shrink * roll_rad, shrink * pitch_rad
    square = min(size, 8.0)
    mu0 = 1.0 - square / 8.0
    mu1 = math.sqrt(16.0 - square) / 8.0 * roll_rad
    mu2 = math.sqrt(16.0 - square) / 8.0 * pitch_rad
    c = rate[0] / law.orbital_rate_rad_s
    is_near = rate[1] >= 0.0 and (abs(c) <= 1.0 or not law.is_guarded)
    if is_near:
        nu3 = c * law.slope
        nu0 = math.sqrt(1.0 - nu3 * nu3) if abs(nu3) <= 1.0 else math.nan
    else:
        nu0 = math.sqrt(0.5)
        nu3 = math.copysign(nu0, rate[0])
    # 0: L1 o L2; 1: as printed, which is no product; 2: L2 o L1
    sign_1 = -1.0 if law.product == 2 else 1.0
    sign_2 = -1.0 if law.product == 0 else 1.0
    return (mu0 * nu0, mu1 * nu0 + sign_1 * mu2 * nu3, mu2 * nu0 + sign_2 * mu1 * nu3, mu0 * nu3)


def wanted_torque(law: Law, roll_rad: float, pitch_rad: float, rate: Triple) -> Triple:
    """Return the torque on the body that the law wants, N m, without limit."""
    l0, l1, l2, l3 = half_angles(law, roll_rad, pitch_rad, rate)
    g = law.gains
    return (
        -g.roll_stiffness * l0 * l1 - g.roll_damping * rate[0],
        -g.pitch_stiffness * l0 * l2 - g.pitch_damping * (rate[1] - law.orbital_rate_rad_s),
        -g.yaw_stiffness * l0 * l3 - g.yaw_damping * rate[2],
    )


def derivative(state: State, inertia: Inverse, inverse: Inverse, gravity: float, wheel: Triple, w0: float) -> State:
    """Return the time derivative of a state under given torques of the wheels on the body, N m.

    ``inertia`` is the tensor as ``(xx yy zz xy xz yz)``, ``gravity`` is 3 w0^2, or 0 without the gravity gradient.
    """
    q0, q1, q2, q3, kx, ky, kz = state[0], state[1], state[2], state[3], state[4], state[5], state[6]
    wx, wy, wz = body_rate(state, inverse)
    n = normal(state)
    rx, ry, rz = wx - w0 * n[0], wy - w0 * n[1], wz - w0 * n[2]
    up = vertical(state)
    j = times(inertia, up)
    return (
        -0.5 * (q1 * rx + q2 * ry + q3 * rz),
        0.5 * (q0 * rx + q2 * rz - q3 * ry),
        0.5 * (q0 * ry + q3 * rx - q1 * rz),
        0.5 * (q0 * rz + q1 * ry - q2 * rx),
        ky * wz - kz * wy + gravity * (up[1] * j[2] - up[2] * j[1]),
        kz * wx - kx * wz + gravity * (up[2] * j[0] - up[0] * j[2]),
        kx * wy - ky * wx + gravity * (up[0] * j[1] - up[1] * j[0]),
        -wheel[0],
        -wheel[1],
        -wheel[2],
    )


def moved(state: State, slope: State, step_s: float) -> State:
    """Return the state moved along a slope."""
    return (
        state[0] + step_s * slope[0],
        state[1] + step_s * slope[1],
        state[2] + step_s * slope[2],
        state[3] + step_s * slope[3],
        state[4] + step_s * slope[4],
        state[5] + step_s * slope[5],
        state[6] + step_s * slope[6],
        state[7] + step_s * slope[7],
        state[8] + step_s * slope[8],
        state[9] + step_s * slope[9],
    )


def blended(state: State, slopes: tuple[State, State, State, State], step_s: float) -> State:
    """Return the state after a step of the classical Runge-Kutta method, the quaternion at unit length."""
    a, b, c, d = slopes
    sixth = step_s / 6.0
    q0 = state[0] + sixth * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
    q1 = state[1] + sixth * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    q2 = state[2] + sixth * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
    q3 = state[3] + sixth * (a[3] + 2.0 * b[3] + 2.0 * c[3] + d[3])
    scale = 1.0 / math.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    return (
        q0 * scale,
        q1 * scale,
        q2 * scale,
        q3 * scale,
        state[4] + sixth * (a[4] + 2.0 * b[4] + 2.0 * c[4] + d[4]),
        state[5] + sixth * (a[5] + 2.0 * b[5] + 2.0 * c[5] + d[5]),
        state[6] + sixth * (a[6] + 2.0 * b[6] + 2.0 * c[6] + d[6]),
        state[7] + sixth * (a[7] + 2.0 * b[7] + 2.0 * c[7] + d[7]),
        state[8] + sixth * (a[8] + 2.0 * b[8] + 2.0 * c[8] + d[8]),
        state[9] + sixth * (a[9] + 2.0 * b[9] + 2.0 * c[9] + d[9]),
    )
