"""Momentum of the wheels: how it moves, how a record sees it, and which records are believed."""

import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, SIZE, H, state

from service.core.estimation.filtering.filter_model import FilterSettings, Gaussian, MomentumModel, no_carriers
from service.core.estimation.filtering.filter_state import initial_sensors
from service.core.estimation.filtering.motion_sensor import JUMPED, REFUSED, SILENT, sensor_advice
from service.core.estimation.filtering.plant import (
    TORQUES,
    filter_model,
    gathered_prior_deg_h2,
    momentum_count,
    torque_prior_deg_h2,
)
from service.core.estimation.filtering.state_changes import inserted
from service.core.estimation.filtering.wheel_momentum import (
    WheelRecord,
    compare_momentum,
    momentum_covariance,
    moved_momentum,
    push_momentum,
    refuse_impossible,
)

MODEL = filter_model(no_carriers(), SETTINGS)


def expected(mean, after_h):
    return -compare_momentum(MODEL, mean, np.eye(SIZE), FIRST, np.zeros(3), after_h).innovation


#: a torque that pushes the body, and another of unknown profile that gathers in the wheels
GATHERED = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), unknown_torque_deg_h2=(5.0, 5.0, 9.0))
UNKNOWN = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2), momentum=GATHERED)


def with_own_torque():
    """Return the state with nine torques behind the momentum."""
    return inserted(state(), SIZE, momentum_covariance(UNKNOWN, GATHERED)[7:, 7:])


@pytest.mark.parametrize("after_h", [0.0, -0.1])
def test_the_measurement_is_linearised_as_it_is(after_h):
    mean, step = state(0.2).mean, 1e-6
    found = compare_momentum(MODEL, mean, np.eye(SIZE), FIRST, np.zeros(3), after_h)
    for place in range(SIZE):
        moved = mean.copy()
        moved[place] += step
        slope = (expected(moved, after_h) - expected(mean, after_h)) / step
        np.testing.assert_allclose(found.cross[:, place], slope, atol=2e-4)


@pytest.mark.parametrize("settings", [SETTINGS, UNKNOWN])
def test_momentum_of_many_short_steps_is_that_of_a_long_one(settings):
    gaussian = with_own_torque() if settings is UNKNOWN else state()
    one, many = moved_momentum(gaussian, FIRST, 0, 120 * MINUTE_US, settings), gaussian
    for minute in range(120):
        many = moved_momentum(many, FIRST, minute * MINUTE_US, MINUTE_US, settings)
    np.testing.assert_allclose(one.mean, many.mean, atol=2e-4)
    # a torque counts as constant for ten minutes, in which roll and yaw exchange by 0.04
    np.testing.assert_allclose(one.covariance, many.covariance, rtol=5e-3, atol=1e-6)
    np.testing.assert_array_equal(one.covariance, one.covariance.T)


def test_a_torque_of_its_own_moves_the_momentum_and_that_of_the_body_does_not():
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


def test_states_of_a_torque_of_its_own_exist_where_another_pushes_the_body():
    assert momentum_count(UNKNOWN) == len(momentum_covariance(UNKNOWN, GATHERED)) == 16
    alone = UNKNOWN._replace(torque_deg_h2=(0.0, 0.0, 0.0))
    assert momentum_count(alone) == len(momentum_covariance(alone, GATHERED)) == 7
    np.testing.assert_array_equal(torque_prior_deg_h2(alone), gathered_prior_deg_h2(alone))
    assert gathered_prior_deg_h2(SETTINGS).tolist() == [0.0] * 9


def fed(watch, gaussian, minute, value, *, is_unloading=False):
    """Return watch and state after a record of a minute, those given as they were."""
    epoch_us, watch, gaussian = minute * MINUTE_US, watch.copy(), Gaussian(*(each.copy() for each in gaussian))
    record = WheelRecord(epoch_us, np.asarray(value), is_unloading)
    push_momentum(MODEL, watch[0], *gaussian, FIRST, record, epoch_us, np.zeros((0, 0)))
    return watch, gaussian


def records(values):
    watch, gaussian = initial_sensors(0, 0), state()
    for number, value in enumerate(values):
        watch, gaussian = fed(watch, gaussian, number, value)
    return watch, gaussian


def is_same(after, before):
    """Return whether watch and state are as before, bit for bit."""
    (watch, gaussian), (former, kept) = after, before
    return repr(watch) == repr(former) and all(map(np.array_equal, gaussian, kept))


def advice(watch, epoch_us):
    """Return the words of what is wrong with the wheels."""
    advised = sensor_advice(watch, epoch_us)
    return [name for name, bit in (("refused", REFUSED), ("jump", JUMPED), ("silent", SILENT)) if advised & bit]


def noisy_records(count, seed=1):
    return list(H + np.random.default_rng(seed).normal(0.0, 0.01, (count, 3)))


def test_one_wild_record_is_left_out_and_two_are_a_jump():
    quiet = noisy_records(10)
    watch, gaussian = records([*quiet, H + 1.0])
    before, known = records(quiet)
    np.testing.assert_array_equal(gaussian.mean, known.mean)
    assert (watch["skipped"][0], before["skipped"][0]) == (1, 0)
    assert advice(watch, 11 * MINUTE_US) == []
    watch, gaussian = records([*quiet, H + 1.0, H + 1.001])
    assert advice(watch, 12 * MINUTE_US) == ["jump"]
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_a_marked_unloading_is_no_jump():
    watch, gaussian = records(noisy_records(10))
    watch, gaussian = fed(watch, gaussian, 10, H + 1.0, is_unloading=True)
    assert advice(watch, 10 * MINUTE_US) == []
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_repeated_and_earlier_records_tell_nothing():
    watch, gaussian = records(noisy_records(5))
    for minute, value in ((5, watch["newest_n_m_s"][0]), (3, H + 0.5)):
        assert is_same(fed(watch, gaussian, minute, value), (watch, gaussian))


def test_telemetry_that_keeps_jumping_is_refused_and_yaw_is_known_less():
    watch, gaussian = records([H + (number // 2 % 2) for number in range(20)])
    assert watch["is_refused"][0]
    assert gaussian.covariance[0, 0] > 0.2**2
    assert is_same(fed(watch, gaussian, 30, H), (watch, gaussian))


def test_an_outlier_of_true_noise_among_the_first_records_refuses_nothing():
    # sigmas along roll as a closed loop drew them, whose true telemetry was refused; the last one was 3.9
    drawn = (-2.45, -1.57, 0.67, -0.29, 1.07, 5.3)
    watch, _ = records([H + 0.01 * np.array([sigmas, 0.5, -0.5]) for sigmas in drawn])
    assert watch["skipped"][0] == 1
    assert not watch["is_refused"][0]


def test_telemetry_that_begins_with_what_no_wheel_holds_is_refused():
    watch = initial_sensors(0, 0)
    refuse_impossible(watch[0])
    assert watch["is_refused"][0]
    # and is not silent as well
    assert advice(watch, 1000 * MINUTE_US) == ["refused"]
    watch, _ = records(noisy_records(5))
    refuse_impossible(watch[0])
    assert not watch["is_refused"][0]


@pytest.mark.parametrize(("count", "silent_after_minutes"), [(0, 180), (5, 184)])
def test_three_hours_without_a_new_record_are_reported(count, silent_after_minutes):
    watch, _ = records(noisy_records(count))
    for minutes, is_reported in ((silent_after_minutes, False), (silent_after_minutes + 1, True)):
        assert advice(watch, minutes * MINUTE_US) == ["silent"] * is_reported
