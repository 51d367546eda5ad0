"""Claims about what is stated of a torque before powers tell: size, shares of a known profile, shape."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.hidden_shares import with_stated_torque, with_torque
from service.core.estimation.filtering.model.filter_model import FedForward, FilterSettings, no_motion
from service.core.estimation.filtering.model.filter_state import core_size, initial_gaussian
from service.core.estimation.filtering.model.hidden_motion import hidden_transition, torque_states
from service.core.estimation.filtering.model.torque_prior import (
    DAY_US,
    TORQUES,
    is_pushed,
    scale_covariance,
    torque_covariance,
    torque_size_deg_h2,
    wave_period_us,
)

HOUR_US = 3_600_000_000
#: roll and pitch a quarter of a wave apart, yaw between them, a constant about pitch
PROFILE = FedForward((0.0, 0.0, 0.5), (1.6, 3.9, 0.0), (1.6, 0.0, 3.8), 0.06, 0.01, DAY_US)
TOLD = FilterSettings(fed_forward=PROFILE)


def profile_at(hour, reported=PROFILE):
    phase = 2.0 * np.pi * hour * HOUR_US / reported.period_us
    return np.array(
        [np.array(reported[0]), np.cos(phase) * np.array(reported[1]), np.sin(phase) * np.array(reported[2])]
    ).sum(axis=0)


def aligned(model, settings):
    sigma = np.array([0.01, 0.005, 0.005])
    state = initial_gaussian(model, np.zeros(3), sigma, np.full(model.carriers, 0.03), drift_deg_h=settings.drift_deg_h)
    return with_torque(model, state, settings)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=8, common=1)


@pytest.mark.parametrize("hour", [0.0, 5.0, 13.3])
def test_the_error_is_a_share_of_the_profile_at_every_hour(hour):
    phase = 2.0 * np.pi * hour / 24.0
    now = np.kron([1.0, np.cos(phase), np.sin(phase)], np.eye(3))
    covariance = now @ torque_covariance(TOLD) @ now.T
    shares = 0.06**2 * np.ones((3, 3)) + 0.01**2 * np.eye(3)
    np.testing.assert_allclose(covariance, np.outer(profile_at(hour), profile_at(hour)) * shares, atol=1e-15)


def test_a_torque_of_unknown_shape_adds_to_it():
    both = TOLD._replace(torque_deg_h2=(0.1, 0.1, 0.2))
    alone = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2))
    np.testing.assert_allclose(torque_covariance(both), torque_covariance(alone) + torque_covariance(TOLD), rtol=1e-12)
    np.testing.assert_allclose(
        torque_size_deg_h2(both) ** 2, torque_size_deg_h2(alone) ** 2 + torque_size_deg_h2(TOLD) ** 2, rtol=1e-12
    )


def test_the_size_is_that_of_the_crest():
    share = np.hypot(0.06, 0.01)
    np.testing.assert_allclose(torque_size_deg_h2(TOLD), share * np.array([np.hypot(1.6, 1.6), 3.9, 4.3]), rtol=1e-12)


def test_a_profile_without_errors_pushes_nothing(model):
    exact = FilterSettings(fed_forward=PROFILE._replace(relative_error=0.0, axis_relative_error=0.0))
    assert is_pushed(TOLD)
    assert not is_pushed(exact)
    assert not is_pushed(FilterSettings())
    assert torque_states(model, aligned(model, exact), 0) is None


@pytest.mark.parametrize("step_us", [60_000_000, HOUR_US, 31 * HOUR_US])
def test_a_wave_of_another_period_moves_the_craft_as_fine_steps_do(step_us):
    """Pitch is not coupled: its rate is the integral of the profile, its angle that of the rate."""
    reported = PROFILE._replace(period_us=5 * HOUR_US)
    settings = FilterSettings(fed_forward=reported)
    assert wave_period_us(settings) == 5 * HOUR_US
    from_us = 1_700_000_000 * 1_000_000
    added = hidden_transition(TORQUES, from_us, step_us, settings, no_motion())
    torque = np.concatenate(reported[:3])
    nodes = 20_000
    hours = (np.arange(nodes) + 0.5) / nodes * step_us / HOUR_US
    phase = 2.0 * np.pi * (from_us % reported.period_us / HOUR_US + hours) / 5.0
    push = reported.constant_deg_h2[2] + reported.sine_deg_h2[2] * np.sin(phase)
    rate = push.mean() * step_us / HOUR_US
    angle = ((hours[-1] + hours[0] - hours) * push).mean() * step_us / HOUR_US
    assert (added @ torque)[8] == pytest.approx(rate, rel=1e-6, abs=1e-7)
    assert (added @ torque)[2] == pytest.approx(angle, rel=1e-6, abs=1e-7)


def test_what_is_learned_of_a_share_is_forgotten_with_its_shape(model):
    state = aligned(model, TOLD)
    positions = torque_states(model, state, 0)
    state.covariance[positions, positions] *= 1e-6
    weather = Weather(False, (False, False, False), 1.0, np.zeros(8))
    later, _ = predict(model, TOLD, state, 14 * DAY_US, no_motion(), weather)
    # 2 * 14 / 1000 of what was stated
    expected = -np.expm1(-0.028) * scale_covariance(PROFILE)
    np.testing.assert_allclose(later.covariance[positions, positions], expected, atol=1e-6)


def test_another_profile_is_learned_anew_and_none_ends_it(model):
    pushed = start(model, 0, aligned(model, TOLD))
    pushed.gaussian.mean[core_size(model)] = 0.3
    twice = TOLD._replace(fed_forward=PROFILE._replace(cosine_deg_h2=(3.2, 7.8, 0.0)))
    again = with_stated_torque(model, pushed, 0, TOLD, twice)
    np.testing.assert_array_equal(again.gaussian.covariance, aligned(model, twice).covariance)
    assert not again.gaussian.mean.any()
    ended = with_stated_torque(model, again, 0, twice, FilterSettings())
    np.testing.assert_array_equal(ended.gaussian.covariance, aligned(model, FilterSettings()).covariance)
    same = with_stated_torque(model, pushed, 0, TOLD, TOLD._replace(torque_deg_h2=(0.1, 0.1, 0.1)))
    assert same.gaussian.mean[core_size(model)] == 0.3
