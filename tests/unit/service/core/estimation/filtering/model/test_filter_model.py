"""The filter's model: state, measured motion, torque prior, wheel momentum and polarimeter."""

import math

import filter_models
import numpy as np
import pytest
from wheel_filter import FIRST, MINUTE_US, SETTINGS, SIZE, WHEELS, state

from service.core.estimation.filtering.attitude_filter import start
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.state_changes import with_stated_torque, with_torque
from service.core.estimation.filtering.kernels.state_kernels import know_rate
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    DRIFT,
    RATE,
    FedForward,
    FilterSettings,
    Gaussian,
    LearnedFeed,
    MomentumModel,
    PolarimeterModel,
    carrier_states,
    core_size,
    freed,
    initial_gaussian,
    model_error_component,
    model_variance_db2,
    no_motion,
    pattern_change,
    reference_states,
    reset_carriers,
)
from service.core.estimation.filtering.state_changes import (
    hidden_noise,
    hidden_transition,
    inserted,
    momentum_count,
    sensor_states,
    torque_states,
)
from service.core.estimation.filtering.rate_sensor import (
    with_inertial_drift,
    with_measured_rate,
    with_sensor_bias,
    with_unknown_drift,
)
from service.core.estimation.filtering.polarimeter import (
    POLARIMETER,
    angle_deg,
    compared_angle,
    polarimeter_covariance,
    ratio_db,
    slope_db_deg,
    with_learned_feeds,
)
from service.core.estimation.filtering.plant import (
    DAY_US,
    TORQUES,
    gathered_prior_deg_h2,
    is_pushed,
    scale_covariance,
    torque_covariance,
    torque_prior_deg_h2,
    torque_size_deg_h2,
    wave_period_us,
)
from service.core.estimation.filtering.wheel_momentum import compared, momentum_covariance, moved_momentum


def test_the_pattern_is_the_quadratic_and_its_gradient_the_derivative():
    model = filter_models.carrier_model()
    attitude_deg = np.array([0.3, -0.2, 0.1])
    change = pattern_change(model, attitude_deg)
    expected = model.gradient_db_deg @ attitude_deg + 0.5 * np.einsum(
        "i,nij,j->n", attitude_deg, model.hessian_db_deg2, attitude_deg
    )
    np.testing.assert_allclose(change.deviation_db, expected, rtol=0.0, atol=1e-14)  # rounding
    for axis in range(3):
        turned = attitude_deg + 1e-5 * np.eye(3)[axis]
        slope = (pattern_change(model, turned).deviation_db - change.deviation_db) / 1e-5
        # the second derivative of some 3 dB/deg^2 times half the step of 1e-5 deg
        np.testing.assert_allclose(slope, change.gradient_db_deg[:, axis], rtol=0.0, atol=5e-5)


def test_the_calibrations_error_is_that_of_the_nine_coefficients():
    model = filter_models.carrier_model(carriers=1)
    rng = np.random.default_rng(3)
    attitude_deg = np.array([0.4, -0.3, 0.2])
    errors = rng.multivariate_normal(np.zeros(9), model.coefficient_covariance[0], size=40_000)
    gradient, upper = errors[:, :3], errors[:, 3:]
    hessian = np.empty((len(errors), 3, 3))
    for number, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        hessian[:, a, b] = hessian[:, b, a] = upper[:, number]
    drawn = gradient @ attitude_deg + 0.5 * np.einsum("i,nij,j->n", attitude_deg, hessian, attitude_deg)
    # a variance of 40 000 draws is good to 0.7 %
    np.testing.assert_allclose(
        model_variance_db2(model.coefficient_covariance, attitude_deg)[0], drawn.var(), rtol=0.03
    )
    assert model_variance_db2(model.coefficient_covariance, np.zeros(3))[0] == 0.0


def test_the_calibrations_error_rides_on_the_component_of_about_an_hour():
    model = filter_models.carrier_model(components=3)
    assert model_error_component(model.coloured_tau_s).tolist() == [1] * model.carriers


