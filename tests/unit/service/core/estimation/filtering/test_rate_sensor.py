"""Rate sensor: records judged, the rate that takes the place of the commanded one, and back."""

import filter_models
import numpy as np
import pytest
from filter_rows import records_of

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FilterSettings,
    Gaussian,
    RateSensorModel,
    no_carriers,
)
from service.core.estimation.filtering.filter_state import FilterState, start
from service.core.estimation.filtering.plant import filter_model, measured_settings
from service.core.estimation.filtering.rate_sensor import follow_model, push_rates
from service.core.estimation.filtering.row_block import BODY_RATE, empty_block

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


MODEL = filter_model(no_carriers(), PLAIN, rate_sensor=SENSOR)


def after_step(state, minutes, records, *, commanded=(0.0, 0.0, 0.0), is_pushed=False):
    """Return the state after a step of some minutes, by records (minute of the step, rate); that given as it was."""
    state, from_us = FilterState._make(each.copy() for each in state), state.epoch_us
    to_us = from_us + round(minutes * MINUTE_US)
    told = [{"kind": BODY_RATE, "epoch_us": from_us + round(m * MINUTE_US), "rate_deg_h": rate} for m, rate in records]
    block = empty_block(1, 0)._replace(records=records_of(*told))
    block.rows["epoch_us"] = to_us
    block.rows["correction_deg"] = np.array(commanded) * (to_us - from_us) / 3.6e9
    block.rows["rate_change_deg_h"] = 1e-9 if is_pushed else 0.0
    push_rates(MODEL, state, block, 0)
    return state.with_watch(epoch_us=to_us)


def pushed(state, rates, **flags):
    """Return the state after steps of a minute that each end with a record."""
    for rate in rates:
        state = after_step(state, 1, [(1, rate)], **flags)
    return state


def judgement(state):
    return state.rates[0]


def noisy(count, size=0.001):
    return [RATE_DEG_H + size * each for each in np.random.default_rng(2).normal(size=(count, 3))]


def test_the_measured_rate_takes_the_place_of_the_commanded_one_and_the_bias_that_of_the_drift():
    before = moving_state()
    moving = pushed(before, noisy(1, 0.0))
    assert judgement(moving)["is_measured"]
    np.testing.assert_array_equal(moving.mean[RATE], RATE_DEG_H)
    alone(moving, DRIFT, 0.01)
    assert not moving.mean[DRIFT].any()
    same(moving, before, ATTITUDE, REST)
    settings = measured_settings(PLAIN._replace(coupling_per_h=0.0), SENSOR)
    assert (settings.coupling_per_h, settings.drift_deg_h, settings.drift_tau_h) == (0.2625162, (0.01,) * 3, 8.0)
    assert (settings.rate_noise_deg_sqrt_h, PLAIN.rate_noise_deg_sqrt_h) == (0.003, None)


def test_what_was_commanded_is_in_the_measured_rate_and_not_added_to_it():
    state, block = moving_state(), empty_block(1, 0, shares=1)
    record = {"kind": BODY_RATE, "epoch_us": MINUTE_US, "rate_deg_h": RATE_DEG_H}
    block = block._replace(records=records_of(record))
    block.rows["epoch_us"], block.rows["correction_deg"] = MINUTE_US, 1e-6
    # a command that nobody has reported may push: the powers have to judge
    push_rates(MODEL, state, block, 0)
    assert not judgement(state)["is_measured"]
    assert block.rows["correction_deg"].all()
    state, block = moving_state(), block._replace(unreported=np.zeros((1, 0, 2, 3)))
    push_rates(MODEL, state, block, 0)
    assert judgement(state)["is_measured"]
    assert not block.rows["correction_deg"].any()


def test_the_inertial_model_goes_on_with_the_rate_that_was_measured():
    moving = pushed(moving_state(), noisy(3), commanded=(0.01, 0.0, 0.0))
    back = FilterState._make(each.copy() for each in moving)
    follow_model(back)
    assert not judgement(back)["is_measured"]
    np.testing.assert_allclose(back.mean[DRIFT], moving.mean[DRIFT] + judgement(moving)["residual_deg_h"], atol=1e-15)
    np.testing.assert_array_equal(back.covariance[DRIFT, ATTITUDE], moving.covariance[DRIFT, ATTITUDE])
    np.testing.assert_array_equal(back.mean[RATE], np.zeros(3))
    alone(back, RATE, 1e-4)


