"""Consistency of levels with stated angles: chi-square with three degrees of freedom, and what it finds."""

import numpy as np
import pytest
from scipy import stats

from service.core.estimation.paper.consistency import chi_square_tail_3, compare_with_angles

RNG = np.random.default_rng(20260101)
SLOPES = RNG.normal(0.0, [0.16, 1.4, 1.2], (12, 3))
SIGMA = RNG.uniform(0.05, 0.2, 12)


@pytest.mark.parametrize("value", [0.0, 0.3, 2.366, 7.8147, 16.266, 60.0])
def test_the_tail_is_that_of_the_distribution(value):
    # closed form against an independent implementation
    assert chi_square_tail_3(value) == pytest.approx(float(stats.chi2.sf(value, 3)), rel=1e-10)


def test_a_missing_attitude_is_found_with_its_size():
    missing = np.array([0.5, -0.2, 0.3])
    found = compare_with_angles(SLOPES @ missing + 0.7, SLOPES, SIGMA)
    # noise-free and linear: the solution is exact but for rounding
    np.testing.assert_allclose(found.offset_deg, missing, atol=1e-9)
    assert found.probability < 1e-4
    assert found.carriers_tested == 12


def test_a_common_change_is_no_contradiction():
    found = compare_with_angles(np.full(12, -3.0), SLOPES, SIGMA)
    assert found.chi_square == pytest.approx(0.0, abs=1e-9)  # rounding of a square of 60 sigma
    assert found.probability == pytest.approx(1.0, abs=1e-9)


def test_without_a_contradiction_the_probability_is_uniform():
    rng = np.random.default_rng(5)
    found = [compare_with_angles(SIGMA * rng.normal(size=12) + 0.3, SLOPES, SIGMA).probability for _ in range(800)]
    # Kolmogorov-Smirnov of 800 draws: fails at one seed in a thousand
    assert stats.kstest(found, "uniform").pvalue > 1e-3


def test_absent_carriers_do_not_count():
    change = SLOPES @ np.array([0.0, 0.1, 0.0])
    slopes, sigma = SLOPES.copy(), SIGMA.copy()
    change[0], slopes[1, 2], sigma[2], sigma[3] = np.nan, np.nan, 0.0, np.nan
    found = compare_with_angles(change, slopes, sigma)
    assert found.carriers_tested == 8
    np.testing.assert_allclose(found.offset_deg, [0.0, 0.1, 0.0], atol=1e-9)  # rounding


@pytest.mark.parametrize("count", [0, 5])
def test_fewer_than_six_carriers_test_nothing(count):
    found = compare_with_angles(np.full(count, 9.0), SLOPES[:count], SIGMA[:count])
    assert (found.chi_square, found.probability, found.carriers_tested) == (0.0, 1.0, count)
    assert np.isnan(found.offset_deg).all()