def test_every_state_has_one_place():
    model = filter_models.carrier_model(carriers=5, components=3, common=2)
    positions = carrier_states(model, np.arange(5))
    assert positions.shape == (4, 5)
    assert sorted(positions.ravel().tolist()) == list(range(core_size(model), core_size(model) + 20))
    assert positions[-1].tolist() == reference_states(model, np.arange(5)).tolist()
    assert len(filter_models.aligned(model).mean) == core_size(model) + 20


def test_an_alignment_sets_attitude_and_stationary_noise():
    model = filter_models.carrier_model(carriers=4, components=2)
    state = filter_models.aligned(model)
    np.testing.assert_allclose(state.attitude_sigma_deg, [0.01, 0.005, 0.005], rtol=1e-12)
    variance = np.diagonal(state.covariance)
    positions = carrier_states(model, np.arange(4))
    np.testing.assert_allclose(np.sqrt(variance[positions[0]]), 0.07, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(variance[positions[2]]), 0.03, rtol=1e-12)
    assert (variance > 0.0).all()


def test_what_is_freed_together_keeps_its_differences():
    model = filter_models.carrier_model(carriers=6)
    state = filter_models.aligned(model)
    positions = reference_states(model, np.array([1, 4]))
    wider = freed(state, positions, 4.0)
    one, other = positions
    spread = wider.covariance[one, one] + wider.covariance[other, other] - 2.0 * wider.covariance[one, other]
    np.testing.assert_allclose(spread, 2.0 * 0.03**2, rtol=1e-9)  # 4 dB^2 minus 4 dB^2 loses eight digits at most
    assert wider.covariance[one, one] > 4.0
    assert state.covariance[one, one] < 0.01


def test_a_reset_carrier_knows_nothing_of_the_others():
    model = filter_models.carrier_model(carriers=6)
    state = freed(filter_models.aligned(model), np.arange(core_size(model) + 18), 0.01)
    after = reset_carriers(model, state, np.array([2]), np.array([1.5]), np.array([9.0]))
    positions = carrier_states(model, np.array([2])).ravel()
    others = np.setdiff1d(np.arange(len(state.mean)), positions)
    assert not after.covariance[np.ix_(positions, others)].any()
    assert after.mean[positions[-1]] == 1.5
    assert after.covariance[positions[-1], positions[-1]] == 9.0
    np.testing.assert_array_equal(after.covariance[ATTITUDE, ATTITUDE], state.covariance[ATTITUDE, ATTITUDE])


RATE_DEG_H = np.array([0.2, -0.1, 0.3])
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


HOUR_US = 3_600_000_000
#: roll and pitch a quarter of a wave apart, yaw between them, a constant about pitch
PROFILE = FedForward((0.0, 0.0, 0.5), (1.6, 3.9, 0.0), (1.6, 0.0, 3.8), 0.06, 0.01, DAY_US)
TOLD = FilterSettings(fed_forward=PROFILE)


def profile_at(hour, reported=PROFILE):
    phase = 2.0 * np.pi * hour * HOUR_US / reported.period_us
    return np.array(
        [np.array(reported[0]), np.cos(phase) * np.array(reported[1]), np.sin(phase) * np.array(reported[2])]
    ).sum(axis=0)


def aligned(model, settings):
    sigma = np.array([0.01, 0.005, 0.005])
    state = initial_gaussian(model, np.zeros(3), sigma, np.full(model.carriers, 0.03), drift_deg_h=settings.drift_deg_h)
    return with_torque(model, state, settings)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=8, common=1)


@pytest.mark.parametrize("hour", [0.0, 5.0, 13.3])
def test_the_error_is_a_share_of_the_profile_at_every_hour(hour):
    phase = 2.0 * np.pi * hour / 24.0
    now = np.kron([1.0, np.cos(phase), np.sin(phase)], np.eye(3))
    covariance = now @ torque_covariance(TOLD) @ now.T
    shares = 0.06**2 * np.ones((3, 3)) + 0.01**2 * np.eye(3)
    np.testing.assert_allclose(covariance, np.outer(profile_at(hour), profile_at(hour)) * shares, atol=1e-15)


