"""Rates that a sensor beside the loop tells: inertial rates of the flown attitude, with its errors."""

import numpy as np
import pytest

from analyzer_sim.world.scenario.story import RateTelemetry
from analyzer_sim.world.spacecraft.body_rates import reported_rates, true_rates

ORBIT_DEG_S = np.rad2deg(7.2921159e-5)
MINUTE_US = 60_000_000


def test_a_body_that_points_at_the_earth_turns_with_the_orbit_about_pitch() -> None:
    epochs_us = MINUTE_US * np.arange(5)
    np.testing.assert_allclose(true_rates(epochs_us, np.zeros((5, 3))), [[0.0, 0.0, -ORBIT_DEG_S]] * 5, atol=1e-15)


@pytest.mark.parametrize(("axis", "other", "sign"), [(0, 1, -1.0), (1, 0, 1.0)])
def test_an_angle_held_against_the_orbit_is_an_inertial_rate_about_the_other_axis(
    axis: int, other: int, sign: float
) -> None:
    attitude_deg = np.zeros((3, 3))
    attitude_deg[:, axis] = 0.5
    rates = true_rates(MINUTE_US * np.arange(3), attitude_deg)
    # yaw' = -w roll + rate about yaw and roll' = w yaw + rate about roll vanish
    assert rates[1, other] == pytest.approx(sign * ORBIT_DEG_S * np.deg2rad(0.5), rel=1e-4)


def test_errors_have_their_sizes() -> None:
    epochs_us = MINUTE_US * np.arange(180_000)
    figures = RateTelemetry(bias_deg_h=0.01, bias_tau_h=2.0, noise_deg_sqrt_h=0.003, bias_factor=5.0)
    error = 3600.0 * (reported_rates(figures, 7, 60.0, epochs_us, np.zeros((180_000, 3))) - [0.0, 0.0, -ORBIT_DEG_S])
    means = error.reshape(-1, 60, 3).mean(axis=1)
    print("seed 7", error.std(axis=0), means.std(axis=0))
    np.testing.assert_allclose(means.std(axis=0), 0.05, rtol=0.25)
    np.testing.assert_allclose(np.diff(error, axis=0).std(axis=0) / np.sqrt(2.0), 0.003 * np.sqrt(60.0), rtol=0.05)
