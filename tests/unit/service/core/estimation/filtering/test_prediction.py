"""Prediction over a step of time without a row, and the update by one, against dense algebra."""

import filter_models
import numpy as np
import pytest
from filter_models import reference_states
from filter_rows import step

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    CHAIN,
    DRIFT,
    RAIN,
    FilterSettings,
    Gaussian,
    KnownMotion,
    carrier_states,
    core_size,
    no_motion,
    pattern_change,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.prediction import Innovation, site_level_db, update_state
from service.core.estimation.filtering.row_block import empty_result, empty_trace, nothing_declared

MINUTE_US, HOUR_US = 60_000_000, 3_600_000_000
ZEROS = np.zeros(3)
UNCOUPLED = FilterSettings(coupling_per_h=0.0)


@pytest.fixture
def model():
    return filter_models.carrier_model()


def begun(model, **watch):
    """Return the state at an alignment, with some findings of the watches."""
    return start(model, 0, filter_models.aligned(model)).with_watch(**watch)


def predicted(model, state, step_us, known=None, settings=None, declared=None):
    return filter_models.coasted(filter_model(model, settings), state, step_us, known, declared)


def variances(model, state, step_us):
    return np.diagonal(predicted(model, state, step_us).covariance)


def test_commanded_corrections_move_the_attitude_and_cost_their_scale(model):
    chunk = KnownMotion(np.array([0.0, 0.01, 0.0]), ZEROS, ZEROS)
    moved = still = begun(model)
    for _ in range(30):  # half an hour of one command: 0.3 deg in all
        moved = predicted(model, moved, MINUTE_US, chunk, UNCOUPLED)
        still = predicted(model, still, MINUTE_US, None, UNCOUPLED)
    np.testing.assert_allclose(moved.mean[ATTITUDE], [0.0, 0.3, 0.0], rtol=0.0, atol=1e-12)
    added = moved.covariance[1, 1] - still.covariance[1, 1]
    np.testing.assert_allclose(np.sqrt(added), 0.05 * 0.3, rtol=1e-6)  # five percent of the whole command


def test_a_late_correction_raises_sigma_by_its_size(model):
    late = KnownMotion(ZEROS, np.array([0.2, 0.0, 0.0]), ZEROS)
    state, still = (predicted(model, begun(model), MINUTE_US, known) for known in (late, None))
    np.testing.assert_allclose(state.mean[0], 0.2, atol=1e-12)
    np.testing.assert_allclose(state.covariance[0, 0] - still.covariance[0, 0], 0.04, rtol=1e-9)


def test_rain_walks_widely_only_in_rain_mode():
    model = filter_models.carrier_model(common=1)
    dry, wet = (variances(model, begun(model, is_raining=is_raining), MINUTE_US) for is_raining in (False, True))
    np.testing.assert_allclose(np.sqrt(wet[RAIN]), 0.25, rtol=1e-4)
    assert np.sqrt(dry[RAIN]) < 0.005
    assert dry[CHAIN] == wet[CHAIN]


def test_stationary_parts_stay_stationary_and_scale_with_what_was_learned():
    model = filter_models.carrier_model(common=2)
    positions = carrier_states(model, np.arange(model.carriers))
    for step_us in (1_000_000, MINUTE_US, 6 * HOUR_US):
        after = variances(model, begun(model), step_us)
        np.testing.assert_allclose(after[positions[0]], 0.07**2, rtol=1e-9)
        np.testing.assert_allclose(after[11:13], 0.05**2, rtol=1e-9)
        louder = variances(model, begun(model, slow_scale=2.0), step_us)
        assert (louder[positions[0]] > after[positions[0]]).all()


def test_the_calibrations_error_grows_with_the_attitude_at_once(model):
    turned = begun(model)
    turned.mean[1] = 0.4
    positions = carrier_states(model, np.arange(model.carriers))
    state = predicted(model, turned, MINUTE_US, None, UNCOUPLED)
    variance, own = state.carriers["model_variance_db2"], np.diagonal(state.covariance)
    assert (variance > 0.0).all()
    np.testing.assert_allclose(own[positions[1]] - 0.03**2, variance, rtol=1e-9)
    again = predicted(model, state, MINUTE_US, None, UNCOUPLED)
    np.testing.assert_allclose(np.diagonal(again.covariance)[positions[1]], own[positions[1]], rtol=1e-9)


def test_suspected_motion_is_followed_with_a_wide_drift(model):
    calm = variances(model, begun(model), HOUR_US)
    wide = variances(model, begun(model, followed_minutes=(0.0, 30.0, 0.0)), HOUR_US)
    np.testing.assert_allclose(wide[1] - calm[1], 0.15**2, rtol=1e-9)
    assert wide[2] == calm[2]
    assert (wide[DRIFT] == calm[DRIFT]).all()


