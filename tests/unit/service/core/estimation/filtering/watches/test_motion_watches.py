"""Watches of rates, motion, momentum and drift."""

import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, WHEELS, H, state

from service.core.estimation.filtering.filter_model import DRIFT, RATE, FilterSettings, Gaussian, RateSensorModel
from service.core.estimation.filtering.rate_sensor import measured_settings
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.wheel_momentum import momentum_advice, push_record, with_impossible
from service.core.estimation.filtering.command_watch import executed_commands
from service.core.estimation.filtering.watches.drift_watch import (
    LARGEST,
    DriftWatch,
    push_drift,
    scaled_settings,
    usual_drift,
)
from service.core.estimation.filtering.watches.minute_sums import empty_minute, push_minute
from service.core.estimation.filtering.watches.motion_watch import (
    FOLLOWED_MINUTES,
    alarmed_axes,
    follow_all,
    forget_shifts,
    newly_explained,
    pass_motion,
    push_shift,
    still_watch,
    with_alarms,
)
from service.core.estimation.filtering.rate_sensor import MovingState, fresh_rates, inertial_motion, push_rates

SENSOR = RateSensorModel(0.01, 8.0, 0.003)
PLAIN = FilterSettings()
RATE_DEG_H = np.array([0.02, -0.01, 0.015])


def moving_state(log_scale=0.0):
    mixed = np.random.default_rng(1).normal(size=(11, 11))
    covariance = 1e-4 * (mixed @ mixed.T)
    covariance[RATE, :] = covariance[:, RATE] = 0.0
    covariance[RATE, RATE] = 1e-8 * np.eye(3)
    return MovingState(0, Gaussian(np.zeros(11), covariance), DriftWatch(log_scale), executed_commands())


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
        moving = moving._replace(epoch_us=to_us)
    return watch, moving


def noisy(count, size=0.001):
    return [RATE_DEG_H + size * each for each in np.random.default_rng(2).normal(size=(count, 3))]


def test_the_measured_rate_takes_the_place_of_the_commanded_one_and_the_bias_that_of_the_drift():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(1, 0.0))
    assert watch.is_measured
    np.testing.assert_array_equal(moving.gaussian.mean[RATE], RATE_DEG_H)
    np.testing.assert_array_equal(moving.gaussian.covariance[DRIFT, DRIFT], np.diag(np.full(3, 0.01**2)))
    settings = measured_settings(PLAIN._replace(coupling_per_h=0.0), SENSOR)
    assert (settings.coupling_per_h, settings.drift_deg_h, settings.drift_tau_h) == (0.2625162, (0.01,) * 3, 8.0)
    assert (settings.rate_noise_deg_sqrt_h, PLAIN.rate_noise_deg_sqrt_h) == (0.003, None)


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(3))
    rate = moving.gaussian.mean[RATE] + moving.gaussian.mean[DRIFT]
    after, back = inertial_motion(watch, moving)
    assert not after.is_measured
    np.testing.assert_allclose(back.gaussian.mean[DRIFT], rate, atol=1e-15)
    np.testing.assert_array_equal(back.gaussian.mean[RATE], np.zeros(3))


def test_a_rate_holds_for_ten_minutes():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(2))
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    for minutes, is_measured in ((5, True), (10, True), (11, False)):
        to_us = moving.epoch_us + minutes * MINUTE_US
        late = moving._replace(epoch_us=to_us - MINUTE_US)
        found, _ = push_rates(watch, late, nothing[1], nothing[0], to_us, np.zeros(3), PLAIN, SENSOR, is_pushed=False)
        assert found.is_measured is is_measured


def test_a_held_rate_follows_what_is_commanded():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(2, 0.0)[:1])
    wild = [np.array([30.0, 0.0, 0.0])]
    _, after = pushed(watch, moving, wild, commanded=(0.3, 0.0, 0.0))
    np.testing.assert_allclose(after.gaussian.mean[RATE], np.add(RATE_DEG_H, [0.3, 0.0, 0.0]))


