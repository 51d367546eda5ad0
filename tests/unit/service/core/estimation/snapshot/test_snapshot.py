"""Snapshot of the attitude and the bounds of a faulty carrier."""

import numpy as np
import pytest

from service.core.estimation.calibration.geometry_columns import (
    QuadraticResponse,
    exact_response,
    predict_deviation,
    predict_jacobian,
)
from service.core.estimation.observability import crlb_deg, judge_set
from service.core.estimation.snapshot import (
    CarrierUse,
    group_memberships,
    solve_snapshots,
    subset_orders,
)

SEED = 31
ATTITUDE = np.array([0.2, -0.15, 0.1])


def model_of(carriers=16, seed=SEED):
    rng = np.random.default_rng(seed)
    bend = np.diag([-0.05, -2.7, -1.5]) + np.zeros((carriers, 3, 3))
    return exact_response(rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3)), bend)


def solve(model, values, sigma_db=0.05, **options):
    values = np.atleast_2d(values)
    carriers = values.shape[1]
    return solve_snapshots(model, values, np.full(carriers, sigma_db), subset_orders(carriers), **options)


@pytest.mark.parametrize(("carriers", "wrong"), [(16, 6), (8, 2), (32, 14), (5, 0)])
def test_noise_free_values_give_the_attitude_in_spite_of_wrong_carriers(carriers, wrong):
    """As many as floor((N - 4) / 2) steps of 2 to 5 dB, and 1.5 dB on all."""
    model = model_of(carriers)
    values = predict_deviation(ATTITUDE, model) + 1.5
    values[:wrong] -= np.linspace(2.0, 5.0, max(wrong, 1))[:wrong]
    fix = solve(model, values)
    # converged to 1e-10; five carriers amplify rounding
    assert fix.attitude_deg[0] == pytest.approx(ATTITUDE, abs=1e-7)
    assert fix.common_db[0] == pytest.approx(1.5, abs=1e-7)
    assert (fix.use[0] == CarrierUse.EXCLUDED).tolist() == [k < wrong for k in range(carriers)]
    assert fix.carriers_used[0] == carriers - wrong
    assert fix.residual_db[0, :wrong] == pytest.approx(-np.linspace(2.0, 5.0, max(wrong, 1))[:wrong], abs=1e-6)


def test_too_few_carriers_are_no_fix():
    """Four carriers fit four unknowns and check nothing; absent ones are told."""
    model = model_of(6)
    values = predict_deviation(ATTITUDE, model)
    values[:2] = np.nan
    fix = solve(model, values)
    for field in (fix.attitude_deg, fix.covariance_deg2, fix.common_db):
        assert np.isnan(field).all()
    assert (fix.use[0, :2] == CarrierUse.ABSENT).all()
    assert np.isnan(solve(model, np.full(6, np.nan)).attitude_deg).all()


def test_carriers_that_do_not_tell_the_axes_apart_are_no_fix():
    """All alike: nothing but the common level is seen."""
    alike = exact_response(np.ones((8, 3)), np.zeros((8, 3, 3)))
    assert np.isnan(solve(alike, np.zeros(8)).attitude_deg).all()


def test_unknown_models_and_sigmas_make_a_carrier_absent():
    """NaN in the model, a sigma of zero."""
    model = model_of(10)
    model.slope[3, 1] = np.nan
    values = predict_deviation(ATTITUDE, model_of(10))
    sigma = np.full(10, 0.05)
    sigma[5] = 0.0
    fix = solve_snapshots(model, values[None], sigma, subset_orders(10))
    assert np.flatnonzero(fix.use[0] == CarrierUse.ABSENT).tolist() == [3, 5]
    assert fix.attitude_deg[0] == pytest.approx(ATTITUDE, abs=1e-8)
    assert np.isnan(fix.residual_db[0, [3, 5]]).all()


def test_a_moved_transponder_keeps_its_carriers():
    """Six of sixteen moved by 2 dB: a moved group, no carrier excluded."""
    model, labels = model_of(), np.array([4] * 6 + [7] * 5 + [9] * 4 + [-1])
    values = predict_deviation(ATTITUDE, model) - 0.3
    values[:6] -= 2.0
    fix = solve(model, values, group=labels)
    assert fix.group[0] == 4
    assert fix.attitude_deg[0] == pytest.approx(ATTITUDE, abs=1e-8)
    assert np.flatnonzero(fix.use[0] == CarrierUse.GROUP_MOVED).tolist() == list(range(6))
    assert fix.carriers_used[0] == 16
    alone = solve(model, values)
    assert alone.group[0] == -1
    assert (alone.use[0] == CarrierUse.EXCLUDED).sum() == 6
    assert np.trace(fix.covariance_deg2[0]) < np.trace(alone.covariance_deg2[0])


