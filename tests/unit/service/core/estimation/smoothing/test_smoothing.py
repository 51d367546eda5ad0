"""Smoothed rows: the adjoint, the effective row and rows of the sensors."""

from typing import NamedTuple

import filter_models
import numpy as np
import pytest
from filter_rows import after_records, records_of, step
from wheel_filter import WHEELS, H

from service.core.estimation.effective_row import (
    EffectiveRow,
    LinearStep,
    WhitenedRow,
    before_resize,
    before_row,
    before_start,
    before_step,
    effective_row,
    no_later_rows,
    restarted_states,
    smoothed_rows,
    smoothed_state,
    state_origin,
)
from service.core.estimation.filtering import row_block
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    FREE_REFERENCE_DB2,
    RAIN,
    FilterSettings,
    Gaussian,
    PolarimeterModel,
    no_motion,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.state_changes import with_torque
from service.core.estimation.filtering.wheel_momentum import FREE_N_M_S

STATES, ROWS, SEED = 6, 25, 20261124


def dense(step):
    """Return the matrix (D, D) of a step."""
    matrix = np.diag(step.factor)
    matrix[step.targets] = 0.0
    matrix[np.ix_(step.targets, step.sources)] = step.shares
    return matrix


class Filter:
    """Kalman filter that keeps its rows, and the dense problem of the whole span beside it."""

    def __init__(self, mean, covariance):
        self.states, self.rows, self.steps = [(mean, covariance)], [], []
        # every state is an affine function of the first one and of all noise: mean and square root of the span
        values, vectors = np.linalg.eigh(covariance)
        self.means, self.roots = [mean], [vectors * np.sqrt(np.maximum(values, 0.0))]
        self.measured = []

    def move(self, step, noise_root):
        mean, covariance = self.states[-1]
        matrix = dense(step)
        self.states.append((matrix @ mean, matrix @ covariance @ matrix.T + noise_root @ noise_root.T))
        self.steps.append(step)
        self.means.append(matrix @ self.means[-1])
        self.roots.append(np.hstack([matrix @ self.roots[-1], noise_root]))

    def measure(self, jacobian, white, values):
        mean, covariance = self.states[-1]
        cross = jacobian @ covariance
        spread = cross @ jacobian.T + np.diag(white)
        whiten = np.linalg.inv(np.linalg.cholesky(spread))
        row = WhitenedRow(whiten @ jacobian, whiten @ cross, whiten @ (values - jacobian @ mean))
        self.states[-1] = mean + row.residual @ row.cross, covariance - row.cross.T @ row.cross
        self.rows.append(row)
        self.measured.append((len(self.means) - 1, jacobian, white, values))

    def smoothed(self, count):
        """Return the smoothed first numbers of every state, the first state first."""
        adjoint, found = no_later_rows(STATES), []
        for number in range(len(self.states) - 1, -1, -1):
            mean, covariance = self.states[number]
            found.append(smoothed_state(mean[:count], covariance[:count], adjoint))
            if number:
                adjoint = before_step(before_row(adjoint, self.rows[number - 1]), self.steps[number - 1])
        return found[::-1]

    def batch(self, count):
        """Return the same of the dense problem: one conditional distribution of all noise."""
        size = self.roots[-1].shape[1]
        wide = [np.hstack([root, np.zeros((STATES, size - root.shape[1]))]) for root in self.roots]
        jacobian = np.vstack([h @ wide[k] for k, h, _, _ in self.measured])
        white = np.concatenate([r for _, _, r, _ in self.measured])
        left = np.concatenate([z - h @ self.means[k] for k, h, _, z in self.measured])
        gain = np.linalg.solve(jacobian @ jacobian.T + np.diag(white), jacobian).T
        found = []
        for mean, root in zip(self.means, wide, strict=True):
            covariance = root @ (np.eye(size) - gain @ jacobian) @ root.T
            found.append(((mean + root @ gain @ left)[:count], covariance[:count, :count]))
        return found


def flown(rng, *, singular=False):
    """Make a filter over random rows, some of fewer measurements than others."""
    root = 0.5 * rng.normal(size=(STATES, STATES))
    covariance = root @ root.T + 0.1 * np.eye(STATES)
    if singular:
        # three numbers of one share
        profile = rng.normal(size=(3, 1))
        covariance[3:, :] = covariance[:, 3:] = 0.0
        covariance[3:, 3:] = profile @ profile.T
    made = Filter(rng.normal(size=STATES), covariance)
    for _ in range(ROWS):
        factor = rng.uniform(0.7, 1.0, STATES)
        step = LinearStep(factor, np.array([0, 1]), np.array([0, 1, 3]), rng.normal(size=(2, 3)) * 0.6)
        made.move(step, np.diag(np.where(np.arange(STATES) < 3, rng.uniform(0.05, 0.2, STATES), 0.0)))
        count = int(rng.integers(1, 5))
        made.measure(rng.normal(size=(count, STATES)), rng.uniform(0.05, 0.5, count), rng.normal(size=count))
    return made


