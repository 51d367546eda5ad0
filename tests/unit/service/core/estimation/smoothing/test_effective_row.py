"""Effective rows of the filter: not a bit of it changes, and the way back is that of the dense recursion."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion
from service.core.estimation.filtering.model.filter_state import ATTITUDE, FREE_REFERENCE_DB2
from service.core.estimation.filtering.rows.row_kernels import ARRAYS
from service.core.estimation.smoothing.effective_row import (
    effective_row,
    restarted_states,
    smoothed_rows,
    state_origin,
)
from service.core.estimation.smoothing.row_capture import StepCapture

MINUTE_US, CARRIERS, ROWS = 60_000_000, 8, 60
SETTINGS = FilterSettings()


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


def taken(model, changes_db, seed=1):
    """Return states, results and effective rows of a still spacecraft, each row with a change (N,) of its levels."""
    rng = np.random.default_rng(seed)
    capture = StepCapture(ARRAYS)
    states, rows = [start(model, 0, filter_models.aligned(model))], []
    for change_db in changes_db:
        level_db = change_db + model.white_sigma_db * rng.standard_normal(CARRIERS)
        before = states[-1]
        epoch_us = before.epoch_us + MINUTE_US
        found = step(model, SETTINGS, before, epoch_us, level_db, no_motion(), kernels=capture.kernels)
        plain = step(model, SETTINGS, before, epoch_us, level_db, no_motion())
        np.testing.assert_array_equal(found.state.gaussian.covariance, plain.state.gaussian.covariance)
        np.testing.assert_array_equal(found.state.gaussian.mean, plain.state.gaussian.mean)
        rows.append(effective_row(model, SETTINGS, before, found, capture.newest, np.arange(len(before.gaussian.mean))))
        states.append(found.state)
    return states[1:], rows


def dense(transition):
    matrix = np.diag(transition.factor)
    matrix[transition.targets] = 0.0
    matrix[np.ix_(transition.targets, transition.sources)] = transition.shares
    return matrix


def recursion(model, states, rows):
    """Return the smoothed attitude by Rauch, Tung and Striebel, which inverts the predicted covariance."""
    mean, covariance = states[-1].gaussian
    found = [(mean[ATTITUDE], covariance[ATTITUDE, ATTITUDE])]
    for number in range(len(states) - 2, -1, -1):
        own, later = states[number].gaussian, rows[number + 1]
        matrix = dense(later.step)
        # what came after the step is an update: the predicted state follows from it
        whitened = later.update
        reduced = states[number + 1].gaussian.covariance + whitened.cross.T @ whitened.cross
        predicted = matrix @ own.mean
        gain = np.linalg.solve(reduced, matrix @ own.covariance).T
        mean = own.mean + gain @ (mean - predicted)
        covariance = own.covariance + gain @ (covariance - reduced) @ gain.T
        found.append((mean[ATTITUDE], covariance[ATTITUDE, ATTITUDE]))
    return found


def test_the_way_back_is_that_of_the_dense_recursion(model):
    states, rows = taken(model, np.zeros((ROWS, CARRIERS)))
    assert any(row.rain_push > 0.0 for row in rows), "no row raises rain to its border"
    pairs = zip(smoothed_rows(rows), recursion(model, states, rows), strict=True)
    for own, (mean, covariance) in pairs:
        np.testing.assert_allclose(own.mean[ATTITUDE], mean, atol=1e-8)
        np.testing.assert_allclose(own.covariance[ATTITUDE, ATTITUDE], covariance, atol=1e-8)


def test_later_rows_make_every_sigma_smaller_and_the_newest_row_is_the_filter(model):
    states, rows = taken(model, np.zeros((ROWS, CARRIERS)))
    newest, *older = smoothed_rows(rows)
    np.testing.assert_array_equal(newest.mean[ATTITUDE], states[-1].gaussian.mean[ATTITUDE])
    for own, state in zip(older, states[-2::-1], strict=True):
        assert (np.diag(own.covariance)[ATTITUDE] < np.diag(state.gaussian.covariance)[ATTITUDE]).all()


def test_a_carrier_whose_level_steps_is_an_edge_and_the_attitude_goes_on(model):
    changes_db = np.zeros((ROWS, CARRIERS))
    changes_db[30:, 2] = 3.0
    states, rows = taken(model, changes_db)
    flagged = next(k for k, state in enumerate(states) if state.carriers.is_flagged[2])
    assert len(rows[flagged - 1].restarted) == 0
    assert len(rows[flagged].restarted) == model.components + 1
    smoothed = list(smoothed_rows(rows))[::-1]
    sigma = np.array([np.sqrt(np.diag(each.covariance)[1]) for each in smoothed])
    assert sigma[flagged - 5] < np.sqrt(states[flagged - 5].gaussian.covariance[1, 1])
    # skipped rows and the restart leave no trace in the angles
    error_deg = np.abs([each.mean[ATTITUDE] for each in smoothed])
    assert (error_deg <= 4.0 * np.array([np.sqrt(np.diag(each.covariance))[ATTITUDE] for each in smoothed])).all()


def test_a_row_without_carriers_is_a_step_alone(model):
    changes_db = np.zeros((ROWS, CARRIERS))
    changes_db[20:30] = np.nan
    _, rows = taken(model, changes_db)
    assert [row.update is None for row in rows] == [20 <= k < 30 for k in range(ROWS)]
    sigma = [np.sqrt(each.covariance[1, 1]) for each in smoothed_rows(rows)][::-1]
    assert sigma[25] < np.sqrt(rows[29].covariance[1, 1])


def test_states_without_a_link_to_others_have_just_begun():
    covariance = np.diag([1.0, FREE_REFERENCE_DB2, 0.0, 2.0])
    covariance[0, 3] = covariance[3, 0] = 0.1
    assert restarted_states(covariance).tolist() == [1, 2]


def test_hidden_states_come_and_go(model):
    mean = start(model, 0, filter_models.aligned(model)).gaussian.mean
    core = len(mean) - CARRIERS * (model.components + 1)
    wider = np.insert(mean, core, [0.0, 7.0])
    origin = state_origin(model, mean, wider)
    assert origin[core : core + 2].tolist() == [-1, -1]
    assert np.delete(origin, [core, core + 1]).tolist() == list(range(len(mean)))
    np.testing.assert_array_equal(state_origin(model, wider, mean), np.flatnonzero(origin >= 0))


def test_a_state_that_was_moved_in_between_has_no_past(model):
    mean = start(model, 0, filter_models.aligned(model)).gaussian.mean
    moved = mean.copy()
    moved[0] += 0.1
    assert state_origin(model, mean, moved) is None