@pytest.mark.parametrize("kind", ["wild", "repeated"])
def test_records_that_tell_nothing_do_not_move_the_angles(kind):
    rates = [np.array([0.0, 0.0, 15.0]) + each for each in noisy(60)] if kind == "wild" else [RATE_DEG_H] * 60
    watch, moving = pushed(fresh_rates(), moving_state(), rates)
    assert not watch.is_measured
    assert watch.is_refused is (kind == "wild")
    assert np.isfinite(moving.gaussian.mean).all()


def test_a_sensor_no_better_than_the_model_is_refused_and_yaw_is_known_less():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(5))
    before = moving.gaussian.covariance[0, 0]
    grown = moving._replace(drift=DriftWatch(np.log(3.5)))
    after, refused = pushed(watch, grown, noisy(1))
    assert (after.is_refused, after.is_measured) == (True, False)
    assert refused.gaussian.covariance[0, 0] == pytest.approx(before + 0.2**2)
    assert refused.drift.log_scale == 0.0
    assert after.other_log_scale == grown.drift.log_scale


def test_each_model_keeps_its_own_factor():
    watch, moving = pushed(fresh_rates(), moving_state(0.5), noisy(2))
    assert (moving.drift.log_scale, watch.other_log_scale) == (0.0, 0.5)
    assert inertial_motion(watch, moving)[1].drift.log_scale == 0.5


def test_torques_from_the_ground_leave_the_powers_to_judge_for_an_hour():
    watch, moving = pushed(fresh_rates(), moving_state(), noisy(3))
    watch, moving = pushed(watch, moving, noisy(1), is_pushed=True)
    assert not watch.is_measured
    watch, moving = pushed(watch, moving, noisy(59))
    assert not watch.is_measured
    assert pushed(watch, moving, noisy(3))[0].is_measured


def shifted(watch, epoch_us, shift, *, is_pushed=False):
    """Return the watch after a row, as the filter does it."""
    pushed = push_shift(watch, epoch_us, shift)
    return with_alarms(pushed, is_pushed=is_pushed) if alarmed_axes(pushed).any() else pushed


def test_shifts_of_one_sign_raise_their_axis_for_an_hour():
    watch = still_watch(0)
    for minute in range(1, 20):
        watch = shifted(watch, minute * MINUTE_US, np.array([0.1, -1.6, 0.5]))
        if any(watch.is_unannounced):
            break
    assert minute == 10  # 10 (1.6 - 0.6) > 9
    assert watch.is_unannounced == (False, True, False)
    for _ in range(int(FOLLOWED_MINUTES)):
        assert watch.is_unannounced[1]
        watch = pass_motion(watch, 1.0)
    assert not any(watch.is_unannounced)


def reported_minutes(minutes, **settings):
    """Return for each minute of a steady shift of roll whether it is followed, reported, and newly explained."""
    watch, announced = still_watch(0), []
    for minute in range(1, minutes):
        before = watch
        watch = shifted(pass_motion(watch, 1.0), minute * MINUTE_US, np.array([0.0, 1.6, 0.0]), **settings)
        announced.append((watch.is_followed[1], watch.is_unannounced[1], bool(newly_explained(before, watch)[1])))
    assert not any(watch.is_unannounced[axis] for axis in (0, 2))
    return announced


def test_where_a_torque_acts_the_first_alarm_follows_and_the_second_is_reported():
    announced = reported_minutes(30, is_pushed=True)
    # ten minutes to an alarm: followed, and widened; ten more to the next one, which is reported, and widens again
    assert announced.index((True, False, True)) == 9
    assert [minute for minute, one in enumerate(announced) if one[2]] == [9, 19]
    assert [one[1] for one in announced].index(True) == 19


def test_what_a_torque_may_explain_is_reported_for_a_quarter_of_an_hour():
    """Before: an hour from the second alarm on. Two alarms, then the widened torque explains the shifts."""
    watch, reported = still_watch(0), 0
    for minute in range(1, 120):
        shift = np.array([0.0, 1.6 if minute <= 20 else 0.0, 0.0])
        watch = shifted(pass_motion(watch, 1.0), minute * MINUTE_US, shift, is_pushed=True)
        reported += watch.is_unannounced[1]
    assert reported == 15
    assert not watch.alarms.any()  # still for an hour: the next alarm is a first one


