"""Boresight of an antenna by the hour: what it follows, what does not move it, and how sure it says it is."""

import numpy as np
import pytest

from service.core.estimation.beams.boresight import boresight_series

SEED = 11
GRADIENT = np.random.default_rng(SEED).normal(0.0, 1.3, (16, 2))
SIGMA_DB = np.full(16, 0.03)
HOURS = 96


def moved(boresight_deg, common_db=0.0):
    """Return deviations (H, N) of a moved antenna without noise."""
    return -boresight_deg @ GRADIENT.T + np.reshape(common_db, (-1, 1))


@pytest.fixture
def noisy():
    """A wave of 0.03 deg, levels that wander together, and noise of 0.03 dB."""
    rng = np.random.default_rng(SEED + 1)
    angle = 2.0 * np.pi * np.arange(HOURS) / 24.0
    truth = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    return truth, moved(truth, rng.normal(0.0, 0.5, HOURS)) + rng.normal(0.0, 0.03, (HOURS, 16))


def test_errors_are_those_that_it_states(noisy):
    truth, residual_db = noisy
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    scaled = (series.boresight_deg - truth) / series.sigma_deg
    print("seed", SEED, "rms over sigma", scaled.std(axis=0), "sigma", series.sigma_deg.mean(axis=0))
    # the sigma of a sigma of 96 hours is seven percent; three of them
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, atol=0.22)
    zero_rms = np.sqrt(np.mean(truth**2, axis=0))
    assert (np.sqrt(np.mean((series.boresight_deg - truth) ** 2, axis=0)) < 0.6 * zero_rms).all(), "zero is as good"


def test_wrong_carriers_and_steps_leave_it(noisy):
    truth, residual_db = noisy
    plain = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    # a user steps, one fades for a day, one leaves the air
    residual_db[40:, 3] += 0.8
    residual_db[20:44, 7] -= 3.0
    residual_db[60:, 9] = np.nan
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    errors = [np.sqrt(np.mean((one.boresight_deg - truth) ** 2, axis=0)) for one in (plain, series)]
    print("seed", SEED, "rms without and with the faults", *errors)
    # three of sixteen carriers less cost a tenth; the least wise answer, all carriers alike, errs by 0.1 deg
    assert (errors[1] < 1.3 * errors[0]).all()
    assert np.abs(series.boresight_deg - truth).max() < 0.04


def test_what_all_carriers_share_is_no_boresight():
    shared = GRADIENT @ [0.0, 0.0] + np.full((30, 1), -4.0)
    series = boresight_series(shared, GRADIENT, SIGMA_DB)
    np.testing.assert_allclose(series.boresight_deg, 0.0, atol=1e-9)
    np.testing.assert_allclose(series.common_db, -4.0)


def test_a_part_of_the_gradient_that_all_share_changes_nothing(noisy):
    _, residual_db = noisy
    plain = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    shifted = boresight_series(residual_db, GRADIENT + np.array([0.7, -0.4]), SIGMA_DB)
    np.testing.assert_allclose(shifted.boresight_deg, plain.boresight_deg, atol=1e-6)


def test_few_carriers_tell_nothing():
    residual_db = moved(np.full((10, 2), 0.02))
    residual_db[5:, 4:] = np.nan
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    assert np.isfinite(series.boresight_deg[:5]).all()
    assert np.isnan(series.boresight_deg[5:]).all()
    assert (series.carriers_used[5:] <= 4).all()


def test_beams_of_one_direction_do_not_determine_it():
    series = boresight_series(np.zeros((4, 16)), np.outer(np.linspace(-1.0, 1.0, 16), [1.0, 0.5]), SIGMA_DB)
    assert np.isnan(series.boresight_deg).all()


def test_levels_that_changed_since_the_calibration_widen_the_constant_part(noisy):
    _, residual_db = noisy
    sure = boresight_series(residual_db, GRADIENT, SIGMA_DB).constant_sigma_deg
    levels_db = np.random.default_rng(SEED + 2).normal(0.0, 0.08, 16)
    unsure = boresight_series(residual_db + levels_db, GRADIENT, SIGMA_DB).constant_sigma_deg
    # 0.08 dB on sixteen carriers of 1.3 dB/deg
    assert (unsure > 2.0 * sure).all()
    np.testing.assert_allclose(unsure, 0.08 / 1.3 / 4.0, rtol=0.6)


def test_nothing_measured():
    series = boresight_series(np.full((3, 16), np.nan), GRADIENT, SIGMA_DB)
    assert np.isnan(series.boresight_deg).all()
    assert series.boresight_deg.shape == (3, 2)
    assert boresight_series(np.zeros((0, 16)), GRADIENT, SIGMA_DB).boresight_deg.shape == (0, 2)
