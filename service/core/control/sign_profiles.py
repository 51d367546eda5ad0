"""Turns by which the sign of each axis is proven, small enough that a wrong sign loses less than a tenth of a degree.

Roll and pitch swing as far to one side as to the other: the powers see the whole swing, the spacecraft leaves its
attitude by half of it, whatever the sign. Yaw hardly shows in the powers; held to one side and then to the other it
makes roll rise and fall, ``roll' = w0 yaw``.
"""

from typing import NamedTuple

import numpy as np

#: places of the axes in yaw, roll, pitch
YAW, ROLL, PITCH = 0, 1, 2


class SlewLeg(NamedTuple):
    """One slew of a profile; it ends without a rate."""

    start_s: float
    duration_s: float
    #: change of the angle of the profile's axis
    change_deg: float


class Profile(NamedTuple):
    """Slews about one axis and the rest after each."""

    #: 0 yaw, 1 roll, 2 pitch
    axis: int
    legs: tuple[SlewLeg, ...]
    stop_s: float


def roll_profile(side_deg: float = 0.08) -> Profile:
    """Return the roll check: 45 minutes, 0.08 deg to either side, each slew 480 s."""
    return Profile(ROLL, _swing(side_deg, 480.0, 260.0), 2700.0)


def pitch_profile(side_deg: float = 0.075) -> Profile:
    """Return the pitch check: 45 minutes, a swing of 0.15 deg, each slew 300 s."""
    return Profile(PITCH, _swing(side_deg, 300.0, 500.0), 2700.0)


def _swing(side_deg: float, slew_s: float, rest_s: float) -> tuple[SlewLeg, ...]:
    """Return out, rest, back in two slews and beyond, rest, back: each slew no further than a side."""
    back_s = slew_s + rest_s
    return (
        SlewLeg(0.0, slew_s, side_deg),
        SlewLeg(back_s, slew_s, -side_deg),
        SlewLeg(back_s + slew_s, slew_s, -side_deg),
        SlewLeg(2.0 * back_s + slew_s, slew_s, side_deg),
    )


def yaw_profile(side_deg: float = 0.25, hold_s: float = 3600.0) -> Profile:
    """Return the yaw check: 4 hours, one side, the other, back; slews in parts of at most 0.1 deg."""
    parts = int(np.ceil(side_deg / 0.1 - 1e-9))
    step, slew_s = side_deg / parts, 600.0
    legs = [SlewLeg(k * slew_s, slew_s, step) for k in range(parts)]
    begin_s = parts * slew_s + hold_s
    legs += [SlewLeg(begin_s + k * slew_s, slew_s, -step) for k in range(2 * parts)]
    begin_s += 2 * parts * slew_s + hold_s
    legs += [SlewLeg(begin_s + k * slew_s, slew_s, step) for k in range(parts)]
    return Profile(YAW, tuple(legs), begin_s + parts * slew_s)
