"""Claims about the measurement update."""

import filter_models
import numpy as np

from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_update import innovate, site_db, update
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion, pattern_change
from service.core.estimation.filtering.model.filter_state import (
    ATTITUDE,
    CHAIN,
    RAIN,
    Gaussian,
    carrier_states,
    core_size,
)


def walked(model, aligned, rows=30):
    """Return a state with correlations of every kind."""
    weather = Weather(True, (False, False, False), 1.0, np.zeros(model.carriers))
    rng, state = np.random.default_rng(8), aligned
    for _ in range(rows):
        state, _ = predict(model, FilterSettings(), state, 60_000_000, no_motion(), weather)
        row = 0.2 * rng.standard_normal(model.carriers)
        row_innovation = innovate(model, state, row, np.arange(model.carriers), model.white_sigma_db**2)
        state = update(model, state, row, row_innovation).state
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
    return -innovate(model, state, nothing, np.arange(model.carriers), model.white_sigma_db**2).innovation_db


def test_the_blocks_make_the_update_of_the_textbook():
    model = filter_models.carrier_model(common=1)
    state = walked(model, filter_models.aligned(model))
    carriers = np.array([0, 2, 3, 7, 11])
    row = 0.1 * np.random.default_rng(2).standard_normal(model.carriers) + expected_db(model, state.mean)
    innovation = innovate(model, state, row, carriers, model.white_sigma_db**2)
    jacobian = dense_jacobian(model, state.mean, carriers)
    white = np.diag(model.white_sigma_db[carriers] ** 2)
    spread = jacobian @ state.covariance @ jacobian.T + white
    gain = state.covariance @ jacobian.T @ np.linalg.inv(spread)
    kept = np.eye(len(state.mean)) - gain @ jacobian
    reported = update(model, state, row, innovation)
    # products of some hundred terms near one
    np.testing.assert_allclose(innovation.covariance_db2, spread, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(
        reported.state.covariance, kept @ state.covariance @ kept.T + gain @ white @ gain.T, rtol=1e-8, atol=1e-13
    )
    np.testing.assert_allclose(reported.state.mean, state.mean + gain @ innovation.innovation_db, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        reported.nis, innovation.innovation_db @ np.linalg.solve(spread, innovation.innovation_db)
    )
    shift = (gain @ innovation.innovation_db)[ATTITUDE] / np.sqrt(np.diagonal(gain @ spread @ gain.T)[ATTITUDE])
    np.testing.assert_allclose(reported.attitude_shift, shift, rtol=1e-9)
    assert reported.degrees == 5


def test_expected_levels_are_the_sum_of_all_parts():
    model = filter_models.carrier_model(common=1)
    mean = np.zeros(len(filter_models.aligned(model).mean))
    mean[[CHAIN, RAIN, 11]] = 0.5, 2.0, 0.25
    np.testing.assert_allclose(site_db(model, mean), 0.75 - 2.0 * model.rain_share)
    mean[carrier_states(model, np.array([3]))[:, 0]] = 1.0
    np.testing.assert_allclose(expected_db(model, mean)[[2, 3]], site_db(model, mean)[[2, 3]] + [0.0, 3.0])


def test_a_large_jump_is_linearised_where_it_leads():
    model = filter_models.carrier_model(carriers=24)
    state = filter_models.aligned(model)
    wide = state.covariance.copy()
    wide[ATTITUDE, ATTITUDE] += 0.3**2 * np.eye(3)
    truth = np.array([0.3, -0.4, 0.35])
    row = pattern_change(model, truth).deviation_db
    jumped = Gaussian(state.mean, wide)
    innovation = innovate(model, jumped, row, np.arange(24), model.white_sigma_db**2)
    once = (np.linalg.solve(innovation.covariance_db2, innovation.cross).T @ innovation.innovation_db)[ATTITUDE]
    reported = update(model, jumped, row, innovation)
    error = reported.state.mean[ATTITUDE] - truth
    # noise-free levels; what remains is the pull of the prior, well inside the sigma that is told
    assert (np.abs(error) < reported.state.attitude_sigma_deg).all()
    assert np.abs(error[1:]).max() < 0.03
    assert np.abs(once - truth)[1:].max() > np.abs(error[1:]).max()


def test_rain_never_falls_below_zero():
    model = filter_models.carrier_model()
    state = walked(model, filter_models.aligned(model))
    row = expected_db(model, state.mean) + 1.0
    reported = update(
        model, state, row, innovate(model, state, row, np.arange(model.carriers), model.white_sigma_db**2)
    )
    assert reported.state.mean[RAIN] == 0.0


def test_passes_of_linearisation_are_limited():
    model = filter_models.carrier_model(carriers=24)
    state = filter_models.aligned(model)
    wide = state.covariance + 0.0
    wide[ATTITUDE, ATTITUDE] += 4.0 * np.eye(3)
    row = 20.0 * (-1.0) ** np.arange(24)  # no attitude makes these
    lost = Gaussian(state.mean, wide)
    reported = update(model, lost, row, innovate(model, lost, row, np.arange(24), model.white_sigma_db**2))
    assert np.isfinite(reported.state.mean).all()
    assert np.linalg.eigvalsh(reported.state.covariance).min() > 0.0
