"""Allocation of a body torque to reaction wheels.

A wheel that is accelerated about its axis turns the body the other way: the torque on the body is minus the sum of
axis times wheel torque. The least-norm allocation is the pseudo-inverse of the matrix of axes.
"""

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
    unit_axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    wheels: FloatArray = -torque_n_m @ np.linalg.pinv(unit_axes)
    return wheels + 0.0
