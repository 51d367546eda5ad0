"""Claims about the sign-dependent least squares: exact optimum, absent carriers, ties, covariance, speed."""

import itertools

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from service.core.estimation.paper.octants import OCTANT_SIGNS, predict_deviation_db, solve_octants, solve_octants_rows


def random_model(rng, carriers):
    """Sensitivities of the size that the studies found, with curvature common to the carriers as asymmetry."""
    steep = rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3))
    bend = np.abs(rng.normal([0.0, 0.5, 0.28], [0.05, 0.15, 0.1], (carriers, 3)))
    return steep - bend, steep + bend


def brute_force(plus, minus, deviation_db):
    """Bounded least squares of scipy in each octant: the independent oracle."""
    fits = []
    for signs in itertools.product((1.0, -1.0), repeat=3):
        is_up = np.array(signs) > 0.0
        bounds = np.where(is_up, 0.0, -np.inf), np.where(is_up, np.inf, 0.0)
        fit = lsq_linear(np.where(is_up, plus, minus), deviation_db, bounds=bounds, method="bvls", tol=1e-15)
        fits.append((2.0 * fit.cost, fit.x))
    return min(fits, key=lambda pair: pair[0])


@pytest.mark.parametrize("carriers", [4, 5, 8, 16])
@pytest.mark.parametrize("noise_db", [0.0, 0.05, 0.3])
def test_it_equals_bounded_least_squares_of_eight_octants(carriers, noise_db):
    seed = 100 * carriers + round(100 * noise_db)
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for _ in range(12):
        plus, minus = random_model(rng, carriers)
        deviation_db = predict_deviation_db(plus, minus, rng.uniform(-0.5, 0.5, 3))
        deviation_db += noise_db * rng.standard_normal(carriers)
        fix = solve_octants(plus, minus, deviation_db, None)
        cost, attitude_deg = brute_force(plus, minus, deviation_db)
        assert fix.cost <= cost + 1e-12  # rounding of sums of squares of about 1 dB
        if fix.second_best_cost > fix.cost + 1e-9:
            # 1e-6 deg: the oracle itself stops at 1e-15 of the cost, that is 1e-7 in yaw
            np.testing.assert_allclose(fix.attitude_deg, attitude_deg, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("octant", range(8))
def test_each_octant_returns_its_own_truth(octant):
    plus, minus = random_model(np.random.default_rng(octant), 9)
    truth_deg = OCTANT_SIGNS[octant] * [0.2, 0.3, 0.1]
    fix = solve_octants(plus, minus, predict_deviation_db(plus, minus, truth_deg), None)
    np.testing.assert_allclose(fix.attitude_deg, truth_deg, rtol=0.0, atol=1e-11)  # rounding, condition about 100
    assert fix.octant == octant
    assert fix.cost < 1e-20
    assert fix.second_best_cost > 1e-6
    assert fix.carriers_used == 9


def test_the_solution_never_leaves_its_octant():
    rng = np.random.default_rng(17)
    plus, minus = random_model(rng, 6)
    fixes = solve_octants_rows(plus, minus, rng.standard_normal((500, 6)), None)
    assert np.all(fixes.attitude_deg * OCTANT_SIGNS[fixes.octant] >= 0.0)


def test_an_angle_held_at_zero_counts_as_plus_and_ties_the_neighbour():
    # each sign of roll makes the only reacting carrier weaker, but it is measured stronger: roll stays at zero
    plus = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0], [1.0, 0, 1.0], [1.0, 0, -1.0]])
    minus = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0], [1.0, 0, 1.0], [1.0, 0, -1.0]])
    fix = solve_octants(plus, minus, np.array([0.1, -0.2, 0.5, -0.1, 0.3]), None)
    np.testing.assert_allclose(fix.attitude_deg, [0.1, 0.0, -0.2], rtol=0.0, atol=1e-15)  # rounding
    assert fix.octant == 1  # + + -
    assert fix.cost == pytest.approx(0.25, abs=1e-15)
    assert fix.second_best_cost == fix.cost


