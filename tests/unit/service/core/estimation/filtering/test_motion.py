"""Motion over a step of time: what the closed forms add against matrix exponentials, and what a torque may be."""

import filter_models
import numpy as np
import pytest
from scipy.linalg import expm

from service.core.estimation.filtering.filter_model import (
    RATE,
    FedForward,
    FilterSettings,
    KnownMotion,
    core_size,
    initial_gaussian,
    no_carriers,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.motion import step_motion
from service.core.estimation.filtering.plant import (
    DAY_US,
    TORQUES,
    filter_model,
    is_pushed,
    scale_covariance,
    torque_covariance,
    torque_prior_deg_h2,
    torque_size_deg_h2,
    wave_period_us,
)
from service.core.estimation.filtering.state_changes import torque_states, with_torque

MINUTE_US, HOUR_US = 60_000_000, 3_600_000_000
ZEROS = np.zeros(3)
#: 5e-7 N m on 2600, 2600 and 1400 kg m2
PUSHED = FilterSettings(torque_deg_h2=(0.143, 0.143, 0.265))
#: roll and pitch a quarter of a wave apart, yaw between them, a constant about pitch
PROFILE = FedForward((0.0, 0.0, 0.5), (1.6, 3.9, 0.0), (1.6, 0.0, 3.8), 0.06, 0.01, DAY_US)
TOLD = FilterSettings(fed_forward=PROFILE)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=16, common=1)


def motion_over(step_us, settings, *, hidden=0, from_us=0, known=None):
    known = known or no_motion()
    commanded = known.correction_deg, known.late_correction_deg, known.rate_change_deg_h
    still, compiled = np.zeros(3, dtype=bool), filter_model(no_carriers(), settings)
    return step_motion(compiled, hidden, known.unreported, from_us, step_us, *commanded, 1.0, np.nan, still, False)


def aligned(model, settings=PUSHED):
    references = np.full(model.carriers, 0.03)
    sigma = np.array([0.01, 0.005, 0.005])
    gaussian = initial_gaussian(model, ZEROS, sigma, references, drift_deg_h=settings.drift_deg_h)
    return start(model, 0, with_torque(model, gaussian, settings))


def generator(settings):
    rate = settings.coupling_per_h
    matrix = np.zeros((9, 9))
    matrix[0, 1], matrix[1, 0] = -rate, rate
    matrix[0:3, 3:6] = matrix[0:3, 6:9] = np.eye(3)
    matrix[3:6, 3:6] = -np.eye(3) / settings.drift_tau_h
    return matrix


