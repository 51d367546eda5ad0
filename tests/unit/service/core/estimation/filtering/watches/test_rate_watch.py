"""Watch on a rate sensor: what counts, what is left out, and what stands in the state before and after."""

from typing import Any

import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_model import FilterSettings, RateSensorModel
from service.core.estimation.filtering.model.filter_state import DRIFT, RATE, Gaussian
from service.core.estimation.filtering.model.measured_motion import measured_settings
from service.core.estimation.filtering.watches.command_watch import executed_commands
from service.core.estimation.filtering.watches.drift_watch import DriftWatch
from service.core.estimation.filtering.watches.rate_watch import (
    MovingState,
    RateWatch,
    fresh_rates,
    inertial_motion,
    push_rates,
)

SENSOR = RateSensorModel(0.01, 8.0, 0.003)
SETTINGS = FilterSettings()
MINUTE_US = 60_000_000
RATE_DEG_H = np.array([0.02, -0.01, 0.015])


def state(log_scale: float = 0.0) -> MovingState:
    mixed = np.random.default_rng(1).normal(size=(11, 11))
    covariance = 1e-4 * (mixed @ mixed.T)
    covariance[RATE, :] = covariance[:, RATE] = 0.0
    covariance[RATE, RATE] = 1e-8 * np.eye(3)
    return MovingState(0, Gaussian(np.zeros(11), covariance), DriftWatch(log_scale), executed_commands())


def pushed(
    watch: RateWatch, moving: MovingState, rates: list[np.ndarray], *, commanded: Any = (0.0, 0.0, 0.0), **flags: bool
) -> tuple[RateWatch, MovingState]:
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
            SETTINGS,
            SENSOR,
            is_pushed=flags.get("is_pushed", False),
        )
        moving = moving._replace(epoch_us=to_us)
    return watch, moving


def noisy(count: int, size: float = 0.001) -> list[np.ndarray]:
    return [RATE_DEG_H + size * each for each in np.random.default_rng(2).normal(size=(count, 3))]


def test_the_measured_rate_takes_the_place_of_the_commanded_one_and_the_bias_that_of_the_drift() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(1, 0.0))
    assert watch.is_measured
    np.testing.assert_array_equal(moving.gaussian.mean[RATE], RATE_DEG_H)
    np.testing.assert_array_equal(moving.gaussian.covariance[DRIFT, DRIFT], np.diag(np.full(3, 0.01**2)))
    settings = measured_settings(SETTINGS._replace(coupling_per_h=0.0), SENSOR)
    assert (settings.coupling_per_h, settings.drift_deg_h, settings.drift_tau_h) == (0.2625162, (0.01,) * 3, 8.0)


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(3))
    rate = moving.gaussian.mean[RATE] + moving.gaussian.mean[DRIFT]
    after, back = inertial_motion(watch, moving)
    assert not after.is_measured
    np.testing.assert_allclose(back.gaussian.mean[DRIFT], rate, atol=1e-15)
    np.testing.assert_array_equal(back.gaussian.mean[RATE], np.zeros(3))


def test_a_rate_holds_for_ten_minutes() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(2))
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    for minutes, is_measured in ((5, True), (10, True), (11, False)):
        to_us = moving.epoch_us + minutes * MINUTE_US
        late = moving._replace(epoch_us=to_us - MINUTE_US)
        found, _ = push_rates(
            watch, late, nothing[1], nothing[0], to_us, np.zeros(3), SETTINGS, SENSOR, is_pushed=False
        )
        assert found.is_measured is is_measured


def test_a_held_rate_follows_what_is_commanded() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(2, 0.0)[:1])
    wild = [np.array([30.0, 0.0, 0.0])]
    _, after = pushed(watch, moving, wild, commanded=(0.3, 0.0, 0.0))
    np.testing.assert_allclose(after.gaussian.mean[RATE], np.add(RATE_DEG_H, [0.3, 0.0, 0.0]))


@pytest.mark.parametrize("kind", ["wild", "repeated"])
def test_records_that_tell_nothing_do_not_move_the_angles(kind: str) -> None:
    rates = [np.array([0.0, 0.0, 15.0]) + each for each in noisy(60)] if kind == "wild" else [RATE_DEG_H] * 60
    watch, moving = pushed(fresh_rates(), state(), rates)
    assert not watch.is_measured
    assert watch.is_refused is (kind == "wild")
    assert np.isfinite(moving.gaussian.mean).all()


def test_a_sensor_no_better_than_the_model_is_refused_and_yaw_is_known_less() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(5))
    before = moving.gaussian.covariance[0, 0]
    grown = moving._replace(drift=DriftWatch(np.log(3.5)))
    after, refused = pushed(watch, grown, noisy(1))
    assert (after.is_refused, after.is_measured) == (True, False)
    assert refused.gaussian.covariance[0, 0] == pytest.approx(before + 0.2**2)
    assert refused.drift.log_scale == 0.0
    assert after.other_log_scale == grown.drift.log_scale


def test_each_model_keeps_its_own_factor() -> None:
    watch, moving = pushed(fresh_rates(), state(0.5), noisy(2))
    assert (moving.drift.log_scale, watch.other_log_scale) == (0.0, 0.5)
    assert inertial_motion(watch, moving)[1].drift.log_scale == 0.5


def test_torques_from_the_ground_leave_the_powers_to_judge_for_an_hour() -> None:
    watch, moving = pushed(fresh_rates(), state(), noisy(3))
    watch, moving = pushed(watch, moving, noisy(1), is_pushed=True)
    assert not watch.is_measured
    watch, moving = pushed(watch, moving, noisy(59))
    assert not watch.is_measured
    assert pushed(watch, moving, noisy(3))[0].is_measured
