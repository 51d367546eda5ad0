"""A body torque shared out to any set of wheels within their limits of torque and momentum.

Functions of arrays are compiled as they stand.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import FloatArray


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
    rows = np.asarray(axes, dtype=np.float64)
    return np.ascontiguousarray(np.linalg.pinv(rows / np.linalg.norm(rows, axis=1, keepdims=True)))


#: least singular value of the unit axes: no direction may need more than twenty times the torque
LEAST_SINGULAR_VALUE = 0.05
#: components of null motion below this share of its length do not move a wheel
_STILL = 1e-6


class Wheels(NamedTuple):
    """A set of wheels."""

    #: (W, 3) unit axes in the order yaw, roll, pitch
    axes: FloatArray
    #: (3, W) wheel torques of least norm that give a torque about each body axis, with the other sign
    inverse: FloatArray
    #: (W - 3, W) directions of wheel torques that turn nothing
    null: FloatArray
    torque_limit_n_m: float
    momentum_limit_n_m_s: float
    #: momentum below which a wheel counts as near zero speed; 0 = null motion is not used
    least_momentum_n_m_s: float

    @property
    def size(self) -> int:
        """Number of wheels W."""
        return len(self.axes)


class Allocation(NamedTuple):
    """Torque command of each wheel."""

    #: (W,) N m, null motion included
    wheels_n_m: FloatArray
    #: (W,) N m, the part that turns nothing
    null_n_m: FloatArray
    #: of the requested torque on the body; 1 = all of it
    share: float


def wheel_set(
    axes: ArrayLike, torque_limit_n_m: float, momentum_limit_n_m_s: float, least_momentum_n_m_s: float = 0.0
) -> Wheels:
    """Return a set of wheels.

    Parameters
    ----------
    axes : array_like, shape (W, 3)
        Spin axes in the order yaw, roll, pitch, of any length.
    torque_limit_n_m, momentum_limit_n_m_s : float
        Greatest torque and momentum of one wheel.
    least_momentum_n_m_s : float, N m s
        Momentum from which a wheel is kept away by null motion.

    Raises
    ------
    ValueError
        Fewer than three wheels, an axis without direction, axes that do not span all three directions, or limits that
        contradict each other.
    """
    rows = np.asarray(axes, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < 3 or not np.isfinite(rows).all():
        raise ValueError("three wheels are needed at least, each with an axis of three finite numbers")
    lengths = np.linalg.norm(rows, axis=1)
    if not (lengths > 0.0).all():
        raise ValueError(f"wheel {int(np.argmin(lengths)) + 1} has no direction: its axis is the zero vector")
    unit = np.ascontiguousarray(rows / lengths[:, None])
    values, directions = np.linalg.svd(unit, full_matrices=False)[1:]
    if values[-1] < LEAST_SINGULAR_VALUE:
        weak = ", ".join(f"{name} {part:+.2f}" for name, part in zip(_AXES, directions[-1], strict=True))
        raise ValueError(
            f"the wheels are singular: about the direction {weak} they give {values[-1]:.2g} of a wheel's torque, "
            f"at least {LEAST_SINGULAR_VALUE:g} is needed; control with them is not possible"
        )
    limits = (torque_limit_n_m, momentum_limit_n_m_s)
    if not all(math.isfinite(each) and each > 0.0 for each in limits):
        raise ValueError("limits of torque and momentum must be finite and positive")
    if not 0.0 <= least_momentum_n_m_s < momentum_limit_n_m_s:
        raise ValueError("the least momentum must lie between zero and the limit of momentum")
    null = np.ascontiguousarray(np.linalg.svd(unit.T)[2][3:])
    return Wheels(unit, _allocation(unit), null, *map(float, (*limits, least_momentum_n_m_s)))


_AXES = ("yaw", "roll", "pitch")


def allocate(wheels: Wheels, torque_n_m: FloatArray, momentum_n_m_s: FloatArray, duration_s: float) -> Allocation:
    """Return the torque of each wheel for a torque on the body.

    Parameters
    ----------
    wheels : Wheels
        Of `wheel_set`.
    torque_n_m : ndarray, shape (3,), N m
        Wanted torque on the body about yaw, roll, pitch.
    momentum_n_m_s : ndarray, shape (W,), N m s
        Stored momentum at the beginning.
    duration_s : float, s
        How long the torque lasts.

    Returns
    -------
    Allocation
        A wheel beyond its limit of momentum takes no torque that leads further out, any that leads back.
    """
    wheels_n_m, null_n_m, share = np.empty(len(momentum_n_m_s)), np.zeros(len(momentum_n_m_s)), 1.0
    for k in range(len(wheels_n_m)):
        wanted = 0.0
        for axis in range(3):
            wanted -= torque_n_m[axis] * wheels.inverse[axis, k]
        wheels_n_m[k] = wanted
        room = _room(wheels, momentum_n_m_s[k], math.copysign(1.0, wanted), duration_s)
        bound = min(room, wheels.torque_limit_n_m)
        if abs(wanted) > bound:
            share = min(share, bound / abs(wanted))
    is_slow = False
    for k in range(len(wheels_n_m)):
        wheels_n_m[k] = share * wheels_n_m[k] + 0.0
        is_slow |= abs(momentum_n_m_s[k] + wheels_n_m[k] * duration_s) < wheels.least_momentum_n_m_s
    if is_slow and len(wheels.null):
        _write_null_torque(null_n_m, wheels, wheels_n_m, momentum_n_m_s, duration_s)
        for k in range(len(wheels_n_m)):
            wheels_n_m[k] += null_n_m[k]
    return Allocation(wheels_n_m, null_n_m, share)


def _room(wheels: Wheels, momentum_n_m_s: float, sign: float, duration_s: float) -> float:
    """Return the greatest torque of a sign that the momentum of a wheel still allows."""
    return max(0.0, (wheels.momentum_limit_n_m_s - sign * momentum_n_m_s) / duration_s)


def _write_null_torque(
    null_n_m: FloatArray, wheels: Wheels, given_n_m: FloatArray, momentum_n_m_s: FloatArray, duration_s: float
) -> None:
    """Write the null motion that keeps wheels away from zero speed, within the room that is left; zeros: none does.

    Of some null directions the one with the smallest change of momentum after which no wheel is slow. Tried are: slow
    wheels pushed on, each the way it turns, projected; then each direction of the null space.
    """
    size, smallest, share = len(null_n_m), math.inf, 1.0
    ending, direction = np.empty(size), np.empty(size)
    for k in range(size):
        ending[k] = momentum_n_m_s[k] + given_n_m[k] * duration_s
    for candidate in range(1 + len(wheels.null)):
        _write_direction(direction, wheels, ending, candidate)
        step = _step_along(wheels, ending, direction)
        if abs(step) < smallest:
            smallest = abs(step)
            for k in range(size):
                null_n_m[k] = step * direction[k] / duration_s
    for k in range(size):
        if abs(null_n_m[k]) > 0.0:
            sign = math.copysign(1.0, null_n_m[k])
            room = min(_room(wheels, momentum_n_m_s[k], sign, duration_s), wheels.torque_limit_n_m)
            share = min(share, (room - sign * given_n_m[k]) / abs(null_n_m[k]))
    for k in range(size):
        null_n_m[k] *= max(0.0, share)


def _write_direction(direction: FloatArray, wheels: Wheels, momentum_n_m_s: FloatArray, candidate: int) -> None:
    """Write the null direction (W,) that is tried at some place, the projected one first."""
    for k in range(len(direction)):
        direction[k] = 0.0
    for row in range(len(wheels.null)):
        along = 1.0 if row == candidate - 1 else 0.0
        for k in range(len(direction)):
            if candidate == 0 and abs(momentum_n_m_s[k]) < wheels.least_momentum_n_m_s:
                along += wheels.null[row, k] if momentum_n_m_s[k] >= 0.0 else -wheels.null[row, k]
        for k in range(len(direction)):
            direction[k] += along * wheels.null[row, k]


def _step_along(wheels: Wheels, momentum_n_m_s: FloatArray, direction: FloatArray) -> float:
    """Return the smallest step along a direction after which every wheel is neither slow nor beyond its limit.

    The direction is made a unit vector; infinity: there is no such step.
    """
    square, smallest = 0.0, math.inf
    for k in range(len(direction)):
        square += direction[k] ** 2
    if square < _STILL**2:
        return smallest
    for k in range(len(direction)):
        direction[k] /= math.sqrt(square)
    for side in range(2):
        edge = -wheels.least_momentum_n_m_s if side else wheels.least_momentum_n_m_s
        for k in range(len(direction)):
            step = (edge - momentum_n_m_s[k]) / direction[k] if abs(direction[k]) > _STILL else math.inf
            if abs(step) < abs(smallest) and _are_clear(wheels, momentum_n_m_s, step, direction):
                smallest = step
    return smallest


def _are_clear(wheels: Wheels, momentum_n_m_s: FloatArray, step: float, direction: FloatArray) -> bool:
    """Return whether no wheel is slow or beyond its limit after a step."""
    for k in range(len(direction)):
        size = abs(momentum_n_m_s[k] + step * direction[k])
        # an edge itself counts as away from zero, but for rounding
        if size < wheels.least_momentum_n_m_s * (1.0 - 1e-9):
            return False
        if size > max(wheels.momentum_limit_n_m_s, abs(momentum_n_m_s[k])):
            return False
    return True
