"""Exact motion between two events on both sheets of the phase bi-plane, and the times of the events."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.flexible.phi_functions import phi1, phi2, phi2_scalar
from service.core.flexible.spacecraft import HubMode


class BodyState(NamedTuple):
    """State of one axis."""

    #: thT and its rate: the body as a rigid one
    angle_rad: float
    rate_rad_s: float
    #: thU and its rate: what the flexible mode adds at the hub
    deflection_rad: float = 0.0
    deflection_rate_rad_s: float = 0.0
    #: H
    momentum_n_m_s: float = 0.0


class MotionLeg(NamedTuple):
    """Motion between two events: its start and the constants of the solution."""

    start: BodyState
    inertia_kg_m2: float
    external_torque_n_m: float
    #: h, torque between wheel and body at the start
    wheel_torque_n_m: float
    #: c, at which it decays
    decay_1_s: float
    #: xi w and w nu
    damping_1_s: float
    frequency_rad_s: float
    #: a0, a1, q, b
    offset_rad: float
    decaying_rad: float
    cosine_rad: float
    sine_rad: float


def start_leg(
    start: BodyState,
    mode: HubMode | None,
    *,
    inertia_kg_m2: float,
    wheel_torque_n_m: float,
    decay_1_s: float = 0.0,
    external_torque_n_m: float = 0.0,
) -> MotionLeg:
    """Return the leg that begins in a state under a torque.

    Parameters
    ----------
    start : BodyState
        State at t = 0.
    mode : HubMode or None
        None for a rigid body.
    inertia_kg_m2 : float, kg m^2
        Inertia of the axis.
    wheel_torque_n_m : float, N m
        M_y at the start.
    decay_1_s : float, 1/s
        c; the torque decays as the momentum comes to its own end.
    external_torque_n_m : float, N m
        M_B, constant.
    """
    if mode is None:
        return MotionLeg(start, inertia_kg_m2, external_torque_n_m, wheel_torque_n_m, decay_1_s, 0, 0, 0, 0, 0, 0)
    omega, xi = mode.omega_rad_s, mode.damping_ratio
    frequency = omega * math.sqrt(1.0 - xi * xi)
    gain = mode.coupling / inertia_kg_m2
    offset = gain * external_torque_n_m / omega**2
    decaying = gain * wheel_torque_n_m / (omega**2 - 2.0 * xi * omega * decay_1_s + decay_1_s**2)
    cosine = start.deflection_rad - offset - decaying
    rate = start.deflection_rate_rad_s + decay_1_s * decaying
    sine = (rate + xi * omega * cosine) / frequency
    constants = (xi * omega, frequency, offset, decaying, cosine, sine)
    return MotionLeg(start, inertia_kg_m2, external_torque_n_m, wheel_torque_n_m, decay_1_s, *constants)


def state_at(leg: MotionLeg, elapsed_s: float) -> BodyState:
    """Return the state some time after the start of a leg."""
    states = states_at(leg, np.array([elapsed_s]))
    return BodyState(*(float(value) for value in states[0]))


def angle_and_rate_at(leg: MotionLeg, t: float) -> tuple[float, float]:
    """Return theta and its rate, what `state_at` gives in sum, ten times as fast: searches for events live on it."""
    start, c = leg.start, leg.decay_1_s
    half = phi2_scalar(c * t)
    gained = leg.wheel_torque_n_m * t * (1.0 - c * t * half)
    rate = start.rate_rad_s + (leg.external_torque_n_m * t + gained) / leg.inertia_kg_m2
    turned = (0.5 * leg.external_torque_n_m + leg.wheel_torque_n_m * half) * t * t / leg.inertia_kg_m2
    angle = start.angle_rad + start.rate_rad_s * t + turned
    if leg.frequency_rad_s == 0.0:
        return angle, rate
    fading = leg.decaying_rad * math.exp(-c * t)
    envelope = math.exp(-leg.damping_1_s * t)
    cosine, sine = math.cos(leg.frequency_rad_s * t), math.sin(leg.frequency_rad_s * t)
    swing = envelope * (leg.cosine_rad * cosine + leg.sine_rad * sine)
    swing_rate = envelope * leg.frequency_rad_s * (leg.sine_rad * cosine - leg.cosine_rad * sine)
    swing_rate -= leg.damping_1_s * swing + c * fading
    return angle + leg.offset_rad + fading + swing, rate + swing_rate


def states_at(leg: MotionLeg, elapsed_s: FloatArray) -> FloatArray:
    """Return states (T, 5), columns those of `BodyState`, at some times (T,) after the start of a leg."""
    t, start = elapsed_s, leg.start
    z = leg.decay_1_s * t
    gained = leg.wheel_torque_n_m * t * phi1(z)
    rate = start.rate_rad_s + (leg.external_torque_n_m * t + gained) / leg.inertia_kg_m2
    turned = (0.5 * leg.external_torque_n_m + leg.wheel_torque_n_m * phi2(z)) * t * t / leg.inertia_kg_m2
    angle = start.angle_rad + start.rate_rad_s * t + turned
    deflection, deflection_rate = _deflection(leg, t)
    return np.column_stack([angle, rate, deflection, deflection_rate, start.momentum_n_m_s + gained])


def _deflection(leg: MotionLeg, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return thU and its rate."""
    fading = leg.decaying_rad * np.exp(-leg.decay_1_s * t)
    envelope = np.exp(-leg.damping_1_s * t)
    cosine, sine = np.cos(leg.frequency_rad_s * t), np.sin(leg.frequency_rad_s * t)
    swing = envelope * (leg.cosine_rad * cosine + leg.sine_rad * sine)
    swing_rate = envelope * leg.frequency_rad_s * (leg.sine_rad * cosine - leg.cosine_rad * sine)
    return leg.offset_rad + fading + swing, swing_rate - leg.damping_1_s * swing - leg.decay_1_s * fading


