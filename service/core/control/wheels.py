"""Allocation of a body torque to reaction wheels.

A wheel that is accelerated about its axis turns the body the other way: the torque on the body is minus the sum of
axis times wheel torque. The least-norm allocation is the pseudo-inverse of the matrix of axes.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def allocate_to_wheels(axes: FloatArray, torque_n_m: FloatArray) -> FloatArray:
    """Return the least-norm wheel torques that give a torque on the body.

    Parameters
    ----------
    axes : ndarray, shape (W, 3)
        Spin axes in body axes x roll, y pitch, z yaw; normalised here. They must span the space.
    torque_n_m : ndarray, shape (..., 3), N m
        Torque on the body about x roll, y pitch, z yaw.

    Returns
    -------
    ndarray, shape (..., W), N m
        Command to each wheel.

    Examples
    --------
    >>> allocate_to_wheels(np.eye(3), np.array([0.01, 0.0, -0.02])).tolist()
    [-0.01, 0.0, 0.02]
    """
    wheels: FloatArray = -torque_n_m @ _allocation(axes)
    return wheels + 0.0


def body_torque_limit_n_m(axes: FloatArray, wheel_limit_n_m: float) -> float:
    """Return the torque that may be asked for about all three body axes at once without overloading a wheel.

    Parameters
    ----------
    axes : ndarray, shape (W, 3)
        Spin axes in body axes; they must span the space.
    wheel_limit_n_m : float, N m
        Greatest torque of one wheel.

    Returns
    -------
    float, N m
        The limit on each body axis: the hardest-worked wheel at the worst signs is just at its own.

    Examples
    --------
    >>> body_torque_limit_n_m(np.eye(3), 0.05)
    0.05
    """
    return float(wheel_limit_n_m / np.abs(_allocation(axes)).sum(axis=0).max())


def _allocation(axes: FloatArray) -> FloatArray:
    """Return the pseudo-inverse (3, W) of the normalised axes."""
    plain = np.ascontiguousarray(axes, dtype=np.float64)
    return _pseudo_inverse(len(plain), plain.tobytes())


@lru_cache(maxsize=64)
def _pseudo_inverse(wheels: int, axes: bytes) -> FloatArray:
    """Return the pseudo-inverse of axes (W, 3) told byte by byte: a set of wheels hardly ever changes; read-only."""
    rows = np.frombuffer(axes).reshape(wheels, 3)
    inverse = np.asarray(np.linalg.pinv(rows / np.linalg.norm(rows, axis=1, keepdims=True)), dtype=np.float64)
    inverse.setflags(write=False)
    return inverse
