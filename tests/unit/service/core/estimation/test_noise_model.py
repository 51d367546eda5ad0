"""Noise of a level: the split into white and coloured parts, and what a mean of it is worth."""

import numpy as np
import pytest

from service.core.estimation.noise_model import averaged_sigma_db, split_noise


def noise(seed, rows=4320, white=0.15, coloured=0.1, tau_s=1200.0, step_s=60.0):
    rng = np.random.default_rng(seed)
    keep = np.exp(-step_s / tau_s)
    slow = np.empty(rows)
    slow[0] = coloured * rng.normal()
    for k in range(1, rows):
        slow[k] = keep * slow[k - 1] + coloured * np.sqrt(1.0 - keep**2) * rng.normal()
    return slow + white * rng.normal(size=rows)


@pytest.mark.parametrize("seed", range(4))
def test_three_days_of_white_and_coloured_noise_are_told_apart(seed):
    split = split_noise(noise(seed), 60.0)
    # the docstring's own figures: 10 % on sigmas, times two for the worst of a few seeds; 1.5 on the time, squared
    assert split.sigma_white_db == pytest.approx(0.15, rel=0.1)
    assert split.sigma_coloured_db == pytest.approx(0.10, rel=0.2)
    assert 1200.0 / 2.25 < split.correlation_time_s < 1200.0 * 2.25


def test_the_parts_add_up_to_the_variance_also_with_rows_absent():
    residual = noise(7)
    residual[::5] = np.nan
    split = split_noise(residual, 60.0)
    variance = np.nanmean((residual - np.nanmean(residual)) ** 2)
    # by construction; rounding only
    assert split.sigma_white_db**2 + split.sigma_coloured_db**2 == pytest.approx(variance, rel=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_is_mostly_called_white(seed):
    split = split_noise(noise(seed, coloured=0.0), 60.0)
    # lags correlate by chance with 1.5 %: what is taken for coloured stays below a tenth of the variance
    assert split.sigma_coloured_db**2 < 0.1 * 0.15**2
    assert split.sigma_white_db == pytest.approx(0.15, rel=0.06)


def test_rows_that_do_not_correlate_have_no_coloured_part():
    split = split_noise(noise(1, coloured=0.0), 60.0)
    assert (split.sigma_coloured_db, split.correlation_time_s) == (0.0, 0.0)


def test_a_wander_longer_than_the_lags_counts_as_long():
    # noise-free and slower than twenty rows can show: every lag correlates alike, or better with distance
    residual = np.repeat([0.1, -0.1], 200)
    alternating = residual + np.tile([0.05, -0.05, 0.0, 0.0], 100)
    split = split_noise(alternating, 60.0)
    assert split.sigma_coloured_db == pytest.approx(0.1, rel=0.1)
    assert split.correlation_time_s > 20 * 60.0


def test_a_correlation_that_does_not_decay_gets_the_longest_time():
    # of a wave of 23 rows the last lags correlate better than the first; the trough between is left out
    rows = np.arange(4000)
    split = split_noise(np.cos(2.0 * np.pi * rows / 23.0), 60.0)
    assert split.correlation_time_s == pytest.approx(20 * 60.0 * 10.0)


@pytest.mark.parametrize("present", [0, 1, 59])
def test_too_few_rows_are_no_figure(present):
    residual = np.full(200, np.nan)
    residual[:present] = 0.1
    split = split_noise(residual, 60.0)
    assert np.isnan(split.sigma_white_db)
    assert np.isnan(split.sigma_coloured_db)
    assert split.correlation_time_s == 0.0


def test_rows_so_sparse_that_some_lags_have_no_pair_are_split_all_the_same():
    residual = np.full(400, np.nan)
    residual[::2] = noise(5)[:200]
    split = split_noise(residual, 60.0)
    assert split.sigma_white_db**2 + split.sigma_coloured_db**2 == pytest.approx(np.nanvar(residual), rel=1e-12)


def sigma(white, coloured, tau_s, rows, span_s):
    return averaged_sigma_db(np.array([white]), np.array([coloured]), np.array([tau_s]), rows=rows, span_s=span_s)[0]


def test_a_mean_of_one_row_keeps_everything():
    # sqrt of the sum of squares, rounding only
    assert sigma(0.15, 0.1, 1200.0, 1, 0.0) == pytest.approx(np.hypot(0.15, 0.1), rel=1e-12)


def test_white_noise_falls_with_the_root_of_the_rows_and_rows_below_one_count_as_one():
    assert sigma(0.15, 0.0, 0.0, 15, 840.0) == pytest.approx(0.15 / np.sqrt(15), rel=1e-12)
    assert sigma(0.15, 0.0, 0.0, 0, 0.0) == pytest.approx(0.15, rel=1e-12)


@pytest.mark.parametrize("x", [1e-4, 1e-3, 0.5, 3.0, 40.0])
def test_the_coloured_part_keeps_the_variance_of_a_mean_over_time(x):
    # by brute force: mean of the autocorrelation exp(-|s - t|) over the square [0, x]^2, midpoints
    grid = (np.arange(1500) + 0.5) * x / 1500
    kept = np.exp(-np.abs(grid[:, None] - grid)).mean()
    # midpoint rule on a kink: x / 1500 / 3
    assert sigma(0.0, 1.0, 600.0, 1, 600.0 * x) ** 2 == pytest.approx(kept, rel=1e-3)


def test_the_simulated_mean_has_the_stated_sigma():
    means = np.array([noise(seed, rows=15).mean() for seed in range(600)])
    # 600 means: 2.9 %, four sigma
    assert means.std() == pytest.approx(sigma(0.15, 0.1, 1200.0, 15, 840.0), rel=0.12)


def test_coloured_parts_of_a_carrier_add_up():
    parts, times = np.array([[0.1, 0.2], [0.05, 0.0]]), np.array([[300.0, 7200.0], [1200.0, 0.0]])
    together = averaged_sigma_db(np.array([0.15, 0.15]), parts, times, rows=15, span_s=840.0)
    each = [sigma(0.0, one, tau_s, 15, 840.0) for one, tau_s in zip(parts[0], times[0], strict=True)]
    # sums of squares, rounding only; a part of size and time zero adds nothing
    assert together[0] == pytest.approx(np.sqrt(0.15**2 / 15 + each[0] ** 2 + each[1] ** 2), rel=1e-12)
    assert together[1] == pytest.approx(sigma(0.15, 0.05, 1200.0, 15, 840.0), rel=1e-12)
