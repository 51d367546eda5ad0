"""Times at which the measured angle reaches a line, and the momentum zero or its limit.

A crossing has a direction: +1 upwards, -1 downwards. A line already passed that way at the start of a leg is crossed at
once; on the line itself the rate decides. A rigid body is followed from turn to turn, with Newton's steps between; a
flexible one is scanned at 48 points a period, and where the rate turns between two points the hidden extremum is
looked at as well.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from service.core.flexible.phi_functions import FloatArray
from service.core.flexible.propagation import MotionLeg, angle_and_rate_at, states_at
from service.core.flexible.roots import brent_root, newton_root

#: points a period of the flexible mode
SCAN_POINTS = 48
#: points of one chunk of a scan; a crossing ends the scan
_CHUNK = 96
#: an angle nearer to a line is on it, rad
_ON_LINE_RAD = 1e-14


class Line(NamedTuple):
    """An angle to be crossed in one direction."""

    angle_rad: float
    #: +1 upwards, -1 downwards
    direction: float


def crossing_time(leg: MotionLeg, line: Line, horizon_s: float) -> float:
    """Return when a leg first crosses a line within a time; infinite where it does not."""
    ahead_rad = line.direction * (_angle(leg, 0.0) - line.angle_rad)
    rate = line.direction * _rate(leg, 0.0)
    if ahead_rad > _ON_LINE_RAD or (ahead_rad >= -_ON_LINE_RAD and rate > 0.0):
        return 0.0
    if leg.frequency_rad_s == 0.0:
        return _rigid_crossing(leg, line, horizon_s)
    return _scanned_crossing(leg, line, horizon_s)


def _angle(leg: MotionLeg, t: float) -> float:
    """Return theta."""
    return angle_and_rate_at(leg, t)[0]


def _rate(leg: MotionLeg, t: float) -> float:
    """Return the rate of theta."""
    return angle_and_rate_at(leg, t)[1]


def _rigid_crossing(leg: MotionLeg, line: Line, horizon_s: float) -> float:
    """Return the first crossing of a rigid body: monotone between its turns."""

    def gap(t: float) -> tuple[float, float]:
        angle, rate = angle_and_rate_at(leg, t)
        return angle - line.angle_rad, rate

    ends = [0.0, *_turns(leg, horizon_s), horizon_s]
    for low, high in pairwise(ends):
        before, after = line.direction * gap(low)[0], line.direction * gap(high)[0]
        if after >= 0.0 and after > before:
            return newton_root(gap, low, high)
    return math.inf


def _turns(leg: MotionLeg, horizon_s: float) -> list[float]:
    """Return when the rate of a rigid body is zero, at most twice."""
    c, v = leg.decay_1_s, leg.start.rate_rad_s
    constant, fading = leg.external_torque_n_m / leg.inertia_kg_m2, leg.wheel_torque_n_m / leg.inertia_kg_m2
    if constant == 0.0 or c == 0.0:
        turn_s = _single_turn(v, constant + fading, c if constant == 0.0 else 0.0)
        return [turn_s] if 0.0 < turn_s < horizon_s else []
    # the rate itself turns once where both torques oppose each other
    turn = math.log(-fading / constant) / c if fading * constant < 0.0 else -1.0
    ends = [0.0, turn, horizon_s] if 0.0 < turn < horizon_s else [0.0, horizon_s]
    return [
        brent_root(lambda t: _rate(leg, t), low, high)
        for low, high in pairwise(ends)
        if _rate(leg, low) * _rate(leg, high) < 0.0
    ]


def _single_turn(rate: float, acceleration: float, c: float) -> float:
    """Return when the rate of a body under a decaying acceleration is zero; infinite where it never is."""
    if rate * acceleration >= 0.0:
        return math.inf
    left = 1.0 + c * rate / acceleration
    if left <= 0.0:
        return math.inf
    return -math.log(left) / c if c > 0.0 else -rate / acceleration


def _scanned_crossing(leg: MotionLeg, line: Line, horizon_s: float) -> float:
    """Return the first crossing of a flexible body by a scan in chunks."""
    step_s = 2.0 * math.pi / (leg.frequency_rad_s * SCAN_POINTS)
    first, count = 0, math.ceil(horizon_s / step_s)
    while first < count:
        last = min(first + _CHUNK, count)
        times = np.minimum(step_s * np.arange(first, last + 1), horizon_s)
        found = _crossing_in(leg, line, times)
        if found is not None:
            return found
        first = last
    return math.inf


def _crossing_in(leg: MotionLeg, line: Line, times: FloatArray) -> float | None:
    """Return the first crossing between some times in order."""
    states = states_at(leg, times)
    ahead = line.direction * (states[:, 0] + states[:, 2] - line.angle_rad)
    rate = line.direction * (states[:, 1] + states[:, 3])
    crosses = ahead[1:] > 0.0
    hides = (rate[:-1] > 0.0) & (rate[1:] < 0.0)
    for k in np.flatnonzero(crosses | hides):
        low, high = float(times[k]), float(times[k + 1])
        if hides[k] and not crosses[k]:
            high = _turn(leg, low, high)
        if line.direction * (_angle(leg, high) - line.angle_rad) > 0.0:
            return _root_after(leg, line, low, high)
    return None


def _turn(leg: MotionLeg, low: float, high: float) -> float:
    """Return when the rate turns between two times; the later one where it hardly does, by rounding."""
    if _rate(leg, low) * _rate(leg, high) >= 0.0:
        return high
    return brent_root(lambda t: _rate(leg, t), low, high)


def _root_after(leg: MotionLeg, line: Line, low: float, high: float) -> float:
    """Return the crossing between a time before the line, or on it, and one beyond."""
    # a leg may begin on the line and turn back to it within the first points: its root comes after the turn
    if line.direction * (_angle(leg, low) - line.angle_rad) >= 0.0 and line.direction * _rate(leg, low) < 0.0:
        low = _turn(leg, low, high)
    if line.direction * (_angle(leg, low) - line.angle_rad) >= 0.0:
        return low
    return brent_root(lambda t: _angle(leg, t) - line.angle_rad, low, high)


def momentum_time(leg: MotionLeg, momentum_n_m_s: float) -> float:
    """Return when the momentum of a leg comes to a value; infinite where it does not. A value held is not come to."""
    gap, c = momentum_n_m_s - leg.start.momentum_n_m_s, leg.decay_1_s
    if gap * leg.wheel_torque_n_m <= 0.0:
        return math.inf
    share = 1.0 - c * gap / leg.wheel_torque_n_m
    if share <= 0.0:
        return math.inf
    return -math.log1p(-c * gap / leg.wheel_torque_n_m) / c if c > 0.0 else gap / leg.wheel_torque_n_m