def test_of_equal_optima_the_first_octant_wins():
    # a carrier that loses power for either sign of roll cannot tell them apart
    plus = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0], [1.0, 0, 1.0]])
    minus = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 1.0]])
    for order in itertools.permutations(range(4)):
        index = list(order)
        deviation_db = np.array([0.1, -0.3, 0.2, 0.3])
        fix = solve_octants(plus[index], minus[index], deviation_db[index], None)
        np.testing.assert_allclose(fix.attitude_deg, [0.1, 0.3, 0.2], rtol=0.0, atol=1e-15)  # rounding
        assert fix.octant == 0
        assert fix.second_best_cost == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("blank", ["deviation", "plus", "minus", "sigma nan", "sigma zero", "sigma negative"])
def test_an_absent_carrier_is_as_if_it_were_not_there(blank):
    rng = np.random.default_rng(23)
    plus, minus = random_model(rng, 9)
    deviation_db, sigma_db = rng.standard_normal(9), rng.uniform(0.05, 0.3, 9)
    expected = solve_octants(plus[1:], minus[1:], deviation_db[1:], sigma_db[1:])
    spoil = {"sigma zero": 0.0, "sigma negative": -1.0}.get(blank, np.nan)
    if blank == "deviation":
        deviation_db[0] = spoil
    elif blank in {"plus", "minus"}:
        {"plus": plus, "minus": minus}[blank][0, 2] = spoil
    else:
        sigma_db[0] = spoil
    fix = solve_octants(plus, minus, deviation_db, sigma_db)
    np.testing.assert_allclose(fix.attitude_deg, expected.attitude_deg, rtol=0.0, atol=1e-12)  # order of sums
    np.testing.assert_allclose(fix.residual_db[1:], expected.residual_db, rtol=0.0, atol=1e-12)  # order of sums
    assert fix.carriers_used == 8
    assert np.isnan(fix.residual_db[0])


def is_absent(fix):
    return (
        np.isnan(fix.attitude_deg).all()
        and np.isnan([fix.cost, fix.second_best_cost]).all()
        and np.isnan(fix.covariance_deg2).all()
        and np.isnan(fix.residual_db).all()
        and fix.octant == -1
    )


def test_three_carriers_are_no_fix():
    plus, minus = random_model(np.random.default_rng(2), 4)
    fix = solve_octants(plus, minus, np.array([0.1, 0.2, np.nan, 0.3]), None)
    assert is_absent(fix)
    assert fix.carriers_used == 3


def test_an_axis_that_no_carrier_feels_is_no_fix():
    plus, minus = random_model(np.random.default_rng(2), 8)
    plus[:, 0] = minus[:, 0] = 0.0
    assert is_absent(solve_octants(plus, minus, np.linspace(-1.0, 1.0, 8), None))


def test_carriers_that_all_feel_one_mixture_are_no_fix():
    mixture = np.outer(np.linspace(0.5, 2.0, 8), [0.2, 1.0, 0.7])
    assert is_absent(solve_octants(mixture, mixture, np.linspace(-1.0, 1.0, 8), None))


def test_each_set_of_carriers_has_its_own_equations():
    rng = np.random.default_rng(32)
    models = [random_model(rng, 8) for _ in range(3)]
    for number in range(90):
        plus, minus = models[number % 3]
        deviation_db = np.where(rng.random(8) < 0.2, np.nan, rng.standard_normal(8))
        equal = solve_octants(plus, minus, deviation_db, None)
        weighted = solve_octants(plus, minus, deviation_db, np.ones(8))
        np.testing.assert_allclose(equal.attitude_deg, weighted.attitude_deg, rtol=0.0, atol=1e-12)  # rounding
        np.testing.assert_allclose(equal.residual_db, weighted.residual_db, rtol=0.0, atol=1e-12)
        assert equal.cost == pytest.approx(weighted.cost, abs=1e-12, nan_ok=True)
        assert equal.second_best_cost == pytest.approx(weighted.second_best_cost, abs=1e-12, nan_ok=True)
        assert (equal.octant, equal.carriers_used) == (weighted.octant, weighted.carriers_used)


