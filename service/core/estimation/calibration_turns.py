"""Turns for a calibration: every axis to both sides in steps, then the corners of all octants.

The law of this file: the spacecraft returns to zero between the axes, so that slow changes of the users' levels are
seen apart from its turns, and consecutive corners differ in one sign, so that no slew is longer than it must be.
"""

from typing import NamedTuple

#: deg and minutes, the turns of a calibration: levels on each side of each axis, then the corners of all octants.
TURN_LEVELS_DEG = (0.125, 0.25, 0.375, 0.5)
TURN_CORNER_DEG = 0.3
TURN_MINUTES = 15.0
REST_MINUTES = 10.0
#: deg, yaw is turned this far where the spacecraft allows it: it is eight times less visible.
FAR_YAW_DEG = 1.0


class TurnLevel(NamedTuple):
    """One recommended level: yaw, roll, pitch in deg, held for some minutes."""

    attitude_deg: tuple[float, float, float]
    minutes: float


def recommended_turns(*, far_yaw: bool = False) -> tuple[TurnLevel, ...]:
    """Return the turns of a calibration in order, with rests at zero.

    Parameters
    ----------
    far_yaw : bool
        The spacecraft may turn 1 deg about yaw; the yaw levels are then doubled.

    Returns
    -------
    tuple of TurnLevel
        8.5 hours: plus and minus four levels for each axis, then the eight corners of 0.3 deg, one sign at a time.

    Examples
    --------
    >>> turns = recommended_turns()
    >>> len(turns), sum(turn.minutes for turn in turns) / 60.0
    (39, 8.5)
    """
    scale = (FAR_YAW_DEG / TURN_LEVELS_DEG[-1] if far_yaw else 1.0, 1.0, 1.0)
    rest = TurnLevel((0.0, 0.0, 0.0), REST_MINUTES)
    turns = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            sizes = [sign * level * scale[axis] for level in TURN_LEVELS_DEG]
            turns += [TurnLevel(_about(axis, size), TURN_MINUTES) for size in sizes]
            turns.append(rest)
    for number in range(8):
        # Gray code: consecutive corners differ in one sign
        code = number ^ (number >> 1)
        yaw, roll, pitch = (TURN_CORNER_DEG * (-1.0 if code >> bit & 1 else 1.0) for bit in (2, 1, 0))
        turns.append(TurnLevel((yaw, roll, pitch), REST_MINUTES))
    return (*turns, rest)


def _about(axis: int, size_deg: float) -> tuple[float, float, float]:
    """Return an attitude about one axis."""
    yaw, roll, pitch = (size_deg if axis == k else 0.0 for k in range(3))
    return yaw, roll, pitch
