"""Prediction of the filter, effects that are declared, and the kernels that compute both."""

import filter_models
import numpy as np
import pytest
from filter_models import aligned, carrier_model
from scipy.linalg import expm

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.kernels import state_kernels
from service.core.estimation.filtering.declared import nothing_declared
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    RAIN,
    RATE,
    FilterSettings,
    KnownMotion,
    carrier_states,
    core_size,
    no_motion,
    reference_states,
)
from service.core.estimation.filtering.state_changes import inserted
from service.core.estimation.filtering.model.step_inputs import motion_over
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, compiled_kernels
from service.core.estimation.filtering.watches.drift_watch import DriftWatch

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


@pytest.fixture(scope="module")
def compiled():
    """The compiled set."""
    return compiled_kernels()


def walk(model, kernels, rows, shares=None):
    """Return the steps of some rows with commands, a jump, a gap and carriers that come and go."""
    rng, settings = np.random.default_rng(11), FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2))
    state, epoch_us, steps = start(model, 0, filter_models.aligned(model)), 0, []
    if shares is not None:
        hidden = np.diag(np.concatenate([np.ones(shares), np.full(9, 0.01)]) ** 2)
        state = state._replace(gaussian=inserted(state.gaussian, core_size(model), hidden))
    for row in range(rows):
        known = KnownMotion(*(0.01 * rng.standard_normal((3, 3))))
        known = known._replace(unreported=0.01 * rng.standard_normal((shares or 0, 2, 3)))
        epoch_us += (1 + row % 4) * MINUTE_US // 2
        deviation_db = 0.2 * rng.standard_normal(model.carriers) - 3.0 * (row == rows // 2)
        deviation_db[rng.random(model.carriers) < 0.2] = np.nan
        found = step(model, settings, state, epoch_us, deviation_db, known, kernels=kernels)
        state = found.state
        steps.append(found)
    return steps


def assert_alike(first, second, tolerance):
    for one, other in zip(first, second, strict=True):
        sigma = np.sqrt(np.diagonal(one.state.gaussian.covariance))
        # relative to the sigmas: an element that happens to be near zero has no relative accuracy of its own
        (mean, covariance), (other_mean, other_covariance) = one.state.gaussian, other.state.gaussian
        assert np.abs((mean - other_mean) / sigma).max() <= tolerance
        assert np.abs((covariance - other_covariance) / np.outer(sigma, sigma)).max() <= tolerance
        np.testing.assert_allclose(one.innovation_db, other.innovation_db, rtol=0.0, atol=tolerance)
        np.testing.assert_array_equal(one.used, other.used)
        assert one.is_ordinary is other.is_ordinary


@pytest.mark.parametrize(("components", "common", "shares"), [(1, 0, None), (3, 2, None), (2, 1, 0), (2, 1, 2)])
def test_both_sets_agree(compiled, components, common, shares):
    model = filter_models.carrier_model(components=components, common=common)
    model = model._replace(coefficient_covariance=model.coefficient_covariance + 1e-5)
    arrays, loops = walk(model, ARRAYS, 40, shares), walk(model, compiled, 40, shares)
    assert_alike(arrays, loops, 1e-9)  # 1e-12 of one row, and forty rows build upon one another
    assert_alike(arrays[:1], loops[:1], 1e-12)
    assert {each.is_ordinary for each in arrays} == {True, False}  # the jump is none of the ordinary rows


@pytest.mark.parametrize("name", ["arrays", "compiled"])
def test_a_set_gives_the_same_bits_twice_and_a_covariance_that_stays_one(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled}[name]
    model = filter_models.carrier_model(common=1)
    first, second = (walk(model, kernels, 60) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        (mean, covariance), (other_mean, other_covariance) = one.state.gaussian, other.state.gaussian
        np.testing.assert_array_equal(mean, other_mean)
        np.testing.assert_array_equal(covariance, other_covariance)
        np.testing.assert_array_equal(covariance, covariance.T)
        scale = np.sqrt(np.diagonal(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 1e-9


def test_a_state_of_other_memory_is_the_same_to_the_compiled_set(compiled):
    """A state that was restored, or cut out of another one, compiles nothing again."""
    model = filter_models.carrier_model(common=1)
    state = start(model, 0, filter_models.aligned(model))
    deviation_db = 0.1 * np.random.default_rng(2).standard_normal(model.carriers)
    covariance = np.asfortranarray(state.gaussian.covariance)
    covariance.setflags(write=False)
    other = state._replace(gaussian=state.gaussian._replace(covariance=covariance))
    first, second = (
        step(model, FilterSettings(), each, MINUTE_US, deviation_db, no_motion(), kernels=compiled)
        for each in (state, other)
    )
    np.testing.assert_array_equal(first.state.gaussian.covariance, second.state.gaussian.covariance)


def _after_precise_rows():
    """Return the covariance after many precise rows on free references."""
    model = filter_models.carrier_model()._replace(white_sigma_db=np.full(12, 1e-4))
    state = filter_models.aligned(model)
    wide = state.covariance.copy()
    wide[-12:, -12:] += 9.0 * (np.eye(12) + 1.0)
    state = state._replace(covariance=wide)
    for _ in range(50):
        row = innovate(model, state, np.zeros(12), np.arange(12), model.white_sigma_db**2)
        state = update(model, state, np.zeros(12), row).state
    return state.covariance


def assert_positive(covariance):
    assert (np.diagonal(covariance) > 0.0).all()
    scale = np.sqrt(np.diagonal(covariance))
    # nothing is added between the rows, which operation never does
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-12


def test_a_precise_row_on_free_references_leaves_a_positive_covariance():
    assert_positive(_after_precise_rows())


def test_innovations_without_a_covariance_are_refused():
    with pytest.raises(np.linalg.LinAlgError):
        state_kernels.update_state(
            np.zeros(2), np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros(2), np.zeros((2, 2))
        )


EIGHT = 8


def copied(value):
    """Return a value with arrays of its own that nobody may write to, as a restored state has them."""
    if isinstance(value, np.ndarray):
        array = value.copy()
        array.setflags(write=False)
        return array
    if isinstance(value, tuple):
        parts = [copied(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def bits(value):
    """Return the bytes of all numbers of a state."""
    if isinstance(value, tuple):
        return b"".join(bits(each) for each in value)
    return np.asarray(value).tobytes()


@pytest.fixture(scope="module")
def flown():
    """Return the rows of some minutes, and the states before each and after the last."""
    model, settings = carrier_model(EIGHT, components=3, common=2), FilterSettings()
    seed = 7
    rows = np.random.default_rng(seed).normal(0.0, 0.1, (40, EIGHT))
    states = [start(model, 0, aligned(model))]
    for row in rows:
        states.append(taken(model, settings, states[-1], row))
    return model, settings, rows, states


def taken(model, settings, state, row_db):
    """Return the state after a row by the compiled stages."""
    kernels = compiled_kernels()
    return step(model, settings, state, state.epoch_us + MINUTE_US, row_db, no_motion(), kernels=kernels).state


@pytest.mark.timeout(900)
def test_a_restored_state_goes_on_with_the_same_bits(flown):
    model, settings, rows, states = flown
    state = copied(states[25])
    for row_db, before in zip(rows[25:], states[25:], strict=False):
        assert bits(state) == bits(before)
        state = taken(model, settings, state, row_db)
    assert bits(state) == bits(states[-1])


@pytest.mark.timeout(900)
def test_rows_are_taken_again_from_an_earlier_state_and_beside_another_model(flown):
    model, settings, rows, states = flown
    other = carrier_model(EIGHT, components=3, common=2)
    beside = start(other, 0, aligned(other))
    state = states[30]
    for number in range(30, len(rows)):
        state = taken(model, settings, state, rows[number])
        beside = taken(other, settings, beside, rows[number - 30])
        assert bits(state) == bits(states[number + 1])
        assert bits(beside) == bits(states[number - 29])


@pytest.mark.timeout(900)
def test_models_that_are_no_longer_used_are_let_go(flown):
    model, settings, rows, states = flown
    made = [carrier_model(EIGHT, components=3, common=2) for _ in range(70)]
    for each in made:
        assert bits(taken(each, settings, states[0], rows[0])) == bits(states[1])
    assert bits(taken(model, settings, states[-2], rows[-1])) == bits(states[-1])


@pytest.mark.timeout(900)
def test_a_state_that_a_sensor_changed_goes_on_from_the_held_one_with_the_same_bits(flown, monkeypatch):
    model, settings, rows, states = flown
    newest = taken(model, settings, states[22], rows[22])
    gaussian = newest.gaussian._replace(mean=newest.gaussian.mean + 0.01)
    sensed = newest._replace(gaussian=gaussian, drift=DriftWatch(0.5))
    row, brought_in = compiled_kernels().ordinary_row, []
    hold = row._hold_state
    monkeypatch.setattr(row, "_hold_state", lambda state: brought_in.append(state) or hold(state))
    found = taken(model, settings, sensed, rows[23])
    assert not brought_in
    assert bits(found) == bits(taken(model, settings, copied(sensed), rows[23]))
    assert len(brought_in) == 1
    assert bits(found) != bits(states[24])