def test_two_single_faults_are_no_group():
    """Faults in different transponders stay faults; small groups are not tried."""
    model, labels = model_of(), np.arange(16) // 4
    values = predict_deviation(ATTITUDE, model)
    values[1] -= 2.0
    values[14] += 1.0
    fix = solve(model, values, group=labels)
    assert fix.group[0] == -1
    assert np.flatnonzero(fix.use[0] == CarrierUse.EXCLUDED).tolist() == [1, 14]
    members, kept = group_memberships(np.array([-1, -1, 3]))
    assert kept.tolist() == [-1]
    assert members.shape == (1, 3)


def test_covariance_is_the_bound_and_sigma_enters_as_stated():
    """Exact coefficients, no fault: the bound of Cramer and Rao of noise and model error."""
    model = model_of()
    values = predict_deviation(ATTITUDE, model)
    fix = solve(model, values, sigma_db=0.04, model_error_db=0.03)
    bound = crlb_deg(predict_jacobian(ATTITUDE, model), np.full(16, 0.05), with_common=True)
    assert np.sqrt(np.diag(fix.covariance_deg2[0])) == pytest.approx(bound, rel=1e-5)  # ridge of 1e-6
    assert fix.sigma_db[0] == pytest.approx(np.full(16, 0.05), rel=1e-12)


def test_calibration_error_enters_the_covariance_its_shared_part_as_shared():
    """A shared error of the common level's shape goes into the level and not into the attitude."""
    exact = model_of()
    factors = np.zeros((16, 9, 1))
    factors[:, 1, 0] = 0.5
    shared = QuadraticResponse(exact.slope, exact.curvature, factors @ np.swapaxes(factors, 1, 2), factors)
    values = predict_deviation(ATTITUDE, exact)
    plain, certain = solve(shared, values), solve(exact, values)
    own = solve(shared._replace(common_root=np.zeros_like(factors)), values)
    assert own.sigma_db[0] == pytest.approx(np.hypot(certain.sigma_db[0], 0.5 * 0.15), rel=1e-6)
    assert np.sqrt(np.diag(plain.covariance_deg2[0])) == pytest.approx(
        np.sqrt(np.diag(certain.covariance_deg2[0])), rel=1e-4
    )
    assert plain.common_sigma_db[0] > 0.07, "dB, 0.5 dB/deg at 0.15 deg"
    assert (np.diag(own.covariance_deg2[0]) > np.diag(certain.covariance_deg2[0]) * 1.5).all()


def test_sigmas_that_are_far_too_small_widen():
    """Noise of twenty times the stated sigma widens the sigmas."""
    model = model_of()
    rng = np.random.default_rng(SEED)
    values = predict_deviation(ATTITUDE, model) + 0.4 * rng.normal(size=(50, 16))
    fix = solve(model, values, sigma_db=0.02, model_error_db=0.0)
    fitting = solve(model, values, sigma_db=0.4, model_error_db=0.0)
    # half of the carriers, fitted, scatter less than all of them: the widening is a fraction of the twenty
    assert np.median(fix.sigma_db) > 2.0 * 0.02
    assert np.median(fitting.sigma_db) == pytest.approx(0.4, rel=1e-9)


def test_a_fault_of_the_size_that_the_plan_states_is_excluded():
    """About nine times of ten."""
    model, rng, rows = model_of(), np.random.default_rng(SEED), 400
    clean = predict_deviation(ATTITUDE, model)
    fault_db = judge_set(predict_jacobian(ATTITUDE, model), np.full(16, 0.05)).undetectable_fault_db
    for carrier in (0, 7):
        values = clean + 0.05 * rng.normal(size=(rows, 16))
        values[:, carrier] += fault_db[carrier]
        share = (solve(model, values, model_error_db=1e-6).use[:, carrier] == CarrierUse.EXCLUDED).mean()
        # nine in ten +- 1.5 %; the weights have partly let go of the carrier already, so it is found more often
        assert share >= 0.85


def test_rows_of_a_batch_are_those_of_single_calls():
    """Sums of a batch are ordered differently, so to rounding."""
    model, rng = model_of(), np.random.default_rng(SEED)
    values = predict_deviation(ATTITUDE, model) + 0.05 * rng.normal(size=(5, 16))
    values[2, :3] = np.nan
    batch = solve(model, values)
    for row in range(5):
        assert batch.attitude_deg[row] == pytest.approx(solve(model, values[row]).attitude_deg[0], abs=1e-8)