def test_a_torque_of_unknown_shape_adds_to_it():
    both = TOLD._replace(torque_deg_h2=(0.1, 0.1, 0.2))
    alone = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2))
    np.testing.assert_allclose(torque_covariance(both), torque_covariance(alone) + torque_covariance(TOLD), rtol=1e-12)
    np.testing.assert_allclose(
        torque_size_deg_h2(both) ** 2, torque_size_deg_h2(alone) ** 2 + torque_size_deg_h2(TOLD) ** 2, rtol=1e-12
    )


def test_the_size_is_that_of_the_crest():
    share = np.hypot(0.06, 0.01)
    np.testing.assert_allclose(torque_size_deg_h2(TOLD), share * np.array([np.hypot(1.6, 1.6), 3.9, 4.3]), rtol=1e-12)


def test_a_profile_without_errors_pushes_nothing(model):
    exact = FilterSettings(fed_forward=PROFILE._replace(relative_error=0.0, axis_relative_error=0.0))
    assert is_pushed(TOLD)
    assert not is_pushed(exact)
    assert not is_pushed(FilterSettings())
    assert torque_states(model, aligned(model, exact), 0) is None


@pytest.mark.parametrize("step_us", [60_000_000, HOUR_US, 31 * HOUR_US])
def test_a_wave_of_another_period_moves_the_craft_as_fine_steps_do(step_us):
    """Pitch is not coupled: its rate is the integral of the profile, its angle that of the rate."""
    reported = PROFILE._replace(period_us=5 * HOUR_US)
    settings = FilterSettings(fed_forward=reported)
    assert wave_period_us(settings) == 5 * HOUR_US
    from_us = 1_700_000_000 * 1_000_000
    added = hidden_transition(TORQUES, from_us, step_us, settings, no_motion())
    torque = np.concatenate(reported[:3])
    nodes = 20_000
    hours = (np.arange(nodes) + 0.5) / nodes * step_us / HOUR_US
    phase = 2.0 * np.pi * (from_us % reported.period_us / HOUR_US + hours) / 5.0
    push = reported.constant_deg_h2[2] + reported.sine_deg_h2[2] * np.sin(phase)
    rate = push.mean() * step_us / HOUR_US
    angle = ((hours[-1] + hours[0] - hours) * push).mean() * step_us / HOUR_US
    assert (added @ torque)[8] == pytest.approx(rate, rel=1e-6, abs=1e-7)
    assert (added @ torque)[2] == pytest.approx(angle, rel=1e-6, abs=1e-7)


def test_what_is_learned_of_a_share_is_forgotten_with_its_shape(model):
    state = aligned(model, TOLD)
    positions = torque_states(model, state, 0)
    state.covariance[positions, positions] *= 1e-6
    weather = Weather(False, (False, False, False), 1.0, np.zeros(8))
    later, _ = predict(model, TOLD, state, 14 * DAY_US, no_motion(), weather)
    # 2 * 14 / 1000 of what was stated
    expected = -np.expm1(-0.028) * scale_covariance(PROFILE)
    np.testing.assert_allclose(later.covariance[positions, positions], expected, atol=1e-6)


def test_another_profile_is_learned_anew_and_none_ends_it(model):
    pushed = start(model, 0, aligned(model, TOLD))
    pushed.gaussian.mean[core_size(model)] = 0.3
    twice = TOLD._replace(fed_forward=PROFILE._replace(cosine_deg_h2=(3.2, 7.8, 0.0)))
    again = with_stated_torque(model, pushed, 0, TOLD, twice)
    np.testing.assert_array_equal(again.gaussian.covariance, aligned(model, twice).covariance)
    assert not again.gaussian.mean.any()
    ended = with_stated_torque(model, again, 0, twice, FilterSettings())
    np.testing.assert_array_equal(ended.gaussian.covariance, aligned(model, FilterSettings()).covariance)
    same = with_stated_torque(model, pushed, 0, TOLD, TOLD._replace(torque_deg_h2=(0.1, 0.1, 0.1)))
    assert same.gaussian.mean[core_size(model)] == 0.3


def expected(mean, after_h):
    return -compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS).innovation


