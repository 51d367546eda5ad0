"""Quaternions of frame rotations, scalar last, as CCSDS messages and most of the field have them.

A quaternion ``q = (q1, q2, q3, qc)`` names the rotation from frame A to frame B: with the axis e and the angle phi by
which frame A is turned to become frame B, ``(q1, q2, q3) = e sin(phi/2)`` and ``qc = cos(phi/2)``; vectors change as
``v_B = R v_A`` with ``R`` the matrix of the frame rotation. ``q`` and ``-q`` name the same rotation.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.core.geometry.frames import body_from_nadir

FloatArray = NDArray[np.float64]


def quaternion_of_matrix(matrix: ArrayLike) -> FloatArray:
    """Return unit quaternions, scalar last, of matrices of frame rotations.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)
        Orthogonal, determinant +1, ``v_B = R v_A``.

    Returns
    -------
    ndarray, shape (..., 4)
        With ``qc >= 0``; accurate to rounding for every rotation: the largest of the four squared components is
        computed from the diagonal, the others from it (Shepperd, J. Guidance 1 (3), 1978).

    Examples
    --------
    >>> quaternion_of_matrix([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    r = np.asarray(matrix, dtype=np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    # four times the outer product of the quaternion with itself: any of its rows is the quaternion, unscaled
    outer = np.empty((*r.shape[:-2], 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[..., i, i] = 1.0 + 2.0 * r[..., i, i] - trace
        outer[..., i, j] = outer[..., j, i] = r[..., i, j] + r[..., j, i]
        outer[..., i, 3] = outer[..., 3, i] = r[..., j, k] - r[..., k, j]
    outer[..., 3, 3] = 1.0 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :]
    unit = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.asarray(np.where(unit[..., 3:] < 0.0, -unit, unit))


def matrix_of_quaternion(quaternion: ArrayLike) -> FloatArray:
    """Return the matrices of frame rotations, shape (..., 3, 3), of quaternions (..., 4), scalar last, of any length.

    Examples
    --------
    >>> matrix_of_quaternion([0.0, 0.0, 1.0, 1.0]).round(6) @ np.array([1.0, 0.0, 0.0])
    array([ 0., -1.,  0.])
    """
    q = np.asarray(quaternion, dtype=np.float64)
    unit = q / np.linalg.norm(q, axis=-1, keepdims=True)
    vector, scalar = unit[..., :3], unit[..., 3, np.newaxis, np.newaxis]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack(
        [np.stack([zero, -z, y], axis=-1), np.stack([z, zero, -x], axis=-1), np.stack([-y, x, zero], axis=-1)], axis=-2
    )
    dyad = vector[..., :, np.newaxis] * vector[..., np.newaxis, :]
    length_2 = np.sum(vector**2, axis=-1)[..., np.newaxis, np.newaxis]
    return np.asarray((scalar**2 - length_2) * np.eye(3) + 2.0 * dyad - 2.0 * scalar * cross)


def quaternion_of_attitude(attitude_deg: ArrayLike) -> FloatArray:
    """Return unit quaternions nadir frame -> body, shape (..., 4), scalar last, of attitudes.

    Parameters
    ----------
    attitude_deg : array_like, shape (..., 3), deg
        Yaw, roll, pitch.

    Examples
    --------
    >>> quaternion_of_attitude([90.0, 0.0, 0.0]).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    return quaternion_of_matrix(body_from_nadir(attitude_deg))


def attitude_of_quaternion(quaternion: ArrayLike) -> FloatArray:
    """Return attitudes (yaw, roll, pitch; deg), shape (..., 3), of quaternions nadir frame -> body, scalar last.

    Pitch lies within 90 degrees; at exactly 90 degrees yaw and roll are not told apart.

    Examples
    --------
    >>> attitude_of_quaternion(quaternion_of_attitude([0.2, -0.1, 0.05])).round(9)
    array([ 0.2 , -0.1 ,  0.05])
    """
    r = matrix_of_quaternion(quaternion)
    yaw = np.arctan2(r[..., 0, 1], r[..., 0, 0])
    pitch = -np.arcsin(np.clip(r[..., 0, 2], -1.0, 1.0))
    roll = np.arctan2(r[..., 1, 2], r[..., 2, 2])
    return np.asarray(np.degrees(np.stack([yaw, roll, pitch], axis=-1)))


def with_continuous_sign(quaternion: ArrayLike) -> FloatArray:
    """Return a sequence of quaternions, shape (T, 4), whose neighbours lie on the same half of the sphere.

    Interpolation between neighbours of opposite sign would pass through a rotation that never was.

    Examples
    --------
    >>> with_continuous_sign([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -0.1, -1.0], [0.0, 0.0, 0.1, 1.0]])[:, 3]
    array([1., 1., 1.])
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if len(q) < 2:
        return q.copy()
    step = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0.0, -1.0, 1.0)
    return np.asarray(q * np.concatenate([[1.0], np.cumprod(step)])[:, np.newaxis])
