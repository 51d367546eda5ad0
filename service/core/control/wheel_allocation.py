"""A body torque shared out to any set of wheels within their limits of torque and momentum."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    plain = np.ascontiguousarray(axes, dtype=np.float64)
    return _pseudo_inverse(len(plain), plain.tobytes())


@lru_cache(maxsize=64)
def _pseudo_inverse(wheels: int, axes: bytes) -> FloatArray:
    """Return the pseudo-inverse of axes (W, 3) told byte by byte: a set of wheels hardly ever changes; read-only."""
    rows = np.frombuffer(axes).reshape(wheels, 3)
    inverse = np.asarray(np.linalg.pinv(rows / np.linalg.norm(rows, axis=1, keepdims=True)), dtype=np.float64)
    inverse.setflags(write=False)
    return inverse


#: least singular value of the unit axes: no direction may need more than twenty times the torque
LEAST_SINGULAR_VALUE = 0.05
#: components of null motion below this share of its length do not move a wheel
_STILL = 1e-6


class Wheels(NamedTuple):
    """A set of wheels."""

    #: (W, 3) unit axes in the order yaw, roll, pitch
    axes: FloatArray
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
    #: (3,) N m, resulting torque on the body: `share` times the requested one
    torque_n_m: FloatArray
    #: 1 = all of it
    share: float
    #: which wheel cut the share, and by "torque" or "momentum"; None where nothing did
    limited_by: tuple[int, str] | None
    #: (W,) N m s after the given time
    momentum_n_m_s: FloatArray


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
    unit = rows / lengths[:, None]
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
    return Wheels(unit, *limits, least_momentum_n_m_s)


_AXES = ("yaw", "roll", "pitch")


def allocate(wheels: Wheels, torque_n_m: ArrayLike, momentum_n_m_s: ArrayLike, duration_s: float) -> Allocation:
    """Return the torque of each wheel for a torque on the body.

    Parameters
    ----------
    wheels : Wheels
        Of `wheel_set`.
    torque_n_m : array_like, shape (3,), N m
        Wanted torque on the body about yaw, roll, pitch.
    momentum_n_m_s : array_like, shape (W,), N m s
        Stored momentum at the beginning.
    duration_s : float, s
        How long the torque lasts.

    Returns
    -------
    Allocation
        A wheel beyond its limit of momentum takes no torque that leads further out, any that leads back.

    Raises
    ------
    ValueError
        A number is not finite, momenta do not fit the wheels, or the duration is not positive.
    """
    wanted, momentum = np.asarray(torque_n_m, dtype=np.float64), np.asarray(momentum_n_m_s, dtype=np.float64)
    if wanted.shape != (3,) or momentum.shape != (wheels.size,):
        raise ValueError(f"three torques and {wheels.size} momenta are needed, one for each wheel")
    if not (np.isfinite(wanted).all() and np.isfinite(momentum).all() and math.isfinite(duration_s)):
        raise ValueError("torque, momentum and duration must be finite")
    if duration_s <= 0.0:
        raise ValueError("the duration must be positive")
    least_norm = allocate_to_wheels(wheels.axes, wanted)
    share, limited_by = _share(wheels, least_norm, momentum, duration_s)
    given = share * least_norm
    null = _null_torque(wheels, given, momentum, duration_s)
    return Allocation(
        wheels_n_m=given + null,
        null_n_m=null,
        torque_n_m=share * wanted,
        share=share,
        limited_by=limited_by,
        momentum_n_m_s=momentum + (given + null) * duration_s,
    )


def _room(wheels: Wheels, momentum: FloatArray, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the least and greatest torque (W,) that the momentum of each wheel still allows, zero always included."""
    limit = wheels.momentum_limit_n_m_s
    return np.minimum(0.0, (-limit - momentum) / duration_s), np.maximum(0.0, (limit - momentum) / duration_s)


def _share(
    wheels: Wheels, torque: FloatArray, momentum: FloatArray, duration_s: float
) -> tuple[float, tuple[int, str] | None]:
    """Return the greatest share of the wheel torques (W,) that keeps to every limit, and what set it."""
    lower, upper = _room(wheels, momentum, duration_s)
    share, limited_by = 1.0, None
    for k, each in enumerate(torque.tolist()):
        room = float(upper[k] if each > 0.0 else -lower[k])
        for bound, name in ((wheels.torque_limit_n_m, "torque"), (room, "momentum")):
            if abs(each) > bound and bound / abs(each) < share:
                share, limited_by = bound / abs(each), (k, name)
    return share, limited_by


def _null_torque(wheels: Wheels, given: FloatArray, momentum: FloatArray, duration_s: float) -> FloatArray:
    """Return the null motion (W,) that keeps wheels away from zero speed, within the room that is left."""
    ending = momentum + given * duration_s
    nothing = np.zeros(wheels.size)
    is_slow = np.abs(ending) < wheels.least_momentum_n_m_s
    if wheels.size == 3 or not is_slow.any():
        return nothing
    shift = _null_shift(wheels, ending, is_slow)
    if shift is None:
        return nothing
    torque = shift / duration_s
    lower, upper = _room(wheels, momentum, duration_s)
    lower = np.maximum(lower, -wheels.torque_limit_n_m) - given
    upper = np.minimum(upper, wheels.torque_limit_n_m) - given
    moved = np.abs(torque) > 0.0
    room = np.where(torque > 0.0, upper, lower)[moved] / torque[moved]
    return np.asarray(torque * max(0.0, min(1.0, float(room.min()))))


def _null_shift(wheels: Wheels, momentum: FloatArray, is_slow: NDArray[np.bool_]) -> FloatArray | None:
    """Return the smallest change of momentum (W,) along one null direction after which no wheel is slow.

    Directions tried: slow wheels pushed on, each the way it turns, projected; then each direction of the null space.
    None where none of them helps.
    """
    basis = np.linalg.svd(wheels.axes.T)[2][3:]
    onward = np.where(is_slow, np.where(momentum >= 0.0, 1.0, -1.0), 0.0)
    candidates = [basis.T @ (basis @ onward), *basis]
    shifts = [_along(wheels, momentum, direction) for direction in candidates]
    found = [shift for shift in shifts if shift is not None]
    return min(found, key=lambda shift: float(np.linalg.norm(shift)), default=None)


def _along(wheels: Wheels, momentum: FloatArray, direction: FloatArray) -> FloatArray | None:
    """Return the smallest step along a direction after which every wheel is neither slow nor beyond its limit."""
    length = float(np.linalg.norm(direction))
    if length < _STILL:
        return None
    unit = direction / length
    least, limit = wheels.least_momentum_n_m_s, wheels.momentum_limit_n_m_s
    moving = np.abs(unit) > _STILL
    edges = [((edge - momentum[moving]) / unit[moving]) for edge in (least, -least)]
    steps = sorted(np.concatenate(edges).tolist(), key=abs)
    for step in steps:
        size = np.abs(momentum + step * unit)
        # an edge itself counts as away from zero, but for rounding
        if (size >= least * (1.0 - 1e-9)).all() and (size <= np.maximum(limit, np.abs(momentum))).all():
            return np.asarray(step * unit)
    return None
