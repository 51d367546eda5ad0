"""Polarimeter among the states: ratio and angle, its measurement, its states beside those of the wheels."""

import math

import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_model import (
    FilterSettings,
    LearnedFeed,
    MomentumModel,
    PolarimeterModel,
)
from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.model.hidden_motion import hidden_noise, momentum_count, sensor_states
from service.core.estimation.filtering.model.polarimeter import (
    POLARIMETER,
    angle_deg,
    compared_angle,
    polarimeter_covariance,
    ratio_db,
    slope_db_deg,
    updated_by_angle,
    with_learned_feeds,
)

READ = PolarimeterModel((0.99, -0.09, -0.13))
#: nine core states, chain and rain, four of the polarimeter
FIRST, SIZE = 11, 15
HOUR_US = 3_600_000_000


def state() -> Gaussian:
    mean = np.zeros(SIZE)
    mean[:3], mean[3:6] = (0.1, -0.02, 0.03), (0.04, -0.02, 0.01)
    mean[FIRST:] = (1.0, 0.02, -0.03, 0.04)
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return Gaussian(mean, np.diag(np.square(sigma)))


@pytest.mark.parametrize("feed_deg", [2.0, 10.0, 45.0, -10.0])
def test_the_slope_is_the_derivative_of_the_ratio(feed_deg: float) -> None:
    step = 1e-5
    slope = (ratio_db(feed_deg, step) - ratio_db(feed_deg, -step)) / (2.0 * step)
    assert slope_db_deg(feed_deg) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("leakage_deg", [-1.0, 0.4, 1.0])
def test_a_leakage_of_35_db_is_an_offset_and_leaves_the_slope_right_to_a_percent(leakage_deg: float) -> None:
    leak = math.radians(leakage_deg)
    still, turned = (angle_deg(10.0, ratio_db(10.0, turn, leak)) for turn in (0.0, 0.5))
    assert turned - still == pytest.approx(0.5, rel=0.01)
    assert still == pytest.approx(leakage_deg, rel=0.04)


@pytest.mark.parametrize(("epoch_h", "after_h"), [(0.0, 0.0), (5.0, -0.1)])
def test_the_measurement_follows_attitude_and_its_own_states(epoch_h: float, after_h: float) -> None:
    epoch_us = round(epoch_h * HOUR_US)
    phase = math.radians(15.0 * epoch_h)
    mean = state().mean
    then = mean[:3] + after_h * mean[3:6]
    expected = then @ np.array(READ.sight) + 1.04 + 0.02 * math.cos(phase) - 0.03 * math.sin(phase)
    found = compared_angle(state(), FIRST, expected + 0.2, 0.01, epoch_us, after_h, READ)
    assert found.innovation_deg == pytest.approx(0.2)
    assert found.variance_deg2 == pytest.approx(
        float(found.cross[:3] @ np.array(READ.sight)) + 9.0 + 0.005 + 0.01, abs=1e-4
    )


def test_a_first_angle_sets_the_offset_and_leaves_yaw() -> None:
    before = state()
    found = compared_angle(before, FIRST, 2.0, 0.005, 0, 0.0, READ)
    after = updated_by_angle(before, found)
    assert after.mean[0] == pytest.approx(before.mean[0], abs=2e-3)
    assert after.covariance[0, 0] == pytest.approx(before.covariance[0, 0], rel=2e-3)
    # a change is of yaw, as far as the wander allows: 0.1 deg of yaw beside some hundredths
    again = updated_by_angle(after, compared_angle(after, FIRST, 2.1, 0.0005, 0, 0.0, READ))
    assert again.covariance[0, 0] < after.covariance[0, 0]
    np.testing.assert_array_equal(again.covariance, again.covariance.T)


def test_states_of_polarimeters_stand_behind_those_of_the_wheels_and_only_the_wander_fades() -> None:
    wheels = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0))
    settings = FilterSettings(momentum=wheels, polarimeters=(READ, READ._replace(wander_deg=0.1, wander_h=2.0)))
    sensors = sensor_states(settings)
    own = momentum_count(settings)
    assert sensors == own + 2 * POLARIMETER
    # eleven states of wheels and one instrument are no torque
    sigma, tau_s = hidden_noise(2 + sensors, 2, settings)
    np.testing.assert_array_equal(np.flatnonzero(sigma), [2 + own + 3, 2 + own + 7])
    np.testing.assert_array_equal(tau_s[np.isfinite(tau_s)], [4 * 3600.0, 2 * 3600.0])
    assert polarimeter_covariance(settings).diagonal()[[3, 7]] == pytest.approx([0.05**2, 0.1**2])


def test_a_filter_begins_with_what_quiet_days_told_of_each_feed() -> None:
    told = LearnedFeed((0.6, 0.02, -0.01), ((4e-4, 1e-5, 0.0), (1e-5, 1e-4, 0.0), (0.0, 0.0, 1e-4)))
    settings = FilterSettings(polarimeters=(READ, READ._replace(learned=told)))
    covariance = polarimeter_covariance(settings)
    begun = with_learned_feeds(Gaussian(np.zeros(8), covariance), 0, settings)
    np.testing.assert_array_equal(begun.mean, [0.0, 0.0, 0.0, 0.0, 0.6, 0.02, -0.01, 0.0])
    np.testing.assert_array_equal(begun.covariance[4:7, 4:7], told.covariance)
    np.testing.assert_array_equal(begun.covariance[:4, :4], covariance[:4, :4])
    assert begun.covariance[7, 7] == covariance[7, 7]
    unknown = Gaussian(np.zeros(4), covariance[:4, :4])
    assert with_learned_feeds(unknown, 0, FilterSettings(polarimeters=(READ,))) is unknown