#: a torque that pushes the body, and another of unknown profile that gathers in the wheels
GATHERED = MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), unknown_torque_deg_h2=(5.0, 5.0, 9.0))
UNKNOWN = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2), momentum=GATHERED)


def with_own_torque():
    """Return the state with nine torques behind the momentum."""
    return inserted(state(), SIZE, momentum_covariance(UNKNOWN, GATHERED)[7:, 7:])


@pytest.mark.parametrize("after_h", [0.0, -0.1])
def test_the_measurement_is_linearised_as_it_is(after_h):
    mean, step = state(0.2).mean, 1e-6
    found = compared(Gaussian(mean, np.eye(SIZE)), FIRST, np.zeros(3), after_h, SETTINGS, WHEELS)
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


READ = PolarimeterModel((0.99, -0.09, -0.13))
#: nine core states, chain and rain, four of the polarimeter
FIRST_READ, SIZE_READ = 11, 15


def read_state():
    mean = np.zeros(SIZE_READ)
    mean[:3], mean[3:6] = (0.1, -0.02, 0.03), (0.04, -0.02, 0.01)
    mean[FIRST_READ:] = (1.0, 0.02, -0.03, 0.04)
    sigma = [0.1, 0.02, 0.02, *(0.04,) * 3, *(1e-4,) * 3, 0.1, 1e-3, 3.0, 0.05, 0.05, 0.05]
    return Gaussian(mean, np.diag(np.square(sigma)))


@pytest.mark.parametrize("feed_deg", [2.0, 10.0, 45.0, -10.0])
def test_the_slope_is_the_derivative_of_the_ratio(feed_deg):
    step = 1e-5
    slope = (ratio_db(feed_deg, step) - ratio_db(feed_deg, -step)) / (2.0 * step)
    assert slope_db_deg(feed_deg) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("leakage_deg", [-1.0, 0.4, 1.0])
def test_a_leakage_of_35_db_is_an_offset_and_leaves_the_slope_right_to_a_percent(leakage_deg):
    leak = math.radians(leakage_deg)
    still, turned = (angle_deg(10.0, ratio_db(10.0, turn, leak)) for turn in (0.0, 0.5))
    assert turned - still == pytest.approx(0.5, rel=0.01)
    assert still == pytest.approx(leakage_deg, rel=0.04)


@pytest.mark.parametrize(("epoch_h", "after_h"), [(0.0, 0.0), (5.0, -0.1)])
def test_the_measurement_follows_attitude_and_its_own_states(epoch_h, after_h):
    epoch_us = round(epoch_h * HOUR_US)
    phase = math.radians(15.0 * epoch_h)
    mean = read_state().mean
    then = mean[:3] + after_h * mean[3:6]
    expected = then @ np.array(READ.sight) + 1.04 + 0.02 * math.cos(phase) - 0.03 * math.sin(phase)
    found = compared_angle(read_state(), FIRST_READ, expected + 0.2, 0.01, epoch_us, after_h, READ)
    assert found.innovation[0] == pytest.approx(0.2)
    assert found.covariance[0, 0] == pytest.approx(
        float(found.cross[0, :3] @ np.array(READ.sight)) + 9.0 + 0.005 + 0.01, abs=1e-4
    )


def test_a_first_angle_sets_the_offset_and_leaves_yaw():
    before = read_state()
    found = compared_angle(before, FIRST_READ, 2.0, 0.005, 0, 0.0, READ)
    after = found.applied(before)
    assert after.mean[0] == pytest.approx(before.mean[0], abs=2e-3)
    assert after.covariance[0, 0] == pytest.approx(before.covariance[0, 0], rel=2e-3)
    # a change is of yaw, as far as the wander allows: 0.1 deg of yaw beside some hundredths
    again = compared_angle(after, FIRST_READ, 2.1, 0.0005, 0, 0.0, READ).applied(after)
    assert again.covariance[0, 0] < after.covariance[0, 0]
    np.testing.assert_array_equal(again.covariance, again.covariance.T)


def test_states_of_polarimeters_stand_behind_those_of_the_wheels_and_only_the_wander_fades():
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


def test_a_filter_begins_with_what_quiet_days_told_of_each_feed():
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