def test_what_no_torque_explains_is_reported_for_an_hour():
    announced = reported_minutes(60, is_pushed=True)
    assert all(one[1] for one in announced[19:])
    jumped = shifted(follow_all(still_watch(0)), MINUTE_US, np.zeros(3), is_pushed=True)
    left = pass_motion(jumped, FOLLOWED_MINUTES - 1.0)
    assert left.is_unannounced == (True, True, True)


def test_rows_inside_a_minute_wait_for_its_end():
    watch = shifted(still_watch(0), 10_000_000, np.full(3, 50.0))
    assert not any(watch.is_unannounced)
    assert not any(forget_shifts(watch, 10_000_000).minute.total)


def test_a_jump_is_followed_on_all_axes():
    assert follow_all(still_watch(0)).is_unannounced == (True, True, True)


def fed(watch, gaussian, minute, value, **flags):
    epoch_us = minute * MINUTE_US
    is_unloading = bool(flags.get("is_unloading"))
    pushed = push_record(watch, gaussian, FIRST, epoch_us, value, epoch_us, SETTINGS, WHEELS, is_unloading=is_unloading)
    return pushed[:2]


def records(values, **flags):
    watch, gaussian = SensorWatch(), state()
    for number, value in enumerate(values):
        watch, gaussian = fed(watch, gaussian, number, value, **flags)
    return watch, gaussian


def noisy_records(count, seed=1):
    return list(H + np.random.default_rng(seed).normal(0.0, 0.01, (count, 3)))


def test_one_wild_record_is_left_out_and_two_are_a_jump():
    quiet = noisy_records(10)
    watch, gaussian = records([*quiet, H + 1.0])
    before, known = records(quiet)
    np.testing.assert_array_equal(gaussian.mean, known.mean)
    assert (watch.skipped, before.skipped) == (1, 0)
    assert not watch.has_jumped(11 * MINUTE_US)
    watch, gaussian = records([*quiet, H + 1.0, H + 1.001])
    assert watch.has_jumped(12 * MINUTE_US)
    assert not watch.is_refused
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_a_marked_unloading_is_no_jump():
    watch, gaussian = records(noisy_records(10))
    watch, gaussian = fed(watch, gaussian, 10, H + 1.0, is_unloading=True)
    assert not watch.has_jumped(10 * MINUTE_US)
    np.testing.assert_allclose(gaussian.mean[FIRST : FIRST + 3], H + 1.0, atol=0.1)


def test_repeated_and_earlier_records_tell_nothing():
    watch, gaussian = records(noisy_records(5))
    for minute, value in ((5, watch.newest_n_m_s), (3, H + 0.5)):
        after, unchanged = fed(watch, gaussian, minute, value)
        assert after is watch
        assert unchanged is gaussian


