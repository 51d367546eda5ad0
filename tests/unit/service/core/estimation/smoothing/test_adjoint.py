"""Adjoint against a dense solution of the whole span, and what a world that is symmetric in time must give."""

import numpy as np
import pytest

from service.core.estimation.smoothing.adjoint import (
    LinearStep,
    before_resize,
    before_row,
    before_start,
    before_step,
    no_later_rows,
    smoothed_state,
    whitened_row,
)

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
        row = whitened_row(jacobian, values - jacobian @ mean, spread, cross)
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
    print(f"seed {seed}")
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
