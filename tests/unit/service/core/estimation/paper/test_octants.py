"""Octants of the published method: their global optimum and the fix with its sensitivity."""

import itertools

import numpy as np
import pytest
from paper_rows import solve
from scipy.optimize import lsq_linear, nnls

from service.core.estimation.paper.sensitivity import (
    fit_turn_sensitivity,
    level_knots,
    one_sided_columns,
    symmetric_sensitivity,
)
from service.core.estimation.paper.snapshot import SIGNS, predict_deviation_db, residual_db, solve_octants


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
    (cost, attitude_deg), (second_cost, _) = sorted(fits, key=lambda pair: pair[0])[:2]
    return cost, attitude_deg, second_cost


@pytest.mark.parametrize("carriers", [4, 5, 8, 16])
@pytest.mark.parametrize("noise_db", [0.0, 0.05, 0.3])
def test_it_equals_bounded_least_squares_of_eight_octants(carriers, noise_db):
    seed = 100 * carriers + round(100 * noise_db)
    rng = np.random.default_rng(seed)
    for _ in range(12):
        plus, minus = random_model(rng, carriers)
        deviation_db = predict_deviation_db(plus, minus, rng.uniform(-0.5, 0.5, 3))
        deviation_db += noise_db * rng.standard_normal(carriers)
        fix = solve(plus, minus, deviation_db)
        cost, attitude_deg, second_cost = brute_force(plus, minus, deviation_db)
        assert fix.cost <= cost + 1e-12  # rounding of sums of squares of about 1 dB
        if second_cost > fix.cost + 1e-9:
            # 1e-6 deg: the oracle itself stops at 1e-15 of the cost, that is 1e-7 in yaw
            np.testing.assert_allclose(fix.attitude_deg, attitude_deg, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("octant", range(8))
def test_each_octant_returns_its_own_truth(octant):
    plus, minus = random_model(np.random.default_rng(octant), 9)
    truth_deg = SIGNS[octant] * [0.2, 0.3, 0.1]
    fix = solve(plus, minus, predict_deviation_db(plus, minus, truth_deg))
    np.testing.assert_allclose(fix.attitude_deg, truth_deg, rtol=0.0, atol=1e-11)  # rounding, condition about 100
    assert fix.octant == octant
    assert fix.cost < 1e-20
    assert fix.carriers_used == 9


def test_the_solution_never_leaves_its_octant():
    rng = np.random.default_rng(17)
    plus, minus = random_model(rng, 6)
    for deviation_db in rng.standard_normal((500, 6)):
        fix = solve(plus, minus, deviation_db)
        assert np.all(fix.attitude_deg * SIGNS[fix.octant] >= 0.0)


def test_an_angle_held_at_zero_counts_as_plus():
    # each sign of roll makes the only reacting carrier weaker, but it is measured stronger: roll stays at zero
    plus = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0], [1.0, 0, 1.0], [1.0, 0, -1.0]])
    minus = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0], [1.0, 0, 1.0], [1.0, 0, -1.0]])
    fix = solve(plus, minus, np.array([0.1, -0.2, 0.5, -0.1, 0.3]))
    np.testing.assert_allclose(fix.attitude_deg, [0.1, 0.0, -0.2], rtol=0.0, atol=1e-15)  # rounding
    assert fix.octant == 1  # + + -
    assert fix.cost == pytest.approx(0.25, abs=1e-15)


def test_of_equal_optima_the_first_octant_wins():
    # a carrier that loses power for either sign of roll cannot tell them apart
    plus = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0], [1.0, 0, 1.0]])
    minus = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 1.0]])
    for order in itertools.permutations(range(4)):
        index = list(order)
        deviation_db = np.array([0.1, -0.3, 0.2, 0.3])
        fix = solve(plus[index], minus[index], deviation_db[index])
        np.testing.assert_allclose(fix.attitude_deg, [0.1, 0.3, 0.2], rtol=0.0, atol=1e-15)  # rounding
        assert fix.octant == 0


@pytest.mark.parametrize("blank", ["deviation", "plus", "minus"])
def test_an_absent_carrier_is_as_if_it_were_not_there(blank):
    rng = np.random.default_rng(23)
    plus, minus = random_model(rng, 9)
    deviation_db = rng.standard_normal(9)
    expected = solve(plus[1:], minus[1:], deviation_db[1:])
    {"deviation": deviation_db.reshape(-1, 1), "plus": plus, "minus": minus}[blank][0, -1] = np.nan
    fix = solve(plus, minus, deviation_db)
    np.testing.assert_allclose(fix.attitude_deg, expected.attitude_deg, rtol=0.0, atol=1e-12)  # order of sums
    assert fix.cost == pytest.approx(expected.cost, abs=1e-12)
    assert fix.carriers_used == 8


