"""Claims about protection levels."""

import numpy as np
import pytest
from mixture_models import PRIOR, branches, jacobian

from service.core.estimation.filtering.anchor.carrier_mixture import Mixture, solve_mixture
from service.core.estimation.filtering.anchor.protection import protection_levels_deg

SIGMA_DEG = np.array([0.2, 0.02, 0.03])


def one(mean_deg=(0.0, 0.0, 0.0), sigma_deg=SIGMA_DEG):
    return Mixture(np.ones(1), np.array([mean_deg]), np.diag(np.square(sigma_deg))[None], np.ones((1, 1)))


def test_one_normal_error_has_the_quantile_of_the_normal_distribution():
    # two-sided: 1e-4 lies beyond 3.891 sigma
    np.testing.assert_allclose(protection_levels_deg(one()), 3.8906 * SIGMA_DEG, rtol=1e-3)


def test_an_expected_error_is_added():
    # one-sided now: 1e-4 lies beyond 3.719 sigma
    levels = protection_levels_deg(one((0.0, 0.3, -0.3)))
    np.testing.assert_allclose(levels[1:], 0.3 + 3.719 * SIGMA_DEG[1:], rtol=1e-3)


def test_an_unlikely_combination_counts_once_it_is_likelier_than_the_risk():
    def levels(probability):
        return protection_levels_deg(
            Mixture(
                np.array([1.0 - probability, probability]),
                np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]),
                np.tile(np.diag(np.square(SIGMA_DEG)), (2, 1, 1)),
                np.ones((1, 1)),
            )
        )

    assert levels(1e-5)[1] < 0.09
    assert 0.5 < levels(1e-3)[1] < 0.53
    assert levels(1e-3)[2] == pytest.approx(levels(1e-5)[2], rel=0.01)


def test_errors_of_the_assumed_kind_pass_the_level_as_often_as_it_says():
    """Truth is drawn from the hypotheses themselves; a risk of 2 % is seen in 600 draws."""
    rng = np.random.default_rng(31)
    passed, draws, risk = np.zeros(3), 600, 0.02
    for _ in range(draws):
        known, design = branches(12), jacobian(rng, 12)
        regime = int(rng.random() < 0.2)
        chosen = [rng.choice(5, p=np.exp(known.log_probability[regime, k])) for k in range(12)]
        at = np.arange(12), np.array(chosen)
        truth = rng.normal(0.0, PRIOR)
        residual_db = design @ truth + known.mean_db[at] + np.sqrt(known.variance_db2[at]) * rng.normal(size=12)
        level = protection_levels_deg(solve_mixture(design, residual_db, known, PRIOR), risk)
        passed += np.abs(truth[:3]) > level
    # two standard deviations of a share of 2 % in 600 draws are 1.1 %
    assert (passed / draws < risk + 0.012).all()
    # a level that nothing ever passes says nothing
    assert passed.sum() > 0
