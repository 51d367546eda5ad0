"""Wheel momentum among the states: its motion and its measurement."""

import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, SIZE, WHEELS, state

from service.core.estimation.filtering.model.filter_model import FilterSettings, MomentumModel
from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.model.hidden_motion import inserted, momentum_count
from service.core.estimation.filtering.model.torque_prior import TORQUES, gathered_prior_deg_h2, torque_prior_deg_h2
from service.core.estimation.filtering.model.wheel_momentum import compared, momentum_covariance, moved_momentum


def expected(mean: np.ndarray, after_h: float) -> np.ndarray:
    return -compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS).innovation


#: a torque that pushes the body, and another of unknown profile that gathers in the wheels
GATHERED = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), unknown_torque_deg_h2=(5.0, 5.0, 9.0))
UNKNOWN = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2), momentum=GATHERED)


def with_own_torque() -> Gaussian:
    """Return the state with nine torques behind the momentum."""
    return inserted(state(), SIZE, momentum_covariance(UNKNOWN, GATHERED)[7:, 7:])


@pytest.mark.parametrize("after_h", [0.0, -0.1])
def test_the_measurement_is_linearised_as_it_is(after_h: float) -> None:
    mean, step = state(0.2).mean, 1e-6
    found = compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS)
    for place in range(SIZE):
        moved = mean.copy()
        moved[place] += step
        slope = (expected(moved, after_h) - expected(mean, after_h)) / step
        np.testing.assert_allclose(found.cross[:, place], slope, atol=2e-4)


@pytest.mark.parametrize("settings", [SETTINGS, UNKNOWN])
def test_momentum_of_many_short_steps_is_that_of_a_long_one(settings: FilterSettings) -> None:
    gaussian = with_own_torque() if settings is UNKNOWN else state()
    one, many = moved_momentum(gaussian, FIRST, 0, 120 * MINUTE_US, settings), gaussian
    for minute in range(120):
        many = moved_momentum(many, FIRST, minute * MINUTE_US, MINUTE_US, settings)
    np.testing.assert_allclose(one.mean, many.mean, atol=2e-4)
    # a torque counts as constant for ten minutes, in which roll and yaw exchange by 0.04
    np.testing.assert_allclose(one.covariance, many.covariance, rtol=5e-3, atol=1e-6)
    np.testing.assert_array_equal(one.covariance, one.covariance.T)


def test_a_torque_of_its_own_moves_the_momentum_and_that_of_the_body_does_not() -> None:
    gaussian = with_own_torque()
    rested = moved_momentum(gaussian, FIRST, 0, 60 * MINUTE_US, UNKNOWN)
    momentum = slice(FIRST, FIRST + 3)
    for place, is_moving in ((FIRST - TORQUES + 2, False), (SIZE + 2, True)):
        # of pitch, which exchanges with nothing: 1 deg/h^2 is inertia 1400 kg m^2 times 1.35e-9 N m
        mean = gaussian.mean.copy()
        mean[place] += 1.0
        pushed = moved_momentum(Gaussian(mean, gaussian.covariance), FIRST, 0, 60 * MINUTE_US, UNKNOWN)
        moved = (pushed.mean - rested.mean)[momentum]
        expected_n_m_s = 1400.0 * np.radians(1.0) / 3600.0**2 * 3600.0 * is_moving
        np.testing.assert_allclose(moved, [0.0, expected_n_m_s, 0.0], atol=1e-12)


def test_states_of_a_torque_of_its_own_exist_where_another_pushes_the_body() -> None:
    assert momentum_count(UNKNOWN) == len(momentum_covariance(UNKNOWN, GATHERED)) == 16
    alone = UNKNOWN._replace(torque_deg_h2=(0.0, 0.0, 0.0))
    assert momentum_count(alone) == len(momentum_covariance(alone, GATHERED)) == 7
    np.testing.assert_array_equal(torque_prior_deg_h2(alone), gathered_prior_deg_h2(alone))
    assert gathered_prior_deg_h2(SETTINGS).tolist() == [0.0] * 9