def is_absent(fix):
    return (
        np.isnan(fix.attitude_deg).all()
        and np.isnan(fix.cost)
        and np.isnan(fix.unit_covariance).all()
        and fix.octant == -1
    )


def test_three_carriers_are_no_fix():
    plus, minus = random_model(np.random.default_rng(2), 4)
    fix = solve(plus, minus, np.array([0.1, 0.2, np.nan, 0.3]))
    assert is_absent(fix)
    assert fix.carriers_used == 3


def test_an_axis_that_no_carrier_feels_is_no_fix():
    plus, minus = random_model(np.random.default_rng(2), 8)
    plus[:, 0] = minus[:, 0] = 0.0
    assert is_absent(solve(plus, minus, np.linspace(-1.0, 1.0, 8)))


def test_carriers_that_all_feel_one_mixture_are_no_fix():
    mixture = np.outer(np.linspace(0.5, 2.0, 8), [0.2, 1.0, 0.7])
    assert is_absent(solve(mixture, mixture, np.linspace(-1.0, 1.0, 8)))


def test_the_covariance_is_that_of_the_octants_linear_model():
    rng = np.random.default_rng(43)
    plus, minus = random_model(rng, 12)
    deviation_db = predict_deviation_db(plus, minus, np.array([0.3, -0.2, 0.2]))
    design = np.where(np.array([True, False, True]), plus, minus)
    fix = solve(plus, minus, deviation_db)
    # rounding, condition of the normal matrix about 1e3
    np.testing.assert_allclose(fix.unit_covariance, np.linalg.inv(design.T @ design), rtol=1e-11, atol=0.0)


def test_residuals_and_prediction_add_up_to_the_measurement():
    rng = np.random.default_rng(53)
    plus, minus = random_model(rng, 8)
    deviation_db = rng.standard_normal(8)
    fix = solve(plus, minus, deviation_db)
    left_db = residual_db(plus, minus, deviation_db, fix.attitude_deg)
    total_db = predict_deviation_db(plus, minus, fix.attitude_deg) + left_db
    np.testing.assert_allclose(total_db, deviation_db, rtol=0.0, atol=1e-12)  # rounding
    assert fix.cost == pytest.approx(np.sum(left_db**2), rel=1e-12)  # rounding


def test_inputs_are_left_alone():
    rng = np.random.default_rng(59)
    arrays = [*random_model(rng, 8), rng.standard_normal(8), np.full(8, True)]
    for array in arrays:
        array.setflags(write=False)
    assert solve_octants(*arrays).carriers_used == 8


#: deg, every hundredth from -0.6 to 0.6.
GRID_DEG = np.arange(-60, 61) / 100.0


def any_model(rng, carriers):
    steep = rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3))
    bend = rng.normal([0.0, 0.5, 0.28], [0.05, 0.3, 0.2], (carriers, 3))
    return steep - bend, steep + bend


def grid_minimum(plus, minus, deviation_db):
    """Return the least cost among all 121^3 points; the cost splits into terms of one and of two angles."""
    # answer[j, k] = what angle j at grid point k adds to the carriers, shape (3, 121, N)
    answer = np.where(GRID_DEG[:, None] >= 0.0, plus.T[:, None, :], minus.T[:, None, :]) * GRID_DEG[:, None]
    single = np.einsum("jkn,jkn->jk", answer, answer) - 2.0 * answer @ deviation_db
    yaw_roll = 2.0 * answer[0] @ answer[1].T + single[0][:, None] + single[1]
    yaw_pitch = 2.0 * answer[0] @ answer[2].T + single[2]
    roll_pitch = 2.0 * answer[1] @ answer[2].T
    least, plane = np.inf, np.empty((121, 121))
    for yaw in range(121):
        np.add(roll_pitch, yaw_pitch[yaw], out=plane)
        least = min(least, float((plane.min(axis=1) + yaw_roll[yaw]).min()))
    return least + deviation_db @ deviation_db


def polished(plus, minus, deviation_db):
    """Return cost and angles of the best of eight non-negative least squares, one an octant, and the second cost."""
    fits = []
    for signs in np.array(list(itertools.product((1.0, -1.0), repeat=3))):
        angles, misfit = nnls(np.where(signs > 0.0, plus, minus) * signs, deviation_db)
        fits.append((misfit**2, signs * angles))
    (cost, attitude_deg), (second_cost, _) = sorted(fits, key=lambda pair: pair[0])[:2]
    return cost, attitude_deg, second_cost


