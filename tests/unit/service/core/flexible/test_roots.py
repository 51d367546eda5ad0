"""Roots between bounds."""

import math

import pytest
from scipy.optimize import brentq

from service.core.flexible.roots import brent_root, newton_root

FUNCTIONS = [
    (lambda x: x * x - 2.0, 0.0, 2.0),
    (lambda x: math.cos(x) - x, 0.0, 1.5),
    (lambda x: math.exp(-20.0 * x) - 1e-3, 0.0, 10.0),
    (lambda x: (x - 0.3) ** 3, -4.0, 1.0),
    (lambda x: math.atan(1e6 * (x - 0.7)), 0.0, 1.0),
]


@pytest.mark.parametrize(("function", "low", "high"), FUNCTIONS)
def test_the_root_is_that_of_a_known_program(function, low, high):
    found = brent_root(function, low, high)
    # a triple root is as wide as the cube root of rounding
    assert found == pytest.approx(
        brentq(function, low, high, xtol=1e-15, maxiter=1000), abs=1e-12 if function(found) == 0.0 else 1e-5
    )
    assert found == brent_root(function, high, low) or abs(function(found)) < 1e-12


def test_a_bound_that_is_the_root_is_returned():
    assert brent_root(lambda x: x - 1.0, 1.0, 3.0) == 1.0
    assert brent_root(lambda x: x - 3.0, 1.0, 3.0) == 3.0


def test_bounds_without_a_change_of_sign_are_refused():
    with pytest.raises(ValueError, match="no change of sign between 2 and 3: the function is 4 and 9"):
        brent_root(lambda x: x * x, 2.0, 3.0)


def test_a_jump_is_found_as_a_place_where_the_function_is_not_zero():
    step = brent_root(lambda x: -1.0 if x < 0.4 else 1.0, 0.0, 1.0)
    assert step == pytest.approx(0.4, abs=1e-12)


def test_few_evaluations_are_needed():
    calls = []

    def counted(x):
        calls.append(x)
        return math.cos(x) - x

    brent_root(counted, 0.0, 1.5)
    assert len(calls) <= 12


def test_newton_never_leaves_its_bounds():
    seen = []

    def flat_in_the_middle(x):
        seen.append(x)
        return x**3 - 1e-9, 3.0 * x * x

    found = newton_root(flat_in_the_middle, -1.0, 2.0)
    assert found == pytest.approx(1e-3, rel=1e-12)
    assert min(seen) >= -1.0
    assert max(seen) <= 2.0


def test_newton_on_a_falling_function():
    assert newton_root(lambda x: (2.0 - x * x, -2.0 * x), 0.5, 3.0) == pytest.approx(math.sqrt(2.0), rel=1e-15)