def test_telemetry_that_keeps_jumping_is_refused_and_yaw_is_known_less():
    watch, gaussian = records([H + (number // 2 % 2) for number in range(20)])
    assert watch.is_refused
    assert gaussian.covariance[0, 0] > 0.2**2
    after, unchanged = fed(watch, gaussian, 30, H)
    assert after is watch
    assert unchanged is gaussian


def test_an_outlier_of_true_noise_among_the_first_records_refuses_nothing():
    # sigmas along roll as a closed loop drew them, whose true telemetry was refused; the last one was 3.9
    drawn = (-2.45, -1.57, 0.67, -0.29, 1.07, 5.3)
    watch, _ = records([H + 0.01 * np.array([sigmas, 0.5, -0.5]) for sigmas in drawn])
    assert watch.skipped == 1
    assert not watch.is_refused


def test_telemetry_that_begins_with_what_no_wheel_holds_is_refused():
    assert with_impossible(SensorWatch()).is_refused
    watch, _ = records(noisy_records(5))
    assert with_impossible(watch) is watch


@pytest.mark.parametrize(("count", "silent_after_minutes"), [(0, 180), (5, 184)])
def test_three_hours_without_a_new_record_are_reported(count, silent_after_minutes):
    watch, _ = records(noisy_records(count)) if count else (SensorWatch(), None)
    for minutes, is_reported in ((silent_after_minutes, False), (silent_after_minutes + 1, True)):
        assert momentum_advice(watch, 0, minutes * MINUTE_US, is_used=True)["momentum_silent"] is is_reported
        assert not momentum_advice(watch, 0, minutes * MINUTE_US, is_used=False)["momentum_silent"]


def test_refused_telemetry_is_not_silent_as_well():
    advice = momentum_advice(with_impossible(SensorWatch()), 0, 1000 * MINUTE_US, is_used=True)
    assert advice == {"momentum_refused": True, "momentum_jump": False, "momentum_silent": False}


SIGMA = np.array(PLAIN.drift_deg_h)


def drifting(drift_deg_h, known_share=0.75):
    """Return a state of 12 places that knows its drift to some share of the variance."""
    variance = np.full(12, 1e-4)
    variance[DRIFT] = (1.0 - known_share) * SIGMA**2
    mean = np.zeros(12)
    mean[DRIFT] = drift_deg_h
    return Gaussian(mean, np.diag(variance))


def drifted(ratio, minutes, known_share=0.75):
    watch, state = usual_drift(), drifting(ratio * SIGMA, known_share)
    for _ in range(minutes):
        watch, _ = push_drift(watch, PLAIN.drift_deg_h, state, 1.0)
    return watch


def test_a_usual_drift_leaves_the_settings_as_they_are():
    watch = drifted(np.sqrt(0.75), 600)  # exactly what the model expects of the estimate
    assert watch.scale == 1.0
    assert scaled_settings(PLAIN, watch) is PLAIN


def test_a_small_drift_never_narrows_it():
    assert drifted(0.0, 600) == usual_drift()


def test_three_times_the_drift_is_learned_within_half_a_day():
    scale = drifted(3.0, 720).scale
    assert 2.0 <= scale <= LARGEST
    np.testing.assert_allclose(
        scaled_settings(PLAIN, DriftWatch(np.log(scale) + 1e-6)).drift_deg_h, scale * SIGMA, rtol=1e-12
    )


def test_the_factor_has_a_limit():
    assert drifted(50.0, 3000).scale == pytest.approx(LARGEST)


def test_an_unknown_drift_says_nothing():
    assert drifted(3.0, 600, known_share=0.01) == usual_drift()


def test_a_step_of_the_factor_widens_the_drift_and_nothing_else():
    watch, state = DriftWatch(0.0866), drifting(3.0 * SIGMA)  # just below the first step of 2^(1/8)
    after, wider = push_drift(watch, PLAIN.drift_deg_h, state, 1.0)
    assert after.scale > watch.scale
    growth = wider.covariance - state.covariance
    np.testing.assert_allclose(np.diagonal(growth)[DRIFT], (2.0**0.25 - 1.0) * SIGMA**2, rtol=1e-9)
    growth[DRIFT, DRIFT] = 0.0
    assert not growth.any()


def test_the_factor_follows_time_and_not_rows():
    state = drifting(3.0 * SIGMA)
    one, many = usual_drift(), usual_drift()
    one, _ = push_drift(one, PLAIN.drift_deg_h, state, 1.0)
    for _ in range(6):
        many, _ = push_drift(many, PLAIN.drift_deg_h, state, 1.0 / 6.0)
    assert many.log_scale == pytest.approx(one.log_scale, rel=1e-12)


def test_rows_a_minute_apart_are_minutes_each():
    minute = push_minute(empty_minute(2, 0), 59_990_000, np.array([1.5, np.nan]))
    np.testing.assert_array_equal(minute.values, [1.5, np.nan])
    assert minute.sums.start_us == 59_990_000


def test_ten_second_rows_are_added_up_with_unit_variance():
    rng, values = np.random.default_rng(1), []
    sums = empty_minute(1, 0)
    for row in range(1, 6 * 2000 + 1):
        sums, is_over, value = push_minute(sums, row * 10_000_000, rng.standard_normal(1))
        if is_over:
            values.append(float(value[0]))
    assert len(values) == 2000
    assert abs(np.std(values) - 1.0) < 0.05  # 2000 draws are good to 1.6 %


def test_a_gap_closes_the_minute():
    sums, is_over, _ = push_minute(empty_minute(1, 0), 5_000_000, np.array([2.0]))
    assert not is_over
    assert push_minute(sums, 9_000_000_000, np.array([2.0])).values[0] == 4.0 / np.sqrt(2.0)
