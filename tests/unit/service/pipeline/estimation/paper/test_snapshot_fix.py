"""Snapshot fix: exact on an exact payload, honest about who took part and about its sigma."""

from dataclasses import replace

import numpy as np
import pytest

from service.core.estimation.paper.octants import predict_deviation_db
from service.pipeline.config import EstimationConfig
from service.pipeline.estimation.paper.snapshot_fix import sensitivity_model, solve_attitude
from service.records.levels.attitude import Axes, Exclusion
from service.records.noise import NoiseComponent

ANGLES = np.array([0.2, -0.15, 0.1])
CONFIG = EstimationConfig()


@pytest.fixture
def model(payload):
    """The payload's true model."""
    return sensitivity_model(payload.calibration())


@pytest.fixture
def deviation(payload):
    """Deviations at the angles of this file."""
    return predict_deviation_db(payload.plus, payload.minus, ANGLES)


def solve(model, deviation_db, rows=15, span_s=840.0):
    return solve_attitude(5, deviation_db, rows, span_s, model, CONFIG)


def test_the_model_holds_the_figures_of_the_calibration(payload, model):
    np.testing.assert_array_equal(model.plus_db_per_deg, payload.plus)
    np.testing.assert_array_equal(model.minus_db_per_deg, payload.minus)
    assert model.carrier_ids == payload.ids
    assert model.is_selected.all()
    # carriers without a coloured part have a zero there, not a hole
    np.testing.assert_array_equal(model.sigma_coloured_db[:, 0], np.tile([0.0, 0.02], 6))
    np.testing.assert_array_equal(model.correlation_time_s[:, 0], np.tile([0.0, 1200.0], 6))


def test_an_unfinished_calibration_is_an_empty_model(payload):
    empty = sensitivity_model(replace(payload.calibration(), result=None))
    assert empty.plus_db_per_deg.shape == (0, 3)
    assert solve(empty, np.zeros(0)).carriers_used == 0


def test_an_exact_deviation_gives_the_exact_attitude(model, deviation):
    fix = solve(model, deviation)
    np.testing.assert_allclose(fix.attitude_deg, ANGLES, atol=1e-9)  # rounding of a condition of about 30
    assert (fix.epoch_us, fix.carriers_used, fix.excluded) == (5, 12, ())
    np.testing.assert_allclose(fix.residual_db, 0.0, atol=1e-9)


def test_a_carrier_in_uplink_rain_is_left_out_with_its_reason(model, deviation):
    deviation[3] -= 4.0
    fix = solve(model, deviation)
    np.testing.assert_allclose(fix.attitude_deg, ANGLES, atol=1e-9)
    assert (fix.carriers_used, fix.excluded) == (11, (Exclusion("c03", "uplink_fade"),))
    assert fix.residual_db[3] == pytest.approx(-4.0, abs=1e-9)


def test_unselected_carriers_neither_enter_nor_count_as_excluded(payload, deviation):
    calibration = payload.calibration()
    carriers = (replace(calibration.result.carriers[0], selected=False), *calibration.result.carriers[1:])
    model = sensitivity_model(replace(calibration, result=replace(calibration.result, carriers=carriers)))
    deviation[0] += 50.0
    fix = solve(model, deviation)
    np.testing.assert_allclose(fix.attitude_deg, ANGLES, atol=1e-9)
    assert (fix.carriers_used, fix.excluded) == (11, ())


def test_absent_levels_and_coefficients_are_not_counted_as_used(payload, deviation):
    calibration = payload.calibration()
    holed = replace(calibration.result.carriers[1], sensitivity_minus_db_per_deg=Axes(float("nan"), 1.0, 1.0))
    carriers = (calibration.result.carriers[0], holed, *calibration.result.carriers[2:])
    model = sensitivity_model(replace(calibration, result=replace(calibration.result, carriers=carriers)))
    deviation[0] = np.nan
    fix = solve(model, deviation)
    assert fix.carriers_used == 10
    assert fix.excluded == (Exclusion("c00", "absent"), Exclusion("c01", "absent"))


@pytest.mark.parametrize("present", [0, 3])
def test_too_few_carriers_give_no_fix_and_no_exception(model, deviation, present):
    deviation[present:] = np.nan
    fix = solve(model, deviation)
    assert np.isnan(fix.attitude_deg).all()
    assert np.isnan(fix.covariance_deg2).all()
    assert fix.carriers_used == present
    assert len(fix.excluded) == 12 - present


def test_the_sigma_is_never_better_than_the_learned_noise_allows(payload, model, deviation):
    """Residuals that agree by chance do not shrink it: then the learned noise of the mean holds."""
    rng = np.random.default_rng(11)
    fix = solve(model, deviation + 1e-4 * rng.normal(size=12))
    slopes = np.where(ANGLES >= 0.0, payload.plus, payload.minus)
    identified = np.sqrt(np.mean(fix.sigma_db**2) * np.diag(np.linalg.inv(slopes.T @ slopes)))
    np.testing.assert_allclose(np.sqrt(np.diag(fix.covariance_deg2)), identified, rtol=1e-9)  # the same products
    rough = solve(model, deviation + 0.3 * rng.normal(size=12))
    assert (np.diag(rough.covariance_deg2) > 4.0 * np.diag(fix.covariance_deg2)).all()


def test_a_sigma_that_is_not_known_does_not_hide_those_that_are(model, deviation):
    rng = np.random.default_rng(12)
    noisy = deviation + 1e-4 * rng.normal(size=12)
    holed = replace(model, sigma_white_db=np.where(np.arange(12) == 4, np.nan, model.sigma_white_db))
    whole = np.diag(solve(model, noisy).covariance_deg2)
    # one of twelve like carriers less in the mean of the learned variances: at most 12 % either way
    np.testing.assert_allclose(np.diag(solve(holed, noisy).covariance_deg2), whole, rtol=0.12)
    unknown = replace(model, sigma_white_db=np.full(12, np.nan))
    assert (np.diag(solve(unknown, noisy).covariance_deg2) < 0.01 * whole).all()


def test_perfect_agreement_is_no_division_by_zero(model):
    fix = solve(model, np.zeros(12))
    np.testing.assert_array_equal(fix.attitude_deg, 0.0)
    assert np.isfinite(fix.covariance_deg2).all()


def test_all_coloured_parts_of_a_carrier_count(payload, deviation):
    calibration = payload.calibration(noise=(NoiseComponent(300.0, 0.06), NoiseComponent(7200.0, 0.08)))
    model = sensitivity_model(calibration)
    assert model.sigma_coloured_db.shape == (12, 2)
    fix = solve(model, deviation)
    # a mean of 14 minutes keeps nearly all of the slow part and half of the fast one
    assert (fix.sigma_db > 0.08).all()
    assert (fix.sigma_db < np.sqrt(0.05**2 / 15 + 0.06**2 + 0.08**2)).all()