@pytest.mark.parametrize("carriers", [5, 16, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise_db", [0.05, pytest.param(0.0, marks=pytest.mark.slow)])
def test_never_above_the_polished_grid(carriers, noise_db):
    seed = 1000 + 10 * carriers + round(100 * noise_db)
    rng = np.random.default_rng(seed)
    compared = 0
    for _ in range(200):
        plus, minus = any_model(rng, carriers)
        deviation_db = predict_deviation_db(plus, minus, rng.uniform(-0.4, 0.4, 3))
        deviation_db += noise_db * rng.standard_normal(carriers)
        cost, attitude_deg, second_cost = polished(plus, minus, deviation_db)
        fix = solve(plus, minus, deviation_db)
        # the bound asked for; rounding is 1e-15
        assert fix.cost <= min(cost, grid_minimum(plus, minus, deviation_db)) + 1e-9
        if second_cost > fix.cost + 1e-6:
            compared += 1
            # asked for: 1e-4 deg; both are exact, so rounding at a condition of about 1e3 is enough
            np.testing.assert_allclose(fix.attitude_deg, attitude_deg, rtol=0.0, atol=1e-9)
    assert compared > 100


SIZES_DEG = (0.125, 0.25, 0.375, 0.5)


def turn_plan(rows=15, jitter_deg=0.01, seed=0):
    """Return angles (K, 3): +-4 sizes about each axis with rests between, then the eight corners of 0.3 deg."""
    stops = [sign * size * np.eye(3)[axis] for axis in range(3) for size in SIZES_DEG for sign in (1.0, -1.0)]
    stops += [0.3 * np.array([1 - 2 * (k >> 2 & 1), 1 - 2 * (k >> 1 & 1), 1 - 2 * (k & 1)]) for k in range(8)]
    levels = [level for stop in stops for level in (stop, np.zeros(3))]
    angle_deg = np.repeat(np.array(levels), rows, axis=0)
    return angle_deg + jitter_deg * np.random.default_rng(seed).standard_normal(angle_deg.shape)


def random_slopes(rng, carriers):
    steep = rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3))
    bend = rng.normal([0.0, 0.5, 0.28], 0.1, (carriers, 3))
    return steep - bend, steep + bend


def answer(angle_deg, plus, minus):
    return np.maximum(angle_deg, 0.0) @ plus.T + np.minimum(angle_deg, 0.0) @ minus.T


def test_standard_errors_are_those_of_repeated_experiments():
    plus, minus = random_slopes(np.random.default_rng(2), 1)
    angle_deg = turn_plan(rows=8)
    noise_db = 0.1 * np.random.default_rng(3).standard_normal((len(angle_deg), 400))
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus) + noise_db, gate_sigma=50.0)
    # a standard deviation from 400 draws is good to 3.5 per cent; four of these
    np.testing.assert_allclose(fit.plus_sigma.mean(axis=0), fit.plus.std(axis=0), rtol=0.15)
    np.testing.assert_allclose(fit.minus_sigma.mean(axis=0), fit.minus.std(axis=0), rtol=0.15)
    assert fit.residual_db.mean() == pytest.approx(0.1, rel=0.02)  # 400 x 500 draws


def test_small_angles_about_the_other_axes_are_accounted_for():
    # every turn of roll drags 0.08 deg of pitch along: a fit of roll alone would be 7 per cent off
    plus, minus = random_slopes(np.random.default_rng(4), 3)
    angle_deg = turn_plan()
    angle_deg[:, 2] += 0.16 * angle_deg[:, 1]
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding


def test_an_error_of_the_reference_does_not_reach_the_slopes():
    plus, minus = random_slopes(np.random.default_rng(5), 3)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus) + 0.05 * np.random.default_rng(6).standard_normal((len(angle_deg), 3))
    right, wrong = fit_turn_sensitivity(angle_deg, deviation_db), fit_turn_sensitivity(angle_deg, deviation_db + 1.0)
    np.testing.assert_allclose(right.plus, wrong.plus, rtol=0.0, atol=1e-12)  # rounding
    np.testing.assert_allclose(wrong.level_db - right.level_db, 1.0, rtol=0.0, atol=1e-12)  # rounding


def test_a_shower_and_impulses_are_rejected_and_counted():
    plus, minus = random_slopes(np.random.default_rng(7), 2)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus) + 0.02 * np.random.default_rng(8).uniform(
        -1.0, 1.0, (len(angle_deg), 2)
    )
    deviation_db[100:112, 0] -= 5.0
    deviation_db[300, 1] += 9.0
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert fit.samples_rejected.tolist() == [12, 1]
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=0.02)  # five sigmas of 0.004 dB/deg


