"""Wheel momentum among the states: its motion, its measurement and the judgement of records."""

from typing import Any

import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_model import FedForward, FilterSettings, MomentumModel
from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.model.wheel_momentum import compared, moved_momentum
from service.core.estimation.filtering.watches.momentum_watch import (
    MomentumWatch,
    fresh_watch,
    has_jumped,
    push_record,
    with_impossible,
)

#: nine core states, chain and rain, nine torques, seven of the momentum
FIRST, SIZE = 20, 27
PROFILE = FedForward((1e-3, 2e-3, 3e-3), (0.0, 1e-3, 0.0), (0.0, 0.0, 2e-3), 0.05, 0.01, 86_400_000_000)
WHEELS = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), PROFILE)
SETTINGS = FilterSettings(momentum=WHEELS)
MINUTE_US, H = 60_000_000, np.array([0.4, -8.0, -0.3])


def state(yaw_deg: float = 0.0) -> Gaussian:
    mean = np.zeros(SIZE)
    mean[:3], mean[FIRST : FIRST + 3] = (yaw_deg, 0.02, -0.03), H
    mean[FIRST + 3 :] = (0.01, -0.02, 1e-3, -2e-3)
    sigma = np.array([0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, *(1e-4,) * 9])
    covariance = np.diag(np.square([*sigma, 0.02, 0.02, 0.02, 0.05, 0.05, 0.005, 0.005]))
    return Gaussian(mean, covariance)


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


def fed(watch: MomentumWatch, gaussian: Gaussian, minute: int, value: np.ndarray, **flags: Any) -> Any:
    epoch_us = minute * MINUTE_US
    is_unloading = bool(flags.get("is_unloading"))
    return push_record(watch, gaussian, FIRST, epoch_us, value, epoch_us, SETTINGS, WHEELS, is_unloading=is_unloading)


def records(values: list[np.ndarray], **flags: Any) -> tuple[MomentumWatch, Gaussian]:
    watch, gaussian = fresh_watch(), state()
    for number, value in enumerate(values):
        watch, gaussian = fed(watch, gaussian, number, value, **flags)
    return watch, gaussian


def noisy(count: int, seed: int = 1) -> list[np.ndarray]:
    return list(H + np.random.default_rng(seed).normal(0.0, 0.01, (count, 3)))


def test_one_wild_record_is_left_out_and_two_are_a_jump() -> None:
    quiet = noisy(10)
    watch, gaussian = records([*quiet, H + 1.0])
    before, known = records(quiet)
    np.testing.assert_array_equal(gaussian.mean, known.mean)
    assert (watch.skipped, before.skipped) == (1, 0)
    assert not has_jumped(watch, 11 * MINUTE_US)
    watch, gaussian = records([*quiet, H + 1.0, H + 1.001])
    assert has_jumped(watch, 12 * MINUTE_US)
    assert not watch.is_refused
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_a_marked_unloading_is_no_jump() -> None:
    watch, gaussian = records(noisy(10))
    watch, gaussian = fed(watch, gaussian, 10, H + 1.0, is_unloading=True)
    assert not has_jumped(watch, 10 * MINUTE_US)
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_repeated_and_earlier_records_tell_nothing() -> None:
    watch, gaussian = records(noisy(5))
    for minute, value in ((5, watch.newest), (3, H + 0.5)):
        after, unchanged = fed(watch, gaussian, minute, value)
        assert after is watch
        assert unchanged is gaussian


def test_telemetry_that_keeps_jumping_is_refused_and_yaw_is_known_less() -> None:
    watch, gaussian = records([H + (number // 2 % 2) for number in range(20)])
    assert watch.is_refused
    assert gaussian.covariance[0, 0] > 0.2**2
    after, unchanged = fed(watch, gaussian, 30, H)
    assert after is watch
    assert unchanged is gaussian


def test_telemetry_that_begins_with_what_no_wheel_holds_is_refused() -> None:
    assert with_impossible(fresh_watch()).is_refused
    watch, _ = records(noisy(5))
    assert with_impossible(watch) is watch