_MACHINE_EPSILON = 2.220446049250313e-16
_MAX_STEPS = 200


def brent_root(function: Callable[[float], float], low: float, high: float, tolerance: float = 0.0) -> float:
    """Return a root of a continuous function between two bounds where its signs differ.

    Parameters
    ----------
    function : callable
        Of one float.
    low, high : float
        Bounds in any order; the function has opposite signs there, or is zero at one.
    tolerance : float
        Absolute error that is allowed beside four units of the last digit.

    Raises
    ------
    ValueError
        The signs are equal.

    References
    ----------
    .. [1] R. P. Brent, "Algorithms for Minimization without Derivatives", 1973, chapter 4.

    Examples
    --------
    >>> round(brent_root(lambda x: x * x - 2.0, 0.0, 2.0), 12)
    1.414213562373
    """
    a, b = low, high
    fa, fb = function(a), function(b)
    if fa * fb > 0.0:
        raise ValueError(f"no change of sign between {low:g} and {high:g}: the function is {fa:g} and {fb:g}")
    c, fc = a, fa
    step = last = b - a
    for _ in range(_MAX_STEPS):
        if fb * fc > 0.0:
            c, fc = a, fa
            step = last = b - a
        if abs(fc) < abs(fb):
            a, b, c = b, c, b
            fa, fb, fc = fb, fc, fb
        least = 2.0 * _MACHINE_EPSILON * abs(b) + 0.5 * tolerance
        half = 0.5 * (c - b)
        if fb == 0.0 or abs(half) <= least:
            break
        step, last = _step(a, b, c, fa, fb, fc, step, last, least)
        a, fa = b, fb
        b += step if abs(step) > least else (least if half > 0.0 else -least)
        fb = function(b)
    return b


def _step(
    a: float, b: float, c: float, fa: float, fb: float, fc: float, step: float, last: float, least: float
) -> tuple[float, float]:
    """Return the next step, interpolated where that is safe, and the one it is compared with next time."""
    half = 0.5 * (c - b)
    if abs(last) < least or abs(fa) <= abs(fb):
        return half, half
    s = fb / fa
    if a == c:
        p, q = 2.0 * half * s, 1.0 - s
    else:
        q, r = fa / fc, fb / fc
        p = s * (2.0 * half * q * (q - r) - (b - a) * (r - 1.0))
        q = (q - 1.0) * (r - 1.0) * (s - 1.0)
    p, q = abs(p), -q if p > 0.0 else q
    if 2.0 * p < min(3.0 * half * q - abs(least * q), abs(last * q)):
        return p / q, step
    return half, half


def newton_root(function: Callable[[float], tuple[float, float]], low: float, high: float) -> float:
    """Return the root of a monotone function by Newton's steps that never leave the bounds.

    Parameters
    ----------
    function : callable
        Gives value and derivative.
    low, high : float
        Bounds; the function has opposite signs there, or is zero at one.

    Examples
    --------
    >>> round(newton_root(lambda x: (x**3 - 2.0, 3.0 * x * x), 0.0, 2.0), 12)
    1.259921049895
    """
    is_rising = function(high)[0] > function(low)[0]
    x = 0.5 * (low + high)
    for _ in range(_MAX_STEPS):
        value, slope = function(x)
        if (value > 0.0) == is_rising:
            high = x
        else:
            low = x
        last, x = x, x - value / slope if slope != 0.0 else low
        if not low <= x <= high:
            x = 0.5 * (low + high)
        if abs(x - last) <= 2.0 * _MACHINE_EPSILON * abs(x) or value == 0.0:
            break
    return x


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
    return angle_and_rate_at(leg, t)[0]


def _rate(leg: MotionLeg, t: float) -> float:
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