def declared_covariance(model, step_us, **changes):
    """Return the covariance after a step with a declaration minus the one without."""
    declared = nothing_declared(model.carriers, int(model.transponder.max()) + 1)._replace(**changes)
    with_it, without = (predicted(model, begun(model), step_us, declared=each) for each in (declared, None))
    return with_it.covariance - without.covariance


def test_declared_walks_add_variance_by_the_hour(model):
    walk_db = np.linspace(0.0, 0.3, 12)
    walks_deg = np.array([0.3, 0.0, 0.2])
    more = declared_covariance(
        model, 2 * HOUR_US, attitude_walk_deg=walks_deg, chain_walk_db=0.1, reference_walk_db=walk_db
    )
    expected = np.zeros(len(more))
    expected[[0, 2, CHAIN]] = [0.18, 0.08, 0.02]
    expected[reference_states(model, np.arange(12))] = 2.0 * walk_db**2
    np.testing.assert_allclose(more, np.diag(expected), rtol=0.0, atol=1e-15)  # rounding of sums below one


@pytest.mark.parametrize("step_us", [1_000_000, 6 * HOUR_US])
def test_declared_steps_do_not_grow_with_the_step(model, step_us):
    steps_db, steps_deg = np.linspace(0.0, 0.6, 12), np.array([0.0, 0.05, 0.02])
    more = declared_covariance(
        model, step_us, attitude_step_deg=steps_deg, chain_step_db=0.4, reference_step_db=steps_db
    )
    expected = np.zeros(len(more))
    expected[[1, 2, CHAIN]] = [0.0025, 0.0004, 0.16]
    expected[reference_states(model, np.arange(12))] = steps_db**2
    np.testing.assert_allclose(more, np.diag(expected), rtol=0.0, atol=1e-15)  # rounding of sums below one


def test_a_declared_step_of_a_transponder_moves_its_references_together(model):
    groups = np.zeros(int(model.transponder.max()) + 1)
    groups[1] = 0.5
    more = declared_covariance(model, MINUTE_US, group_step_db=groups)
    members = reference_states(model, np.flatnonzero(model.transponder == 1))
    expected = np.zeros_like(more)
    expected[np.ix_(members, members)] = 0.25
    assert len(members) > 1
    np.testing.assert_allclose(more, expected, rtol=0.0, atol=1e-15)  # rounding of sums below one


def walked(model, rows=30):
    """Return a state with correlations of every kind."""
    rng, state = np.random.default_rng(8), begun(model)
    for _ in range(rows):
        row_db = 0.2 * rng.standard_normal(model.carriers)
        state = step(filter_model(model), state, state.epoch_us + MINUTE_US, row_db, no_motion()).state
        state = state.with_watch(is_raining=True)
    return state


def dense_jacobian(model, mean, carriers):
    matrix = np.zeros((len(carriers), len(mean)))
    matrix[:, ATTITUDE] = pattern_change(model, mean[ATTITUDE]).gradient_db_deg[carriers]
    matrix[:, CHAIN : core_size(model)] = 1.0
    matrix[:, RAIN] = -model.rain_share[carriers]
    for number, positions in enumerate(carrier_states(model, carriers).T):
        matrix[number, positions] = 1.0
    return matrix


def expected_db(model, mean):
    """Return the levels that a state makes: those from which nothing is left over."""
    state, nothing = Gaussian(mean, np.eye(len(mean))), np.zeros(model.carriers)
    return -filter_models.innovated(filter_model(model), state, nothing).innovation_db


