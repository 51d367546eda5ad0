"""Roots of one variable between two bounds."""

from collections.abc import Callable

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
