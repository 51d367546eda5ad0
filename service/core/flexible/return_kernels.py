"""Return of one-sided motion to its first line: the arithmetic, in scalars, plain or compiled.

The law of this file: numbers and named tuples of numbers only, so that numba compiles it as it stands. The same source
is run as Python where nothing is compiled; both agree to rounding, which a chaotic sequence of returns does not forgive
(`tests/unit/service/core/flexible/test_succession.py`).

y (rad) and u (rad/s) are angle and rate counted outward, to the side to which friction turns the body. Between two
events y'' = a - c y' with a = +eps_c while the motor is off and a = -eps_a while it is on.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.flexible.phi_functions import phi2_scalar

_NEWTON_STEPS = 60
_ROUNDING = 4e-16


class OneSided(NamedTuple):
    """Numbers of one-sided motion under the pulse law."""

    passive_rad_s2: float
    pulse_rad_s2: float
    viscous_rate_1_s: float
    alpha_rad: float
    beta_rad: float
    pulse_s: float
    pulse_count: int
    line_step_rad: float
    #: a visit of more pulses counts as one without return; bounces at the last line may go on for hundreds
    most_pulses: int = 2000


class Visit(NamedTuple):
    """State of a return: motion, counter and extremes so far."""

    angle_rad: float
    rate_rad_s: float
    #: lines used
    counter: int
    #: 1 once all lines were used
    is_full: int
    elapsed_s: float
    pulses: int
    inner_rad: float
    outer_rad: float
    rate_min_rad_s: float
    rate_max_rad_s: float


def advance(y: float, u: float, a: float, c: float, t: float) -> tuple[float, float]:
    """Return angle and rate after a time."""
    z = c * t
    phi2 = phi2_scalar(z)
    h = a - c * u
    return y + u * t + h * t * t * phi2, u + h * t * (1.0 - z * phi2)


def turning_time(u: float, a: float, c: float) -> float:
    """Return when the rate is zero; u and a have opposite signs."""
    return math.log1p(-c * u / a) / c if c > 0.0 else -u / a


def arrival_time(y: float, u: float, a: float, c: float, level: float, guess: float) -> float:
    """Return when the angle is at a level, by Newton's steps from a guess."""
    t = guess
    for _ in range(_NEWTON_STEPS):
        angle, rate = advance(y, u, a, c, t)
        step = (angle - level) / rate if rate != 0.0 else 0.0
        t -= step
        if abs(step) <= _ROUNDING * abs(t):
            break
    return t


def drift_to(visit: Visit, elapsed_s: float, level: float, motion: OneSided) -> Visit:
    """Return a visit after the drift that ends at a level."""
    a, c = motion.passive_rad_s2, motion.viscous_rate_1_s
    _, u = advance(visit.angle_rad, visit.rate_rad_s, a, c, elapsed_s)
    inner = min(visit.inner_rad, level)
    if visit.rate_rad_s < 0.0 < u:
        lowest, _ = advance(visit.angle_rad, visit.rate_rad_s, a, c, turning_time(visit.rate_rad_s, a, c))
        inner = min(inner, lowest)
    low, high = min(visit.rate_min_rad_s, u), max(visit.rate_max_rad_s, u)
    total_s = visit.elapsed_s + elapsed_s
    return Visit(level, u, visit.counter, visit.is_full, total_s, visit.pulses, inner, visit.outer_rad, low, high)


def time_to_rise(visit: Visit, level: float, motion: OneSided) -> float:
    """Return when a drift comes up to a level; friction always brings it there."""
    a, c = motion.passive_rad_s2, motion.viscous_rate_1_s
    y, u, turn_s = visit.angle_rad, visit.rate_rad_s, 0.0
    if u < 0.0:
        turn_s = turning_time(u, a, c)
        y, _ = advance(y, u, a, c, turn_s)
        u = 0.0
    guess = (math.sqrt(max(u * u + 2.0 * a * (level - y), 0.0)) - u) / a
    return turn_s + arrival_time(y, u, a, c, level, guess)


def time_to_fall(visit: Visit, level: float, motion: OneSided) -> float:
    """Return when a drift falls to a level; -1 where it turns before."""
    if visit.angle_rad <= level:
        return 0.0
    if visit.rate_rad_s >= 0.0:
        return -1.0
    a, c = motion.passive_rad_s2, motion.viscous_rate_1_s
    lowest, _ = advance(visit.angle_rad, visit.rate_rad_s, a, c, turning_time(visit.rate_rad_s, a, c))
    if lowest > level:
        return -1.0
    return arrival_time(visit.angle_rad, visit.rate_rad_s, a, c, level, 0.0)