def test_the_blocks_make_the_update_of_the_textbook():
    model = filter_models.carrier_model(common=1)
    compiled, state = filter_model(model), walked(model)
    carriers = np.array([0, 2, 3, 7, 11])
    row = 0.1 * np.random.default_rng(2).standard_normal(model.carriers) + expected_db(model, state.mean)
    innovation = filter_models.innovated(compiled, state.gaussian, row, carriers)
    jacobian = dense_jacobian(model, state.mean, carriers)
    white = np.diag(model.white_sigma_db[carriers] ** 2)
    spread = jacobian @ state.covariance @ jacobian.T + white
    gain = state.covariance @ jacobian.T @ np.linalg.inv(spread)
    kept = np.eye(len(state.mean)) - gain @ jacobian
    found = filter_models.updated(compiled, state, row, innovation)
    covariance = kept @ state.covariance @ kept.T + gain @ white @ gain.T
    # products of some hundred terms near one
    np.testing.assert_allclose(innovation.predicted_db2 + white, spread, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(found.state.covariance, covariance, rtol=1e-8, atol=1e-13)
    np.testing.assert_allclose(found.state.mean, state.mean + gain @ innovation.innovation_db, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.nis, innovation.innovation_db @ np.linalg.solve(spread, innovation.innovation_db))
    shift = (gain @ innovation.innovation_db)[ATTITUDE] / np.sqrt(np.diagonal(gain @ spread @ gain.T)[ATTITUDE])
    np.testing.assert_allclose(found.shift, shift, rtol=1e-9)


def test_expected_levels_are_the_sum_of_all_parts():
    model = filter_models.carrier_model(common=1)
    compiled, mean = filter_model(model), np.zeros(len(filter_models.aligned(model).mean))
    mean[[CHAIN, RAIN, 11]] = 0.5, 2.0, 0.25
    np.testing.assert_allclose(site_level_db(compiled, mean), 0.75 - 2.0 * model.rain_share)
    mean[ATTITUDE] = 0.3, -0.2, 0.1
    turned_db = pattern_change(model, mean[ATTITUDE]).deviation_db
    np.testing.assert_allclose(site_level_db(compiled, mean), 0.75 - 2.0 * model.rain_share + turned_db)
    mean[carrier_states(model, np.array([3]))[:, 0]] = 1.0
    alone = expected_db(model, mean)[[2, 3]] - site_level_db(compiled, mean)[[2, 3]]
    np.testing.assert_allclose(alone, [0.0, 3.0], atol=1e-12)


def test_a_large_jump_is_linearised_where_it_leads():
    model = filter_models.carrier_model(carriers=24)
    compiled, state = filter_model(model), begun(model)
    state.covariance[ATTITUDE, ATTITUDE] += 0.3**2 * np.eye(3)
    truth = np.array([0.3, -0.4, 0.35])
    row = pattern_change(model, truth).deviation_db
    innovation = filter_models.innovated(compiled, state.gaussian, row)
    spread = innovation.predicted_db2 + np.diag(innovation.white_db2)
    once = (np.linalg.solve(spread, innovation.cross).T @ innovation.innovation_db)[ATTITUDE]
    found = filter_models.updated(compiled, state, row, innovation).state
    error = found.mean[ATTITUDE] - truth
    # noise-free levels; what remains is the pull of the prior, well inside the sigma that is told
    assert (np.abs(error) < found.gaussian.attitude_sigma_deg).all()
    assert np.abs(error[1:]).max() < 0.03
    assert np.abs(once - truth)[1:].max() > np.abs(error[1:]).max()


def test_rain_never_falls_below_zero(model):
    compiled, state = filter_model(model), walked(model)
    row = expected_db(model, state.mean) + 1.0
    found = filter_models.updated(compiled, state, row, filter_models.innovated(compiled, state.gaussian, row))
    assert found.state.mean[RAIN] == 0.0


def test_passes_of_linearisation_are_limited():
    model = filter_models.carrier_model(carriers=24)
    compiled, lost = filter_model(model), begun(model)
    lost.covariance[ATTITUDE, ATTITUDE] += 4.0 * np.eye(3)
    row = 20.0 * (-1.0) ** np.arange(24)  # no attitude makes these
    found = filter_models.updated(compiled, lost, row, filter_models.innovated(compiled, lost.gaussian, row)).state
    assert np.isfinite(found.mean).all()
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_a_precise_row_on_free_references_leaves_a_positive_covariance():
    model = filter_models.carrier_model()._replace(white_sigma_db=np.full(12, 1e-4))
    compiled, state = filter_model(model), begun(model)
    state.covariance[-12:, -12:] += 9.0 * (np.eye(12) + 1.0)
    for _ in range(50):
        innovation = filter_models.innovated(compiled, state.gaussian, np.zeros(12))
        state = filter_models.updated(compiled, state, np.zeros(12), innovation).state
    assert (np.diagonal(state.covariance) > 0.0).all()
    scale = np.sqrt(np.diagonal(state.covariance))
    # nothing is added between the rows, which operation never does
    assert np.linalg.eigvalsh(state.covariance / np.outer(scale, scale)).min() > -1e-12


def test_innovations_without_a_covariance_change_nothing(model):
    compiled, state = filter_model(model), begun(model)
    after, found, row_db = filter_models.copied(state), empty_result(1, 12).rows[0], np.full(12, 0.1)
    good = filter_models.innovated(compiled, state.gaussian, row_db, np.array([0, 1]))
    bad = Innovation(*good[:2], np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros(2), *good[4:])
    is_done, _ = update_state(compiled, after, row_db, bad, np.zeros(3), found, empty_trace(0, 0, 0))
    assert not is_done
    assert filter_models.bits(after) == filter_models.bits(state)
