"""Records of wheel momentum judged one by one, and the advice that follows."""

from typing import Any

import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, WHEELS, H, state

from service.core.estimation.filtering.model.filter_state import Gaussian
from service.core.estimation.filtering.watches.momentum_watch import (
    MomentumWatch,
    fresh_watch,
    has_jumped,
    momentum_advice,
    push_record,
    with_impossible,
)


def fed(watch: MomentumWatch, gaussian: Gaussian, minute: int, value: np.ndarray, **flags: Any) -> Any:
    epoch_us = minute * MINUTE_US
    is_unloading = bool(flags.get("is_unloading"))
    pushed = push_record(watch, gaussian, FIRST, epoch_us, value, epoch_us, SETTINGS, WHEELS, is_unloading=is_unloading)
    return pushed[:2]


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


def test_an_outlier_of_true_noise_among_the_first_records_refuses_nothing() -> None:
    # sigmas along roll as a closed loop drew them, whose true telemetry was refused; the last one was 3.9
    drawn = (-2.45, -1.57, 0.67, -0.29, 1.07, 5.3)
    watch, _ = records([H + 0.01 * np.array([sigmas, 0.5, -0.5]) for sigmas in drawn])
    assert watch.skipped == 1
    assert not watch.is_refused


def test_telemetry_that_begins_with_what_no_wheel_holds_is_refused() -> None:
    assert with_impossible(fresh_watch()).is_refused
    watch, _ = records(noisy(5))
    assert with_impossible(watch) is watch


@pytest.mark.parametrize(("count", "silent_after_minutes"), [(0, 180), (5, 184)])
def test_three_hours_without_a_new_record_are_reported(count: int, silent_after_minutes: int) -> None:
    watch, _ = records(noisy(count)) if count else (fresh_watch(), None)
    for minutes, is_reported in ((silent_after_minutes, False), (silent_after_minutes + 1, True)):
        assert momentum_advice(watch, 0, minutes * MINUTE_US, is_used=True)["momentum_silent"] is is_reported
        assert not momentum_advice(watch, 0, minutes * MINUTE_US, is_used=False)["momentum_silent"]


def test_refused_telemetry_is_not_silent_as_well() -> None:
    advice = momentum_advice(with_impossible(fresh_watch()), 0, 1000 * MINUTE_US, is_used=True)
    assert advice == {"momentum_refused": True, "momentum_jump": False, "momentum_silent": False}
