"""Prediction of the filter and effects that are declared."""

import filter_models
import numpy as np
import pytest
from scipy.linalg import expm

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.model.declared import nothing_declared
from service.core.estimation.filtering.model.filter_model import FilterSettings, KnownMotion, no_motion
from service.core.estimation.filtering.model.filter_state import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    RAIN,
    RATE,
    carrier_states,
    reference_states,
)
from service.core.estimation.filtering.model.step_inputs import motion_over

HOUR_US = 3_600_000_000


def generator(settings):
    rate = settings.coupling_per_h
    matrix = np.zeros((9, 9))
    matrix[0, 1], matrix[1, 0] = -rate, rate
    matrix[0:3, 3:6] = matrix[0:3, 6:9] = np.eye(3)
    matrix[3:6, 3:6] = -np.eye(3) / settings.drift_tau_h
    return matrix


@pytest.mark.parametrize("coupling", [0.2625162, 0.0])
@pytest.mark.parametrize("step_us", [1_000_000, 60_000_000, 600_000_000, HOUR_US, 12 * HOUR_US])
def test_the_transition_is_the_matrix_exponential(coupling, step_us):
    settings = FilterSettings(coupling_per_h=coupling)
    expected = expm(generator(settings) * step_us / HOUR_US)
    # rounding, and 1e-6 squared where a quotient is taken by its series
    np.testing.assert_allclose(motion_over(step_us, settings).transition, expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("step_us", [1_000_000, 60_000_000, 3 * HOUR_US, 12 * HOUR_US])
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
    minute, hour = motion_over(60_000_000, settings), motion_over(HOUR_US, settings)
    transition, noise = np.eye(9), np.zeros((9, 9))
    for _ in range(60):
        transition = minute.transition @ transition
        noise = minute.transition @ noise @ minute.transition.T + minute.noise
    np.testing.assert_allclose(transition, hour.transition, rtol=0.0, atol=1e-12)  # sixty roundings
    np.testing.assert_allclose(noise, hour.noise, rtol=1e-9, atol=1e-14)


def quiet_weather(model, **changes):
    calm = Weather(
        is_raining=False,
        is_unannounced=(False, False, False),
        slow_scale=1.0,
        model_variance_db2=np.zeros(model.carriers),
    )
    return calm._replace(**changes)


def variances(model, aligned, settings, step_us, known, weather):
    state, _ = predict(model, settings, aligned, step_us, known, weather)
    return np.diagonal(state.covariance)


def test_commanded_corrections_move_the_attitude_and_cost_their_scale():
    model = filter_models.carrier_model()
    aligned, settings = filter_models.aligned(model), FilterSettings(coupling_per_h=0.0)
    zeros = np.zeros(3)
    chunk = KnownMotion(np.array([0.0, 0.01, 0.0]), zeros, zeros)
    state, weather = aligned, quiet_weather(model)
    for _ in range(30):  # half an hour of one command: 0.3 deg in all
        state, variance = predict(model, settings, state, 60_000_000, chunk, weather)
        weather = weather._replace(model_variance_db2=variance)
    still = aligned
    for _ in range(30):
        still, _ = predict(model, settings, still, 60_000_000, no_motion(), quiet_weather(model))
    np.testing.assert_allclose(state.mean[ATTITUDE], [0.0, 0.3, 0.0], rtol=0.0, atol=1e-12)
    added = state.covariance[1, 1] - still.covariance[1, 1]
    np.testing.assert_allclose(np.sqrt(added), 0.05 * 0.3, rtol=1e-6)  # five percent of the whole command


def test_a_late_correction_raises_sigma_by_its_size():
    model = filter_models.carrier_model()
    aligned, settings, zeros = filter_models.aligned(model), FilterSettings(), np.zeros(3)
    late = KnownMotion(zeros, np.array([0.2, 0.0, 0.0]), zeros)
    state, _ = predict(model, settings, aligned, 60_000_000, late, quiet_weather(model))
    still, _ = predict(model, settings, aligned, 60_000_000, no_motion(), quiet_weather(model))
    np.testing.assert_allclose(state.mean[0], 0.2, atol=1e-12)
    np.testing.assert_allclose(state.covariance[0, 0] - still.covariance[0, 0], 0.04, rtol=1e-9)


def test_a_torque_leaves_a_rate_that_stays():
    model = filter_models.carrier_model()
    settings, zeros = FilterSettings(coupling_per_h=0.0), np.zeros(3)
    pushed = KnownMotion(zeros, zeros, np.array([0.0, 0.0, 0.6]))
    state, _ = predict(model, settings, filter_models.aligned(model), 60_000_000, pushed, quiet_weather(model))
    np.testing.assert_allclose(state.mean[2], 0.6 / 120.0, rtol=1e-12)  # half a minute of the new rate
    later, _ = predict(model, settings, state, HOUR_US, no_motion(), quiet_weather(model))
    np.testing.assert_allclose(later.mean[RATE], [0.0, 0.0, 0.6], rtol=1e-12)
    np.testing.assert_allclose(later.mean[2] - state.mean[2], 0.6, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(later.covariance[8, 8]), 0.02 * 0.6, rtol=1e-3)  # and the floor of the rate


def test_rain_walks_widely_only_in_rain_mode():
    model = filter_models.carrier_model(common=1)
    aligned, settings = filter_models.aligned(model), FilterSettings()
    dry = variances(model, aligned, settings, 60_000_000, no_motion(), quiet_weather(model))
    wet = variances(model, aligned, settings, 60_000_000, no_motion(), quiet_weather(model, is_raining=True))
    np.testing.assert_allclose(np.sqrt(wet[RAIN]), 0.25, rtol=1e-4)
    assert np.sqrt(dry[RAIN]) < 0.005
    assert dry[CHAIN] == wet[CHAIN]


def test_stationary_parts_stay_stationary_and_scale_with_what_was_learned():
    model = filter_models.carrier_model(common=2)
    aligned, settings = filter_models.aligned(model), FilterSettings()
    positions = carrier_states(model, np.arange(model.carriers))
    for step_us in (1_000_000, 60_000_000, 6 * HOUR_US):
        after = variances(model, aligned, settings, step_us, no_motion(), quiet_weather(model))
        np.testing.assert_allclose(after[positions[0]], 0.07**2, rtol=1e-9)
        np.testing.assert_allclose(after[11:13], 0.05**2, rtol=1e-9)
        louder = variances(model, aligned, settings, step_us, no_motion(), quiet_weather(model, slow_scale=2.0))
        assert (louder[positions[0]] > after[positions[0]]).all()


def test_the_calibrations_error_grows_with_the_attitude_at_once():
    model = filter_models.carrier_model()
    aligned = filter_models.aligned(model)
    turned = aligned._replace(mean=np.concatenate([[0.0, 0.4, 0.0], aligned.mean[3:]]))
    settings = FilterSettings(coupling_per_h=0.0)
    positions = carrier_states(model, np.arange(model.carriers))
    state, variance = predict(model, settings, turned, 60_000_000, no_motion(), quiet_weather(model))
    own = np.diagonal(state.covariance)
    np.testing.assert_allclose(own[positions[1]] - 0.03**2, variance, rtol=1e-9)
    again, _ = predict(
        model, settings, state, 60_000_000, no_motion(), quiet_weather(model, model_variance_db2=variance)
    )
    np.testing.assert_allclose(np.diagonal(again.covariance)[positions[1]], own[positions[1]], rtol=1e-9)


def test_suspected_motion_is_followed_with_a_wide_drift():
    model = filter_models.carrier_model()
    aligned, settings = filter_models.aligned(model), FilterSettings()
    calm = variances(model, aligned, settings, HOUR_US, no_motion(), quiet_weather(model))
    suspected = quiet_weather(model, is_unannounced=(False, True, False))
    wide = variances(model, aligned, settings, HOUR_US, no_motion(), suspected)
    np.testing.assert_allclose(wide[1] - calm[1], 0.15**2, rtol=1e-9)
    assert wide[2] == calm[2]
    assert (wide[DRIFT] == calm[DRIFT]).all()


def declared_covariance(filter_models, step_us, **changes):
    """Covariance after a step with a declaration minus the one without."""
    model = filter_models.carrier_model()
    aligned, settings = filter_models.aligned(model), FilterSettings()
    declared = nothing_declared(model.carriers, int(model.transponder.max()) + 1)._replace(**changes)
    with_it, _ = predict(model, settings, aligned, step_us, no_motion(), quiet_weather(model, declared=declared))
    without, _ = predict(model, settings, aligned, step_us, no_motion(), quiet_weather(model))
    return model, with_it.covariance - without.covariance


def test_declared_walks_add_variance_by_the_hour():
    walk_db = np.linspace(0.0, 0.3, 12)
    model, more = declared_covariance(
        filter_models,
        2 * HOUR_US,
        attitude_walk_deg=np.array([0.3, 0.0, 0.2]),
        chain_walk_db=0.1,
        reference_walk_db=walk_db,
    )
    expected = np.zeros(len(more))
    expected[[0, 2, CHAIN]] = [0.18, 0.08, 0.02]
    expected[reference_states(model, np.arange(12))] = 2.0 * walk_db**2
    np.testing.assert_allclose(more, np.diag(expected), rtol=0.0, atol=1e-15)  # rounding of sums below one


def test_declared_steps_do_not_grow_with_the_step():
    steps_db = np.linspace(0.0, 0.6, 12)
    for step_us in (1_000_000, 6 * HOUR_US):
        model, more = declared_covariance(
            filter_models,
            step_us,
            attitude_step_deg=np.array([0.0, 0.05, 0.02]),
            chain_step_db=0.4,
            reference_step_db=steps_db,
        )
        expected = np.zeros(len(more))
        expected[[1, 2, CHAIN]] = [0.0025, 0.0004, 0.16]
        expected[reference_states(model, np.arange(12))] = steps_db**2
        np.testing.assert_allclose(more, np.diag(expected), rtol=0.0, atol=1e-15)  # rounding of sums below one


def test_a_declared_step_of_a_transponder_moves_its_references_together():
    model = filter_models.carrier_model()
    groups = np.zeros(int(model.transponder.max()) + 1)
    groups[1] = 0.5
    _, more = declared_covariance(filter_models, 60_000_000, group_step_db=groups)
    members = reference_states(model, np.flatnonzero(model.transponder == 1))
    expected = np.zeros_like(more)
    expected[np.ix_(members, members)] = 0.25
    assert len(members) > 1
    np.testing.assert_allclose(more, expected, rtol=0.0, atol=1e-15)  # rounding of sums below one


MINUTE_US = 60_000_000
CARRIERS = 16
EVERYONE = np.arange(CARRIERS)
NONE = nothing_declared(CARRIERS, 3)


class Run:
    """A filter of a still craft, driven with declarations."""

    def __init__(self, filter_models):
        self.model, self.rng = filter_models.carrier_model(carriers=CARRIERS), np.random.default_rng(1)
        self.state = start(self.model, 0, filter_models.aligned(self.model))
        self.reported = []
        self.rows(60)

    def rows(self, count, change_db=0.0, declared=None):
        """Feed rows of white noise and a change (N,) or (), return what the last told."""
        for _ in range(count):
            row = change_db + self.model.white_sigma_db * self.rng.standard_normal(CARRIERS)
            epoch_us = self.state.epoch_us + MINUTE_US
            reported = step(self.model, FilterSettings(), self.state, epoch_us, row, no_motion(), declared=declared)
            self.reported.append(reported)
            self.state = reported.state
        return self.reported[-1]


@pytest.fixture
def run():
    return Run(filter_models)


def test_nothing_declared_changes_nothing():
    plain, reported = Run(filter_models).rows(5), Run(filter_models).rows(5, declared=NONE)
    np.testing.assert_array_equal(reported.attitude_deg, plain.attitude_deg)
    np.testing.assert_array_equal(reported.state.gaussian.covariance, plain.state.gaussian.covariance)


def test_declared_noise_is_believed_and_not_learned(run):
    before = run.state.noise.white_scale
    declared = NONE._replace(white_db=np.full(CARRIERS, 2.0))
    sigma = np.diagonal(run.reported[-1].covariance_deg2)
    reported = run.rows(15, 1.5 * run.rng.standard_normal(CARRIERS), declared)
    np.testing.assert_array_equal(reported.state.noise.white_scale, before)
    assert not reported.state.carriers.is_flagged.any()
    assert (np.diagonal(reported.covariance_deg2) > sigma).all()


@pytest.mark.parametrize("size_db", [2.5, -2.5])
def test_a_declared_step_of_the_chain_holds_control_and_is_no_rain(run, size_db):
    run.rows(1, size_db, NONE._replace(chain_step_db=3.0))
    reported = run.rows(30, size_db)
    assert sum("chain_step" in row.integrity.reasons for row in run.reported[60:]) == 10
    assert not any(row.state.rain.is_raining for row in run.reported[60:])
    assert abs(reported.state.gaussian.mean[CHAIN] - size_db) < 0.25  # what 16 carriers with 0.1 dB each share
    assert abs(reported.state.rain.base_chain_db - size_db) < 0.3


def test_small_steps_of_every_row_hide_no_fault_and_hold_nothing(run):
    """An eclipse is told as a step of 0.04 dB a row of each transponder."""
    declared = NONE._replace(group_step_db=np.full(3, 0.04), chain_step_db=0.04)
    reported = run.rows(6, np.where(EVERYONE == 5, -4.0, 0.0), declared)
    assert reported.state.carriers.is_flagged[5]
    assert not any("chain_step" in row.integrity.reasons for row in run.reported[60:])


def test_a_fall_while_the_chain_is_worked_on_is_no_rain(run):
    working = NONE._replace(chain_walk_db=0.1)
    run.rows(5, 0.0, working)
    reported = run.rows(20, -2.5, working)
    assert not any(row.state.rain.is_raining for row in run.reported)
    assert sum("chain_step" in row.integrity.reasons for row in run.reported) == 10
    assert abs(reported.state.gaussian.mean[CHAIN] + 2.5) < 0.25  # what 16 carriers with 0.1 dB each share
    assert len(reported.used) == CARRIERS
