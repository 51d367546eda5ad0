"""Claims about the mixture over the hypotheses of the carriers."""

from itertools import product

import numpy as np
import pytest
from mixture_models import CALM, PRIOR, STORM, branches, jacobian

import service.core.estimation.filtering.anchor.carrier_mixture as module
from service.core.estimation.filtering.anchor.carrier_mixture import DRY, Branches, solve_mixture
from service.core.estimation.filtering.anchor.protection import protection_levels_deg
from service.core.estimation.filtering.rows.row_kernels import compiled_kernels


def by_hand(design, residual_db, hypotheses):
    """Return probabilities (R B^N,) and errors (R B^N, 3) of every combination, by least squares of each."""
    carriers, count = hypotheses.mean_db.shape
    weights, errors = [], []
    for regime, *chosen in product(range(2), *[range(count)] * carriers):
        at = np.arange(carriers), np.array(chosen)
        rest = residual_db - hypotheses.mean_db[at]
        covariance = design @ np.diag(PRIOR**2) @ design.T + np.diag(hypotheses.variance_db2[at])
        prior = hypotheses.regime_log_probability[regime] + hypotheses.log_probability[regime][at].sum()
        likelihood = -0.5 * (np.linalg.slogdet(covariance)[1] + rest @ np.linalg.solve(covariance, rest))
        weights.append(prior + likelihood)
        errors.append((np.diag(PRIOR**2) @ design.T @ np.linalg.solve(covariance, rest))[:3])
    weight = np.exp(np.array(weights) - max(weights))
    return weight / weight.sum(), np.array(errors)


def test_all_combinations_kept_are_those_of_least_squares(monkeypatch):
    monkeypatch.setattr(module, "KEPT", 10_000)
    rng = np.random.default_rng(5)
    design, residual_db = jacobian(rng, 4), np.array([0.1, -0.5, 0.05, -0.9])
    found = solve_mixture(design, residual_db, branches(4), PRIOR)
    probability, error = by_hand(design, residual_db, branches(4))
    assert len(found.probability) == len(probability) == 2 * 5**4
    np.testing.assert_allclose(found.error_deg, probability @ error, atol=1e-12)
    np.testing.assert_allclose(np.sort(found.probability), np.sort(probability), atol=1e-12)


def test_what_is_merged_loses_no_probability_and_hardly_moves_the_answer():
    rng = np.random.default_rng(6)
    design, residual_db = jacobian(rng, 4), np.array([0.1, -0.5, 0.05, -0.9])
    found = solve_mixture(design, residual_db, branches(4), PRIOR)
    probability, error = by_hand(design, residual_db, branches(4))
    assert len(found.probability) == module.KEPT
    assert found.probability.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(found.branch_probability.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(found.error_deg, probability @ error, atol=0.005)


def test_stations_in_rain_do_not_turn_the_spacecraft():
    rng = np.random.default_rng(7)
    design, residual_db = jacobian(rng, 16), rng.normal(0.0, 0.06, 16)
    residual_db[[2, 5, 8, 11, 14]] -= [0.5, 1.2, 0.4, 2.0, 0.8]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    # least squares of all carriers would be wrong by more than that
    plain = np.linalg.lstsq(design, residual_db, rcond=None)[0]
    assert np.abs(plain[1:3]).max() > 0.1
    assert np.abs(found.error_deg[1:]).max() < 0.05
    assert (found.branch_probability[[2, 5, 8, 11, 14], DRY] < 0.1).all()


def test_an_error_of_the_attitude_is_found_through_the_rain():
    rng = np.random.default_rng(8)
    design = jacobian(rng, 16)
    residual_db = design @ [0.0, 0.2, -0.15, 0.1] + rng.normal(0.0, 0.06, 16)
    residual_db[[1, 4, 9]] -= [0.9, 1.5, 0.6]
    found = solve_mixture(design, residual_db, branches(16), PRIOR)
    np.testing.assert_allclose(found.error_deg[1:], [0.2, -0.15], atol=0.06)
    assert (np.abs(found.error_deg[1:] - [0.2, -0.15]) < 4.0 * found.sigma_deg[1:]).all()


def test_a_carrier_without_a_reading_tells_nothing_and_is_told_nothing():
    rng = np.random.default_rng(9)
    design, residual_db = jacobian(rng, 8), rng.normal(0.0, 0.06, 8)
    residual_db[3] = np.nan
    found = solve_mixture(design, residual_db, branches(8), PRIOR)
    kept = np.arange(8) != 3
    seven = branches(8)
    seven = Branches(seven.mean_db[kept], seven.variance_db2[kept], seven.log_probability[:, kept], np.log([0.8, 0.2]))
    np.testing.assert_allclose(
        found.error_deg, solve_mixture(design[kept], residual_db[kept], seven, PRIOR).error_deg, atol=1e-12
    )
    share = found.branch_probability[3, DRY]
    assert CALM[DRY] > share > STORM[DRY]


def test_without_readings_the_error_is_what_it_was_before():
    found = solve_mixture(np.ones((3, 4)), np.full(3, np.nan), branches(3), PRIOR)
    np.testing.assert_allclose(found.sigma_deg, PRIOR[:3])
    np.testing.assert_array_equal(found.error_deg, 0.0)


@pytest.mark.parametrize("carriers", [1, 4, 16])
def test_compiled_the_same_source_gives_the_same_mixture_and_levels(carriers):
    rng, compiled = np.random.default_rng(10), compiled_kernels().anchor
    design, residual_db = jacobian(rng, carriers), rng.normal(0.0, 0.4, carriers)
    plain = solve_mixture(design, residual_db, branches(carriers), PRIOR)
    first, second = (solve_mixture(design, residual_db, branches(carriers), PRIOR, compiled) for _ in range(2))
    for one, other, again in zip(plain, first, second, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)  # products of another library add in another order
        np.testing.assert_array_equal(other, again)
    np.testing.assert_allclose(
        protection_levels_deg(plain), protection_levels_deg(first, kernels=compiled), rtol=0.0, atol=1e-5
    )  # found to 3e-6 deg
