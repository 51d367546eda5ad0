"""Robust daily fits against truth, contamination up to 45 per cent, and what cannot be fitted."""

import math

import numpy as np
import pytest

from service.core.estimation.calibration.daily_fit import fit_daily
from service.core.estimation.calibration.geometry_columns import daily_columns

SEED = 31
ROWS = 1440
PHASE = np.linspace(0.0, 6.0 * np.pi, ROWS, endpoint=False)
TRUTH = np.array([-45.0, 0.3, 0.1, -0.05, 0.08])
SIGMA_DB = 0.15


def powers(carriers=4, seed=SEED, sigma_db=SIGMA_DB):
    columns = daily_columns(None, PHASE, carriers)
    noise = np.random.default_rng(seed).normal(0.0, sigma_db, (ROWS, carriers))
    return columns, TRUTH[0] + columns @ TRUTH[1:] + noise


def test_noise_free_powers_give_the_truth():
    fits = fit_daily(*powers(sigma_db=0.0))
    assert fits.coefficients == pytest.approx(np.tile(TRUTH, (4, 1)), abs=1e-9)  # rounding of 45 dBm
    assert fits.converged.all()


@pytest.mark.parametrize("share", [0.1, 0.2, 0.45])
@pytest.mark.parametrize("size_db", [1.5, 3.0])
def test_blocks_of_wrong_samples_move_it_by_less_than_three_hundredths(share, size_db):
    """Acceptance test 2: block outliers of 3 dB in up to 45 % of the samples: dh, dam <= 0.03."""
    columns, power = powers(8)
    begin, wrong = int(0.2 * ROWS), round(share * ROWS)
    power[begin : begin + wrong] -= size_db
    fits = fit_daily(columns, power)
    error = np.abs(fits.coefficients - TRUTH)
    amplitude = np.hypot(fits.coefficients[:, 1], fits.coefficients[:, 2])
    print(f"seed {SEED}, {share:.0%} of {size_db} dB: {error.max(axis=0)}")
    # the bound of the acceptance test is for the level and amplitude of 1440 samples; 792 good ones are left at worst:
    # five sigma of a coefficient of them is 0.15 sqrt(2 / 792) 5 = 0.038
    assert error[:, 0].max() <= 0.03
    assert np.abs(amplitude - math.hypot(0.3, 0.1)).max() <= 0.038
    assert (fits.samples_rejected >= wrong).all()
    assert (fits.samples_rejected <= wrong + 0.01 * ROWS).all()
    # a spread of 792 samples is good to 2.5 %; four of these
    assert fits.rms_db == pytest.approx(np.full(8, SIGMA_DB), rel=0.1)


def test_the_covariance_is_that_of_the_errors():
    columns, power = powers(100, seed=SEED + 1)
    fits = fit_daily(columns, power)
    errors = fits.coefficients - TRUTH
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(np.diagonal(fits.covariance, axis1=1, axis2=2), axis=0))
    print(f"seed {SEED + 1}: {ratio}")
    # a spread of 100 draws is good to 7 %; four of these
    assert ratio == pytest.approx(np.ones(5), abs=0.28)
    # Tukey's function at 4.685 costs five per cent of variance against least squares on normal noise: of all five
    # coefficients together, 500 draws, good to 6 %
    design = np.column_stack([np.ones(ROWS), columns[:, 0]])
    least = SIGMA_DB**2 * np.diag(np.linalg.inv(design.T @ design))
    assert np.mean(errors**2 / least) < 1.05 * 1.25


def test_what_cannot_be_fitted_is_nan():
    columns, power = powers(3)
    power[:, 0] = np.nan
    power[19:, 1] = np.nan
    columns[:, 2] = np.nan
    fits = fit_daily(columns, power)
    assert np.isnan(fits.coefficients).all()
    assert np.isnan(fits.covariance).all()
    assert fits.samples_used.tolist() == fits.samples_rejected.tolist() == [0, 0, 0]
    assert not fits.converged.any()


def test_no_rows_and_no_carriers():
    assert np.isnan(fit_daily(np.empty((0, 2, 4)), np.empty((0, 2))).coefficients).all()
    assert fit_daily(np.empty((9, 0, 4)), np.empty((9, 0))).coefficients.shape == (0, 5)


def test_a_constant_power_is_fitted_exactly():
    """No scatter at all: the scale is zero and nothing is thrown away for rounding."""
    columns = daily_columns(None, PHASE, 1)
    fits = fit_daily(columns, np.full((ROWS, 1), -40.0))
    assert fits.coefficients[0] == pytest.approx([-40.0, 0.0, 0.0, 0.0, 0.0], abs=1e-12)  # rounding
    assert fits.samples_used[0] == ROWS