def test_rows_of_a_batch_that_cannot_be_solved_do_not_spoil_the_others():
    rng = np.random.default_rng(31)
    plus, minus = random_model(rng, 7)
    deviation_db = rng.standard_normal((3, 7))
    deviation_db[1, :4] = np.nan
    fixes = solve_octants_rows(plus, minus, deviation_db, None)
    assert np.isnan(fixes.attitude_deg[1]).all()
    for row in (0, 2):
        single = solve_octants(plus, minus, deviation_db[row], None)
        np.testing.assert_allclose(fixes.attitude_deg[row], single.attitude_deg, rtol=0.0, atol=1e-12)  # order of sums


def test_weights_follow_the_sigmas():
    rng = np.random.default_rng(41)
    plus, minus = random_model(rng, 10)
    sigma_db = rng.uniform(0.05, 0.5, 10)
    deviation_db = predict_deviation_db(plus, minus, np.array([0.1, -0.2, 0.2])) + sigma_db * rng.standard_normal(10)
    fix = solve_octants(plus, minus, deviation_db, sigma_db)
    cost, attitude_deg = brute_force(plus / sigma_db[:, None], minus / sigma_db[:, None], deviation_db / sigma_db)
    np.testing.assert_allclose(fix.attitude_deg, attitude_deg, rtol=0.0, atol=1e-6)  # accuracy of the oracle
    assert fix.cost == pytest.approx(cost, abs=1e-9)  # accuracy of the oracle, cost about 7


def test_the_covariance_is_that_of_the_octants_linear_model():
    rng = np.random.default_rng(43)
    plus, minus = random_model(rng, 12)
    sigma_db = rng.uniform(0.05, 0.2, 12)
    deviation_db = predict_deviation_db(plus, minus, np.array([0.3, -0.2, 0.2]))
    design = np.where(np.array([True, False, True]), plus, minus) / sigma_db[:, None]
    fix = solve_octants(plus, minus, deviation_db, sigma_db)
    # rounding, condition of the normal matrix about 1e3
    np.testing.assert_allclose(fix.covariance_deg2, np.linalg.inv(design.T @ design), rtol=1e-11, atol=0.0)


def test_without_sigmas_the_residuals_scale_the_covariance():
    rng = np.random.default_rng(47)
    plus, minus = random_model(rng, 16)
    deviation_db = predict_deviation_db(plus, minus, np.array([0.3, -0.2, 0.2])) + 0.05 * rng.standard_normal(16)
    free = solve_octants(plus, minus, deviation_db, None)
    scale_db = np.sqrt(free.cost / 13.0)
    given = solve_octants(plus, minus, deviation_db, np.full(16, scale_db))
    np.testing.assert_allclose(free.covariance_deg2, given.covariance_deg2, rtol=1e-12, atol=0.0)  # rounding


def test_residuals_and_prediction_add_up_to_the_measurement():
    rng = np.random.default_rng(53)
    plus, minus = random_model(rng, 8)
    deviation_db = rng.standard_normal(8)
    fix = solve_octants(plus, minus, deviation_db, None)
    total_db = predict_deviation_db(plus, minus, fix.attitude_deg) + fix.residual_db
    np.testing.assert_allclose(total_db, deviation_db, rtol=0.0, atol=1e-12)  # rounding
    assert fix.cost == pytest.approx(np.sum(fix.residual_db**2), rel=1e-12)  # rounding


def test_inputs_are_left_alone():
    rng = np.random.default_rng(59)
    arrays = [*random_model(rng, 8), rng.standard_normal(8), np.full(8, 0.1)]
    for array in arrays:
        array.setflags(write=False)
    assert solve_octants(*arrays).carriers_used == 8