@pytest.mark.parametrize("coupling", [0.2625162, 0.0])
@pytest.mark.parametrize("step_us", [1_000_000, MINUTE_US, 600_000_000, HOUR_US, 12 * HOUR_US])
def test_the_transition_is_the_matrix_exponential(coupling, step_us):
    settings = FilterSettings(coupling_per_h=coupling)
    expected = expm(generator(settings) * step_us / HOUR_US)
    # rounding, and 1e-6 squared where a quotient is taken by its series
    np.testing.assert_allclose(motion_over(step_us, settings).transition, expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("step_us", [1_000_000, MINUTE_US, 3 * HOUR_US, 12 * HOUR_US])
def test_the_noise_of_the_drifts_is_that_of_van_loan(step_us):
    settings = FilterSettings()
    matrix, hours = generator(settings), step_us / HOUR_US
    intensity = np.zeros((9, 9))
    intensity[3:6, 3:6] = np.diag(2.0 * np.array(settings.drift_deg_h) ** 2 / settings.drift_tau_h)
    block = expm(np.block([[-matrix, intensity], [np.zeros((9, 9)), matrix.T]]) * hours)
    expected = block[9:, 9:].T @ block[:9, 9:]
    noise = motion_over(step_us, settings).noise
    # ten Gauss points; rounding of the drift's variance
    np.testing.assert_allclose(noise, expected, rtol=1e-7, atol=1e-15)


def test_a_minute_sixty_times_is_an_hour():
    settings = FilterSettings()
    minute, hour = motion_over(MINUTE_US, settings), motion_over(HOUR_US, settings)
    transition, noise = np.eye(9), np.zeros((9, 9))
    for _ in range(60):
        transition = minute.transition @ transition
        noise = minute.transition @ noise @ minute.transition.T + minute.noise
    np.testing.assert_allclose(transition, hour.transition, rtol=0.0, atol=1e-12)  # sixty roundings
    np.testing.assert_allclose(noise, hour.noise, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("coupling", [0.2625162, 0.0])
@pytest.mark.parametrize("step_us", [1_000_000, MINUTE_US, HOUR_US, 31 * HOUR_US])
@pytest.mark.parametrize("from_us", [0, 7 * HOUR_US + 1])
def test_what_torques_add_is_the_matrix_exponential(coupling, step_us, from_us):
    """Attitude, rate, constant, and a wave that goes round: p' = w q, q' = -w p."""
    settings = PUSHED._replace(coupling_per_h=coupling)
    matrix, around = np.zeros((15, 15)), 2.0 * np.pi / 24.0
    matrix[0, 1], matrix[1, 0] = -coupling, coupling
    matrix[0:3, 3:6] = matrix[3:6, 6:9] = matrix[3:6, 9:12] = np.eye(3)
    matrix[9:12, 12:15], matrix[12:15, 9:12] = around * np.eye(3), -around * np.eye(3)
    moved = expm(matrix * step_us / HOUR_US)
    phase = 2.0 * np.pi * from_us / DAY_US
    begun = np.kron([[1, 0, 0], [0, np.cos(phase), np.sin(phase)], [0, -np.sin(phase), np.cos(phase)]], np.eye(3))
    expected = moved[0:6, 6:15] @ begun
    added = motion_over(step_us, settings, hidden=TORQUES, from_us=from_us).transition[:, 9:]
    hours = step_us / HOUR_US
    # in units of what a constant does; the exponential itself loses 1e-12 over a day
    scale = np.repeat([0.5 * hours**2, hours], 3)[:, None]
    np.testing.assert_allclose(added[[0, 1, 2, 6, 7, 8]] / scale, expected / scale, rtol=0.0, atol=1e-11)
    assert not added[3:6].any()


@pytest.mark.parametrize("step_us", [MINUTE_US, HOUR_US, 31 * HOUR_US])
def test_a_wave_of_another_period_moves_the_craft_as_fine_steps_do(step_us):
    """Pitch is not coupled: its rate is the integral of the profile, its angle that of the rate."""
    reported = PROFILE._replace(period_us=5 * HOUR_US)
    settings = FilterSettings(fed_forward=reported)
    assert wave_period_us(settings) == 5 * HOUR_US
    from_us = 1_700_000_000 * 1_000_000
    added = motion_over(step_us, settings, hidden=TORQUES, from_us=from_us).transition[:, 9:]
    torque = np.concatenate(reported[:3])
    nodes = 20_000
    hours = (np.arange(nodes) + 0.5) / nodes * step_us / HOUR_US
    phase = 2.0 * np.pi * (from_us % reported.period_us / HOUR_US + hours) / 5.0
    push = reported.constant_deg_h2[2] + reported.sine_deg_h2[2] * np.sin(phase)
    rate = push.mean() * step_us / HOUR_US
    angle = ((hours[-1] + hours[0] - hours) * push).mean() * step_us / HOUR_US
    assert (added @ torque)[8] == pytest.approx(rate, rel=1e-6, abs=1e-7)
    assert (added @ torque)[2] == pytest.approx(angle, rel=1e-6, abs=1e-7)


def test_an_unreported_command_moves_by_its_share_and_torques_stand_behind_it():
    turns = np.array([[[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]]])
    known = no_motion()._replace(unreported=turns)
    added = motion_over(MINUTE_US, PUSHED, hidden=1 + TORQUES, known=known).transition[:, 9:]
    np.testing.assert_array_equal(added[:3, 0], turns[0, 0])
    np.testing.assert_array_equal(added[RATE, 0], turns[0, 1])
    np.testing.assert_array_equal(added[:, 1:], motion_over(MINUTE_US, PUSHED, hidden=TORQUES).transition[:, 9:])


def test_a_constant_roll_torque_shows_in_yaw_too(model):
    state = aligned(model)
    state.mean[core_size(model) + 1] = 0.1
    moved = filter_models.coasted(filter_model(model, PUSHED), state, 6 * HOUR_US)
    # what was learned decays by 0.00025 in six hours; roll'' = a - w^2 roll, yaw' = -w roll
    turn = PUSHED.coupling_per_h * 6.0
    assert moved.mean[1] == pytest.approx(0.1 * (1.0 - np.cos(turn)) / PUSHED.coupling_per_h**2, rel=5e-4)
    assert moved.mean[0] == pytest.approx(-0.1 * (turn - np.sin(turn)) / PUSHED.coupling_per_h**2, rel=5e-4)
    assert moved.mean[2] == 0.0


@pytest.mark.parametrize("hour", [0.0, 5.0, 13.3])
def test_the_torque_has_the_stated_size_at_every_hour(model, hour):
    state = aligned(model)
    positions = torque_states(model, len(state.mean), 0)
    phase = 2.0 * np.pi * hour / 24.0
    now = np.kron([1.0, np.cos(phase), np.sin(phase)], np.eye(3))
    variance = np.diag(now @ state.covariance[positions, positions] @ now.T)
    np.testing.assert_allclose(np.sqrt(variance), PUSHED.torque_deg_h2, rtol=1e-12)


def test_what_is_learned_holds_for_weeks(model):
    state = aligned(model)
    positions = torque_states(model, len(state.mean), 0)
    state.mean[positions] = 0.1
    state.covariance[positions, positions] *= 1e-6
    later = filter_models.coasted(filter_model(model, PUSHED), state, 14 * DAY_US)
    np.testing.assert_allclose(later.mean[positions], 0.1, rtol=0.02)
    sigma = np.sqrt(np.diag(later.covariance)[positions]) / torque_prior_deg_h2(PUSHED)
    # sqrt(2 * 14 / 1000) of what was stated
    np.testing.assert_allclose(sigma, 0.166, atol=0.002)


def test_what_is_learned_of_a_share_is_forgotten_with_its_shape(model):
    state = aligned(model, TOLD)
    positions = torque_states(model, len(state.mean), 0)
    state.covariance[positions, positions] *= 1e-6
    later = filter_models.coasted(filter_model(model, TOLD), state, 14 * DAY_US)
    # 2 * 14 / 1000 of what was stated
    expected = -np.expm1(-0.028) * scale_covariance(PROFILE)
    np.testing.assert_allclose(later.covariance[positions, positions], expected, atol=1e-6)


def profile_at(hour):
    phase = 2.0 * np.pi * hour * HOUR_US / PROFILE.period_us
    parts = np.array(PROFILE[:3]) * np.array([[1.0], [np.cos(phase)], [np.sin(phase)]])
    return parts.sum(axis=0)


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
    for settings in (exact, FilterSettings()):
        assert torque_states(model, len(aligned(model, settings).mean), 0) is None


def test_a_torque_leaves_a_rate_that_stays():
    model = filter_models.carrier_model()
    compiled = filter_model(model, FilterSettings(coupling_per_h=0.0))
    pushed = KnownMotion(ZEROS, ZEROS, np.array([0.0, 0.0, 0.6]))
    state = filter_models.coasted(compiled, start(model, 0, filter_models.aligned(model)), MINUTE_US, pushed)
    np.testing.assert_allclose(state.mean[2], 0.6 / 120.0, rtol=1e-12)  # half a minute of the new rate
    later = filter_models.coasted(compiled, state, HOUR_US)
    np.testing.assert_allclose(later.mean[RATE], [0.0, 0.0, 0.6], rtol=1e-12)
    np.testing.assert_allclose(later.mean[2] - state.mean[2], 0.6, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(later.covariance[8, 8]), 0.02 * 0.6, rtol=1e-3)  # and the floor of the rate