def fire(visit: Visit, motion: OneSided) -> Visit:
    """Return a visit after one pulse."""
    c = motion.viscous_rate_1_s
    y, u = advance(visit.angle_rad, visit.rate_rad_s, -motion.pulse_rad_s2, c, motion.pulse_s)
    outer = max(visit.outer_rad, y)
    if visit.rate_rad_s > 0.0 > u:
        turn_s = turning_time(visit.rate_rad_s, -motion.pulse_rad_s2, c)
        highest, _ = advance(visit.angle_rad, visit.rate_rad_s, -motion.pulse_rad_s2, c, turn_s)
        outer = max(outer, highest)
    counter = visit.counter + 1
    is_full = 1 if counter >= motion.pulse_count else visit.is_full
    total_s, inner = visit.elapsed_s + motion.pulse_s, min(visit.inner_rad, y)
    low, high = min(visit.rate_min_rad_s, u), max(visit.rate_max_rad_s, u)
    return Visit(y, u, counter, is_full, total_s, visit.pulses + 1, inner, outer, low, high)


def next_line(visit: Visit, motion: OneSided) -> float:
    """Return the line that fires next; infinite where the last one has been used and there is no step to another."""
    if visit.counter >= motion.pulse_count and motion.line_step_rad == 0.0:
        return math.inf
    return motion.beta_rad + visit.counter * motion.line_step_rad


def with_counter(visit: Visit, counter: int) -> Visit:
    """Return a visit with another counter."""
    return Visit(
        visit.angle_rad,
        visit.rate_rad_s,
        counter,
        visit.is_full,
        visit.elapsed_s,
        visit.pulses,
        visit.inner_rad,
        visit.outer_rad,
        visit.rate_min_rad_s,
        visit.rate_max_rad_s,
    )


def settle(visit: Visit, motion: OneSided) -> Visit:
    """Return a visit at its next firing; counter 0 where that is a return, -1 where the body does not come back."""
    last = motion.beta_rad + (motion.pulse_count - 1) * motion.line_step_rad
    fall_s = time_to_fall(visit, last, motion) if visit.counter >= motion.pulse_count else -1.0
    if fall_s >= 0.0:
        visit = with_counter(fallen(visit, fall_s, last, motion), motion.pulse_count - 1)
    release = motion.beta_rad if visit.is_full else motion.alpha_rad
    fall_s = time_to_fall(visit, release, motion) if visit.counter < motion.pulse_count else -1.0
    if fall_s >= 0.0:
        visit = with_counter(fallen(visit, fall_s, release, motion), 0)
    level = next_line(visit, motion)
    # beyond the opposite line the other side's pulses begin
    if math.isinf(level) or time_to_fall(visit, -motion.beta_rad, motion) >= 0.0:
        return with_counter(visit, -1)
    if visit.angle_rad > level:
        return visit
    return drift_to(visit, time_to_rise(visit, level, motion), level, motion)


def fallen(visit: Visit, fall_s: float, level: float, motion: OneSided) -> Visit:
    """Return a visit that has fallen to a level, as it is where it was below already."""
    return drift_to(visit, fall_s, level, motion) if fall_s > 0.0 else visit


def one_return(speed_rad_s: float, motion: OneSided) -> Visit:
    """Return the visit from an arrival at the first line to the next one; rate NaN where there is none."""
    beta = motion.beta_rad
    visit = Visit(beta, speed_rad_s, 0, 0, 0.0, 0, beta, beta, speed_rad_s, speed_rad_s)
    # no pulse gives more inward speed than this, and from higher no such speed reaches the last line again
    gained = motion.pulse_rad_s2 * motion.pulse_s
    highest = beta + (motion.pulse_count - 1) * motion.line_step_rad + 0.5 * gained**2 / motion.passive_rad_s2
    while visit.pulses < motion.most_pulses:
        visit = settle(fire(visit, motion), motion)
        if visit.counter == 0:
            return visit
        if visit.counter < 0 or visit.angle_rad > highest:
            break
    nan = math.nan
    return Visit(nan, nan, -1, 0, nan, visit.pulses, nan, nan, nan, nan)


def follow(speeds_rad_s: FloatArray, returns: int, motion: OneSided) -> FloatArray:
    """Return the speeds (S, returns + 1) of successive arrivals at the first line; NaN from where none follows."""
    speeds = np.full((len(speeds_rad_s), returns + 1), np.nan)
    for row in range(len(speeds_rad_s)):
        speed = speeds_rad_s[row]
        speeds[row, 0] = speed
        for k in range(returns):
            speed = one_return(speed, motion).rate_rad_s
            if math.isnan(speed):
                break
            speeds[row, k + 1] = speed
    return speeds


Follow = Callable[[FloatArray, int, OneSided], FloatArray]


@lru_cache(maxsize=1)
def compiled_follow() -> Follow:
    """Return `follow` compiled; worth its five seconds of compiling above some ten thousand returns."""
    # the import costs a quarter of a second: only who follows many returns pays it
    from numba import njit
    from numba.extending import register_jitable

    parts = (phi2_scalar, advance, turning_time, arrival_time, drift_to, time_to_rise, time_to_fall, fire, next_line)
    for part in (*parts, with_counter, fallen, settle, one_return):
        register_jitable(part)
    compiled: Follow = njit(nogil=True, error_model="numpy")(follow)
    return compiled