def test_a_side_never_turned_is_nan_and_flagged_for_all():
    plus, minus = random_slopes(np.random.default_rng(9), 2)
    angle_deg = np.abs(turn_plan(jitter_deg=0.0))
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding
    assert np.isnan(fit.minus).all()
    assert np.isnan(fit.minus_sigma).all()
    np.testing.assert_allclose(fit.symmetric, plus, rtol=0.0, atol=1e-12)  # the side there is
    assert fit.is_missing.tolist() == [[[False, True]] * 3] * 2


def test_small_angles_on_a_missing_side_follow_the_other_side():
    plus, minus = random_slopes(np.random.default_rng(10), 1)
    angle_deg = turn_plan(jitter_deg=0.0)
    angle_deg[:, 0] = np.maximum(angle_deg[:, 0], -0.09)  # yaw never reaches -0.1 deg
    minus[:, 0] = plus[:, 0]
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding
    assert np.isnan(fit.minus[0, 0])
    assert fit.residual_db[0] < 1e-12


def test_a_carrier_that_was_off_during_a_turn_misses_that_side_alone():
    plus, minus = random_slopes(np.random.default_rng(11), 2)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus)
    deviation_db[angle_deg[:, 1] > 0.1, 1] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert not fit.is_missing[0].any()
    assert np.argwhere(fit.is_missing[1]).tolist() == [[1, 0]]
    np.testing.assert_allclose(
        fit.minus, minus, rtol=0.0, atol=0.02
    )  # jitter of roll reaches 0.04 deg on the plus side


def test_a_carrier_with_too_few_samples_is_nan():
    angle_deg = turn_plan()
    deviation_db = np.zeros((len(angle_deg), 2))
    deviation_db[15:, 0] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert np.isnan(fit.plus[0]).all()
    assert np.isnan([fit.level_db[0], fit.residual_db[0]]).all()
    assert (fit.samples_used[0], fit.samples_rejected[0]) == (0, 0)
    assert fit.is_missing[0].all()
    assert np.isfinite(fit.plus[1]).all()


def test_turns_that_do_not_tell_the_axes_apart_give_nan():
    angle_deg = np.outer(np.tile([-0.4, 0.4], 30), [1.0, 1.0, 1.0])
    assert np.isnan(fit_turn_sensitivity(angle_deg, np.zeros((60, 1))).plus).all()


def test_a_level_that_wanders_is_kept_out_of_the_slopes():
    plus, minus = random_slopes(np.random.default_rng(12), 3)
    angle_deg = turn_plan()
    time_s = 60.0 * np.arange(len(angle_deg))
    wander_db = level_knots(time_s, 7200.0) @ np.random.default_rng(13).normal(
        0.0, 0.1, (len(level_knots(time_s, 7200.0).T), 3)
    )
    deviation_db = answer(angle_deg, plus, minus) + wander_db
    with_knots = fit_turn_sensitivity(angle_deg, deviation_db, baseline=level_knots(time_s, 7200.0))
    np.testing.assert_allclose(with_knots.plus, plus, rtol=0.0, atol=1e-11)  # rounding
    constant = fit_turn_sensitivity(angle_deg, deviation_db)
    assert np.abs(constant.plus - plus)[:, 0].max() > 0.02


def test_knots_without_samples_have_no_level():
    plus, minus = random_slopes(np.random.default_rng(14), 1)
    angle_deg = turn_plan()
    time_s = 60.0 * np.arange(len(angle_deg))
    deviation_db = answer(angle_deg, plus, minus)
    deviation_db[:200] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db, baseline=level_knots(time_s, 1800.0))
    np.testing.assert_allclose(
        fit.plus[0, 1:], plus[0, 1:], rtol=0.0, atol=1e-11
    )  # rounding; yaw was lost with the rows


@pytest.mark.parametrize("span_s", [0.0, 100.0, 5000.0, 86_400.0])
def test_knots_add_up_to_one(span_s):
    knots = level_knots(np.linspace(7.0, 7.0 + span_s, 50), 1000.0)
    np.testing.assert_allclose(knots.sum(axis=1), 1.0, rtol=0.0, atol=1e-12)  # rounding
    assert np.all(knots >= 0.0)


def test_columns_and_mean_slope():
    columns = one_sided_columns(np.array([[0.1, -0.2, 0.3]]))
    assert columns.tolist() == [[0.1, 0.0, 0.3, 0.0, -0.2, 0.0]]
    assert symmetric_sensitivity(np.array([np.nan]), np.array([3.0])).tolist() == [3.0]