@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("seed", range(SEED, SEED + 5))
def test_a_linear_gaussian_case_equals_the_dense_solution(seed, singular):
    made = flown(np.random.default_rng(seed), singular=singular)
    for own, (mean, covariance) in zip(made.smoothed(3), made.batch(3), strict=True):
        np.testing.assert_allclose(own.mean, mean, atol=1e-9)
        np.testing.assert_allclose(own.covariance, covariance, atol=1e-9)


def test_a_world_symmetric_in_time_gives_symmetric_sigma():
    # a stationary state measured alike in every row, seen alike from either end
    step = LinearStep(np.full(STATES, 0.9), np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 0)))
    made = Filter(np.zeros(STATES), np.eye(STATES))
    jacobian = np.random.default_rng(SEED).normal(size=(4, STATES))
    for _ in range(ROWS):
        made.move(step, np.sqrt(1.0 - 0.9**2) * np.eye(STATES))
        made.measure(jacobian, np.full(4, 0.3), np.zeros(4))
    sigma = np.array([np.sqrt(np.diag(each.covariance)) for each in made.smoothed(STATES)[1:]])
    np.testing.assert_allclose(sigma, sigma[::-1], rtol=1e-9)
    assert sigma[ROWS // 2, 0] < sigma[0, 0]


def test_a_state_that_began_again_hears_nothing_of_later_rows():
    made = flown(np.random.default_rng(SEED))
    adjoint = before_row(no_later_rows(STATES), made.rows[-1])
    cut = before_start(adjoint, np.array([1, 4]))
    assert not cut.vector[[1, 4]].any()
    assert not cut.covariance[[1, 4]].any()
    assert not cut.covariance[:, [1, 4]].any()
    kept = [0, 2, 3, 5]
    np.testing.assert_array_equal(cut.covariance[np.ix_(kept, kept)], adjoint.covariance[np.ix_(kept, kept)])


def test_numbers_that_came_or_went_are_left_out():
    made = flown(np.random.default_rng(SEED))
    adjoint = before_row(no_later_rows(STATES), made.rows[-1])
    # number 2 is new, two of the seven before are gone
    before = before_resize(adjoint, np.array([0, 1, -1, 3, 5, 6]), 7)
    assert before.vector.tolist() == [*adjoint.vector[:2], 0.0, adjoint.vector[3], 0.0, *adjoint.vector[4:]]
    np.testing.assert_array_equal(before.covariance[3, [0, 1, 3, 5, 6]], adjoint.covariance[3, [0, 1, 3, 4, 5]])
    assert not before.covariance[[2, 4]].any()


MINUTE_US, CARRIERS, EFFECTIVE_ROWS = 60_000_000, 8, 60
SETTINGS = FilterSettings()


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


def taken(model, changes_db, seed=1):
    """Return states, results and effective rows of a still spacecraft, each row with a change (N,) of its levels."""
    rng, compiled = np.random.default_rng(seed), filter_model(model, SETTINGS)
    states, rows = [start(model, 0, filter_models.aligned(model))], []
    for change_db in changes_db:
        level_db = change_db + model.white_sigma_db * rng.standard_normal(CARRIERS)
        before = states[-1]
        epoch_us = before.epoch_us + MINUTE_US
        found = step(compiled, before, epoch_us, level_db, no_motion())
        plain = step(compiled, before, epoch_us, level_db, no_motion(), is_traced=False)
        assert filter_models.bits(found.state) == filter_models.bits(plain.state)
        rows.append(
            effective_row(model, SETTINGS, before, found.state, found.row, found.trace, np.arange(len(before.mean)))
        )
        states.append(found.state)
    return states[1:], rows


def test_later_rows_make_every_sigma_smaller_and_the_newest_row_is_the_filter(model):
    states, rows = taken(model, np.zeros((EFFECTIVE_ROWS, CARRIERS)))
    newest, *older = smoothed_rows(rows)
    np.testing.assert_array_equal(newest.mean[ATTITUDE], states[-1].mean[ATTITUDE])
    for own, state in zip(older, states[-2::-1], strict=True):
        assert (np.diag(own.covariance)[ATTITUDE] < np.diag(state.covariance)[ATTITUDE]).all()


def test_a_carrier_whose_level_steps_is_an_edge_and_the_attitude_goes_on(model):
    changes_db = np.zeros((EFFECTIVE_ROWS, CARRIERS))
    changes_db[30:, 2] = 3.0
    states, rows = taken(model, changes_db)
    flagged = next(k for k, state in enumerate(states) if state.carriers["is_flagged"][2])
    assert len(rows[flagged - 1].restarted) == 0
    assert len(rows[flagged].restarted) == model.components + 1
    smoothed = list(smoothed_rows(rows))[::-1]
    sigma = np.array([np.sqrt(np.diag(each.covariance)[1]) for each in smoothed])
    assert sigma[flagged - 5] < np.sqrt(states[flagged - 5].covariance[1, 1])
    # skipped rows and the restart leave no trace in the angles
    error_deg = np.abs([each.mean[ATTITUDE] for each in smoothed])
    assert (error_deg <= 4.0 * np.array([np.sqrt(np.diag(each.covariance))[ATTITUDE] for each in smoothed])).all()


def test_a_row_without_carriers_is_a_step_alone(model):
    changes_db = np.zeros((EFFECTIVE_ROWS, CARRIERS))
    changes_db[20:30] = np.nan
    _, rows = taken(model, changes_db)
    assert [row.update is None for row in rows] == [20 <= k < 30 for k in range(EFFECTIVE_ROWS)]
    sigma = [np.sqrt(each.covariance[1, 1]) for each in smoothed_rows(rows)][::-1]
    assert sigma[25] < np.sqrt(rows[29].covariance[1, 1])


def test_states_without_a_link_to_others_have_just_begun():
    covariance = np.diag([1.0, FREE_REFERENCE_DB2, 0.0, 2.0])
    covariance[0, 3] = covariance[3, 0] = 0.1
    assert restarted_states(covariance).tolist() == [1, 2]


def test_hidden_states_come_and_go(model):
    mean = start(model, 0, filter_models.aligned(model)).mean
    core = len(mean) - CARRIERS * (model.components + 1)
    wider = np.insert(mean, core, [0.0, 7.0])
    origin = state_origin(model, mean, wider)
    assert origin[core : core + 2].tolist() == [-1, -1]
    assert np.delete(origin, [core, core + 1]).tolist() == list(range(len(mean)))
    np.testing.assert_array_equal(state_origin(model, wider, mean), np.flatnonzero(origin >= 0))


def test_a_state_that_was_moved_in_between_has_no_past(model):
    mean = start(model, 0, filter_models.aligned(model)).mean
    moved = mean.copy()
    moved[0] += 0.1
    assert state_origin(model, mean, moved) is None


SENSED_CARRIERS, SENSED_ROWS, UNLOADED = 6, 14, 9
SENSED = FilterSettings(momentum=WHEELS, polarimeters=(PolarimeterModel((0.99, -0.09, -0.13)),))


class Taken(NamedTuple):
    """Row with the state before its records, that after each of them, and the state in the end."""

    began: Gaussian
    records: list[Gaussian]
    after: Gaussian
    row: EffectiveRow


@pytest.fixture
def sensed_model():
    return filter_models.carrier_model(carriers=SENSED_CARRIERS)


@pytest.fixture
def sensed_rows(sensed_model):
    """Return rows of a still spacecraft with an unloading of its wheels on the way."""
    rng, compiled = np.random.default_rng(20261126), filter_model(sensed_model, SENSED)
    gaussian = with_torque(sensed_model, filter_models.aligned(sensed_model), SENSED)
    state, taken = start(sensed_model, 0, gaussian, 1), []
    for number in range(SENSED_ROWS):
        at_us, values = state.epoch_us, []
        if number % 3 == 0 and number:
            unloaded = np.array([0.4, 0.0, -0.2]) if number >= UNLOADED else np.zeros(3)
            momentum = H + unloaded + rng.normal(0.0, 0.01, 3)
            told = {"epoch_us": at_us - 20_000_000, "momentum_n_m_s": momentum, "is_unloading": number == UNLOADED}
            values.append({"kind": row_block.WHEELS, **told})
        if number % 2 == 0:
            angle_deg = 0.3 + rng.normal(0.0, 0.05)
            told = {"epoch_us": at_us, "angle_deg": angle_deg, "variance_deg2": 0.05**2, "co_power_dbm": -55.0}
            values.append({"kind": row_block.ANGLE, **told})
        records, to_us = records_of(*values), at_us + MINUTE_US
        moved = [after_records(compiled, state, records[: k + 1], to_us).gaussian for k in range(len(records))]
        level_db = sensed_model.white_sigma_db * rng.standard_normal(SENSED_CARRIERS)
        found = step(compiled, state, to_us, level_db, no_motion(), records=records)
        origin = np.arange(len(gaussian.mean)) if taken else None
        row = effective_row(sensed_model, SENSED, state, found.state, found.row, found.trace, origin)
        taken.append(Taken(state.gaussian, moved, found.state.gaussian, row))
        state = found.state
    assert not state.sensors["jumps"].any()
    assert not state.sensors["is_refused"].any()
    return taken


def square_root(covariance):
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    assert values[0] > -1e-9
    return vectors * np.sqrt(np.maximum(values, 0.0))


class Dense:
    """All noise of a span: each state is an affine function of it, each measurement says something about it."""

    def __init__(self, gaussian):
        self.mean, self.root = gaussian.mean, square_root(gaussian.covariance)
        self.precision, self.vector = [], []

    def grow(self, root):
        self.root = np.hstack([self.root, root])

    def restart(self, positions, mean, sigma):
        self.mean, self.root = self.mean.copy(), self.root.copy()
        self.mean[positions], self.root[positions] = mean, 0.0
        fresh = np.zeros((len(self.mean), len(positions)))
        fresh[positions] = sigma * np.eye(len(positions))
        self.grow(fresh)

    def measure(self, row, gaussian):
        """Take a whitened row, whose noise is what its innovation has beside the state of the filter."""
        noise = np.eye(len(row.residual)) - row.cross @ row.jacobian.T
        jacobian, left = row.jacobian @ self.root, row.residual + row.jacobian @ (gaussian.mean - self.mean)
        solved = np.linalg.solve(noise, np.column_stack([jacobian, left]))
        self.precision.append(jacobian.T @ solved[:, :-1])
        self.vector.append(jacobian.T @ solved[:, -1])

    def answer(self, states):
        """Return the attitude of states, each the mean and root of its time, after everything."""
        size = self.root.shape[1]
        precision, vector = np.eye(size), np.zeros(size)
        for part, right in zip(self.precision, self.vector, strict=True):
            precision[: len(part), : len(part)] += part
            vector[: len(right)] += right
        covariance = np.linalg.inv(precision)
        for mean, root in states:
            wide = np.zeros((3, size))
            wide[:, : root.shape[1]] = root[ATTITUDE]
            yield mean[ATTITUDE] + wide @ covariance @ vector, wide @ covariance @ wide.T


def before_update(gaussian, update):
    """Return the state that a whitened update moved."""
    mean = gaussian.mean - update.residual @ update.cross
    return gaussian._replace(mean=mean, covariance=gaussian.covariance + update.cross.T @ update.cross)


def dense_solution(taken):
    """Return the attitude after each row by the dense solution, and how many states began again."""
    span, states, restarts = Dense(taken[0].began), [], 0
    for began, records, after, row in taken:
        filtered = began
        for moved, record in zip(records, row.sensed, strict=True):
            found = moved if record.update is None else before_update(moved, record.update)
            if len(record.restarted):
                span.restart(record.restarted, found.mean[record.restarted], FREE_N_M_S)
                restarts += 1
            else:
                span.grow(square_root(found.covariance - filtered.covariance))
            if record.update is not None:
                span.measure(record.update, found)
            filtered = moved
        pushed = after._replace(mean=after.mean - after.covariance[:, RAIN] * row.rain_push)
        predicted, matrix = before_update(pushed, row.update), dense(row.step)
        span.mean = predicted.mean + matrix @ (span.mean - filtered.mean)
        span.root = matrix @ span.root
        span.grow(square_root(predicted.covariance - matrix @ filtered.covariance @ matrix.T))
        span.measure(row.update, predicted)
        span.precision.append(np.zeros((1, 1)))
        span.vector.append(row.rain_push * span.root[RAIN])
        states.append((span.mean, span.root))
    return list(span.answer(states)), restarts


def test_a_linear_gaussian_case_with_records_equals_the_dense_solution(sensed_rows):
    rows = [each.row for each in sensed_rows]
    assert any(row.rain_push > 0.0 for row in rows), "no row raises rain to its border"
    updates = [record.update for row in rows for record in row.sensed if record.update is not None]
    assert sorted(len(update.residual) for update in updates) == [1] * 7 + [3] * 4
    found, restarts = dense_solution(sensed_rows)
    assert restarts == 1
    for own, (mean, covariance) in zip(smoothed_rows(rows), found[::-1], strict=True):
        np.testing.assert_allclose(own.mean[ATTITUDE], mean, atol=1e-9)
        np.testing.assert_allclose(own.covariance[ATTITUDE, ATTITUDE], covariance, atol=1e-9)


def test_smoothed_sigma_is_never_above_the_filters(sensed_rows):
    smoothed = list(smoothed_rows([each.row for each in sensed_rows]))[::-1]
    for own, each in zip(smoothed[:-1], sensed_rows, strict=False):
        assert (np.diag(own.covariance) < np.diag(each.after.covariance)[: len(own.mean)]).all()
