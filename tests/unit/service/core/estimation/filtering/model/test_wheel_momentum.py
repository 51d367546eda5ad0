"""Wheel momentum among the states: its motion and its measurement."""

import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, SIZE, WHEELS, state

from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.model.wheel_momentum import compared, moved_momentum


def expected(mean: np.ndarray, after_h: float) -> np.ndarray:
    return -compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS).innovation


@pytest.mark.parametrize("after_h", [0.0, -0.1])
def test_the_measurement_is_linearised_as_it_is(after_h: float) -> None:
    mean, step = state(0.2).mean, 1e-6
    found = compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS)
    for place in range(SIZE):
        moved = mean.copy()
        moved[place] += step
        slope = (expected(moved, after_h) - expected(mean, after_h)) / step
        np.testing.assert_allclose(found.cross[:, place], slope, atol=2e-4)


def test_momentum_of_many_short_steps_is_that_of_a_long_one() -> None:
    one = moved_momentum(state(), FIRST, 0, 120 * MINUTE_US, SETTINGS, WHEELS, has_torque=True)
    many = state()
    for minute in range(120):
        many = moved_momentum(many, FIRST, minute * MINUTE_US, MINUTE_US, SETTINGS, WHEELS, has_torque=True)
    np.testing.assert_allclose(one.mean, many.mean, atol=2e-4)
    np.testing.assert_allclose(one.covariance, many.covariance, atol=1e-6)
    np.testing.assert_array_equal(one.covariance, one.covariance.T)
