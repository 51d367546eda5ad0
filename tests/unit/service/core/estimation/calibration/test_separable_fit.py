"""Block elimination against one dense least squares of everything."""

import numpy as np
import pytest

from service.core.estimation.calibration.separable_fit import fit_separable

SEED = 3


def problem():
    rng = np.random.default_rng(SEED)
    own, shared = rng.normal(size=(4, 30, 3)), rng.normal(size=(4, 30, 2))
    return own, shared, rng.normal(size=(4, 30))


def dense(own, shared, values, own_prior, shared_prior):
    """Coefficients and covariance of the joint system with its prior rows."""
    carriers, rows, size = own.shape
    big = np.zeros((carriers * rows, carriers * size + shared.shape[2]))
    for k in range(carriers):
        big[k * rows : (k + 1) * rows, k * size : (k + 1) * size] = own[k]
        big[k * rows : (k + 1) * rows, carriers * size :] = shared[k]
    prior = np.diag(1.0 / np.append(own_prior.ravel(), np.full(shared.shape[2], shared_prior)))
    full = np.concatenate([big, prior])
    covariance = np.linalg.inv(full.T @ full)
    return covariance @ full.T @ np.append(values.ravel(), np.zeros(len(prior))), covariance


def test_elimination_is_the_dense_solution():
    """Coefficients, covariances and the correlation through the shared ones."""
    own, shared, values = problem()
    prior = np.full((4, 3), 2.0)
    fit = fit_separable(own, shared, values, prior, 0.5)
    solution, covariance = dense(own, shared, values, prior, 0.5)
    # rounding of a well conditioned system of 14 unknowns
    assert fit.own.ravel() == pytest.approx(solution[:12], abs=1e-11)
    assert fit.shared == pytest.approx(solution[12:], abs=1e-11)
    assert fit.shared_covariance == pytest.approx(covariance[12:, 12:], abs=1e-11)
    assert fit.own_covariance[1] == pytest.approx(covariance[3:6, 3:6], abs=1e-11)
    between = fit.gain[0] @ fit.shared_covariance @ fit.gain[2].T
    assert between == pytest.approx(covariance[:3, 6:9], abs=1e-11)


def test_a_prior_of_zero_holds_a_coefficient():
    """The held coefficient is zero without error; the others are those of the smaller problem."""
    own, shared, values = problem()
    prior = np.full((4, 3), 2.0)
    prior[1, 2] = 0.0
    fit = fit_separable(own, shared, values, prior, 0.5)
    own_without = own.copy()
    own_without[1, :, 2] = 0.0
    expected = fit_separable(own_without, shared, values, np.full((4, 3), 2.0), 0.5)
    assert fit.own[1, 2] == 0.0
    assert not fit.own_covariance[1, 2].any()
    assert not fit.gain[1, 2].any()
    assert fit.own == pytest.approx(expected.own, abs=1e-11)  # rounding


def test_what_the_data_do_not_tell_is_the_prior():
    """A column of zeros comes out as zero with the prior's variance."""
    own, shared, values = problem()
    own[0, :, 1] = 0.0
    fit = fit_separable(own, shared, values, np.full((4, 3), 7.0), 0.5)
    assert fit.own[0, 1] == pytest.approx(0.0, abs=1e-12)  # rounding
    assert fit.own_covariance[0, 1, 1] == pytest.approx(49.0, rel=1e-12)
