"""Whitening against the covariance that the rows really have."""

import numpy as np
import pytest

from service.core.estimation.calibration.coloured_rows import ColouredNoise, stretch_variance_db2, whitened_rows

NOISE = ColouredNoise(np.array([0.15, 0.1]), np.array([[0.09, 0.2], [0.0, 0.0]]), np.array([[1200.0, 9e3], [1.0, 1.0]]))
CENTRE_S = np.arange(40) * 600.0
COUNT = np.full((2, 40), 10.0)


def covariance(carrier):
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))[carrier]
    lag = np.abs(CENTRE_S[:, None] - CENTRE_S)
    apart = sum(s**2 * np.exp(-lag / t) for s, t in zip(NOISE.sigma_db[carrier], NOISE.tau_s[carrier], strict=True))
    return np.where(np.eye(40) > 0, np.diag(variance), apart)


def test_variance_of_a_mean_is_that_of_the_closed_form():
    """White part over ten, coloured parts nearly whole."""
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))
    x = 600.0 / np.array([1200.0, 9e3])
    kept = 2.0 * (x - 1.0 + np.exp(-x)) / x**2
    assert variance[0, 0] == pytest.approx(0.15**2 / 10 + kept @ np.array([0.09, 0.2]) ** 2, rel=1e-12)
    assert variance[1, 0] == pytest.approx(0.1**2 / 10, rel=1e-12)


@pytest.mark.parametrize("carrier", [0, 1])
def test_whitened_rows_are_independent(carrier):
    """Whitening the identity gives W with W C W' = 1."""
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))
    rows = np.tile(np.eye(40), (2, 1, 1))
    white = whitened_rows(rows, CENTRE_S, variance, NOISE, np.ones((2, 40)))[carrier]
    assert white @ covariance(carrier) @ white.T == pytest.approx(np.eye(40), abs=1e-10)  # rounding


def test_rows_without_weight_or_samples_vanish_and_leave_the_others_alone():
    """An outlier and an absent stretch are zero; the rest is as if they had never been."""
    count, weight = COUNT.copy(), np.ones((2, 40))
    count[0, 3], weight[0, 7] = 0.0, 0.0
    variance = stretch_variance_db2(NOISE, count, np.full(40, 600.0))
    white = whitened_rows(np.tile(np.eye(40), (2, 1, 1)), CENTRE_S, variance, NOISE, weight)[0]
    left = np.setdiff1d(np.arange(40), [3, 7])
    assert not white[[3, 7]].any()
    part = covariance(0)[np.ix_(left, left)]
    assert white[np.ix_(left, left)] @ part @ white[np.ix_(left, left)].T == pytest.approx(np.eye(38), abs=1e-10)
