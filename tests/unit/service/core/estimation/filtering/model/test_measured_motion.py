"""Measured motion in the state: rate and bias take the place of the commanded rate and the drift, and give it back."""

import numpy as np

from service.core.estimation.filtering.kernels.state_kernels import know_rate
from service.core.estimation.filtering.model.filter_model import FilterSettings, RateSensorModel
from service.core.estimation.filtering.model.filter_state import ATTITUDE, DRIFT, RATE, Gaussian
from service.core.estimation.filtering.model.measured_motion import (
    ORBITAL_RATE_PER_H,
    measured_settings,
    with_inertial_drift,
    with_measured_rate,
    with_sensor_bias,
    with_unknown_drift,
)

SENSOR = RateSensorModel(0.01, 8.0, 0.003)
RATE_DEG_H = np.array([0.2, -0.1, 0.3])
REST = slice(9, 12)


def state() -> Gaussian:
    mixed = np.random.default_rng(4).normal(size=(12, 12))
    return Gaussian(np.arange(12.0), mixed @ mixed.T)


def same(after: Gaussian, before: Gaussian, *kept: slice) -> None:
    """Check that some states are as before."""
    for one in kept:
        np.testing.assert_array_equal(after.mean[one], before.mean[one])
        for other in kept:
            np.testing.assert_array_equal(after.covariance[one, other], before.covariance[one, other])


def alone(gaussian: Gaussian, states: slice, sigma: float) -> None:
    """Check that some states are known to a sigma and correlated with nothing."""
    rows = gaussian.covariance[states].copy()
    np.testing.assert_allclose(rows[:, states], sigma**2 * np.eye(3), rtol=1e-12)
    rows[:, states] = 0.0
    assert not rows.any()


def test_a_measured_step_has_the_bias_for_the_drift_and_the_noise_of_the_sensor_alone() -> None:
    settings = measured_settings(FilterSettings(coupling_per_h=0.0), SENSOR)
    assert (settings.drift_deg_h, settings.drift_tau_h) == ((0.01, 0.01, 0.01), 8.0)
    assert settings.coupling_per_h == ORBITAL_RATE_PER_H
    assert settings.rate_noise_deg_sqrt_h == 0.003
    assert FilterSettings().rate_noise_deg_sqrt_h is None


def test_the_measured_rate_and_a_fresh_bias_stand_by_themselves() -> None:
    before = state()
    measured = with_measured_rate(before, RATE_DEG_H)
    np.testing.assert_array_equal(measured.mean[RATE], RATE_DEG_H)
    same(measured, before, ATTITUDE, DRIFT, REST)
    known = Gaussian(measured.mean, measured.covariance.copy())
    know_rate(known.covariance)
    same(known, before, ATTITUDE, DRIFT, REST)
    alone(known, RATE, 1e-4)
    biased = with_sensor_bias(before, 0.02)
    assert not biased.mean[DRIFT].any()
    same(biased, before, ATTITUDE, RATE, REST)
    alone(biased, DRIFT, 0.02)


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured_last() -> None:
    before, commanded, residual = state(), np.array([0.5, 0.0, -0.5]), np.array([0.01, 0.02, 0.03])
    after = with_inertial_drift(before, commanded, residual)
    np.testing.assert_allclose(after.mean[DRIFT], before.mean[DRIFT] + residual)
    np.testing.assert_array_equal(after.covariance[DRIFT, ATTITUDE], before.covariance[DRIFT, ATTITUDE])
    np.testing.assert_array_equal(after.mean[RATE], commanded)
    unknown = with_unknown_drift(before, commanded, np.full(3, 0.04))
    assert not unknown.mean[DRIFT].any()
    alone(unknown, DRIFT, 0.04)
    alone(unknown, RATE, 1e-4)
