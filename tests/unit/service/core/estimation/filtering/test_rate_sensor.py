"""Rate sensor: records judged, the rate that takes the place of the commanded one, and back."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FilterSettings,
    Gaussian,
    RateSensorModel,
    no_carriers,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.rate_sensor import (
    fresh_rates,
    inertial_motion,
    measured_settings,
    push_rates,
    with_inertial_drift,
    with_measured_rate,
    with_sensor_bias,
    with_unknown_drift,
)

MINUTE_US = filter_models.MINUTE_US
SENSOR = RateSensorModel(0.01, 8.0, 0.003)
PLAIN = FilterSettings()
RATE_DEG_H = np.array([0.02, -0.01, 0.015])


def moving_state(log_scale=0.0):
    mixed = np.random.default_rng(1).normal(size=(11, 11))
    covariance = 1e-4 * (mixed @ mixed.T)
    covariance[RATE, :] = covariance[:, RATE] = 0.0
    covariance[RATE, RATE] = 1e-8 * np.eye(3)
    return start(no_carriers(), 0, Gaussian(np.zeros(11), covariance)).with_watch(log_drift_scale=log_scale)


def log_scale(state):
    return state.watch["log_drift_scale"][0]


def pushed(watch, moving, rates, *, commanded=(0.0, 0.0, 0.0), **flags):
    """Return watch and state after a step of a minute that ends with each record."""
    for rate in rates:
        to_us = moving.epoch_us + MINUTE_US
        watch, moving = push_rates(
            watch,
            moving,
            np.array([to_us], dtype=np.int64),
            rate[None, :],
            to_us,
            np.array(commanded),
            PLAIN,
            SENSOR,
            is_pushed=flags.get("is_pushed", False),
        )
        moving = moving.with_watch(epoch_us=to_us)
    return watch, moving


def noisy(count, size=0.001):
    return [RATE_DEG_H + size * each for each in np.random.default_rng(2).normal(size=(count, 3))]


def test_the_measured_rate_takes_the_place_of_the_commanded_one_and_the_bias_that_of_the_drift():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(1, 0.0))
    assert watch.is_measured
    np.testing.assert_array_equal(moving.mean[RATE], RATE_DEG_H)
    np.testing.assert_array_equal(moving.covariance[DRIFT, DRIFT], np.diag(np.full(3, 0.01**2)))
    settings = measured_settings(PLAIN._replace(coupling_per_h=0.0), SENSOR)
    assert (settings.coupling_per_h, settings.drift_deg_h, settings.drift_tau_h) == (0.2625162, (0.01,) * 3, 8.0)
    assert (settings.rate_noise_deg_sqrt_h, PLAIN.rate_noise_deg_sqrt_h) == (0.003, None)


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(3))
    rate = moving.mean[RATE] + moving.mean[DRIFT]
    after, back = inertial_motion(watch, moving)
    assert not after.is_measured
    np.testing.assert_allclose(back.mean[DRIFT], rate, atol=1e-15)
    np.testing.assert_array_equal(back.mean[RATE], np.zeros(3))


def test_a_rate_holds_for_ten_minutes():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(2))
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    for minutes, is_measured in ((5, True), (10, True), (11, False)):
        to_us = moving.epoch_us + minutes * MINUTE_US
        late = moving.with_watch(epoch_us=to_us - MINUTE_US)
        found, _ = push_rates(watch, late, nothing[1], nothing[0], to_us, np.zeros(3), PLAIN, SENSOR, is_pushed=False)
        assert found.is_measured is is_measured


def test_a_held_rate_follows_what_is_commanded():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(2, 0.0)[:1])
    wild = [np.array([30.0, 0.0, 0.0])]
    _, after = pushed(watch, moving, wild, commanded=(0.3, 0.0, 0.0))
    np.testing.assert_allclose(after.mean[RATE], np.add(RATE_DEG_H, [0.3, 0.0, 0.0]))


@pytest.mark.parametrize("kind", ["wild", "repeated"])
def test_records_that_tell_nothing_do_not_move_the_angles(kind):
    rates = [np.array([0.0, 0.0, 15.0]) + each for each in noisy(60)] if kind == "wild" else [RATE_DEG_H] * 60
    watch, moving = pushed(fresh_rates(), moving_state(), rates)
    assert not watch.is_measured
    assert watch.is_refused is (kind == "wild")
    assert np.isfinite(moving.mean).all()


def test_a_sensor_no_better_than_the_model_is_refused_and_yaw_is_known_less():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(5))
    before = moving.covariance[0, 0]
    grown = moving.with_watch(log_drift_scale=np.log(3.5))
    after, refused = pushed(watch, grown, noisy(1))
    assert (after.is_refused, after.is_measured) == (True, False)
    assert refused.covariance[0, 0] == pytest.approx(before + 0.2**2)
    assert log_scale(refused) == 0.0
    assert after.other_log_scale == log_scale(grown)


def test_each_model_keeps_its_own_factor():
    watch, moving = pushed(fresh_rates(), moving_state(0.5), noisy(2))
    assert (log_scale(moving), watch.other_log_scale) == (0.0, 0.5)
    assert log_scale(inertial_motion(watch, moving)[1]) == 0.5


def test_torques_from_the_ground_leave_the_powers_to_judge_for_an_hour():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(3))
    watch, moving = pushed(watch, moving, noisy(1), is_pushed=True)
    assert not watch.is_measured
    watch, moving = pushed(watch, moving, noisy(59))
    assert not watch.is_measured
    assert pushed(watch, moving, noisy(3))[0].is_measured


MEASURED_DEG_H = np.array([0.2, -0.1, 0.3])
REST = slice(9, 12)


def mixed_state():
    mixed = np.random.default_rng(4).normal(size=(12, 12))
    return Gaussian(np.arange(12.0), mixed @ mixed.T)


def same(after, before, *kept):
    """Check that some states are as before."""
    for one in kept:
        np.testing.assert_array_equal(after.mean[one], before.mean[one])
        for other in kept:
            np.testing.assert_array_equal(after.covariance[one, other], before.covariance[one, other])


def alone(gaussian, states, sigma):
    """Check that some states are known to a sigma and correlated with nothing."""
    rows = gaussian.covariance[states].copy()
    np.testing.assert_allclose(rows[:, states], sigma**2 * np.eye(3), rtol=1e-12)
    rows[:, states] = 0.0
    assert not rows.any()


def test_the_measured_rate_and_a_fresh_bias_stand_by_themselves():
    before = mixed_state()
    measured = with_measured_rate(before, MEASURED_DEG_H)
    np.testing.assert_array_equal(measured.mean[RATE], MEASURED_DEG_H)
    same(measured, before, ATTITUDE, DRIFT, REST)
    biased = with_sensor_bias(before, 0.02)
    assert not biased.mean[DRIFT].any()
    same(biased, before, ATTITUDE, RATE, REST)
    alone(biased, DRIFT, 0.02)


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured_last():
    before, commanded, residual = mixed_state(), np.array([0.5, 0.0, -0.5]), np.array([0.01, 0.02, 0.03])
    after = with_inertial_drift(before, commanded, residual)
    np.testing.assert_allclose(after.mean[DRIFT], before.mean[DRIFT] + residual)
    np.testing.assert_array_equal(after.covariance[DRIFT, ATTITUDE], before.covariance[DRIFT, ATTITUDE])
    np.testing.assert_array_equal(after.mean[RATE], commanded)
    unknown = with_unknown_drift(before, commanded, np.full(3, 0.04))
    assert not unknown.mean[DRIFT].any()
    alone(unknown, DRIFT, 0.04)
    alone(unknown, RATE, 1e-4)


def test_a_step_by_a_measured_rate_forgets_what_was_uncertain_about_it():
    model = filter_models.carrier_model(carriers=4)
    state = start(model, 0, filter_models.aligned(model))
    mixed = np.random.default_rng(4).normal(size=state.covariance.shape)
    state.covariance[:] = 1e-3 * mixed @ mixed.T
    compiled = filter_model(model, measured_settings(FilterSettings(), SENSOR))
    after = filter_models.coasted(compiled, state, 1_000_000).covariance
    np.testing.assert_allclose(after[RATE, RATE], 1e-8 * np.eye(3), rtol=1e-12)
    # what the rate shares with the angles after a second is its own
    np.testing.assert_allclose(after[RATE, ATTITUDE], 1e-8 / 3600.0 * np.eye(3), rtol=1e-3, atol=1e-15)
    assert not after[RATE, DRIFT].any()
    assert not after[RATE, RATE.stop :].any()