def test_a_rate_holds_for_ten_minutes():
    moving = pushed(moving_state(), noisy(2))
    for minutes, is_measured in ((5, True), (10, True), (11, False)):
        late = moving.with_watch(epoch_us=moving.epoch_us + (minutes - 1) * MINUTE_US)
        assert judgement(after_step(late, 1, []))["is_measured"] == is_measured


@pytest.mark.parametrize(("minutes", "is_measured"), [((5, 10, 15, 20), True), ((5, 20), False), ((5, 9), False)])
def test_a_long_step_is_measured_where_records_reach_through_it(minutes, is_measured):
    records = [(minute, RATE_DEG_H + 1e-4 * minute) for minute in minutes]
    assert judgement(after_step(moving_state(), 20, records))["is_measured"] == is_measured


def test_a_held_rate_follows_what_is_commanded():
    moving = pushed(moving_state(), noisy(2, 0.0)[:1])
    wild = [np.array([30.0, 0.0, 0.0])]
    after = pushed(moving, wild, commanded=(0.3, 0.0, 0.0))
    np.testing.assert_allclose(after.mean[RATE], np.add(RATE_DEG_H, [0.3, 0.0, 0.0]))


@pytest.mark.parametrize("kind", ["wild", "repeated"])
def test_records_that_tell_nothing_do_not_move_the_angles(kind):
    rates = [np.array([0.0, 0.0, 15.0]) + each for each in noisy(60)] if kind == "wild" else [RATE_DEG_H] * 60
    moving = pushed(moving_state(), rates)
    assert not judgement(moving)["is_measured"]
    assert judgement(moving)["is_refused"] == (kind == "wild")
    assert np.isfinite(moving.mean).all()


def test_a_sensor_no_better_than_the_model_is_refused_and_yaw_is_known_less():
    moving = pushed(moving_state(), noisy(5))
    grown = moving.with_watch(log_drift_scale=np.log(3.5))
    refused = pushed(grown, noisy(1))
    assert (judgement(refused)["is_refused"], judgement(refused)["is_measured"]) == (True, False)
    assert refused.covariance[0, 0] == pytest.approx(moving.covariance[0, 0] + 0.2**2)
    assert log_scale(refused) == 0.0
    assert judgement(refused)["other_log_scale"] == log_scale(grown)
    # nothing is known of its drift, and the commanded rate stands by itself
    assert not refused.mean[DRIFT].any()
    alone(refused, DRIFT, np.array(PLAIN.drift_deg_h))
    alone(refused, RATE, 1e-4)
    after = pushed(refused, noisy(1))
    assert repr(judgement(after)) == repr(judgement(refused))


def test_each_model_keeps_its_own_factor():
    moving = pushed(moving_state(0.5), noisy(2))
    assert (log_scale(moving), judgement(moving)["other_log_scale"]) == (0.0, 0.5)
    follow_model(moving)
    assert log_scale(moving) == 0.5


def test_torques_from_the_ground_leave_the_powers_to_judge_for_an_hour():
    moving = pushed(moving_state(), noisy(3))
    moving = pushed(moving, noisy(1), is_pushed=True)
    assert not judgement(moving)["is_measured"]
    moving = pushed(moving, noisy(59))
    assert not judgement(moving)["is_measured"]
    assert judgement(pushed(moving, noisy(3)))["is_measured"]


REST = slice(9, 11)


def same(after, before, *kept):
    """Check that some states are as before."""
    for one in kept:
        np.testing.assert_array_equal(after.mean[one], before.mean[one])
        for other in kept:
            np.testing.assert_array_equal(after.covariance[one, other], before.covariance[one, other])


def alone(state, places, sigma):
    """Check that some states are known to a sigma and correlated with nothing."""
    rows = state.covariance[places].copy()
    np.testing.assert_allclose(rows[:, places], np.square(sigma) * np.eye(3), rtol=1e-12)
    rows[:, places] = 0.0
    assert not rows.any()


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
